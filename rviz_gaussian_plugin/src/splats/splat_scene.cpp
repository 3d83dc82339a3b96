#include "splat_scene.hpp"

#include <malloc.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <new>

#include "rosplat_core/views/hard_regimes.hpp"

namespace rosplat {

namespace {

// What one frame uploads at most, so that a map that streams in doesn't stop the picture.
constexpr std::size_t kUploadBytesPerFrame = 32u << 20;
constexpr std::size_t kMostOrders = 64;  // that wait, a view's newest each
// The view of the mouse tools, which no sidecar hears of.
constexpr const char* kSurfaceView = "surface";
const OrderPtr kNoOrder = std::make_shared<const Order>();  // yet
constexpr const char* kNoMemory = "a part of the map isn't drawn: memory is lacking";
constexpr std::size_t kEverything = std::numeric_limits<std::size_t>::max();

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Who waited for a sidecar in vain takes what is best here.
OrderSource sourceOf(const RenderSettings& settings, bool sort_now) {
  const bool in_vain = sort_now && settings.order == OrderSource::kSidecar;
  return in_vain ? OrderSource::kAuto : settings.order;
}

}  // namespace

SplatScene::Trim::~Trim() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

SplatScene::~SplatScene() {
  leavePainter();
  leaveCard();
}

BatchReport SplatScene::apply(const GaussianBatch& batch) {
  BatchReport report;
  map_.apply(batch, report, [this](const auto& edit, const MapState& state) {
    if (unusable_) return;
    auto arrival = EditQueue::node(edit, state);
    MapState queued = state;  // the last to need memory
    const std::lock_guard queue_lock(queue_mutex_);
    queued_ = std::move(queued);
    arrivals_.push(std::move(arrival));
  });
  return report;
}

void SplatScene::offer(OrderPtr order) {
  const std::lock_guard lock(queue_mutex_);
  if (orders_.size() >= kMostOrders && orders_.count(order->view_id) == 0) return;
  OrderPtr& newest = orders_[order->view_id];
  newest = std::move(order);
}

MapState SplatScene::queued() const {
  const std::lock_guard lock(queue_mutex_);
  return queued_;
}

std::size_t SplatScene::mostSlots(const std::string& map_id, std::uint64_t revision) const {
  const MapState map = state();
  const bool known = map.id == map_id && map.revision == revision;
  return known ? map.capacity : kMaxSlots;
}

MapState SplatScene::state() const {
  return map_.look([](const MapState& state, const auto&...) { return state; });
}

Backlog SplatScene::backlog() const {
  const std::lock_guard lock(queue_mutex_);
  return {arrivals_.size(), arrivals_.bytes()};
}

std::vector<std::string> SplatScene::hardRegimes(const RenderSettings& settings,
                                                 const std::vector<SplatCamera>& cameras) const {
  return map_.look([&](const MapState& state, const MapSample& sample, const Groups& groups) {
    return rosplat::hardRegimes(state, sample, groups, settings, cameras);
  });
}

// The processor rasterises where no graphics card does, or none that can.
bool SplatScene::prefersSoftware(const RenderSettings& settings) {
  if (settings.rasterizer != Rasterizer::kAuto) {
    return settings.rasterizer == Rasterizer::kProcessor;
  }
  if (!auto_is_software_) auto_is_software_ = !gl::accelerated() || !gl::unsupported().empty();
  return *auto_is_software_;
}

void SplatScene::prepare(const RenderSettings& settings) {
  const bool software = prefersSoftware(settings);
  if (software ? bool(software_) : bool(renderer_)) return;
  try {
    if (software) {
      auto software = renderers_->onProcessor();
      auto fresh = std::make_shared<PaintedMap>(
          [this](auto& edit, MapState& state) { return nextEdit(edit, state); });
      if (renderer_) {
        const double clock = software->painter().clock();
        card_->forEachPage([&](const GaussianEdit& page) { fresh->hold(page, clock); });
        fresh->hold(drawn_map_);
        leaveCard();
        sorter_.rest();
      }
      software->painter().add(fresh);
      painted_ = std::move(fresh);
      software_ = std::move(software);
    } else {
      renderer_ = renderers_->onCard();
      card_ = std::make_shared<CardMap>();
      if (software_) moveToCard();
    }
  } catch (...) {
    unusable_ = settings.rasterizer == Rasterizer::kAuto;
    const std::lock_guard lock(queue_mutex_);
    if (unusable_) arrivals_.clear();
    throw;
  }
}

void SplatScene::moveToCard() {
  painted_->leave();
  painted_->forEachPage([this](const GaussianEdit& page) {
    card_->apply(std::make_shared<const GaussianEdit>(page), renderer_->clock());
  });
  drawn_map_ = painted_->state();
  leavePainter();
  std::shared_ptr<const GaussianEdit> edit;
  while (nextEdit(edit, drawn_map_)) card_->apply(edit, renderer_->clock());
  book(drawn_map_);
}

void SplatScene::leavePainter() {
  if (!software_) return;
  painted_->leave();
  software_->painter().remove(painted_);
  for (const auto& [view_id, camera] : cameras_) software_->forget(view_id);
  painted_.reset();
  software_.reset();
}

void SplatScene::leaveCard() {
  if (!renderer_) return;
  for (const auto& [view_id, camera] : cameras_) renderer_->forget(view_id);
  card_.reset();
  next_card_.reset();
  renderer_.reset();
}

bool SplatScene::nextEdit(std::shared_ptr<const GaussianEdit>& edit, MapState& state) {
  const std::lock_guard lock(queue_mutex_);
  if (arrivals_.empty()) return false;
  EditQueue::Waiting oldest = arrivals_.pop();
  edit = std::move(oldest.edit);
  state = std::move(oldest.state);
  return true;
}

void SplatScene::upload(const RenderSettings& settings) {
  prepare(settings);
  if (software_) {
    software_->painter().wake();
  } else {
    takeArrivals(kUploadBytesPerFrame);
  }
}

void SplatScene::takeArrivals(std::size_t budget) {
  std::size_t uploaded = 0;
  while (true) {
    EditQueue::Waiting arrival;
    try {
      const std::lock_guard lock(queue_mutex_);
      if (arrivals_.empty()) break;
      const std::size_t bytes = uploadBytes(*arrivals_.front().edit);
      if (uploaded > 0 && (uploaded >= budget || bytes > budget - uploaded)) break;
      arrival = arrivals_.pop(budget);
    } catch (const std::bad_alloc&) {  // of a part; it waits
      upload_error_ = kNoMemory;
      break;
    }
    uploaded += uploadBytes(*arrival.edit);
    take(arrival);
  }
  card_->advanceLevels(renderer_->clock());
  takeOrders();
}

void SplatScene::take(const EditQueue::Waiting& arrival) {
  if (arrival.edit->clear) {
    upload_error_.clear();
    // What replaces a map in parts doesn't show before it is whole.
    const bool beside = arrival.more && drawn_map_.splats > 0;
    next_card_ = beside ? std::make_shared<CardMap>() : nullptr;
  }
  try {
    if (!next_card_) sorter_.apply(EditQueue::node(arrival.edit, arrival.state));
    (next_card_ ? next_card_ : card_)->apply(arrival.edit, renderer_->clock());
  } catch (const gl::Error& error) {  // the rest of the map is still worth seeing
    upload_error_ = error.what();
  } catch (const std::bad_alloc&) {
    upload_error_ = kNoMemory;
  }
  if (next_card_ && arrival.more) return;
  if (next_card_) {
    card_ = std::exchange(next_card_, nullptr);
    sorter_.rest();
  }
  drawn_map_ = arrival.state;
  book(drawn_map_);
}

// Only what is uploaded; what waits will reach it as it is.
void SplatScene::feedSorter() {
  if (!renderer_) return;
  const auto give = [this](GaussianEdit&& edit) {
    edit.round = drawn_map_.round;
    edit.revision = drawn_map_.revision;
    edit.capacity = drawn_map_.capacity;
    edit.slots = {};
    edit.bands = {};
    edit.channels = {};
    sorter_.apply(EditQueue::node(std::make_shared<GaussianEdit>(std::move(edit)), drawn_map_));
  };
  GaussianEdit nothing;
  nothing.clear = true;
  give(std::move(nothing));
  card_->forEachPage([&give](const GaussianEdit& page) { give(GaussianEdit(page)); });
}

OrderPtr SplatScene::unsorted() {
  const SlotPages& pages = card_->pages();
  const std::array<std::uint64_t, 3> of{drawn_map_.round, drawn_map_.capacity,
                                        pages.pages().size()};
  if (unsorted_ && unsorted_of_ == of) return unsorted_;
  auto order = std::make_shared<Order>();
  order->map_id = drawn_map_.id;
  order->source = "nobody";
  order->slots = pages.slots(drawn_map_.capacity);
  order->bound = drawn_map_.capacity;
  unsorted_of_ = of;
  return unsorted_ = std::move(order);
}

void SplatScene::book(const MapState& map) {
  if (map.edits == booked_.edits && map.pulled == booked_.pulled) return;
  booked_ = map;
  book_.mapChanged(map, now());
}

void SplatScene::takeOrders() {
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
  prepare(settings);
  if (software_) return settings.order == OrderSource::kSidecar;
  const bool others =
      settings.order != OrderSource::kBuiltIn && settings.order != OrderSource::kOff;
  return others && !sortsOnGpu(settings.order);
}

bool SplatScene::answered(const std::string& view_id, const RenderSettings& settings) {
  prepare(settings);
  if (software_) {
    takeMap();
    return book_.answered(view_id);
  }
  takeArrivals(kEverything);
  const std::lock_guard lock(queue_mutex_);
  return arrivals_.empty() && book_.answered(view_id);
}

OrderPtr SplatScene::sortNow(const SplatCamera& camera) {
  if (renderer_->accelerated() && renderer_->sorts()) return nullptr;
  book_.setCamera(kSurfaceView, ++surface_sequence_, camera, now());
  return book_.sortNow(kSurfaceView).order;
}

const FrameReport& SplatScene::draw(const std::string& view_id, const RenderSettings& settings,
                                    Canvas canvas, bool sort_now, const Surroundings& around) {
  prepare(settings);
  draw({{this, view_id, settings}}, canvas, sort_now, around);
  return reports_[view_id];
}

// The order that is drawn of a map that is alone where the graphics card doesn't sort.
OrderBook::Choice SplatScene::choose(const std::string& view_id, OrderSource source,
                                     bool sort_now) {
  const bool ours_to_sort = source != OrderSource::kSidecar;
  OrderBook::Choice choice = source == OrderSource::kOff ? OrderBook::Choice{unsorted(), false, 0}
                             : ours_to_sort && sort_now  ? book_.sortNow(view_id)
                                                         : book_.choose(view_id, now(), source);
  if (!choice.order && !renderer_->sorts()) choice.order = kNoOrder;
  return choice;
}

void SplatScene::drawOnCard(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                            const Surroundings& around) {
  const double start = now();
  const std::shared_ptr<SplatRenderer> renderer = parts.front().scene->renderer_;
  std::vector<CardView> maps;
  bool on_gpu = true;
  OrderBook::Choice choice;
  for (const Part& part : parts) {
    SplatScene& scene = *part.scene;
    scene.takeArrivals(sort_now ? kEverything : kUploadBytesPerFrame);
    if (parts.size() == 1) {
      const OrderSource source = sourceOf(part.settings, sort_now);
      on_gpu = scene.sortsOnGpu(source);
      if (!on_gpu) choice = scene.choose(part.view_id, source, sort_now);
    }
    maps.push_back({part.view_id, scene.card_, scene.cameras_.at(part.view_id), part.settings,
                    choice.order, scene.drawn_map_});
  }
  const auto drawn = renderer->draw(maps, canvas, around);
  const double took = now() - start;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    SplatScene& scene = *parts[i].scene;
    FrameReport report;
    report.map = scene.drawn_map_;
    report.maps = parts.size();
    report.error = drawn[i].error;
    report.detail_error = drawn[i].detail_error;
    report.rasterizer = renderer->rasterizer();
    report.profile = renderer->profile();
    report.draw_time = took;
    if (on_gpu) {
      report.splats = drawn[i].drawn;
      report.order_source = "gpu";
      report.order_fresh = true;
      const auto sort = report.profile.find("sort");
      if (sort != report.profile.end()) report.sort_time = sort->second;
    } else if (choice.order) {
      report.splats = choice.order->slots.size();
      report.order_source = choice.order->source;
      report.order_fresh = choice.fresh;
      report.order_age = choice.age;
      report.sort_time = choice.order->sort_time;
    }
    scene.keepPace(parts[i].view_id, report);
    scene.reports_[parts[i].view_id] = std::move(report);
  }
}

