#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/card_map.hpp"
#include "gpu/frame.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/slot_reader.hpp"
#include "gpu/splat_picker.hpp"
#include "gpu/view_state.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/views/pick.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"
#include "view_names.hpp"
#include "viewed_map.hpp"

namespace rosplat {

using CardView = Viewed<CardMap>;

// Draws maps with OpenGL 4.4: what is visible is projected once a frame, then blended in a given
// order or in one found here, as quads or in tiles. Maps of one view are in one picture, by depth,
// for which the settings of the first decide what doesn't concern a map alone: the rasterizer, its
// precision, the profile. Knows no Ogre; runs in the render thread only.
class SplatRenderer {
 public:
  // Throws gl::Error where the driver can't do it.
  explicit SplatRenderer(const ShaderSource& source);

  double clock() const;  // of `change` in packed_slot.hpp

  // A map without slots, for no other renderer.
  std::shared_ptr<CardMap> makeMap() const { return std::make_shared<CardMap>(scatter_); }

  // What draw() drew of each map.
  struct OfMap {
    std::size_t drawn = 0;     // splats, and nodes that stand for some
    double error = 0;          // to which they do, 0 in full [px]
    std::string detail_error;  // why it is not in the detail that was asked for
  };
  // Blends the splats, in an order or, without one, by the sorters' depth and with their ties,
  // hidden where the current framebuffer and viewport have something nearer, into a target of the
  // view's; then over that viewport, which has the camera's size. Where the scene has translucent
  // objects, which come next, the splats are divided at the nearest of them in each pixel, and only
  // those behind it are laid over. What a view sees is kept until it is forgotten, or others need
  // the memory.
  std::vector<OfMap> draw(const std::vector<CardView>& maps, Canvas canvas,
                          const Surroundings& around = {});
  void forget(const std::string& view_id);
  // Lets the splats that a divided draw() of a view has laid over hide what is translucent and
  // farther, where they are more opaque than not.
  void hideFarther(const std::string& view_id) const;
  // Lays over the splats that it has kept back, once the translucent objects are drawn.
  void drawBefore(const std::string& view_id) const;

  // Writes where the splats' surface is, for rviz's mouse tools, into the current framebuffer and
  // viewport: mean depth / far_clip as 24-bit colour, lowest byte in blue.
  void drawSurface(const std::vector<CardView>& maps, Canvas canvas, double far_clip);

  // Finds the splat that contributes most to each pixel, at least a twentieth of its colour, among
  // those that the current framebuffer and viewport don't hide; then writes there a number, for
  // rviz's selection, as 24-bit colour.
  void drawPick(const std::vector<CardView>& maps, Canvas canvas, std::uint32_t number);
  // What it found of each map: width * height slots, top row first; kNoSlot where there is none.
  std::vector<Pick> readPick() const;

  // The values of slots as they are drawn.
  std::vector<SplatValues> readSlots(const CardMap& map,
                                     const std::vector<std::uint32_t>& slots) const;

  // The splats that draw() blended: width * height * 4 floats, premultiplied, top row first.
  std::vector<float> readColor() const;
  // Draws the mean depth of the splats as draw() saw them: width * height [m], NaN where nothing
  // is. Only right after it: what is drawn for the mouse sees others.
  std::vector<float> readDepth();

  // Whether the GPU sorts right, which is tried when first asked: if not, nothing is drawn or
  // picked in tiles, nor without an order.
  bool sorts();
  // What the driver can't do, and what is done instead, for the user; empty where nothing is.
  std::string warning() const;

  // Whether a graphics card draws, not the processor.
  bool accelerated() const { return accelerated_; }
  // Of the last draw().
  const char* rasterizer() const { return drawn_->rasterizer(); }
  // Of the last draw(), by stage [s]; empty unless settings.profile asked for it.
  const std::map<std::string, double>& profile() const { return profile_; }
  std::size_t gpuBytes() const;  // beside the maps

 private:
  struct RenderedView {
    explicit RenderedView(std::unique_ptr<ViewState> of) : state(std::move(of)) {}

    std::unique_ptr<ViewState> state;
    std::uint64_t used = 0;  // the last time
  };

  // The name of the view that maps are in.
  const std::string& join(const std::vector<CardView>& maps);
  // What is kept of a view; where that were too much, another's, drawn longest ago, becomes its.
  RenderedView& view(const std::string& name);
  // Null where there is nothing of a display's view.
  const ViewState* stateOf(const std::string& view_id) const;
  void drop(const std::string& name);
  Frame frame(const std::vector<CardView>& maps, Canvas canvas, gl::Stopwatch& stopwatch) const;
  // As the window's own, where the driver can.
  void copyDepth(const CanvasScope& window, const gl::Target& target);
  static void keepTranslucent(ViewState& view, const SplatCamera& camera,
                              const std::function<void()>& draw);
  void divide(ViewState& view) const;
  // Lays splats over the canvas.
  void composite(const CanvasScope& window, const gl::Target& splats) const;

  bool accelerated_;
  Shaders shaders_;
  const gl::Program& scatter_;  // slot_scatter.comp
  SlotReader reader_;
  RadixSort sort_;
  std::optional<bool> sorts_;
  SplatPicker picker_;
  const gl::Program &divide_, &composite_, &compute_composite_, &hide_, &surface_;

  ViewNames names_;
  std::map<std::string, RenderedView> views_;  // by name
  std::uint64_t used_ = 0;                     // views so far
  ViewState* drawn_ = nullptr;                 // last
  std::size_t picked_layers_ = 0;
  gl::Target depth_, surface_depth_, pick_depth_;
  GLenum copied_depth_ = 0, refused_depth_ = 0;  // formats that the driver did, or wouldn't copy
  std::map<std::string, double> profile_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace rosplat
