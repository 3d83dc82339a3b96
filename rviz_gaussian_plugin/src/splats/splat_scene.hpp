#pragma once

#include <array>
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

#include "renderers.hpp"
#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/order/built_in_sorter.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/order_book.hpp"
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

// What has arrived and isn't drawn yet.
struct Backlog {
  std::size_t edits = 0;
  std::size_t bytes = 0;
};

// A map with everything that draws it. apply() and offer() may be called from any thread; whatever
// touches OpenGL happens in the render thread, in draw() and the reads.
class SplatScene {
 public:
  explicit SplatScene(std::shared_ptr<Renderers> renderers) : renderers_(std::move(renderers)) {}
  // Drawn together with no other.
  explicit SplatScene(ShaderSource shaders)
      : SplatScene(std::make_shared<Renderers>(std::move(shaders))) {}
  ~SplatScene();

  // Any thread: checks a batch and queues it for the next frame. Throws BatchError.
  BatchReport apply(const GaussianBatch& batch);
  // Any thread: an order to fill, and a sidecar's to be drawn.
  std::shared_ptr<Order> newOrder() { return pool_.make(); }
  void offer(OrderPtr order);
  // Any thread: how many slots an order of a map can have.
  std::size_t mostSlots(const std::string& map_id, std::uint64_t revision) const;
  // Any thread: the map as queued so far.
  MapState state() const;
  // Any thread: what of it waits to be drawn.
  Backlog backlog() const;
  // Any thread: where that map and cameras in its frame are hard to draw; see hardRegimes().
  std::vector<std::string> hardRegimes(const RenderSettings& settings,
                                       const std::vector<SplatCamera>& cameras) const;

