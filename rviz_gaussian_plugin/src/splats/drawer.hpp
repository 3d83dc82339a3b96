#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "gl/canvas.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/views/pick.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// What a frame drew.
struct FrameReport {
  std::size_t splats = 0;                 // drawn, and nodes that stand for some
  std::size_t maps = 1;                   // in the same picture, in one order
  double error = 0;                       // to which they do, 0 where all is drawn in full [px]
  std::string detail_error;               // why that isn't the detail that was asked for
  std::string order_source;               // who sorted, empty where nothing is sorted yet
  bool order_fresh = false;               // for this very camera and map
  double order_age = 0;                   // [s]
  double sort_time = 0;                   // [s]
  double draw_time = 0;                   // of the render thread [s]
  double paint_time = 0;                  // of the processor beside it, if that rasterises [s]
  double frame_interval = 0;              // 19 of 20 frames of late follow within this [s]
  double picture_age = 0;                 // of late at most, 0 where it is of the very camera [s]
  double camera_off = 0;                  // how far its camera was from this one then at most [s]
  std::string rasterizer;                 // "quads", "tiles" or "processor"
  std::map<std::string, double> profile;  // by stage, if asked for [s]
  MapState map;                           // as it was drawn
};

// What a map takes where it is drawn.
struct DrawnBytes {
  std::size_t map = 0, levels = 0;
  std::size_t gpu = 0, host = 0;                // of both, and of what sorts it
  std::size_t shared_gpu = 0, shared_host = 0;  // beside them, with other maps
};

// Who draws maps.
enum class DrawnBy { kCard, kProcessor };

// Holds a map where it is drawn from, and draws it. Edits come from who may take them; another
// takes over by holding what this one held. Render thread only.
class Drawer {
 public:
  // What of a map a view is to show.
  struct Look {
    Drawer* drawer;  // the map's
    std::string view_id;
    SplatCamera camera;
    RenderSettings settings;
    std::optional<OrderBook::Choice> order;  // none: the drawer's own
  };

  virtual ~Drawer() = default;
  virtual DrawnBy by() const = 0;

  // Takes over what another holds. Throws gl::Error or std::bad_alloc where that is too much.
  void hold(Drawer& other) {
    other.settle();
    other.forEachPage([this](const GaussianEdit& page) { hold(page); });
    hold(other.map());
  }
  // Goes on with what has arrived: some of it, or all before the next picture that is waited for.
  // The map that orders have to be of to be drawn then.
  virtual MapState update(bool all) = 0;
  // Has what is held show, even where it isn't whole.
  virtual void settle() {}
  // As it is held, and shown.
  virtual MapState map() const = 0;
  // What writes the map elsewhere: where its groups are, then a page of it at a time.
  virtual void forEachPage(const std::function<void(const GaussianEdit&)>& take) const = 0;
  // The values of slots as they are drawn, in the map's frame.
  virtual std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const = 0;

  // Whether orders from elsewhere are drawn.
  virtual bool wantsOrders(OrderSource source) = 0;
  // The order that a map is drawn in that is alone in its picture; see Look::order. sort_now: none
  // is waited for.
  virtual std::optional<OrderBook::Choice> choose(OrderBook& book, const std::string& view_id,
                                                  OrderSource source, bool sort_now) = 0;

  // Whether both maps can be in one picture, in one order.
  virtual bool drawsWith(const Drawer& other) = 0;
  // Whether a picture that is waited for is there already; has it begun otherwise.
  virtual bool ready(const Look& look) = 0;
  // What follows is of maps that are drawn with each other; this is one of them. Draws into the
  // current framebuffer, and says what of each map.
  virtual std::vector<FrameReport> draw(const std::vector<Look>& looks, Canvas canvas,
                                        const Surroundings& around) = 0;
  // After a draw() of a view with translucent objects; see SplatRenderer, as for the next four.
  virtual void hideFarther(const std::string& view_id) const = 0;
  virtual void drawBefore(const std::string& view_id) const = 0;
  virtual void drawSurface(const std::vector<Look>& looks, Canvas canvas, double far_clip) = 0;
  virtual void drawPick(const std::vector<Look>& looks, Canvas canvas, std::uint32_t number) = 0;
  virtual std::vector<Pick> pick() = 0;
  // What draw() drew last; see SplatRenderer.
  virtual std::vector<float> readColor() const = 0;
  virtual std::vector<float> readDepth() = 0;
  virtual void forget(const std::string& view_id) = 0;

  virtual std::string warning() const { return ""; }  // what the driver can't do
  virtual DrawnBytes bytes() const = 0;

 private:
  virtual void hold(const GaussianEdit& page) = 0;
  virtual void hold(const MapState& map) = 0;
};

}  // namespace rosplat
