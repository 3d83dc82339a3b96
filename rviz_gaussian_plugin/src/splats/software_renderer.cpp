#include "software_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace rosplat {

namespace {

constexpr float kSurfaceAlpha = 0.5f;  // more splats than void

bool same(const MapState& a, const MapState& b) { return a.edits == b.edits; }

bool shows(const Painting& painting, const PaintRequest& request, const MapState& map) {
  return same(painting.map, map) && *painting.request == request;
}

// A number of 24 bits as an opaque colour, its lowest byte in blue.
void putNumber(std::uint8_t* rgba, std::uint32_t number) {
  rgba[0] = static_cast<std::uint8_t>(number >> 16);
  rgba[1] = static_cast<std::uint8_t>(number >> 8);
  rgba[2] = static_cast<std::uint8_t>(number);
  rgba[3] = 255;
}

}  // namespace

SoftwareRenderer::SoftwareRenderer(const ShaderSource& source, Painter::NextEdit next_edit)
    : overlay_(source), painter_(std::move(next_edit)) {}

void SoftwareRenderer::ask(const std::string& view_id, PaintRequestPtr request,
                           const MapState& map) {
  View& view = views_[view_id];
  view.asked = request;
  view.asked_of = map;
  painter_.ask(view_id, std::move(request));
}

bool SoftwareRenderer::asked(const View& view, const PaintRequest& request, const MapState& map) {
  return view.asked && *view.asked == request && same(view.asked_of, map);
}

bool SoftwareRenderer::ready(const std::string& view_id, const SplatCamera& camera,
                             const RenderSettings& settings, const OrderPtr& order,
                             const MapState& map) {
  auto request = std::make_shared<PaintRequest>();
  request->camera = camera;
  request->settings = settings;
  request->settings.asynchronous = false;
  request->order = order;
  request->unsorted = settings.order == OrderSource::kOff;
  const View& view = views_[view_id];
  const PaintingPtr newest = painter_.newest(view_id);
  if (newest && shows(*newest, *request, map)) return true;
  if (!asked(view, *request, map)) ask(view_id, std::move(request), map);
  return false;
}

PaintingPtr SoftwareRenderer::draw(const std::string& view_id, const SplatCamera& camera,
                                   const RenderSettings& settings, const OrderPtr& order,
                                   const MapState& map, Canvas canvas, const Surroundings& around) {
  auto request = std::make_shared<PaintRequest>();
  request->camera = camera;
  request->settings = settings;
  request->order = order;
  request->unsorted = settings.order == OrderSource::kOff;
  request->window = canvas != Canvas::kNone;
  if (settings.asynchronous && settings.mode == DrawMode::kAge) {
    request->age_tick = static_cast<std::uint64_t>(painter_.clock());
  }
  if (around.translucent) {
    request->translucent_depth = depthsOf(canvas, camera.width, camera.height, around.translucent);
  }
  const CanvasScope window(canvas);
  if (around.opaque) request->scene_depth = window.readDepth(camera.width, camera.height);

  View& view = views_[view_id];
  drawn_ = nullptr;
  PaintingPtr painting = painter_.newest(view_id);
  exact_ = painting && shows(*painting, *request, map);
  if (exact_ && !painting->error.empty()) {
    view.asked = nullptr;  // another time it may succeed
    painter_.ask(view_id, request);
    throw PictureError(painting->error);
  }
  if (!settings.asynchronous && !exact_) {
    view.asked = nullptr;
    painting = painter_.paintNow(view_id, request);
    exact_ = true;
  } else if (!exact_ && asked(view, *request, map)) {
    painter_.hurry(view_id);  // the camera rests
  } else if (!exact_) {
    ask(view_id, request, map);
  } else if (settings.asynchronous && !painting->settled && painting->request == view.asked) {
    request->rests = true;
    ask(view_id, request, map);
  }
  const bool fits =
      painting && painting->error.empty() && (painting->request->window || canvas == Canvas::kNone);
  if (!fits) return nullptr;
  drawn_ = &view;
  canvas_ = canvas;
  if (canvas == Canvas::kNone) {
    view.shown = painting;
    return painting;
  }
  mesh_ = painting->mesh.seenBy(camera);
  show(view, painting);
  blendOver();
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, view.behind, mesh_, painting->behind.cells);
  const bool divided = !painting->behind.values.empty();
  if (!divided || !around.translucent)
    overlay_.draw(window, view.colour, mesh_, painting->colour.cells);
  return painting;
}

