#include "software_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "rosplat_core/threads/clock.hpp"

namespace rosplat {

namespace {

constexpr float kSurfaceAlpha = 0.5f;  // splats cover at least half of the pixel
constexpr double kAging = 1.0;         // a picture of ages that is older is painted anew [s]

bool same(const MapState& a, const MapState& b) { return a.edits == b.edits && a.torn == b.torn; }

// Whether a painting answers a request, for the states of its maps; a failed one does, too.
bool shows(const Painting& painting, const PaintRequest& request) {
  const auto as = [](const Painting::OfMap& shown, const Layer<PaintedMapPtr>& layer) {
    return same(shown.map, layer.state);
  };
  const auto ages = [](const auto& layer) { return layer.settings.mode == DrawMode::kAge; };
  const bool aged = now() - painting.asked - painting.took > kAging &&
                    std::any_of(request.layers.begin(), request.layers.end(), ages);
  if (!(*painting.request == request) || (aged && !request.interactive())) return false;
  return !painting.error.empty() || std::equal(painting.maps.begin(), painting.maps.end(),
                                               request.layers.begin(), request.layers.end(), as);
}

// The first of these layers whose map a painting shows; null where it shows none.
const Layer<PaintedMapPtr>* oneIn(const PaintRequest& shown, const PaintedPicture& picture) {
  const auto found = std::find_if(picture.layers.begin(), picture.layers.end(),
                                  [&](const auto& of) { return shown.of(*of.map) != nullptr; });
  return found == picture.layers.end() ? nullptr : &*found;
}

// The camera of a layer in the frame of a painting's first map. The painting must show the map.
SplatCamera inFirst(const PaintRequest& shown, const Layer<PaintedMapPtr>& layer) {
  if (layer.map == shown.map()) return layer.camera;
  return inFrameOf(frameSeenBy(shown.camera(), shown.of(*layer.map)->camera), layer.camera);
}

// A number of 24 bits as an opaque colour, its lowest byte in blue.
void putNumber(std::uint8_t* rgba, std::uint32_t number) {
  rgba[0] = static_cast<std::uint8_t>(number >> 16);
  rgba[1] = static_cast<std::uint8_t>(number >> 8);
  rgba[2] = static_cast<std::uint8_t>(number);
  rgba[3] = 255;
}

}  // namespace

PaintRequest SoftwareRenderer::requestOf(const PaintedPicture& picture) const {
  PaintRequest request(picture);
  const auto ages = [](const auto& layer) {
    return layer.settings.interactive && layer.settings.mode == DrawMode::kAge;
  };
  if (std::any_of(picture.layers.begin(), picture.layers.end(), ages)) {
    request.age_tick = static_cast<std::uint64_t>(painter_.clock());
  }
  return request;
}

const std::string& SoftwareRenderer::join(const PaintedPicture& picture) {
  return names_.join(picture, [this](const std::string& name) { drop(name); });
}

const SoftwareRenderer::ShownView* SoftwareRenderer::viewOf(const PaintedPicture& picture) const {
  const std::string* const name = names_.of(picture.viewId());
  const auto view = name ? views_.find(*name) : views_.end();
  return view == views_.end() ? nullptr : &view->second;
}

void SoftwareRenderer::ask(const std::string& name, PaintRequestPtr request) {
  views_[name].asked = request;
  painter_.ask(name, std::move(request));
}

bool SoftwareRenderer::asked(const ShownView& view, const PaintRequest& request) {
  const auto as = [](const Layer<PaintedMapPtr>& a, const Layer<PaintedMapPtr>& b) {
    return same(a.state, b.state);
  };
  return view.asked && *view.asked == request &&
         std::equal(view.asked->layers.begin(), view.asked->layers.end(), request.layers.begin(),
                    request.layers.end(), as);
}

bool SoftwareRenderer::ready(const PaintedPicture& picture) const {
  const ShownView* const view = viewOf(picture);
  if (!view) return false;
  const PaintingPtr newest = painter_.newest(*names_.of(picture.viewId()));
  if (!newest || !(newest->error.empty() || newest->request == view->asked)) return false;
  const PaintRequest request = requestOf(picture);
  return shows(*newest, request) || overtaken(*view, *newest, request);
}

void SoftwareRenderer::request(const PaintedPicture& picture) {
  const std::string& name = join(picture);
  auto request = std::make_shared<PaintRequest>(requestOf(picture));
  if (!ready(picture) && !asked(views_[name], *request)) ask(name, std::move(request));
}

bool SoftwareRenderer::overtaken(const ShownView& view, const Painting& painting,
                                 const PaintRequest& request) {
  return painting.request == view.asked && painting.error.empty() && *painting.request == request;
}

PaintingPtr SoftwareRenderer::draw(const PaintedPicture& picture, Canvas canvas,
                                   const Surroundings& around) {
  const std::string& name = join(picture);
  const bool interactive = picture.settings().interactive;
  auto request = std::make_shared<PaintRequest>(requestOf(picture));
  const SplatCamera& camera = request->camera();
  request->window = canvas != Canvas::kNone;
  ShownView& view = views_[name];
  if (interactive && request->window) request->motion = view.motion.follow(camera, now());
  if (around.translucent) {
    request->translucent_depth =
        depthsOf(canvas, camera.width, camera.height, around.translucent_in, around.translucent);
  }
  const CanvasScope window(canvas);
  if (around.opaque) request->scene_depth = window.readDepth(camera.width, camera.height);

  drawn_ = nullptr;
  PaintingPtr painting = painter_.newest(name);
  exact_ = painting && shows(*painting, *request);
  if (exact_ && !painting->error.empty()) {
    exact_ = false;  // another time it may succeed
    if (std::exchange(view.asked, nullptr) == painting->request) {
      throw PictureError(painting->error);
    }
  }
  if (!interactive && painting && overtaken(view, *painting, *request)) {
    exact_ = true;
    view.asked = nullptr;  // another picture shows what has come since
  } else if (!interactive && !exact_) {
    view.asked = nullptr;
    view.shown = painting = nullptr;  // one picture is in memory at a time
    painting = painter_.paintNow(name, request);
    exact_ = true;
  } else if (!exact_ && asked(view, *request)) {
    painter_.hurry(name);  // the camera rests
  } else if (!exact_) {
    ask(name, request);
  } else if (interactive && !painting->settled && painting->request == view.asked) {
    request->rests = true;
    ask(name, request);
  }
  if (exact_) view.exact_until = now();
  if (!painting || !painting->error.empty()) return nullptr;
  if (!painting->request->window && canvas != Canvas::kNone) return nullptr;
  const Layer<PaintedMapPtr>* const layer = oneIn(*painting->request, picture);
  if (!layer) return nullptr;
  drawn_ = &view;
  canvas_ = canvas;
  if (canvas == Canvas::kNone) {
    view.shown = painting;
    return painting;
  }
  mesh_ = painting->mesh.seenBy(inFirst(*painting->request, *layer));
  show(view, painting);
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, view.behind, mesh_, painting->behind.cells);
  const bool divided = !painting->behind.values.empty();
  if (!divided || !around.translucent)
    overlay_.draw(window, view.colour, mesh_, painting->colour.cells);
  return painting;
}

