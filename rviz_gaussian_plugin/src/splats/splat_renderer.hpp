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
#include "gl/driver.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "gl/stopwatch.hpp"
#include "gl/target.hpp"
#include "gpu/card_map.hpp"
#include "gpu/frame.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/slot_reader.hpp"
#include "gpu/splat_picker.hpp"
#include "gpu/view_state.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/picture.hpp"
#include "rosplat_core/views/pick.hpp"
#include "rosplat_core/views/splat_camera.hpp"
#include "view_names.hpp"

namespace rosplat {

using CardPicture = Picture<std::shared_ptr<CardMap>>;

// Draws maps with OpenGL 4.4. Visible splats are projected once a frame, then blended tile by tile,
// in a given order or in one found here. Knows no Ogre. Render thread only.
class SplatRenderer {
 public:
  // Throws gl::Error if the driver lacks what this needs, or sorts wrongly.
  explicit SplatRenderer(const ShaderSource& source);

  double clock() const;  // of `change` in packed_slot.hpp

  // Makes an empty map for this renderer alone.
  std::shared_ptr<CardMap> makeMap() const { return std::make_shared<CardMap>(scatter_); }

  // Begins a picture: submits what the scene's other objects don't change, so that the graphics
  // card works while these are drawn. Without a given order, splats are sorted by the sorters'
  // depth, with the same ties. The view's state is kept until forget(), or until others need the
  // memory.
  void begin(const CardPicture& picture, Canvas canvas);
  // What draw() drew of each map.
  struct OfMap {
    std::size_t drawn = 0;     // splats, and nodes that stand for splats
    double error = 0;          // to which nodes stand for splats, 0 in full detail [px]
    std::string detail_error;  // why it is not in the detail that was asked for
  };
  // Draws the picture that was just begun: blends the splats into a target of the view, then lays
  // the target over the current viewport, which has the camera's size. Nearer objects in the
  // current framebuffer and viewport hide splats. If translucent objects are to follow, the splats
  // are divided at the nearest of these in each pixel, and only splats behind it are laid over.
  std::vector<OfMap> draw(const Surroundings& around);
  void forget(const std::string& view_id);
  // After a divided draw() of a view: the splats laid over hide farther translucent objects where
  // their opacity is at least one half.
  void hideFarther(const std::string& view_id) const;
  // Lays over the splats that draw() kept back, once the translucent objects are drawn.
  void drawBefore(const std::string& view_id) const;

  // Writes the depth of the splats' surface, for rviz's mouse tools, into the current framebuffer
  // and viewport: mean depth / far_clip as 24-bit colour, lowest byte in blue. Depths are those
  // where a ray meets a splat: an ellipse's plane, as splat_depths.glsl has it.
  void drawSurface(const CardPicture& picture, Canvas canvas, double far_clip);

  // Finds the splat that contributes most to each pixel, if that is at least a twentieth of its
  // colour, among splats that the current framebuffer and viewport don't hide. Writes a number to
  // these pixels as 24-bit colour, for rviz's selection.
  void drawPick(const CardPicture& picture, Canvas canvas, std::uint32_t number);
  // The slots that drawPick() found, by map: width * height, top row first, kNoSlot for none.
  std::vector<Pick> readPick() const;

  // The values of slots as they are drawn.
  std::vector<SplatValues> readSlots(const CardMap& map,
                                     const std::vector<std::uint32_t>& slots) const;

  // The splats that draw() blended: width * height * 4 floats, premultiplied, top row first.
  std::vector<float> readColor() const;
  // Draws depths of the picture that draw() drew last, as TileRasterizer::blendDepth() has them.
  // The target is valid until the next picture.
  const gl::Target& drawDepth(PictureDepth depth);
  // The same for the processor: the mean depth of the picture that draw() drew last: width * height
  // [m], NaN where there are no splats. Maps are shown as they are now.
  std::vector<float> readDepth();

  // For the user: what the driver can't do and what is done instead. Empty if it can do everything.
  std::string warning() const;
  // Whether OpenGL draws on the processor.
  bool emulated() const { return emulated_; }

  // Of the last draw(), by stage [s]; empty unless settings.profile asked for it.
  const std::map<std::string, double>& profile() const { return profile_; }
  std::size_t gpuBytes() const;  // beside the maps

 private:
  struct RenderedView {
    explicit RenderedView(std::unique_ptr<ViewState> of) : state(std::move(of)) {}

    std::unique_ptr<ViewState> state;
    std::uint64_t used = 0;  // used_ when it was last drawn
  };
  // A picture that was begun, and isn't drawn yet.
  struct Begun {
    Begun(const SplatRenderer& renderer, const CardPicture& of, Canvas on);

    CardPicture picture;
    std::vector<CardMap::Chosen> chosen;  // detail of each map
    Canvas canvas;
    ViewState* view = nullptr;
    gl::Stopwatch stopwatch;
    Frame frame;  // of `picture`
  };
  // The picture that was drawn last.
  struct Drawn {
    CardPicture picture;
    std::vector<double> errors;  // of its layers, as Frame has them
    Canvas canvas;
    ViewState* view;
  };

  // The state of a view. If all states take too much memory, a new view takes over the oldest one.
  RenderedView& view(const std::string& name);
  // The state of a display's view, null if none is kept.
  const ViewState* stateOf(const std::string& view_id) const;
  void drop(const std::string& name);
  Frame frame(const CardPicture& picture, Canvas canvas, gl::Stopwatch& stopwatch) const;
  // Submits the depths of a frame into a target, whose own depths hide splats.
  static void blendDepth(ViewState& view, Frame& frame, PictureDepth depth,
                         const gl::Target& target);
  // Copies the window's depth into the target that is bound, or clears that if the driver can't.
  void copyDepth(const CanvasScope& window, const gl::Target& target);
  static void keepTranslucent(ViewState& view, const SplatCamera& camera,
                              const std::function<void()>& draw);
  void divide(ViewState& view) const;
  // Lays splats over the canvas.
  void composite(const CanvasScope& window, const gl::Target& splats) const;

  Shaders shaders_;
  const gl::Program& scatter_;  // slot_scatter.comp
  SlotReader reader_;
  RadixSort sort_;                 // which the contexts of all windows use
  GLsync sort_is_free_ = nullptr;  // of the last gl::Turn; the destructor leaves it to its context
  SplatPicker picker_;
  const gl::Program &divide_, &composite_, &compute_composite_, &hide_, &surface_;

  ViewNames names_;
  std::map<std::string, RenderedView> views_;  // by name
  std::uint64_t used_ = 0;                     // number of view() calls
  std::unique_ptr<Begun> begun_;
  std::optional<Drawn> drawn_;
  std::size_t picked_layers_ = 0;
  gl::Target depth_, surface_depth_, pick_depth_;
  std::map<GLenum, bool> copies_depth_;  // whether the driver does, by format
  const bool emulated_ = !gl::accelerated();
  bool leaves_out_ = false;  // some splats of the last picture, for lack of memory
  std::map<std::string, double> profile_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace rosplat
