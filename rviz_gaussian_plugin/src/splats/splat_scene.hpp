#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "drawer.hpp"
#include "renderers.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/order/picture.hpp"
#include "rosplat_core/threads/freed_memory.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map, the cameras and orders of its views, and its Drawer. apply() and offer() may be called
// from any thread. Only the render thread touches OpenGL, in draw() and the reads.
class SplatScene {
 public:
  explicit SplatScene(std::shared_ptr<Renderers> renderers) : renderers_(std::move(renderers)) {}
  // A scene that shares its renderer with no other.
  explicit SplatScene(ShaderSource shaders)
      : SplatScene(std::make_shared<Renderers>(std::move(shaders))) {}
  ~SplatScene();

  // Any thread: checks a batch and queues it for the next frame. Throws BatchError.
  BatchReport apply(const GaussianBatch& batch);
  // Any thread: newOrder() returns an order to fill, offer() hands in a sidecar's order.
  std::shared_ptr<Order> newOrder() { return pool_.make(); }
  void offer(OrderPtr order);
  // Any thread: the most slots that an order of a map can have.
  std::size_t mostSlots(const std::string& map_id, std::uint64_t revision) const;
  // Any thread: the map including all queued edits.
  MapState state() const;
  // Any thread: the positions of a sample of the map's splats, in the map's frame. [m]
  std::vector<std::array<double, 3>> samplePositions() const { return map_.samplePositions(); }
  // Any thread: the edits that wait to be drawn.
  Backlog backlog() const { return arrivals_->backlog(); }
  // Any thread: in which ways this map and cameras in its frame are hard to draw; see
  // hardRegimes().
  std::vector<std::string> hardRegimes(const RenderSettings& settings,
                                       const std::vector<SplatCamera>& cameras) const;

  // Render thread: sets the camera of a view; sequence grows by one with each.
  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);
  // Render thread: makes the Drawer that the settings ask for. If that fails, the present one goes
  // on until the settings name another rasterizer; throws gl::Error if there is none.
  void prepare(const RenderSettings& settings);
  // Render thread: uploads waiting edits, all of them or as many as a frame has time for. Throws
  // gl::Error.
  void upload(const RenderSettings& settings, bool all = false);
  // Render thread, after upload(): whether the sidecar has answered the view's newest camera for
  // the whole map.
  bool answered(const std::string& view_id) const;
  // Render thread, after upload(): the map as a view sees it. sort_now: with no sidecar's order.
  Layer<Drawer*> layer(const std::string& view_id, const RenderSettings& settings,
                       bool sort_now) const;
  // Render thread: the same for rviz's mouse tools, in full detail and sorted for the camera.
  Layer<Drawer*> layerUnderMouse(const std::string& view_id, RenderSettings settings,
                                 const SplatCamera& camera) const;

  // Maps in one picture, sorted together. Render thread only.
  class Picture {
   public:
    // Whether the map of a prepared scene can be in the picture: one renderer draws all.
    bool takes(const SplatScene& scene) const;
    void add(SplatScene& scene, Layer<Drawer*> layer);
    // What the other objects around the maps don't change is done by begin(), so that the graphics
    // card works while these are drawn. draw() follows before the next begin().
    void begin(Canvas canvas);
    void draw(const Surroundings& around) const;
    // After draw() with translucent objects; see SplatRenderer.
    void hideFarther() const { maps_.map()->hideFarther(maps_.viewId()); }
    void drawBefore() const { maps_.map()->drawBefore(maps_.viewId()); }
    // For rviz's mouse tools: writes the depth of the surface that a view shows; see SplatRenderer.
    void drawSurface(Canvas canvas, double far_clip) const;
    // Writes a number where pick() finds splats; see SplatRenderer.
    void drawPick(Canvas canvas, std::uint32_t number) const;

   private:
    std::vector<SplatScene*> scenes_;  // of the layers
    Drawer::Picture maps_;
    Canvas canvas_ = Canvas::kNone;
    double took_ = 0;  // of the render thread, for begin() [s]
  };
  // Render thread: has a picture made that isn't interactive, for draw() with the same settings to
  // find once it is ready(). Throws gl::Error.
  void request(const std::string& view_id, const RenderSettings& settings, bool sort_now);
  // Whether draw() need not wait for the processor.
  bool ready(const std::string& view_id, const RenderSettings& settings, bool sort_now) const;
  // Render thread: uploads waiting edits and draws into the current framebuffer. sort_now: draws
  // all edits, and no sidecar's order. Throws gl::Error.
  const FrameReport& draw(const std::string& view_id, const RenderSettings& settings, Canvas canvas,
                          bool sort_now = false, const Surroundings& around = {});
  // Render thread: the report of a view's last draw(); without an order source before the first.
  FrameReport report(const std::string& view_id) const;
  // Render thread, after Picture::drawPick() of this map and others: the picked splats of each. The
  // painter's thread finds them where there is no graphics card.
  std::vector<Pick> pick() { return drawer_->pick(); }
  // Render thread: the values of slots as they are drawn, in the map's frame.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;
  // Render thread: the map as it is drawn.
  MapState drawnMap() const { return drawer_ ? drawer_->map() : MapState{}; }
  // Render thread: whether a view has a camera and wasn't forgotten.
  bool knows(const std::string& view_id) const { return cameras_.count(view_id) > 0; }
  void forget(const std::string& view_id);

  // Whether the driver can't draw at all. The map is not kept then.
  bool unusable() const { return unusable_; }
  // Render thread: what the driver can't do; see SplatRenderer.
  std::string warning() const { return drawer_ ? drawer_->warning() : ""; }
  // Render thread: why the map isn't drawn in full or as asked for; empty if it is.
  std::string error() const;

  // Render thread: what draw() drew last; see SplatRenderer.
  std::vector<float> readColor() const { return drawer_->readColor(); }
  std::vector<float> readDepth() { return drawer_->readDepth(); }

  DrawnBytes bytes() const { return drawer_ ? drawer_->bytes() : DrawnBytes{}; }

 private:
  // A frame's time, its picture's age, and the time offset of this picture's camera. [s]
  struct PastFrame {
    double time, age, off;
  };

  void exchange(DrawnBy by);
  void update(bool all);
  void keepPace(const std::string& view_id, FrameReport& report);

  struct Trim {
    ~Trim() { returnFreedMemory(); }
  } trim_;  // first: destroyed last, when all memory is freed

  std::mutex orders_mutex_;  // orders_
  OrderPool pool_;
  GaussianMap map_;
  std::shared_ptr<Arrivals> arrivals_ = std::make_shared<Arrivals>();
  std::map<std::string, OrderPtr> orders_;  // newest by view
  std::atomic<bool> unusable_{false};

  // Render thread only.
  std::shared_ptr<Renderers> renderers_;
  OrderBook book_;
  MapState booked_;  // the state that book_ takes orders of
  std::map<std::string, SplatCamera> cameras_;
  std::map<std::string, FrameReport> reports_;
  std::map<std::string, std::deque<PastFrame>> paces_;  // recent frames
  std::unique_ptr<Drawer> drawer_;
  std::optional<Rasterizer> asked_;  // of the last settings
  std::string refusal_;              // why drawer_ isn't the one asked for
};

}  // namespace rosplat
