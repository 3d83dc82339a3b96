#include "splat_scene.hpp"

#include <algorithm>
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
  return map_.look([](const MapState& state, const auto&...) { return state; });
}

std::vector<std::string> SplatScene::hardRegimes(const RenderSettings& settings,
                                                 const std::vector<SplatCamera>& cameras) const {
  return map_.look([&](const MapState& state, const MapSample& sample, const Groups& groups) {
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
    if (drawer_) next->hold(*drawer_);
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

void SplatScene::upload(const RenderSettings& settings) {
  prepare(settings);
  update(false);
}

void SplatScene::setCamera(const std::string& view_id, std::uint64_t sequence,
                           const SplatCamera& camera) {
  cameras_[view_id] = camera;
  book_.setCamera(view_id, sequence, camera, now());
}

bool SplatScene::answered(const std::string& view_id, const RenderSettings& settings) {
  prepare(settings);
  update(true);
  return same(booked_, arrivals_->state()) && book_.answered(view_id);
}

Drawer::Look SplatScene::look(const InView& map, bool sort_now, bool alone) {
  update(sort_now);
  Drawer::Look look{drawer_.get(), map.view_id, cameras_.at(map.view_id), map.settings, {}};
  const bool from_sidecar = alone && !sort_now && map.settings.order == OrderSource::kSidecar;
  if (from_sidecar) look.order = book_.newest(map.view_id, now());
  return look;
}

bool SplatScene::ready(const std::string& view_id, const RenderSettings& settings, bool sort_now) {
  prepare(settings);
  if (drawer_->by() == DrawnBy::kCard) return true;  // draw() finds the order
  return drawer_->ready(look({this, view_id, settings}, sort_now, true));
}

const FrameReport& SplatScene::draw(const std::string& view_id, const RenderSettings& settings,
                                    Canvas canvas, bool sort_now, const Surroundings& around) {
  prepare(settings);
  draw(begin({{this, view_id, settings}}, canvas, sort_now), around);
  return reports_[view_id];
}

SplatScene::Picture SplatScene::begin(const std::vector<InView>& maps, Canvas canvas,
                                      bool sort_now) {
  const double start = now();
  Picture picture{maps, canvas};
  for (const InView& map : maps) {
    picture.looks.push_back(map.scene->look(map, sort_now, maps.size() == 1));
  }
  picture.looks.front().drawer->begin(picture.looks, canvas);
  picture.took = now() - start;
  return picture;
}

void SplatScene::draw(const Picture& picture, const Surroundings& around) {
  const double start = now();
  const auto& [maps, canvas, looks, begun_in] = picture;
  std::vector<FrameReport> reports = looks.front().drawer->draw(looks, canvas, around);
  const double took = begun_in + now() - start;
  for (std::size_t i = 0; i < maps.size(); ++i) {
    const auto& [scene, view_id, settings, camera] = maps[i];
    reports[i].maps = maps.size();
    reports[i].draw_time = took;
    scene->keepPace(view_id, reports[i]);
    scene->reports_[view_id] = std::move(reports[i]);
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

FrameReport SplatScene::report(const std::string& view_id) const {
  const auto found = reports_.find(view_id);
  return found == reports_.end() ? FrameReport{} : found->second;
}

// Mouse tools see the map in full detail, sorted here.
std::vector<Drawer::Look> SplatScene::touched(const std::vector<InView>& maps) {
  std::vector<Drawer::Look> looks;
  for (const InView& map : maps) {
    looks.push_back({map.scene->drawer_.get(), map.view_id, *map.camera, inFull(map.settings), {}});
    looks.back().settings.order = OrderSource::kAuto;
  }
  return looks;
}

void SplatScene::drawSurface(const std::vector<InView>& maps, Canvas canvas, double far_clip) {
  const std::vector<Drawer::Look> looks = touched(maps);
  looks.front().drawer->drawSurface(looks, canvas, far_clip);
}

void SplatScene::drawPick(const std::vector<InView>& maps, Canvas canvas, std::uint32_t number) {
  const std::vector<Drawer::Look> looks = touched(maps);
  looks.front().drawer->drawPick(looks, canvas, number);
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