void SoftwareRenderer::show(ShownView& view, const PaintingPtr& painting) {
  if (view.shown == painting) return;
  const SplatCamera& camera = painting->request->camera();
  const auto write = [&camera](OverlayTexture& texture, const auto& layer) {
    if (layer.shows()) texture.write(camera.width, camera.height, layer.values);
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
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, drawn_->colour, mesh_, drawn_->shown->colour.cells);
}

std::vector<double> SoftwareRenderer::depthsShown(const PaintedPicture& picture,
                                                  const std::vector<float>& scene_depth,
                                                  float least_alpha) const {
  const ShownView* const view = viewOf(picture);
  if (!view || !view->shown) return {};
  const Painting& shown = *view->shown;
  const Layer<PaintedMapPtr>* const layer = oneIn(*shown.request, picture);
  if (!layer) return {};
  const SplatCamera& camera = layer->camera;
  std::vector<double> depths =
      shown.surface.seenBy(inFirst(*shown.request, *layer), shown.colour.values, least_alpha);
  for (std::size_t i = 0; i < depths.size() && !scene_depth.empty(); ++i) {
    const double ndc =
        (camera.ndc_scale * depths[i] + camera.ndc_offset) / (camera.orthographic ? 1 : depths[i]);
    if (0.5 * ndc + 0.5 > scene_depth[i]) depths[i] = std::numeric_limits<double>::quiet_NaN();
  }
  return depths;
}

void SoftwareRenderer::drawNumbers(const CanvasScope& window, const SplatCamera& camera,
                                   const std::vector<std::uint32_t>& numbers) {
  if (numbers.empty()) return;
  std::vector<std::uint8_t> rgba(4 * numbers.size(), 0);
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    if (numbers[i]) putNumber(&rgba[4 * i], numbers[i]);
  }
  bytes_.write(camera.width, camera.height, rgba);
  glDisable(GL_DEPTH_TEST);
  overlay_.draw(window, bytes_);
}

void SoftwareRenderer::drawSurface(const PaintedPicture& picture, Canvas canvas, double far_clip) {
  const CanvasScope window(canvas);
  const SplatCamera& camera = picture.camera();
  const auto scene_depth = window.readDepth(camera.width, camera.height);
  std::vector<std::uint32_t> numbers;
  for (const double depth : depthsShown(picture, scene_depth, kSurfaceAlpha)) {
    const double part = std::isnan(depth) ? 0 : std::clamp(depth / far_clip, 0.0, 1.0);
    numbers.push_back(static_cast<std::uint32_t>(16777215.0 * part + 0.5));
  }
  drawNumbers(window, camera, numbers);
}

void SoftwareRenderer::drawPick(const PaintedPicture& picture, Canvas canvas,
                                std::uint32_t number) {
  const CanvasScope window(canvas);
  const SplatCamera& camera = picture.camera();
  picked_ = requestOf(picture);
  if (canvas == Canvas::kNone) return;
  picked_.scene_depth = window.readDepth(camera.width, camera.height);
  std::vector<std::uint32_t> numbers;
  for (const double depth : depthsShown(picture, picked_.scene_depth, kLeastPicked)) {
    numbers.push_back(std::isnan(depth) ? 0 : number);
  }
  drawNumbers(window, camera, numbers);
}

const std::vector<float>& SoftwareRenderer::readColor() const {
  if (!drawn_ || drawn_->shown->request->interactive()) {
    throw PictureError("pictures that follow the camera are only shown");
  }
  return drawn_->shown->picture.colour;
}

const std::vector<float>& SoftwareRenderer::readDepth() const {
  readColor();
  return drawn_->shown->picture.depth;
}

void SoftwareRenderer::forget(const std::string& view_id) {
  names_.forget(view_id, [this](const std::string& name) { drop(name); });
}

void SoftwareRenderer::drop(const std::string& name) {
  painter_.forget(name);
  const auto found = views_.find(name);
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