void SplatScene::takeMap() {
  drawn_map_ = painted_->state();
  // What is queued is painted before anything that is waited for.
  book(queued());
  upload_error_ = painted_->error();
  takeOrders();
}

bool SplatScene::together(const SplatScene& one, const SplatScene& other) {
  if (one.software_) return one.software_ == other.software_;
  return one.renderer_ == other.renderer_ && one.renderer_->sorts();
}

void SplatScene::draw(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                      const Surroundings& around) {
  const bool software = bool(parts.front().scene->software_);
  return software ? drawSoftware(parts, canvas, sort_now, around)
                  : drawOnCard(parts, canvas, sort_now, around);
}

// A sidecar's order is drawn instead of the processor's own, if asked for, of a map that is alone.
ViewedMap SplatScene::viewed(const std::string& view_id, const RenderSettings& settings,
                             bool sort_now, bool alone) {
  takeMap();
  const bool received = alone && sourceOf(settings, sort_now) == OrderSource::kSidecar;
  return {view_id,
          painted_,
          cameras_.at(view_id),
          settings,
          received ? book_.received(view_id, now()).order : nullptr,
          queued()};
}

bool SplatScene::ready(const std::string& view_id, const RenderSettings& settings, bool sort_now) {
  prepare(settings);
  if (!software_) return true;
  RenderSettings waited_for = settings;
  waited_for.asynchronous = false;
  return software_->ready(viewed(view_id, waited_for, sort_now, true));
}

