#include "splat_scene.hpp"

#include <chrono>
#include <limits>

#include "map/hard_regimes.hpp"

namespace rosplat {

namespace {

// What one frame uploads at most, so that a map that streams in doesn't stop the picture.
constexpr std::size_t kUploadBytesPerFrame = 32u << 20;
// The view of the mouse tools, which no sidecar hears of.
constexpr const char* kSurfaceView = "surface";
constexpr std::size_t kEverything = std::numeric_limits<std::size_t>::max();

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::size_t bytes(const GaussianEdit& edit) {
  std::size_t words = edit.slots.size();
  for (const auto& band : edit.bands) words += band.size();
  return words * sizeof(std::uint32_t);
}

}  // namespace

BatchReport SplatScene::apply(const GaussianBatch& batch) {
  BatchReport report;
  const std::lock_guard lock(map_mutex_);
  map_.apply(batch, report, [this](const auto& edit, const MapState& state) {
    if (unusable_) return;
    sorter_.apply(edit, state.id);
    const std::lock_guard queue_lock(queue_mutex_);
    arrivals_.push_back({edit, state});
    if (edit->clear) arrivals_.erase(arrivals_.begin(), arrivals_.end() - 1);  // never to be seen
  });
  return report;
}

void SplatScene::offer(OrderPtr order) {
  const std::lock_guard lock(queue_mutex_);
  OrderPtr& newest = orders_[order->view_id];
  newest = std::move(order);
}

MapState SplatScene::state() const {
  const std::lock_guard lock(map_mutex_);
  return map_.state();
}

std::vector<std::string> SplatScene::hardRegimes(const RenderSettings& settings,
                                                 const std::vector<SplatCamera>& cameras) const {
  const std::lock_guard lock(map_mutex_);
  return rosplat::hardRegimes(map_.state(), map_.sample(), settings, cameras);
}

void SplatScene::prepare() {
  if (renderer_) return;
  try {
    renderer_.emplace(shaders_);
  } catch (...) {
    unusable_ = true;
    const std::lock_guard lock(queue_mutex_);
    arrivals_.clear();
    throw;
  }
}

void SplatScene::upload() {
  prepare();
  takeArrivals(kUploadBytesPerFrame);
}

void SplatScene::takeArrivals(std::size_t budget) {
  std::size_t uploaded = 0;
  while (uploaded < budget) {
    Arrival arrival;
    {
      const std::lock_guard lock(queue_mutex_);
      if (arrivals_.empty()) break;
      arrival = std::move(arrivals_.front());
      arrivals_.pop_front();
    }
    if (arrival.edit->clear) {
      uploaded_order_ = nullptr;
      upload_error_.clear();
    }
    try {
      renderer_->apply(*arrival.edit);
    } catch (const gl::Error& error) {  // the rest of the map is still worth seeing
      upload_error_ = error.what();
    }
    uploaded += bytes(*arrival.edit);
    drawn_map_ = std::move(arrival.state);
    book_.mapChanged(drawn_map_, now());
  }
  std::map<std::string, OrderPtr> orders;
  {
    const std::lock_guard lock(queue_mutex_);
    orders.swap(orders_);
  }
  for (const auto& [view_id, order] : orders) book_.offer(order, now());
}

void SplatScene::setCamera(const std::string& view_id, std::uint64_t sequence,
                           const SplatCamera& camera) {
  cameras_[view_id] = camera;
  book_.setCamera(view_id, sequence, camera, now());
}

// A graphics card sorts in less time than another's order takes to be uploaded.
bool SplatScene::sortsOnGpu(OrderSource source) {
  const bool may =
      source == OrderSource::kGpu || (source == OrderSource::kAuto && renderer_->accelerated());
  return may && renderer_->sorts();
}

bool SplatScene::wantsOrders(const RenderSettings& settings) {
  prepare();
  const bool others =
      settings.order != OrderSource::kBuiltIn && settings.order != OrderSource::kOff;
  return others && !sortsOnGpu(settings.order);
}

bool SplatScene::answered(const std::string& view_id) {
  prepare();
  takeArrivals(kEverything);
  const std::lock_guard lock(queue_mutex_);
  return arrivals_.empty() && book_.answered(view_id);
}

void SplatScene::sortOnGpu() {
  renderer_->sortByDepth();
  uploaded_order_ = nullptr;
}

void SplatScene::sortNow(const SplatCamera& camera) {
  if (renderer_->accelerated() && renderer_->sorts()) {
    sortOnGpu();
  } else {
    book_.setCamera(kSurfaceView, ++surface_sequence_, camera, now());
    useOrder(book_.sortNow(kSurfaceView).order);
  }
}

void SplatScene::useOrder(const OrderPtr& order) {
  if (!order || order == uploaded_order_) return;
  renderer_->setOrder(order->slots.data(), order->slots.size());
  uploaded_order_ = order;
}

const FrameReport& SplatScene::draw(const std::string& view_id, const RenderSettings& settings,
                                    Canvas canvas, bool sort_now,
                                    const DrawTranslucent& translucent) {
  const double start = now();
  prepare();
  takeArrivals(sort_now ? kEverything : kUploadBytesPerFrame);
  const OrderSource named = settings.order;
  // Who waited for a sidecar in vain takes what is best here.
  const OrderSource source =
      sort_now && named == OrderSource::kSidecar ? OrderSource::kAuto : named;
  const bool on_gpu = sortsOnGpu(source);
  OrderBook::Choice choice;
  if (on_gpu) {
    sortOnGpu();
  } else {
    const bool ours_to_sort = source != OrderSource::kSidecar && source != OrderSource::kOff;
    const bool sorts = ours_to_sort && sort_now;
    if (!sorts) choice = book_.choose(view_id, start, source);
    const bool too_old = ours_to_sort && settings.wait_for_order && !choice.fresh;
    if (sorts || too_old) choice = book_.sortNow(view_id);
    useOrder(choice.order);
  }
  renderer_->draw(cameras_.at(view_id), drawn_map_, settings, canvas, translucent);

  FrameReport report;
  report.rasterizer = renderer_->rasterizer();
  report.profile = renderer_->profile();
  if (on_gpu) {
    report.splats = renderer_->drawn();
    report.order_source = "gpu";
    report.order_fresh = true;
    if (const auto sort = report.profile.find("sort"); sort != report.profile.end()) {
      report.sort_time = sort->second;
    }
  } else if (choice.order) {
    report.splats = choice.order->slots.size();
    report.order_source = choice.order->source;
    report.order_fresh = choice.fresh;
    report.order_age = choice.age;
    report.sort_time = choice.order->sort_time;
  }
  report.draw_time = now() - start;
  return reports_[view_id] = std::move(report);
}

FrameReport SplatScene::report(const std::string& view_id) const {
  const auto found = reports_.find(view_id);
  return found == reports_.end() ? FrameReport{} : found->second;
}

void SplatScene::drawSurface(const SplatCamera& camera, const RenderSettings& settings,
                             Canvas canvas, double far_clip) {
  prepare();
  sortNow(camera);
  renderer_->drawSurface(camera, drawn_map_, inFull(settings), canvas, far_clip);
}

void SplatScene::drawPick(const SplatCamera& camera, const RenderSettings& settings, Canvas canvas,
                          std::uint32_t handle) {
  prepare();
  sortNow(camera);
  renderer_->drawPick(camera, drawn_map_, inFull(settings), canvas, handle);
}

std::vector<SplatValues> SplatScene::readSlots(const std::vector<std::uint32_t>& slots) const {
  std::vector<SplatValues> splats;
  if (renderer_) splats = renderer_->readSlots(slots);
  for (SplatValues& splat : splats) {
    for (int i = 0; i < 3; ++i) splat.position[i] += drawn_map_.origin[i];
  }
  return splats;
}

void SplatScene::forget(const std::string& view_id) {
  cameras_.erase(view_id);
  reports_.erase(view_id);
  book_.forget(view_id);
}

}  // namespace rosplat
