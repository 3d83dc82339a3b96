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
          [taker](const Arrivals::Apply& apply) { return taker.take(apply); })) {
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

bool ProcessorDrawer::drawsWith(const Drawer& other) {
  const auto* const painted = dynamic_cast<const ProcessorDrawer*>(&other);
  return painted && painted->renderer_ == renderer_;
}

ViewedMap ProcessorDrawer::view(const Look& look) {
  const auto& of = static_cast<const ProcessorDrawer&>(*look.drawer);
  return {look.view_id, of.painted_, look.camera, look.settings, look.order.order, of.reachable()};
}

std::vector<ViewedMap> ProcessorDrawer::views(const std::vector<Look>& looks) {
  std::vector<ViewedMap> views;
  for (const Look& look : looks) views.push_back(view(look));
  return views;
}

bool ProcessorDrawer::ready(const Look& look) {
  ViewedMap waited_for = view(look);
  waited_for.settings.interactive = false;
  return renderer_->ready(waited_for);
}

std::vector<FrameReport> ProcessorDrawer::draw(const std::vector<Look>& looks, Canvas canvas,
                                               const Surroundings& around) {
  const PaintingPtr painting = renderer_->draw(views(looks), canvas, around);
  std::vector<FrameReport> reports;
  for (const Look& look : looks) {
    const auto& of = static_cast<const ProcessorDrawer&>(*look.drawer);
    reports.push_back(painting ? of.describe(look, *painting) : FrameReport{});
    reports.back().rasterizer = "processor";
  }
  return reports;
}

FrameReport ProcessorDrawer::describe(const Look& look, const Painting& painting) const {
  FrameReport report;
  const PaintLayer* const layer = painting.request->of(*painted_);
  if (!layer) return report;  // the map isn't in the picture yet
  const Painting::OfMap& of = painting.maps[std::size_t(layer - painting.request->layers.data())];
  const bool exact = renderer_->exact();
  report.map = of.map;
  report.splats = of.drawn;
  report.error = of.error;
  report.detail_error = of.detail_error;
  report.paint_time = painting.took;
  if (look.settings.profile) report.profile = painting.profile;
  if (!exact) {
    // A picture that has been exact at rest is as old as that rest's end.
    report.picture_age = now() - std::max(painting.asked, renderer_->exactUntil());
    report.camera_off = std::fabs(now() - std::max(painting.due, renderer_->exactUntil()));
  }
  if (of.order) {
    report.splats = of.order->slots.size();
    report.order_source = of.order->source;
    report.order_fresh = exact && look.order.fresh;
    report.order_age = look.order.order ? look.order.age : report.picture_age;
    report.sort_time = of.order->sort_time;
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