void SplatScene::drawSoftware(const std::vector<Part>& parts, Canvas canvas, bool sort_now,
                              const Surroundings& around) {
  const double start = now();
  const std::shared_ptr<SoftwareRenderer> software = parts.front().scene->software_;
  software->painter().wake();
  std::vector<ViewedMap> maps;
  for (const Part& part : parts) {
    maps.push_back(part.scene->viewed(part.view_id, part.settings, sort_now, parts.size() == 1));
  }
  const PaintingPtr painting = software->draw(maps, canvas, around);
  const double took = now() - start;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    FrameReport report;
    report.rasterizer = "processor";
    report.draw_time = took;
    report.maps = parts.size();
    parts[i].scene->takeMap();
    if (painting) parts[i].scene->describe(*painting, software->exact(), parts[i], report);
    parts[i].scene->keepPace(parts[i].view_id, report);
    parts[i].scene->reports_[parts[i].view_id] = std::move(report);
  }
}

void SplatScene::describe(const Painting& painting, bool exact, const Part& part,
                          FrameReport& report) const {
  const PaintLayer* const layer = painting.request->of(*painted_);
  if (!layer) return;  // it isn't in the picture yet
  const Painting::OfMap& of = painting.maps[std::size_t(layer - painting.request->layers.data())];
  report.map = of.map;
  report.splats = of.drawn;
  report.error = of.error;
  report.detail_error = of.detail_error;
  report.paint_time = painting.took;
  if (part.settings.profile) report.profile = painting.profile;
  if (!exact) {
    report.picture_age = now() - painting.asked;
    report.camera_off = std::fabs(now() - painting.due);
  }
  if (layer->order) {
    const OrderBook::Choice choice = book_.received(part.view_id, now());
    report.splats = layer->order->slots.size();
    report.order_source = layer->order->source;
    report.order_fresh = choice.fresh && exact;
    report.order_age = choice.age;
    report.sort_time = layer->order->sort_time;
  } else if (layer->unsorted) {
    report.order_source = "nobody";
  } else {
    report.order_source = "processor";
    report.order_fresh = exact;
    report.order_age = report.picture_age;
    if (const auto sort = painting.profile.find("sort"); sort != painting.profile.end()) {
      report.sort_time = sort->second;
    }
  }
}