  // Render thread: the camera of a view; sequence grows by one with each.
  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);
  // Render thread: has it drawn by what the settings ask for. Throws gl::Error.
  void prepare(const RenderSettings& settings);
  // Render thread: uploads some of what waits, for a map that isn't to be seen. Throws gl::Error.
  void upload(const RenderSettings& settings);
  // Render thread: whether a sidecar's orders are drawn, or only its own. Throws gl::Error.
  bool wantsOrders(const RenderSettings& settings);
  // Render thread: uploads what waits; whether an order of the sidecar is there for the view's
  // newest camera and the whole map. Throws gl::Error.
  bool answered(const std::string& view_id, const RenderSettings& settings);
  // Render thread: whether draw() with these settings, which aren't asynchronous, doesn't have to
  // wait for the processor; has it begin otherwise. Throws gl::Error.
  bool ready(const std::string& view_id, const RenderSettings& settings, bool sort_now);
  // Render thread: uploads what waits, chooses an order and draws into the current framebuffer.
  // With sort_now none is waited for: it is sorted here, on the graphics card if there is one,
  // unless the settings name another. Throws gl::Error.
  const FrameReport& draw(const std::string& view_id, const RenderSettings& settings, Canvas canvas,
                          bool sort_now = false, const Surroundings& around = {});
  // Render thread: the same of several maps in one picture, in one order by depth; whose cameras
  // are one camera, and which are together().
  struct Part {
    SplatScene* scene;
    std::string view_id;
    RenderSettings settings;
  };
  static void draw(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                   const Surroundings& around);
  // Render thread: whether maps that are prepared are drawn by the same, and so in one picture. A
  // graphics card has to sort for it.
  static bool together(const SplatScene& one, const SplatScene& other);
  // Render thread: after a draw() of a view with translucent objects; see SplatRenderer.
  void hideFarther(const std::string& view_id) const {
    software_ ? software_->hideFarther() : renderer_->hideFarther(view_id);
  }
  void drawBefore(const std::string& view_id) const {
    software_ ? software_->drawBefore() : renderer_->drawBefore(view_id);
  }
  // Render thread: what draw() drew last of a view; of no order source before.
  FrameReport report(const std::string& view_id) const;
  // The same where rviz's mouse tools look at a view, or a part of it.
  struct Touched {
    SplatScene* scene;
    std::string view_id;
    RenderSettings settings;
    SplatCamera camera;
  };
  // Render thread: writes where the surface is that a view shows; see SplatRenderer. A graphics
  // card draws it anew, in the order that it waits for.
  static void drawSurface(const std::vector<Touched>& parts, Canvas canvas, double far_clip);
  // Render thread: writes a number where splats are seen, as pick() finds them; see SplatRenderer.
  // A graphics card sorts for it; without one it is where a view shows some.
  static void drawPick(const std::vector<Touched>& parts, Canvas canvas, std::uint32_t number);
  // Render thread, after drawPick(), of which this was a part: which they are, of each part.
  // Without a graphics card, they are found beside.
  std::vector<Pick> pick() { return software_ ? software_->pick() : renderer_->readPick(); }
  // Render thread: the values of slots as they are drawn, in the map's frame.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;
  // Render thread: the map as it is drawn.
  const MapState& drawnMap() const { return drawn_map_; }
  // Render thread: whether a view has a camera, and is not forgotten since.
  bool knows(const std::string& view_id) const { return cameras_.count(view_id) > 0; }
  void forget(const std::string& view_id);

  // Whether the driver can't draw at all; what is received is then forgotten.
  bool unusable() const { return unusable_; }
  // Render thread: what the driver can't do; see SplatRenderer.
  std::string warning() const { return renderer_ ? renderer_->warning() : ""; }
  // Render thread: why a part of the map is missing, empty where none is.
  const std::string& uploadError() const { return upload_error_; }

  // Render thread: what draw() drew last; see SplatRenderer.
  std::vector<float> readColor() const {
    return software_ ? software_->readColor() : renderer_->readColor();
  }
  std::vector<float> readDepth() {
    return software_ ? software_->readDepth() : renderer_->readDepth();
  }

  std::size_t gpuBytes() const;
  std::size_t mapBytes() const;
  std::size_t levelsBytes() const;  // of what draws the map
  std::size_t hostBytes() const;
  // By what draws this and other maps: of gpuBytes(), and beside hostBytes().
  std::size_t sharedGpuBytes() const;
  std::size_t sharedHostBytes() const;

 private:
  // What was drawn of a view lately.
  struct Pace {
    // Of the frames; of their pictures, and of these pictures' cameras. [s]
    std::deque<double> times, ages, offs;
  };

  bool prefersSoftware(const RenderSettings& settings);
  void moveToCard();
  MapState queued() const;
  void book(const MapState& map);
  bool nextEdit(std::shared_ptr<const GaussianEdit>& edit, MapState& state);
  void takeOrders();
  void takeMap();  // as the painter has it by now
  void leavePainter();
  void leaveCard();
  OrderBook::Choice choose(const std::string& view_id, OrderSource source, bool sort_now);
  ViewedMap viewed(const std::string& view_id, const RenderSettings& settings, bool sort_now,
                   bool alone);
  static void drawOnCard(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                         const Surroundings& around);
  static void drawSoftware(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                           const Surroundings& around);
  void describe(const Painting& painting, bool exact, const Part& part, FrameReport& report) const;
  void keepPace(const std::string& view_id, FrameReport& report);
  bool sortsOnGpu(OrderSource source);
  OrderPtr sortNow(const SplatCamera& camera);  // for the mouse tools; null: on the graphics card
  static std::vector<CardView> touchedOnCard(const std::vector<Touched>& parts);
  static std::vector<ViewedMap> touchedSoftware(const std::vector<Touched>& parts);
  void takeArrivals(std::size_t budget);
  void take(const EditQueue::Waiting& arrival);
  void feedSorter();
  OrderPtr unsorted();

  // Gives memory back to the system: what the painter's threads have freed, glibc keeps for them.
  struct Trim {
    ~Trim();
  } trim_;  // first, so that all else is gone by then

  mutable std::mutex queue_mutex_;  // arrivals_, queued_, orders_
  OrderPool pool_;
  GaussianMap map_;
  EditQueue arrivals_;
  MapState queued_;                         // after arrivals_
  std::map<std::string, OrderPtr> orders_;  // newest by view
  std::atomic<bool> unusable_{false};

  // Render thread only.
  std::shared_ptr<Renderers> renderers_;
  std::string upload_error_;
  std::shared_ptr<SplatRenderer> renderer_;
  std::shared_ptr<CardMap> card_;
  std::shared_ptr<CardMap> next_card_;  // what replaces it, until that is whole
  BuiltInSorter sorter_{pool_, [this] { feedSorter(); }};
  OrderBook book_{sorter_};
  std::map<std::string, SplatCamera> cameras_;
  std::map<std::string, FrameReport> reports_;
  std::map<std::string, Pace> paces_;
  MapState drawn_map_, booked_;
  std::optional<bool> auto_is_software_;
  std::uint64_t surface_sequence_ = 0;
  OrderPtr unsorted_;
  std::array<std::uint64_t, 3> unsorted_of_{};  // round, capacity and number of pages
  // Or renderer_; its thread takes arrivals_.
  std::shared_ptr<SoftwareRenderer> software_;
  PaintedMapPtr painted_;
};

}  // namespace rosplat
