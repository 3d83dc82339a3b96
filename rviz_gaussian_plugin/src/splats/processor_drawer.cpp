#include "processor_drawer.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "rosplat_core/threads/clock.hpp"

namespace rosplat {

ProcessorDrawer::ProcessorDrawer(std::shared_ptr<SoftwareRenderer> renderer,
                                 const Arrivals::Taker& taker)
    : renderer_(std::move(renderer)),
      taker_(taker),
      painted_(std::make_shared<PaintedMap>(
          [taker](const Arrivals::Apply& apply) { return taker.applyNext(apply); })) {
  painter().add(painted_);
}

// Returns the state after all waiting edits: the painter takes these before the next picture.
MapState ProcessorDrawer::update(bool) {
  painter().wake();
  return taker_.from().state();
}

// The state that a picture shows if one waits for it: after all waiting edits, unless memory is
// lacking for these.
MapState ProcessorDrawer::reachable() const {
  return taker_.from().error().empty() ? taker_.from().state() : painted_->state();
}

bool ProcessorDrawer::drawsWith(const Drawer& other) const {
  const auto* const painted = dynamic_cast<const ProcessorDrawer*>(&other);
  return painted && painted->renderer_ == renderer_;
}

PaintedPicture ProcessorDrawer::painted(const Picture& picture) {
  PaintedPicture painted;
  for (const auto& [drawer, view_id, camera, settings, order, state] : picture.layers) {
    const auto& of = static_cast<const ProcessorDrawer&>(*drawer);
    painted.layers.push_back({of.painted_, view_id, camera, settings, order, of.reachable()});
  }
  return painted;
}

std::vector<FrameReport> ProcessorDrawer::draw(const Picture& picture, Canvas canvas,
                                               const Surroundings& around) {
  const PaintingPtr painting = renderer_->draw(painted(picture), canvas, around);
  std::vector<FrameReport> reports;
  for (const Layer<Drawer*>& layer : picture.layers) {
    const auto& of = static_cast<const ProcessorDrawer&>(*layer.map);
    reports.push_back(painting ? of.describe(layer, *painting) : FrameReport{});
    reports.back().rasterizer = "processor";
  }
  return reports;
}

FrameReport ProcessorDrawer::describe(const Layer<Drawer*>& layer, const Painting& painting) const {
  FrameReport report;
  const Layer<PaintedMapPtr>* const shown = painting.request->of(*painted_);
  if (!shown) return report;  // the map isn't in the picture yet
  const Painting::OfMap& of = painting.maps[std::size_t(shown - painting.request->layers.data())];
  const bool exact = renderer_->exact();
  report.map = of.map;
  report.splats = of.drawn;
  report.error = of.error;
  report.detail_error = of.detail_error;
  report.paint_time = painting.took;
  if (layer.settings.profile) report.profile = painting.profile;
  if (!exact) {
    // A picture that has been exact at rest is as old as that rest's end.
    report.picture_age = now() - std::max(painting.asked, renderer_->exactUntil());
    report.camera_off = std::fabs(now() - std::max(painting.due, renderer_->exactUntil()));
  }
  if (of.order) {
    report.splats = of.order->slots.size();
    report.order_source = of.order->source;
    report.order_fresh = exact && layer.order.fresh;
    report.order_age = layer.order.order ? layer.order.age : report.picture_age;
    report.sort_time = of.order->sort_time;
  } else if (painting.request->unsorted()) {
    report.order_source = "unsorted";
  } else {
    report.order_source = "processor";
    report.order_fresh = exact;
    report.order_age = report.picture_age;
    if (const auto sort = painting.profile.find("sort"); sort != painting.profile.end()) {
      report.sort_time = sort->second;
    }
  }
  return report;
}

DrawnBytes ProcessorDrawer::bytes() const {
  DrawnBytes bytes;
  bytes.map = painted_->bytes();
  bytes.levels = painted_->levelsBytes();
  bytes.host = bytes.map + bytes.levels;
  bytes.shared_gpu = renderer_->gpuBytes();
  bytes.shared_host = renderer_->hostBytes();
  return bytes;
}

}  // namespace rosplat
