#include "splat_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>

#include "map/detail.hpp"

namespace rosplat {

namespace {

// What views may take together, beside one.
constexpr std::size_t kMostViewBytes = std::size_t{1} << 30;
constexpr const char* kMouseView = "mouse";  // of picks and of the surface

const ShaderSource& checked(const ShaderSource& source) {
  if (const std::string reason = gl::unsupported(); !reason.empty()) throw gl::Error(reason);
  return source;
}

// Whether more than may be is drawn, and there is a larger error to be tried.
bool coarsen(Frame& frame, std::size_t drawn, std::size_t most) {
  if (!frame.nodes || frame.order || drawn <= most || frame.error > kCoarsestError) return false;
  frame.error = coarserError(frame.error, drawn, most);
  return true;
}

}  // namespace

SplatRenderer::SplatRenderer(const ShaderSource& source)
    : accelerated_(gl::accelerated()),
      shaders_(checked(source)),
      reader_(shaders_),
      sort_(shaders_),
      picker_(shaders_),
      divide_(shaders_.draw({"splat_composite.vert"}, {"splat_divide.frag"})),
      composite_(shaders_.draw({"splat_composite.vert"}, {"splat_composite.frag"})),
      hide_(shaders_.draw({"splat_composite.vert"}, {"splat_hide.frag"})),
      surface_(shaders_.draw({"splat_composite.vert"}, {"splat_surface.frag"})) {
  const ViewState compiled(shaders_, sort_);  // what all views draw with
}

void SplatRenderer::apply(const std::shared_ptr<const GaussianEdit>& edit) {
  store_.apply(*edit, clock());
  if (levels_) levels_->apply(store_, edit, clock());
  gl::deleteAbandoned();
}

void SplatRenderer::advanceLevels(bool all) {
  if (!levels_error_.empty()) return;
  try {
    if (!levels_) levels_.emplace();
    levels_->advance(store_, clock(), all);
    levels_error_ = levels_->error();
  } catch (const gl::Error& error) {
    levels_error_ = error.what();
  } catch (const std::bad_alloc&) {
    levels_error_ = "there is no memory for levels of detail";
  }
  if (!levels_error_.empty()) endLevels();
}

void SplatRenderer::dropLevels() {
  levels_error_.clear();
  endLevels();
}

void SplatRenderer::endLevels() {
  if (!levels_) return;
  levels_.reset();
  store_.dropLevels();
}

void SplatRenderer::forEachPage(const std::function<void(const GaussianEdit&)>& take) const {
  take(pages().moves());
  for (std::size_t i = 0; i < pages().pages().size(); ++i) {
    if (store_.holds(pages().pages()[i])) take(editOf(store_.read(i, 1)));
  }
}

double SplatRenderer::clock() const {
  const std::chrono::duration<double> age = std::chrono::steady_clock::now() - start_;
  return std::fmod(age.count() * kTicksPerSecond, 65536.0);
}

bool SplatRenderer::sorts() {
  if (!sorts_) {
    const gl::StateGuard guard;
    sorts_ = sort_.check();
  }
  return *sorts_;
}

std::string SplatRenderer::warning() const {
  std::string text;
  if (sorts_ && !*sorts_) {
    text = "the graphics driver sorts wrongly: the processor does it, and quads are drawn";
  } else if (sort_.lostBallots()) {
    text = "the graphics driver's subgroups don't serve for sorting, which does without them";
  }
  if (refused_depth_) {
    text += text.empty() ? "" : "; ";
    text += "the graphics driver keeps the depth of the opaque scene: nothing hides splats";
  }
  return text;
}

SplatRenderer::View& SplatRenderer::view(const std::string& view_id) {
  auto found = views_.find(view_id);
  if (found == views_.end()) {
    std::size_t bytes = 0;
    auto oldest = views_.begin();
    for (auto at = views_.begin(); at != views_.end(); ++at) {
      bytes += at->second.state->bytes();
      if (at->second.used < oldest->second.used) oldest = at;
    }
    if (bytes > kMostViewBytes) {
      auto node = views_.extract(oldest);
      node.key() = view_id;
      found = views_.insert(std::move(node)).position;
    } else {
      found = views_.emplace(view_id, std::make_unique<ViewState>(shaders_, sort_)).first;
    }
  }
  found->second.used = ++used_;
  return found->second;
}

void SplatRenderer::forget(const std::string& view_id) {
  const auto found = views_.find(view_id);
  if (found == views_.end()) return;
  if (found->second.state.get() == drawn_) drawn_ = nullptr;
  views_.erase(found);
}

Frame SplatRenderer::frame(const SplatCamera& camera, const MapState& map,
                           const RenderSettings& settings, const OrderPtr& order, Canvas canvas,
                           gl::Stopwatch& stopwatch) const {
  return {store_,   levels_ ? &levels_->nodes() : nullptr,
          camera,   map,
          settings, 0,
          order,    canvas != Canvas::kWindow,
          clock(),  stopwatch};
}

void SplatRenderer::copyDepth(const CanvasScope& window, const gl::Target& target) {
  const GLenum format = window.depthFormat();
  if (format && format == refused_depth_) return clearDepth();
  // Errors are asked for once: a driver with threads of its own would have to wait for them.
  const bool tried = !format || format == copied_depth_;
  if (!tried) gl::dropErrors();
  window.copyDepth(target);
  if (tried) return;
  if (glGetError() == GL_NO_ERROR) {
    copied_depth_ = format;
  } else {
    refused_depth_ = format;
    clearDepth();
  }
}

// Has the depth of the translucent objects in the samples of the framebuffer.
void SplatRenderer::keepTranslucent(ViewState& view, const SplatCamera& camera,
                                    const std::function<void()>& draw) {
  GLint samples = 0;
  glGetIntegerv(GL_SAMPLES, &samples);
  samples = std::max(samples, 1);
  gl::SampledDepth& depth = view.translucent;
  if (depth.width() != camera.width || depth.height() != camera.height ||
      depth.samples() != samples) {
    depth = gl::SampledDepth(camera.width, camera.height, samples);
  }
  const gl::DepthScope scope(depth);
  draw();
}

// Has the depth of the view's colour, so far the opaque scene's, let pass only what is before the
// translucent objects, and keeps the opaque scene's in `behind`.
void SplatRenderer::divide(ViewState& view) const {
  const gl::Target& color = view.color;
  const int width = color.width(), height = color.height();
  view.behind.become(color.format(), width, height, color.depthFormat(), GL_RG32F);
  glCopyImageSubData(color.depth(), GL_TEXTURE_2D, 0, 0, 0, 0, view.behind.depth(), GL_TEXTURE_2D,
                     0, 0, 0, 0, width, height, 1);
  divide_.use();
  divide_.set("samples", view.translucent.samples());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, view.translucent.texture());
  glViewport(0, 0, width, height);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void SplatRenderer::draw(const std::string& view_id, const SplatCamera& camera, const MapState& map,
                         const RenderSettings& settings, const OrderPtr& order, Canvas canvas,
                         const Surroundings& around, Cutting cutting) {
  const std::function<void()>& translucent = around.translucent;
  gl::deleteAbandoned();
  gl::Stopwatch stopwatch(settings.profile);
  View& of = this->view(view_id);
  ViewState& view = *of.state;
  drawn_ = &view;
  if (translucent) {
    keepTranslucent(view, camera, translucent);
    stopwatch.lap("translucent");
  }
  const CanvasScope window(canvas);
  const bool in_tiles = (settings.rasterizer == Rasterizer::kTiles ||
                         (settings.rasterizer == Rasterizer::kAuto && accelerated_)) &&
                        sorts();
  Frame frame = this->frame(camera, map, settings, order, canvas, stopwatch);
  if (levels_ && !order) frame.error = cutting.error;
  const bool fresh = view.color.become(settings.float_blending ? GL_RGBA32F : GL_RGBA16F,
                                       camera.width, camera.height, window.targetDepth());
  of.timer.begin();
  const bool anew = view.prepare(frame);
  glFlush();  // the graphics card begins while the rest is submitted
  const gl::DrawScope scope(view.color);
  if (around.opaque) {
    copyDepth(window, view.color);
  } else if (fresh || !view.open) {
    clearDepth();
  }
  view.open = !around.opaque && !translucent;
  if (translucent) {
    divide(view);
    stopwatch.lap("divide");
  }
  view.blend(frame, scope, in_tiles, bool(translucent));
  glFlush();
  // All is submitted: the graphics card goes on while this waits for what it counted first.
  while (!view.hasRoom(frame) || coarsen(frame, view.splats().count(), cutting.most)) {
    view.prepare(frame);
    view.blend(frame, scope, in_tiles, bool(translucent));
  }
  drawn_error_ = frame.cuts() ? frame.error : 0;
  if (canvas != Canvas::kNone) {
    blendOver();
    glDisable(GL_DEPTH_TEST);
    window.layOver(composite_, translucent ? view.behind : view.color);
    stopwatch.lap("composite");
  }
  if (anew && of.timer.end()) {
    of.timed_error = drawn_error_;
    of.timed_in_time = cutting.in_time;
  }
  profile_ = stopwatch.laps();
}

std::optional<SplatRenderer::Timed> SplatRenderer::timed(const std::string& view_id) {
  const auto found = views_.find(view_id);
  if (found == views_.end()) return {};
  const std::optional<double> seconds = found->second.timer.take();
  if (!seconds) return {};
  return Timed{found->second.timed_error, *seconds, found->second.timed_in_time};
}

void SplatRenderer::hideFarther() const {
  if (!drawn_) return;
  const CanvasScope window(Canvas::kWindow);
  const gl::DrawScope scope(drawn_->behind);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  window.layOver(hide_, drawn_->behind);
}

void SplatRenderer::drawBefore() const {
  if (!drawn_) return;
  const CanvasScope window(Canvas::kWindow);
  const gl::DrawScope scope(drawn_->color);
  blendOver();
  glDisable(GL_DEPTH_TEST);
  window.layOver(composite_, drawn_->color);
}

void SplatRenderer::drawSurface(const SplatCamera& camera, const MapState& map,
                                const RenderSettings& settings, const OrderPtr& order,
                                Canvas canvas, double far_clip) {
  gl::Stopwatch stopwatch(false);
  const CanvasScope window(canvas);
  ViewState& view = *this->view(kMouseView).state;
  const Frame frame = this->frame(camera, map, settings, order, canvas, stopwatch);
  do {
    view.prepare(frame);
  } while (!view.hasRoom(frame));
  surface_depth_.become(GL_RGBA32F, camera.width, camera.height, window.targetDepth());
  const gl::DrawScope scope(surface_depth_);
  copyDepth(window, surface_depth_);
  view.quads().blendDepth(view.splats(), surface_depth_);
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  surface_.use();
  surface_.set("far_clip", static_cast<float>(far_clip));
  window.layOver(surface_, surface_depth_);
}

void SplatRenderer::drawPick(const SplatCamera& camera, const MapState& map,
                             const RenderSettings& settings, const OrderPtr& order, Canvas canvas,
                             std::uint32_t number) {
  gl::Stopwatch stopwatch(false);
  const CanvasScope window(canvas);
  ViewState& view = *this->view(kMouseView).state;
  const Frame frame = this->frame(camera, map, settings, order, canvas, stopwatch);
  const bool in_tiles = sorts();
  bool listed = false;
  do {
    view.prepare(frame);
    listed = in_tiles && view.list(frame);
  } while (!view.hasRoom(frame));
  pick_depth_.become(GL_RGBA16F, camera.width, camera.height, window.targetDepth());
  const gl::DrawScope scope(pick_depth_);
  copyDepth(window, pick_depth_);
  picker_.pick(view.splats(), listed ? &view.tiles() : nullptr, pick_depth_, view.topFirst());
  if (canvas != Canvas::kNone) picker_.draw(window, pick_depth_, number);
}

std::vector<SplatValues> SplatRenderer::readSlots(const std::vector<std::uint32_t>& slots) const {
  const gl::StateGuard guard;
  return reader_.read(store_, slots);
}

std::vector<float> SplatRenderer::readColor() const {
  if (!drawn_) return {};
  const gl::Target& color = drawn_->color;
  const std::size_t row = 4 * static_cast<std::size_t>(color.width());
  const gl::StateGuard guard;
  const gl::DrawScope scope(color);
  std::vector<float> pixels = gl::readPixels(color.width(), color.height());
  if (!drawn_->topFirst()) {
    for (std::size_t top = 0, bottom = pixels.size() - row; top < bottom;
         top += row, bottom -= row) {
      std::swap_ranges(&pixels[top], &pixels[top] + row, &pixels[bottom]);
    }
  }
  return pixels;
}

std::vector<float> SplatRenderer::readDepth() {
  if (!drawn_) return {};
  const CanvasScope window(Canvas::kNone);
  const gl::Target& color = drawn_->color;
  const int width = color.width(), height = color.height();
  depth_.become(GL_RGBA32F, width, height, color.depthFormat());
  const gl::DrawScope drawn(color);
  const gl::DrawScope scope(depth_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, drawn.framebuffer());
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  drawn_->use();
  drawn_->quads().blendDepth(drawn_->splats(), depth_);
  const std::size_t columns = static_cast<std::size_t>(width),
                    rows = static_cast<std::size_t>(height);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, scope.framebuffer());
  const std::vector<float> blended = gl::readPixels(width, height);
  std::vector<float> depths(columns * rows);
  for (std::size_t row = 0; row < rows; ++row) {
    const float* source = &blended[4 * columns * (drawn_->topFirst() ? row : rows - 1 - row)];
    for (std::size_t column = 0; column < columns; ++column, source += 4) {
      depths[columns * row + column] =
          source[3] > 0.0f ? source[0] / source[3] : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return depths;
}

std::size_t SplatRenderer::gpuBytes() const {
  std::size_t bytes = store_.bytes() + (levels_ ? levels_->gpuBytes() : 0) + sort_.bytes() +
                      picker_.bytes() + depth_.bytes() + surface_depth_.bytes() +
                      pick_depth_.bytes();
  for (const auto& [id, view] : views_) bytes += view.state->bytes();
  return bytes;
}

}  // namespace rosplat
