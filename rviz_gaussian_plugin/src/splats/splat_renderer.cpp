#include "splat_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace rosplat {

namespace {

const ShaderSource& checked(const ShaderSource& source) {
  if (const std::string reason = gl::unsupported(); !reason.empty()) throw gl::Error(reason);
  return source;
}

}  // namespace

SplatRenderer::SplatRenderer(const ShaderSource& source)
    : accelerated_(gl::accelerated()),
      shaders_(checked(source)),
      reader_(shaders_),
      sort_(shaders_),
      splats_(shaders_, sort_, tallies_),
      tiles_(shaders_, sort_, tallies_),
      quads_(shaders_),
      picker_(shaders_),
      divide_(shaders_.draw({"splat_composite.vert"}, {"splat_divide.frag"})),
      composite_(shaders_.draw({"splat_composite.vert"}, {"splat_composite.frag"})),
      hide_(shaders_.draw({"splat_composite.vert"}, {"splat_hide.frag"})),
      surface_(shaders_.draw({"splat_composite.vert"}, {"splat_surface.frag"})) {}

void SplatRenderer::apply(const GaussianEdit& edit) {
  store_.apply(edit, clock());
  gl::deleteAbandoned();
  splats_.forget();
}

void SplatRenderer::forEachPage(const std::function<void(const GaussianEdit&)>& take) const {
  for (const SlotPage& page : pages().pages()) {
    if (store_.holds(page)) take(store_.edit(page));
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

void SplatRenderer::setTarget(gl::Target& target, GLenum format, const SplatCamera& camera,
                              const RenderSettings& settings, const CanvasScope& window) {
  target.become(format, camera.width, camera.height,
                window.depthFormat() ? window.depthFormat() : GL_DEPTH24_STENCIL8);
  raster_ = {window.canvas() != Canvas::kWindow,
             camera.orthographic,
             camera.ndc_scale,
             camera.ndc_offset,
             settings.mode,
             settings.depth_range};
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

bool SplatRenderer::prepare(const SplatCamera& camera, const MapState& map,
                            const RenderSettings& settings, gl::Stopwatch& stopwatch) {
  // The frame before may still read what this one writes.
  glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT | GL_SHADER_IMAGE_ACCESS_BARRIER_BIT);
  if (!splats_.prepare(store_, camera, map, settings, clock(), stopwatch)) return false;
  tiles_.forget();
  return true;
}

bool SplatRenderer::prepareAndCheck(const SplatCamera& camera, const MapState& map,
                                    const RenderSettings& settings, const gl::Target* lists_for) {
  gl::Stopwatch stopwatch(false);
  bool in_tiles = lists_for, unknown = false;
  do {
    unknown = prepare(camera, map, settings, stopwatch);
    in_tiles = in_tiles && !tiles_.refused(*lists_for);
    if (in_tiles && !tiles_.listed(*lists_for)) {
      in_tiles = tiles_.count(splats_, *lists_for, stopwatch);
      unknown = true;
    }
    if (unknown) tallies_.ask();
  } while (unknown && !checkRoom(map, in_tiles));
  if (in_tiles && !tiles_.listed(*lists_for)) tiles_.list(splats_, *lists_for, stopwatch);
  return in_tiles;
}

bool SplatRenderer::checkRoom(const MapState& map, bool& in_tiles) {
  // What is still to come will be as visible as what is there; but not all comes that is announced.
  const double growth =
      std::clamp(double(map.expected) / std::max(1u, store_.capacity()), 1.0, 4.0);
  const std::size_t most = std::max<std::size_t>(store_.slots(), std::min(map.expected, kMaxSlots));
  bool enough = splats_.checkRoom(most, growth);
  if (in_tiles) {
    const std::size_t pairs = tallies_.wait(Tallies::kPairs, Tally::kWanted);
    enough = enough && pairs <= tiles_.room();
    in_tiles = tiles_.reserve(pairs, withSlack(pairs, growth));
  }
  return enough;
}

// Has the depth of the translucent objects in translucent_, in the samples of the framebuffer.
void SplatRenderer::keepTranslucent(const SplatCamera& camera, const std::function<void()>& draw) {
  GLint samples = 0;
  glGetIntegerv(GL_SAMPLES, &samples);
  samples = std::max(samples, 1);
  if (translucent_.width() != camera.width || translucent_.height() != camera.height ||
      translucent_.samples() != samples) {
    translucent_ = gl::SampledDepth(camera.width, camera.height, samples);
  }
  const gl::DepthScope scope(translucent_);
  draw();
}

// Has color_'s depth, so far the opaque scene's, let pass only what is before the translucent
// objects, and keeps the opaque scene's in behind_.
void SplatRenderer::divide() {
  const int width = color_.width(), height = color_.height();
  behind_.become(color_.format(), width, height, color_.depthFormat(), GL_RG32F);
  glCopyImageSubData(color_.depth(), GL_TEXTURE_2D, 0, 0, 0, 0, behind_.depth(), GL_TEXTURE_2D, 0,
                     0, 0, 0, width, height, 1);
  divide_.use();
  divide_.set("samples", translucent_.samples());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, translucent_.texture());
  glViewport(0, 0, width, height);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void SplatRenderer::draw(const SplatCamera& camera, const MapState& map,
                         const RenderSettings& settings, Canvas canvas,
                         const std::function<void()>& translucent) {
  gl::deleteAbandoned();
  gl::Stopwatch stopwatch(settings.profile);
  if (translucent) {
    keepTranslucent(camera, translucent);
    stopwatch.lap("translucent");
  }
  const CanvasScope window(canvas);
  setTarget(color_, settings.float_blending ? GL_RGBA32F : GL_RGBA16F, camera, settings, window);
  bool in_tiles = (settings.rasterizer == Rasterizer::kTiles ||
                   (settings.rasterizer == Rasterizer::kAuto && accelerated_)) &&
                  sorts();
  bool unknown = prepare(camera, map, settings, stopwatch);
  glFlush();  // the graphics card begins while the rest is submitted
  const gl::DrawScope scope(color_);
  copyDepth(window, color_);
  if (translucent) {
    divide();
    stopwatch.lap("divide");
  }
  const gl::Target* const behind = translucent ? &behind_ : nullptr;
  in_tiles = in_tiles && !tiles_.refused(color_);
  while (true) {
    if (in_tiles) {
      if (!tiles_.listed(color_)) {
        in_tiles = tiles_.count(splats_, color_, stopwatch);
        if (!in_tiles) continue;
        tallies_.ask();
        unknown = true;
        // Where there were too many, waiting costs less than to list them in vain again.
        if (tiles_.refused() && !checkRoom(map, in_tiles)) {
          unknown = prepare(camera, map, settings, stopwatch);
          continue;
        }
        tiles_.list(splats_, color_, stopwatch);
      }
      tiles_.blend(splats_, color_, behind, raster_);
      stopwatch.lap("blend");
    } else {
      if (unknown) tallies_.ask();
      quads_.blend(splats_, color_, scope, behind, raster_);
      stopwatch.lap("quads");
    }
    // All is submitted: the graphics card goes on while this waits for what it counted first.
    if (!unknown || checkRoom(map, in_tiles)) break;
    unknown = prepare(camera, map, settings, stopwatch);
  }
  rasterizer_ = in_tiles ? "tiles" : "quads";
  if (canvas != Canvas::kNone) {
    blendOver();
    glDisable(GL_DEPTH_TEST);
    window.layOver(composite_, behind ? behind_ : color_);
    stopwatch.lap("composite");
  }
  profile_ = stopwatch.laps();
}

void SplatRenderer::hideFarther() const {
  const CanvasScope window(Canvas::kWindow);
  const gl::DrawScope scope(behind_);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  window.layOver(hide_, behind_);
}

void SplatRenderer::drawBefore() const {
  const CanvasScope window(Canvas::kWindow);
  const gl::DrawScope scope(color_);
  blendOver();
  glDisable(GL_DEPTH_TEST);
  window.layOver(composite_, color_);
}

void SplatRenderer::drawSurface(const SplatCamera& camera, const MapState& map,
                                const RenderSettings& settings, Canvas canvas, double far_clip) {
  const CanvasScope window(canvas);
  setTarget(surface_depth_, GL_RGBA32F, camera, settings, window);
  prepareAndCheck(camera, map, settings, nullptr);
  const gl::DrawScope scope(surface_depth_);
  copyDepth(window, surface_depth_);
  quads_.blendDepth(splats_, surface_depth_, raster_);
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  surface_.use();
  surface_.set("far_clip", static_cast<float>(far_clip));
  window.layOver(surface_, surface_depth_);
}

void SplatRenderer::drawPick(const SplatCamera& camera, const MapState& map,
                             const RenderSettings& settings, Canvas canvas, std::uint32_t handle) {
  const CanvasScope window(canvas);
  setTarget(pick_depth_, GL_RGBA16F, camera, settings, window);
  const bool listed = prepareAndCheck(camera, map, settings, sorts() ? &pick_depth_ : nullptr);
  const gl::DrawScope scope(pick_depth_);
  copyDepth(window, pick_depth_);
  picker_.pick(splats_, listed ? &tiles_ : nullptr, pick_depth_, raster_);
  if (canvas != Canvas::kNone) picker_.draw(window, pick_depth_, handle);
}

std::vector<SplatValues> SplatRenderer::readSlots(const std::vector<std::uint32_t>& slots) const {
  const gl::StateGuard guard;
  return reader_.read(store_, slots);
}

std::vector<float> SplatRenderer::readColor() const {
  const std::size_t row = 4 * static_cast<std::size_t>(color_.width());
  const gl::StateGuard guard;
  const gl::DrawScope scope(color_);
  std::vector<float> pixels = gl::readPixels(color_.width(), color_.height());
  if (!raster_.top_first) {
    for (std::size_t top = 0, bottom = pixels.size() - row; top < bottom;
         top += row, bottom -= row) {
      std::swap_ranges(&pixels[top], &pixels[top] + row, &pixels[bottom]);
    }
  }
  return pixels;
}

std::vector<float> SplatRenderer::readDepth() {
  const CanvasScope window(Canvas::kNone);
  const int width = color_.width(), height = color_.height();
  depth_.become(GL_RGBA32F, width, height, color_.depthFormat());
  const gl::DrawScope color(color_);
  const gl::DrawScope scope(depth_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, color.framebuffer());
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  quads_.blendDepth(splats_, depth_, raster_);
  const std::size_t columns = static_cast<std::size_t>(width),
                    rows = static_cast<std::size_t>(height);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, scope.framebuffer());
  const std::vector<float> blended = gl::readPixels(width, height);
  std::vector<float> depths(columns * rows);
  for (std::size_t row = 0; row < rows; ++row) {
    const float* source = &blended[4 * columns * (raster_.top_first ? row : rows - 1 - row)];
    for (std::size_t column = 0; column < columns; ++column, source += 4) {
      depths[columns * row + column] =
          source[3] > 0.0f ? source[0] / source[3] : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return depths;
}

std::size_t SplatRenderer::gpuBytes() const {
  return store_.bytes() + splats_.bytes() + sort_.bytes() + tiles_.bytes() + quads_.bytes() +
         picker_.bytes() + color_.bytes() + depth_.bytes() + translucent_.bytes() +
         behind_.bytes() + surface_depth_.bytes() + pick_depth_.bytes();
}

}  // namespace rosplat
