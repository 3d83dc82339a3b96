#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "gl/canvas.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/picture.hpp"
#include "rosplat_core/views/pick.hpp"

namespace rosplat {

// What a frame drew.
struct FrameReport {
  std::size_t splats = 0;                 // drawn, counting nodes that stand for splats
  std::size_t maps = 1;                   // in this picture, sorted together
  double error = 0;                       // of the levels drawn, 0 in full detail [px]
  std::string detail_error;               // why the detail asked for could not be drawn
  std::string order_source;               // what sorted, empty if nothing is drawn yet
  bool order_fresh = false;               // whether the order is for this camera and map
  double order_age = 0;                   // [s]
  double sort_time = 0;                   // [s]
  double draw_time = 0;                   // of the render thread [s]
  double paint_time = 0;                  // of the painter's thread, if that rasterises [s]
  double frame_interval = 0;              // 95th percentile over recent frames [s]
  double picture_age = 0;                 // recent maximum, 0 for a picture of this camera [s]
  double camera_off = 0;                  // recent maximum: time from its camera to this one [s]
  std::string rasterizer;                 // "tiles" or "processor"
  bool emulated = false;                  // no card draws the tiles, OpenGL does on the processor
  std::map<std::string, double> profile;  // time of each stage, if asked for [s]
  MapState map;                           // the map as it was drawn
};

// The memory of a map where it is drawn.
struct DrawnBytes {
  std::size_t map = 0, levels = 0;
  std::size_t gpu = 0, host = 0;                // of both, and uploads
  std::size_t shared_gpu = 0, shared_host = 0;  // further memory, shared with other maps
};

// Where a map is drawn.
enum class DrawnBy { kCard, kProcessor };

// Holds a map in the memory that it is drawn from, and draws it. A Drawer takes the map's edits
// while it has their Taker. Another Drawer takes over with copy(). Render thread only.
class Drawer {
 public:
  using Picture = rosplat::Picture<Drawer*>;

  virtual ~Drawer() = default;
  virtual DrawnBy by() const = 0;

  // Copies all that another Drawer holds. Throws gl::Error or std::bad_alloc if memory is lacking.
  void copy(Drawer& other) {
    other.settle();
    other.forEachPage([this](const GaussianEdit& page) { load(page); });
    load(other.map());
  }
  // Applies arrived edits: all of them, or as many as a frame has time for. Returns the map state
  // that an order must match to be drawn.
  virtual MapState update(bool all) = 0;
  // Shows the newest map that is held, even if parts of it are still to come.
  virtual void settle() {}
  // The state of the map as it is held and shown.
  virtual MapState map() const = 0;
  // Calls take() with edits that rebuild the map elsewhere: group poses first, then page by page.
  virtual void forEachPage(const std::function<void(const GaussianEdit&)>& take) const = 0;
  // The values of slots as they are drawn, in the map's frame.
  virtual std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const = 0;

  // Whether both maps can be in one picture, sorted together.
  virtual bool drawsWith(const Drawer& other) const = 0;
  // The rest draws pictures of maps, this drawer's map among them.

  // Has a picture made that isn't interactive, for draw() to find once it is ready().
  virtual void request(const Picture&) {}
  // Whether draw() need not wait for the processor.
  virtual bool ready(const Picture&) const { return true; }
  // Begins a picture. draw() follows before the next one.
  virtual void begin(const Picture&, Canvas) {}
  // Draws the picture into the current framebuffer. Returns a report of each map.
  virtual std::vector<FrameReport> draw(const Picture& picture, Canvas canvas,
                                        const Surroundings& around) = 0;
  // After draw() of a view with translucent objects. SplatRenderer explains these five methods.
  virtual void hideFarther(const std::string& view_id) const = 0;
  virtual void drawBefore(const std::string& view_id) const = 0;
  virtual void drawSurface(const Picture& picture, Canvas canvas, double far_clip) = 0;
  virtual void drawPick(const Picture& picture, Canvas canvas, std::uint32_t number) = 0;
  virtual std::vector<Pick> pick() = 0;
  // What draw() drew last; see SplatRenderer.
  virtual std::vector<float> readColor() const = 0;
  virtual std::vector<float> readDepth() = 0;
  virtual void forget(const std::string& view_id) = 0;

  virtual std::string warning() const { return ""; }  // what the driver can't do
  virtual DrawnBytes bytes() const = 0;

 private:
  virtual void load(const GaussianEdit& page) = 0;
  virtual void load(const MapState& map) = 0;
};

}  // namespace rosplat
