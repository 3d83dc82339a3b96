#include "splat_scene.hpp"

#include <algorithm>
#include <iterator>
#include <new>

#include "rosplat_core/threads/clock.hpp"
#include "rosplat_core/views/hard_regimes.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kMostOrders = 64;  // waiting orders, the newest of each view

bool same(const MapState& a, const MapState& b) {
  return a.edits == b.edits && a.pulled == b.pulled;
}

}  // namespace

SplatScene::~SplatScene() {
  for (const auto& [view_id, camera] : cameras_) {
    if (drawer_) drawer_->forget(view_id);
  }
}

BatchReport SplatScene::apply(const GaussianBatch& batch) {
  BatchReport report;
  map_.apply(batch, report, [this](const auto& edit, const MapState& state) {
    if (!unusable_) arrivals_->push(edit, state);
  });
  return report;
}

void SplatScene::offer(OrderPtr order) {
  const std::lock_guard lock(orders_mutex_);
  if (orders_.size() >= kMostOrders && orders_.count(order->view_id) == 0) return;
  OrderPtr& newest = orders_[order->view_id];
  newest = std::move(order);
}

std::size_t SplatScene::mostSlots(const std::string& map_id, std::uint64_t revision) const {
  const MapState map = state();
  const bool known = map.id == map_id && map.revision == revision;
  return known ? map.capacity : kMaxSlots;
}

MapState SplatScene::state() const {
  return map_.inspect([](const MapState& state, const auto&...) { return state; });
}

std::vector<std::string> SplatScene::hardRegimes(const RenderSettings& settings,
                                                 const std::vector<SplatCamera>& cameras) const {
  return map_.inspect([&](const MapState& state, const MapSample& sample, const Groups& groups) {
    return rosplat::hardRegimes(state, sample, groups, settings, cameras);
  });
}

void SplatScene::prepare(const RenderSettings& settings) {
  if (drawer_ && asked_ == settings.rasterizer) return;
  DrawnBy by = drawnBy(settings.rasterizer);
  refusal_.clear();
  while (!drawer_ || drawer_->by() != by) {
    try {
      exchange(by);
    } catch (const std::exception& error) {
      const bool memory = dynamic_cast<const std::bad_alloc*>(&error) != nullptr;
      const std::string reason = memory ? "memory is lacking" : error.what();
      if (drawer_) {
        refusal_ = "the rasterizer wasn't changed: " + reason;
        break;
      }
      const bool either = settings.rasterizer == Rasterizer::kAuto;
      if (!either || by == DrawnBy::kProcessor) {
        unusable_ = either;
        if (unusable_) arrivals_->clear();
        throw;
      }
      by = DrawnBy::kProcessor;
      refusal_ = "the processor draws, not the graphics card: " + reason;
    }
  }
  asked_ = settings.rasterizer;
}

// The next Drawer takes over all that the present one holds; if that throws, the present one stays.
void SplatScene::exchange(DrawnBy by) {
  const Arrivals::Taker taker = arrivals_->makeTaker();
  std::unique_ptr<Drawer> next = renderers_->makeDrawer(by, taker);
  arrivals_->handOver(taker, [&] {
    if (drawer_) next->copy(*drawer_);
  });
  drawer_.swap(next);
  for (const auto& [view_id, camera] : cameras_) {
    if (next) next->forget(view_id);
  }
}

void SplatScene::update(bool all) {
  const MapState map = drawer_->update(all);
  if (!same(map, booked_)) book_.mapChanged(booked_ = map);
  std::map<std::string, OrderPtr> orders;
  {
    const std::lock_guard lock(orders_mutex_);
    orders.swap(orders_);
  }
  for (const auto& [view_id, order] : orders) book_.offer(order);
}

void SplatScene::upload(const RenderSettings& settings, bool all) {
  prepare(settings);
  update(all);
}

void SplatScene::setCamera(const std::string& view_id, std::uint64_t sequence,
                           const SplatCamera& camera) {
  cameras_[view_id] = camera;
  book_.setCamera(view_id, sequence, camera, now());
}

bool SplatScene::answered(const std::string& view_id) const {
  return same(booked_, arrivals_->state()) && book_.answered(view_id);
}

Layer<Drawer*> SplatScene::layer(const std::string& view_id, const RenderSettings& settings,
                                 bool sort_now) const {
  const bool from_sidecar = !sort_now && settings.order == OrderSource::kSidecar;
  return {drawer_.get(),
          view_id,
          cameras_.at(view_id),
          settings,
          from_sidecar ? book_.newest(view_id, now()) : OrderBook::Choice{},
          {}};
}

