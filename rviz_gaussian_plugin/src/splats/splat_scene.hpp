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
#include "rosplat_core/order/built_in_sorter.hpp"
#include "rosplat_core/order/order.hpp"
#include "rosplat_core/order/order_book.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// A map, the cameras and orders of its views, and what draws it. apply() and offer() may be called
// from any thread; whatever touches OpenGL happens in the render thread, in draw() and the reads.
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
  Backlog backlog() const { return arrivals_->backlog(); }
  // Any thread: where that map and cameras in its frame are hard to draw; see hardRegimes().
  std::vector<std::string> hardRegimes(const RenderSettings& settings,
                                       const std::vector<SplatCamera>& cameras) const;

  // Render thread: the camera of a view; sequence grows by one with each.
  void setCamera(const std::string& view_id, std::uint64_t sequence, const SplatCamera& camera);
  // Render thread: has it drawn by what the settings ask for. If that can't, who draws it goes on,
  // until another rasterizer is asked for; throws gl::Error where nobody does.
  void prepare(const RenderSettings& settings);
  // Render thread: uploads some of what waits, for a map that isn't to be seen. Throws gl::Error.
  void upload(const RenderSettings& settings);
  // Render thread: whether a sidecar's orders are drawn, or only its own. Throws gl::Error.
  bool wantsOrders(const RenderSettings& settings);
  // Render thread: uploads what waits; whether an order of the sidecar is there for the view's
  // newest camera and the whole map. Throws gl::Error.
  bool answered(const std::string& view_id, const RenderSettings& settings);

  // The map in a view.
  struct InView {
    SplatScene* scene;
    std::string view_id;
    RenderSettings settings;
    std::optional<SplatCamera> camera = {};  // if it isn't the view's
  };
  // Render thread: whether draw() with these settings, which aren't interactive, doesn't have to
  // wait for the processor; has it begin otherwise. Throws gl::Error.
  bool ready(const std::string& view_id, const RenderSettings& settings, bool sort_now);
  // Render thread: uploads what waits, chooses an order and draws into the current framebuffer.
  // With sort_now none is waited for: it is sorted here, on the graphics card if there is one,
  // unless the settings name another. Throws gl::Error.
  const FrameReport& draw(const std::string& view_id, const RenderSettings& settings, Canvas canvas,
                          bool sort_now = false, const Surroundings& around = {});
  // Render thread: the same of several maps in one picture, in one order by depth; whose cameras
  // are one camera, and which are together().
  static void draw(const std::vector<InView>& maps, Canvas canvas, bool sort_now,
                   const Surroundings& around);
  // Render thread: whether maps that are prepared are drawn by the same, and so in one picture. A
  // graphics card has to sort for it.
  static bool together(const SplatScene& one, const SplatScene& other) {
    return one.drawer_->drawsWith(*other.drawer_);
  }
  // Render thread: after a draw() of a view with translucent objects; see SplatRenderer.
  void hideFarther(const std::string& view_id) const { drawer_->hideFarther(view_id); }
  void drawBefore(const std::string& view_id) const { drawer_->drawBefore(view_id); }
  // Render thread: what draw() drew last of a view; of no order source before.
  FrameReport report(const std::string& view_id) const;
  // Render thread, for rviz's mouse tools: writes where the surface is that a view shows; see
  // SplatRenderer. A graphics card draws it anew, in the order that it waits for.
  static void drawSurface(const std::vector<InView>& maps, Canvas canvas, double far_clip);
  // Render thread: writes a number where splats are seen, as pick() finds them; see SplatRenderer.
  // A graphics card sorts for it; without one it is where a view shows some.
  static void drawPick(const std::vector<InView>& maps, Canvas canvas, std::uint32_t number);
  // Render thread, after drawPick() of this map and others: which they are, of each. Without a
  // graphics card, they are found beside.
  std::vector<Pick> pick() { return drawer_->pick(); }
  // Render thread: the values of slots as they are drawn, in the map's frame.
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const;
  // Render thread: the map as it is drawn.
  MapState drawnMap() const { return drawer_ ? drawer_->map() : MapState{}; }
  // Render thread: whether a view has a camera, and is not forgotten since.
  bool knows(const std::string& view_id) const { return cameras_.count(view_id) > 0; }
  void forget(const std::string& view_id);

  // Whether the driver can't draw at all; what is received is then forgotten.
  bool unusable() const { return unusable_; }
  // Render thread: what the driver can't do; see SplatRenderer.
  std::string warning() const { return drawer_ ? drawer_->warning() : ""; }
  // Render thread: why not all of the map is drawn, or not as it is asked for; empty where it is.
  std::string error() const;

  // Render thread: what draw() drew last; see SplatRenderer.
  std::vector<float> readColor() const { return drawer_->readColor(); }
  std::vector<float> readDepth() { return drawer_->readDepth(); }

  DrawnBytes bytes() const;

 private:
  // What was drawn of a view lately.
  struct Pace {
    // Of the frames; of their pictures, and of these pictures' cameras. [s]
    std::deque<double> times, ages, offs;
  };

  void exchange(DrawnBy by);
  void update(bool all);
  Drawer::Look look(const InView& map, bool sort_now, bool alone);
  static std::vector<Drawer::Look> touched(const std::vector<InView>& maps);
  void keepPace(const std::string& view_id, FrameReport& report);
  void feedSorter();

  // Gives memory back to the system: what the painter's threads have freed, glibc keeps for them.
  struct Trim {
    ~Trim();
  } trim_;  // first, so that all else is gone by then

  std::mutex orders_mutex_;  // orders_
  OrderPool pool_;
  GaussianMap map_;
  std::shared_ptr<Arrivals> arrivals_ = std::make_shared<Arrivals>();
  std::map<std::string, OrderPtr> orders_;  // newest by view
  std::atomic<bool> unusable_{false};

  // Render thread only.
  std::shared_ptr<Renderers> renderers_;
  BuiltInSorter sorter_{pool_, [this] { feedSorter(); }};
  OrderBook book_{sorter_};
  MapState booked_;  // of which it takes orders
  std::map<std::string, SplatCamera> cameras_;
  std::map<std::string, FrameReport> reports_;
  std::map<std::string, Pace> paces_;
  std::uint64_t touches_ = 0;
  std::unique_ptr<Drawer> drawer_;
  std::optional<Rasterizer> asked_;  // for last
  std::string refusal_;              // why another draws
};

}  // namespace rosplat
