#pragma once

#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/card_levels.hpp"
#include "gpu/frame.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/slot_reader.hpp"
#include "gpu/slot_store.hpp"
#include "gpu/splat_picker.hpp"
#include "gpu/view_state.hpp"
#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"
#include "order/order.hpp"

namespace rosplat {

// What a picture draws where there are levels, and no order is given: nodes that are no wider than
// an error in place of splats, 0 for none [px]; and no more of all than that.
struct Cutting {
  double error = 0;
  std::size_t most = std::numeric_limits<std::size_t>::max();
  bool in_time = false;  // it is to take a certain time
};

// Draws a map with OpenGL 4.4: what is visible is projected once a frame, then blended in a given
// order or in one found here, as quads or in tiles. Knows no Ogre; runs in the render thread only.
class SplatRenderer {
 public:
  // Throws gl::Error where the driver can't do it.
  explicit SplatRenderer(const ShaderSource& source);

  // Uploads what the edit changes; its slots are new from now on. Throws gl::Error when the driver
  // has no memory left.
  void apply(const std::shared_ptr<const GaussianEdit>& edit);

  const SlotPages& pages() const { return store_.pages(); }
  // What writes the map elsewhere: where its groups are, then a page of it at a time.
  void forEachPage(const std::function<void(const GaussianEdit&)>& take) const;

  // Has levels of detail made of the map, some of them or, if that is waited for, all. They stay
  // until they are dropped, and want to be advanced as long as there are edits.
  void advanceLevels(bool all);
  void dropLevels();
  bool hasLevels() const { return levels_.has_value(); }
  // Why there are none although they were to be made.
  const std::string& levelsError() const { return levels_error_; }
  // Those that are drawn by now.
  const std::vector<Levels::Nodes>& levels() const { return levels_->nodes().pages(); }
  std::size_t levelsBytes() const { return levels_ ? levels_->bytes() : 0; }

  // Blends the splats, in an order or, without one, by the sorters' depth and with their ties,
  // hidden where the current framebuffer and viewport have something nearer, into a target of the
  // view's; then over that viewport, which has the camera's size. Where the scene has translucent
  // objects, which come next, the splats are divided at the nearest of them in each pixel, and only
  // those behind it are laid over. What a view sees is kept until it is forgotten, or others need
  // the memory.
  void draw(const std::string& view_id, const SplatCamera& camera, const MapState& map,
            const RenderSettings& settings, const OrderPtr& order, Canvas canvas,
            const Surroundings& around = {}, Cutting cutting = {});
  void forget(const std::string& view_id);
  // Lets the splats that a divided draw() has laid over hide what is translucent and farther, where
  // they are more opaque than not.
  void hideFarther() const;
  // Lays over the splats that a divided draw() has kept back, once the translucent objects are
  // drawn.
  void drawBefore() const;

  // Writes where the splats' surface is, for rviz's mouse tools, into the current framebuffer and
  // viewport: mean depth / far_clip as 24-bit colour, lowest byte in blue.
  void drawSurface(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
                   const OrderPtr& order, Canvas canvas, double far_clip);

  // Finds the splat that contributes most to each pixel, at least a twentieth of its colour, among
  // those that the current framebuffer and viewport don't hide; then writes there a number, for
  // rviz's selection, as 24-bit colour.
  void drawPick(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
                const OrderPtr& order, Canvas canvas, std::uint32_t number);
  // What drawPick() found: width * height slots, top row first; kNoSlot where there is none.
  std::vector<std::uint32_t> readPick() const { return picker_.read(); }

  // The values of slots as they are drawn.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;

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
  std::size_t drawn() const { return drawn_->splats().count(); }
  double error() const { return drawn_error_; }  // [px]
  const char* rasterizer() const { return drawn_->rasterizer(); }
  // How long the graphics card took for one of the last pictures of a view that were new, and its
  // error; none is told twice.
  struct Timed {
    double error, seconds;
    bool in_time;
  };
  std::optional<Timed> timed(const std::string& view_id);
  // Of the last draw(), by stage [s]; empty unless settings.profile asked for it.
  const std::map<std::string, double>& profile() const { return profile_; }
  std::size_t mapBytes() const { return store_.bytes(); }
  std::size_t gpuBytes() const;

 private:
  struct View {
    explicit View(std::unique_ptr<ViewState> of) : state(std::move(of)) {}

    std::unique_ptr<ViewState> state;
    std::uint64_t used = 0;  // the last time
    gl::Timer timer;
    double timed_error = 0;
    bool timed_in_time = false;
  };

  void endLevels();
  // What is kept of a view; where that were too much, another's, drawn longest ago, becomes its.
  View& view(const std::string& view_id);
  Frame frame(const SplatCamera& camera, const MapState& map, const RenderSettings& settings,
              const OrderPtr& order, Canvas canvas, gl::Stopwatch& stopwatch) const;
  // As the window's own, where the driver can.
  void copyDepth(const CanvasScope& window, const gl::Target& target);
  static void keepTranslucent(ViewState& view, const SplatCamera& camera,
                              const std::function<void()>& draw);
  void divide(ViewState& view) const;
  double clock() const;  // of `change` in packed_slot.hpp

  bool accelerated_;
  Shaders shaders_;
  SlotStore store_;
  std::optional<CardLevels> levels_;
  std::string levels_error_;
  SlotReader reader_;
  RadixSort sort_;
  std::optional<bool> sorts_;
  SplatPicker picker_;
  const gl::Program &divide_, &composite_, &hide_, &surface_;

  std::map<std::string, View> views_;
  std::uint64_t used_ = 0;      // views so far
  ViewState* drawn_ = nullptr;  // last
  double drawn_error_ = 0;
  gl::Target depth_, surface_depth_, pick_depth_;
  GLenum copied_depth_ = 0, refused_depth_ = 0;  // formats that the driver did, or wouldn't copy
  std::map<std::string, double> profile_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace rosplat