void SplatScene::keepPace(const std::string& view_id, FrameReport& report) {
  constexpr double kOfLate = 2;  // [s]
  auto& [times, ages, offs] = paces_[view_id];
  times.push_back(now());
  ages.push_back(report.picture_age);
  offs.push_back(report.camera_off);
  while (times.front() < times.back() - kOfLate) {
    times.pop_front();
    ages.pop_front();
    offs.pop_front();
  }
  report.picture_age = *std::max_element(ages.begin(), ages.end());
  report.camera_off = *std::max_element(offs.begin(), offs.end());
  if (times.size() < 2) return;
  std::vector<double> intervals;
  for (std::size_t i = 1; i < times.size(); ++i) intervals.push_back(times[i] - times[i - 1]);
  const auto most = intervals.begin() + std::ptrdiff_t((intervals.size() - 1) * 19 / 20);
  std::nth_element(intervals.begin(), most, intervals.end());
  report.frame_interval = *most;
}

std::size_t SplatScene::gpuBytes() const {
  return (card_ ? card_->gpuBytes() : 0) + sharedGpuBytes();
}

std::size_t SplatScene::sharedGpuBytes() const {
  return software_ ? software_->gpuBytes() : renderer_ ? renderer_->gpuBytes() : 0;
}

std::size_t SplatScene::mapBytes() const {
  return software_ ? painted_->bytes() : card_ ? card_->bytes() : 0;
}