Layer<Drawer*> SplatScene::layerUnderMouse(const std::string& view_id, RenderSettings settings,
                                           const SplatCamera& camera) const {
  settings = inFull(settings);
  settings.order = OrderSource::kAuto;
  return {drawer_.get(), view_id, camera, settings, {}, {}};
}

void SplatScene::request(const std::string& view_id, const RenderSettings& settings,
                         bool sort_now) {
  upload(settings, sort_now);
  drawer_->request({{layer(view_id, settings, sort_now)}});
}

bool SplatScene::ready(const std::string& view_id, const RenderSettings& settings,
                       bool sort_now) const {
  return drawer_->ready({{layer(view_id, settings, sort_now)}});
}

const FrameReport& SplatScene::draw(const std::string& view_id, const RenderSettings& settings,
                                    Canvas canvas, bool sort_now, const Surroundings& around) {
  upload(settings, sort_now);
  Picture picture;
  picture.add(*this, layer(view_id, settings, sort_now));
  picture.begin(canvas);
  picture.draw(around);
  return reports_[view_id];
}

bool SplatScene::Picture::takes(const SplatScene& scene) const {
  return maps_.layers.empty() || maps_.map()->drawsWith(*scene.drawer_);
}

void SplatScene::Picture::add(SplatScene& scene, Layer<Drawer*> layer) {
  scenes_.push_back(&scene);
  maps_.layers.push_back(std::move(layer));
}

void SplatScene::Picture::begin(Canvas canvas) {
  const double start = now();
  canvas_ = canvas;
  maps_.map()->begin(maps_, canvas);
  took_ = now() - start;
}

void SplatScene::Picture::draw(const Surroundings& around) const {
  const double start = now();
  std::vector<FrameReport> reports = maps_.map()->draw(maps_, canvas_, around);
  const double took = took_ + now() - start;
  for (std::size_t i = 0; i < scenes_.size(); ++i) {
    const std::string& view_id = maps_.layers[i].view_id;
    reports[i].maps = scenes_.size();
    reports[i].draw_time = took;
    scenes_[i]->keepPace(view_id, reports[i]);
    scenes_[i]->reports_[view_id] = std::move(reports[i]);
  }
}

void SplatScene::Picture::drawSurface(Canvas canvas, double far_clip) const {
  maps_.map()->drawSurface(maps_, canvas, far_clip);
}

void SplatScene::Picture::drawPick(Canvas canvas, std::uint32_t number) const {
  maps_.map()->drawPick(maps_, canvas, number);
}

void SplatScene::keepPace(const std::string& view_id, FrameReport& report) {
  constexpr double kOfLate = 2;  // [s]
  std::deque<PastFrame>& frames = paces_[view_id];
  frames.push_back({now(), report.picture_age, report.camera_off});
  while (frames.front().time < frames.back().time - kOfLate) frames.pop_front();
  for (const PastFrame& frame : frames) {
    report.picture_age = std::max(report.picture_age, frame.age);
    report.camera_off = std::max(report.camera_off, frame.off);
  }
  if (frames.size() < 2) return;
  std::vector<double> intervals;
  for (auto next = frames.begin() + 1; next != frames.end(); ++next) {
    intervals.push_back(next->time - std::prev(next)->time);
  }
  const auto most = intervals.begin() + std::ptrdiff_t((intervals.size() - 1) * 19 / 20);
  std::nth_element(intervals.begin(), most, intervals.end());
  report.frame_interval = *most;
}

FrameReport SplatScene::report(const std::string& view_id) const {
  const auto found = reports_.find(view_id);
  return found == reports_.end() ? FrameReport{} : found->second;
}

std::vector<SplatValues> SplatScene::readSlots(const std::vector<std::uint32_t>& slots) const {
  return drawer_ ? drawer_->readSlots(slots) : std::vector<SplatValues>{};
}

void SplatScene::forget(const std::string& view_id) {
  cameras_.erase(view_id);
  reports_.erase(view_id);
  paces_.erase(view_id);
  book_.forget(view_id);
  if (drawer_) drawer_->forget(view_id);
}

std::string SplatScene::error() const {
  const std::string missing = arrivals_->error();
  return missing.empty() || refusal_.empty() ? refusal_ + missing : refusal_ + "; " + missing;
}

}  // namespace rosplat