void SoftwareRenderer::show(View& view, const PaintingPtr& painting) {
  if (view.shown == painting) return;
  const SplatCamera& camera = painting->request->camera;
  const auto write = [&camera](OverlayTexture& texture, const auto& layer) {
    if (!layer.values.empty()) texture.write(camera.width, camera.height, layer.values);
  };
  write(view.colour, painting->colour);
  write(view.behind, painting->behind);
  write(view.hiding, painting->hiding);
  view.shown = painting;
}

void SoftwareRenderer::hideFarther() const {
  if (!drawn_) return;
  const CanvasScope window(canvas_);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  overlay_.drawDepth(window, drawn_->hiding, mesh_, drawn_->shown->hiding.cells);
}

void SoftwareRenderer::drawBefore() const {
  if (!drawn_ || drawn_->shown->behind.values.empty()) return;
  const CanvasScope window(canvas_);
  blendOver();
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, drawn_->colour, mesh_, drawn_->shown->colour.cells);
}

void SoftwareRenderer::drawNumbers(const CanvasScope& window, const std::string& view_id,
                                   const SplatCamera& camera, const std::vector<float>& scene_depth,
                                   float least_alpha,
                                   const std::function<std::uint32_t(double)>& number) {
  const auto view = views_.find(view_id);
  if (view == views_.end() || !view->second.shown) return;
  const std::vector<double> depths = view->second.shown->surface.seenBy(camera, least_alpha);
  std::vector<std::uint8_t> rgba(4 * depths.size(), 0);
  for (std::size_t i = 0; i < depths.size(); ++i) {
    const double depth = depths[i];
    if (std::isnan(depth)) continue;
    const double ndc =
        (camera.ndc_scale * depth + camera.ndc_offset) / (camera.orthographic ? 1 : depth);
    if (!scene_depth.empty() && 0.5 * ndc + 0.5 > scene_depth[i]) continue;
    putNumber(&rgba[4 * i], number(depth));
  }
  bytes_.write(camera.width, camera.height, rgba);
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, bytes_);
}

void SoftwareRenderer::drawSurface(const std::string& view_id, const SplatCamera& camera,
                                   Canvas canvas, double far_clip) {
  const CanvasScope window(canvas);
  const auto scene_depth = window.readDepth(camera.width, camera.height);
  drawNumbers(window, view_id, camera, scene_depth, kSurfaceAlpha, [far_clip](double depth) {
    return static_cast<std::uint32_t>(16777215.0 * std::clamp(depth / far_clip, 0.0, 1.0));
  });
}

void SoftwareRenderer::drawPick(const std::string& view_id, const SplatCamera& camera,
                                const RenderSettings& settings, Canvas canvas,
                                std::uint32_t number) {
  const CanvasScope window(canvas);
  picked_ = {};
  picked_.camera = camera;
  picked_.settings = settings;
  if (canvas == Canvas::kNone) return;
  picked_.scene_depth = window.readDepth(camera.width, camera.height);
  drawNumbers(window, view_id, camera, picked_.scene_depth, kLeastPicked,
              [number](double) { return number; });
}

const std::vector<float>& SoftwareRenderer::readColor() const {
  if (!drawn_ || drawn_->shown->request->settings.asynchronous) {
    throw PictureError("pictures that follow the camera are only shown");
  }
  return drawn_->shown->picture.colour;
}

const std::vector<float>& SoftwareRenderer::readDepth() const {
  readColor();
  return drawn_->shown->picture.depth;
}

void SoftwareRenderer::forget(const std::string& view_id) {
  painter_.forget(view_id);
  const auto found = views_.find(view_id);
  if (found == views_.end()) return;
  if (drawn_ == &found->second) drawn_ = nullptr;
  views_.erase(found);
}

std::size_t SoftwareRenderer::gpuBytes() const {
  std::size_t bytes = bytes_.bytes();
  for (const auto& [id, view] : views_) {
    bytes += view.colour.bytes() + view.behind.bytes() + view.hiding.bytes();
  }
  return bytes;
}

}  // namespace rosplat