std::size_t SplatScene::levelsBytes() const {
  return software_ ? painted_->levelsBytes() : card_ ? card_->levelsBytes() : 0;
}

std::size_t SplatScene::hostBytes() const {
  return sorter_.bytes() + (software_ ? painted_->bytes() + painted_->levelsBytes() : 0);
}

std::size_t SplatScene::sharedHostBytes() const { return software_ ? software_->hostBytes() : 0; }

FrameReport SplatScene::report(const std::string& view_id) const {
  const auto found = reports_.find(view_id);
  return found == reports_.end() ? FrameReport{} : found->second;
}

std::vector<CardView> SplatScene::touchedOnCard(const std::vector<Touched>& parts) {
  std::vector<CardView> maps;
  for (const Touched& part : parts) {
    const SplatScene& scene = *part.scene;
    maps.push_back(
        {part.view_id, scene.card_, part.camera, inFull(part.settings), nullptr, scene.drawn_map_});
  }
  if (maps.size() == 1) maps.front().order = parts.front().scene->sortNow(maps.front().camera);
  return maps;
}

std::vector<ViewedMap> SplatScene::touchedSoftware(const std::vector<Touched>& parts) {
  std::vector<ViewedMap> maps;
  for (const Touched& part : parts) {
    RenderSettings settings = inFull(part.settings);
    settings.order = OrderSource::kAuto;
    maps.push_back({part.view_id, part.scene->painted_, part.camera, settings, nullptr, {}});
  }
  return maps;
}

void SplatScene::drawSurface(const std::vector<Touched>& parts, Canvas canvas, double far_clip) {
  const SplatScene& first = *parts.front().scene;
  if (first.software_)
    return first.software_->drawSurface(touchedSoftware(parts), canvas, far_clip);
  first.renderer_->drawSurface(touchedOnCard(parts), canvas, far_clip);
}

void SplatScene::drawPick(const std::vector<Touched>& parts, Canvas canvas, std::uint32_t number) {
  const SplatScene& first = *parts.front().scene;
  if (first.software_) return first.software_->drawPick(touchedSoftware(parts), canvas, number);
  first.renderer_->drawPick(touchedOnCard(parts), canvas, number);
}

std::vector<SplatValues> SplatScene::readSlots(const std::vector<std::uint32_t>& slots) const {
  if (software_) return painted_->read(slots);
  return card_ ? renderer_->readSlots(*card_, slots) : std::vector<SplatValues>{};
}

void SplatScene::forget(const std::string& view_id) {
  cameras_.erase(view_id);
  reports_.erase(view_id);
  paces_.erase(view_id);
  book_.forget(view_id);
  if (software_) software_->forget(view_id);
  if (!renderer_) return;
  renderer_->forget(view_id);
  card_->forget(view_id);
}

}  // namespace rosplat
