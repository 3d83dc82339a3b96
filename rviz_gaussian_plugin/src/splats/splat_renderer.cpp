#include "splat_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

namespace rosplat {

namespace {

constexpr std::size_t kLeastRoom = 65536;  // for visible splats
constexpr int kPatience = 16;              // frames until fewer bits are sorted

// What Ogre may have left that would spoil a pass here.
void resetState() {
  for (const GLenum off :
       {GL_ALPHA_TEST, GL_CULL_FACE, GL_SCISSOR_TEST, GL_STENCIL_TEST, GL_POLYGON_OFFSET_FILL,
        GL_SAMPLE_ALPHA_TO_COVERAGE, GL_FRAMEBUFFER_SRGB}) {
    glDisable(off);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
}

// For what is premultiplied.
void blendOver() {
  glEnable(GL_BLEND);
  glBlendEquation(GL_FUNC_ADD);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
}

// The opaque scene's depth at (x, y) of a framebuffer into the bound one, resolved to one sample a
// pixel. Where there is no scene or no depth, nothing is hidden.
void copyDepth(Canvas canvas, GLuint source, GLint x, GLint y, const gl::Target& target) {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, source);
  GLint kind = GL_NONE;
  glGetFramebufferAttachmentParameteriv(GL_READ_FRAMEBUFFER,
                                        source == 0 ? GL_DEPTH : GL_DEPTH_ATTACHMENT,
                                        GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE, &kind);
  if (canvas == Canvas::kNone || kind == GL_NONE) {
    const GLfloat farthest = 1.0f;
    glDepthMask(GL_TRUE);
    glClearBufferfv(GL_DEPTH, 0, &farthest);
    return;
  }
  glBlitFramebuffer(x, y, x + target.width(), y + target.height(), 0, 0, target.width(),
                    target.height(), GL_DEPTH_BUFFER_BIT, GL_NEAREST);
}

bool isAccelerated() {
  const auto* name = reinterpret_cast<const char*>(glGetString(GL_RENDERER));
  const std::string_view renderer = name ? name : "";
  for (const char* software : {"llvmpipe", "softpipe", "swrast", "SWR", "Software"}) {
    if (renderer.find(software) != std::string_view::npos) return false;
  }
  return true;
}

const ShaderSource& checked(const ShaderSource& source) {
  if (const std::string reason = gl::unsupported(); !reason.empty()) throw gl::Error(reason);
  return source;
}

}  // namespace

SplatRenderer::SplatRenderer(const ShaderSource& source)
    : accelerated_(isAccelerated()),
      shaders_(checked(source)),
      projection_(shaders_, tallies_),
      order_program_(shaders_.compute({"splat_visible.glsl", "splat_order.comp"})),
      sort_(shaders_),
      tiles_(shaders_, sort_, tallies_),
      quads_(shaders_.draw({"splat_ellipses.glsl", "splat_depth.glsl", "splat_quad.vert"},
                           {"splat_quad.frag"})),
      quads_behind_(shaders_.draw({"splat_ellipses.glsl", "splat_depth.glsl", "splat_quad.vert"},
                                  {"splat_behind.glsl", "splat_quad.frag"})),
      divide_(shaders_.draw({"splat_composite.vert"}, {"splat_divide.frag"})),
      tile_depth_(shaders_.compute({"splat_ellipses.glsl", "splat_tiles.glsl", "tile_depth.comp"})),
      divide_quads_(shaders_.compute(
          {"splat_ellipses.glsl", "splat_tiles.glsl", "splat_depth.glsl", "splat_divide.comp"})),
      composite_(shaders_.draw({"splat_composite.vert"}, {"splat_composite.frag"})),
      hide_(shaders_.draw({"splat_composite.vert"}, {"splat_hide.frag"})),
      surface_(shaders_.draw({"splat_composite.vert"}, {"splat_surface.frag"})),
      pick_(shaders_.compute({"splat_visible.glsl", "splat_ellipses.glsl", "splat_tiles.glsl",
                              "splat_depth.glsl", "splat_pick.comp"})),
      pick_colour_(shaders_.draw({"splat_composite.vert"}, {"splat_pick.frag"})) {}

void SplatRenderer::apply(const GaussianEdit& edit) {
  store_.apply(edit, clock());
  prepared_.reset();
}

double SplatRenderer::clock() const {
  const std::chrono::duration<double> age = std::chrono::steady_clock::now() - start_;
  return std::fmod(age.count() * kTicksPerSecond, 65536.0);
}

void SplatRenderer::setOrder(const std::uint32_t* slots, std::size_t count) {
  order_.given = true;
  order_.count = count;
  order_.tally.set(count);
  order_.slots.reserve(count * sizeof(std::uint32_t));
  if (count > 0) order_.slots.write(0, slots, count * sizeof(std::uint32_t));
  prepared_.reset();
}

void SplatRenderer::sortByDepth() {
  if (order_.given) prepared_.reset();
  order_.given = false;
}

void SplatRenderer::setTarget(gl::Target& target, GLenum format, const SplatCamera& camera,
                              const RenderSettings& settings, Canvas canvas) {
  if (target.width() != camera.width || target.height() != camera.height ||
      target.format() != format) {
    target = gl::Target(format, camera.width, camera.height);
  }
  raster_ = {canvas != Canvas::kWindow, camera.orthographic, camera.ndc_scale,
             camera.ndc_offset,         settings.mode,       settings.depth_range};
  resetState();
}

bool SplatRenderer::prepared(const SplatCamera& camera, const MapState& map,
                             const RenderSettings& settings) const {
  return prepared_ && prepared_->camera == camera && prepared_->settings.projectsAs(settings) &&
         prepared_->origin == map.origin && prepared_->antialiased == map.antialiased &&
         settings.mode != DrawMode::kAge;  // which changes with time
}

bool SplatRenderer::prepare(const SplatCamera& camera, const MapState& map,
                            const RenderSettings& settings, gl::Stopwatch& stopwatch) {
  if (prepared(camera, map, settings)) return false;
  prepared_.reset();
  tiles_.forget();
  projection_.reserve(std::min<std::size_t>(store_.capacity(), kLeastRoom));
  sort_.reserve(projection_.room());
  projection_.run(store_, camera, map, settings, clock(), sort_.keys());
  stopwatch.lap("project");
  putInOrder();
  stopwatch.lap("sort");
  return true;
}

void SplatRenderer::prepareAndCheck(const SplatCamera& camera, const MapState& map,
                                    const RenderSettings& settings) {
  gl::Stopwatch stopwatch(false);
  bool in_tiles = false, unknown = false;
  do {
    unknown = prepare(camera, map, settings, stopwatch);
    if (unknown) tallies_.ask();
  } while (unknown && !checkRoom(map, in_tiles));
  prepared_ = Prepared{camera, settings, map.origin, map.antialiased};
}

void SplatRenderer::putInOrder() {
  drawn_.reserve(std::max(projection_.room(), order_.given ? order_.count : 0) * sizeof(GLuint));
  if (!order_.given) {
    sort_.order(projection_.visible(), projection_.depthRange(), key_bits_, drawn_);
    return;
  }
  order_program_.use();
  projection_.bindVisible();
  order_.slots.bind(7);
  drawn_.bind(8);
  order_program_.set("count", static_cast<GLuint>(order_.count));
  order_program_.set("capacity", static_cast<GLuint>(store_.capacity()));
  order_program_.set("room", static_cast<GLuint>(projection_.room()));
  gl::dispatch((order_.count + 255) / 256);
  gl::storageBarrier();
}

bool SplatRenderer::checkRoom(const MapState& map, bool& in_tiles) {
  const GLuint visible = tallies_.wait(Tallies::kVisible, Tally::kWanted),
               pairs = tallies_.wait(Tallies::kPairs, Tally::kWanted),
               nearest = tallies_.wait(Tallies::kDepthRange, 0),
               farthest = tallies_.wait(Tallies::kDepthRange, 1);
  drawn_count_ = order_.given ? order_.count : visible;
  // What is still to come will be as visible as what is there; but not all comes that is announced.
  const double growth =
      std::clamp(double(map.expected) / std::max(1u, store_.capacity()), 1.0, 4.0);
  const auto grown = [growth](std::size_t count) {
    return static_cast<std::size_t>(growth * double(withSlack(count)));
  };
  bool enough = true;
  if (visible > projection_.room()) {
    projection_.reserve(std::min<std::size_t>(
        grown(visible), std::max(store_.capacity(), std::min(map.expected, kMaxSlots))));
    enough = false;
  }
  if (in_tiles && pairs > tiles_.room()) {
    in_tiles = tiles_.reserve(pairs, grown(pairs));
    enough = false;
  }
  const int bits = farthest > nearest ? bitsOf(farthest - nearest) : 1;
  const int key_bits =
      (bits + RadixSort::kDigitBits - 1) / RadixSort::kDigitBits * RadixSort::kDigitBits;
  fewer_bits_for_ = key_bits < key_bits_ ? fewer_bits_for_ + 1 : 0;
  if (key_bits > key_bits_ || fewer_bits_for_ > kPatience) {
    enough = enough && key_bits < key_bits_;
    key_bits_ = key_bits;
    fewer_bits_for_ = 0;
  }
  if (!enough) {
    prepared_.reset();
    tiles_.forget();
  }
  return enough;
}

// Has color_'s depth, so far the opaque scene's, let pass only what is before the translucent
// objects, and keeps the opaque scene's in behind_.
void SplatRenderer::divide() {
  const int width = color_.width(), height = color_.height();
  if (behind_.width() != width || behind_.height() != height ||
      behind_.format() != color_.format()) {
    behind_ = gl::Target(color_.format(), width, height, GL_RG32F);
  }
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

// Lists the splats that may be seen before and behind the translucent objects, by tiles.
void SplatRenderer::divideQuads() {
  const int across = (color_.width() + 15) / 16, down = (color_.height() + 15) / 16;
  if (tile_depths_.width() != across || tile_depths_.height() != down) {
    tile_depths_ = gl::Target(GL_RG32F, across, down);
  }
  tile_depth_.use();
  glUniform2i(tile_depth_.at("tiles"), across, down);
  glUniform2i(tile_depth_.at("picture"), color_.width(), color_.height());
  tile_depth_.set("top_first", int(raster_.top_first));
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, behind_.depth());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, color_.depth());
  glBindImageTexture(0, tile_depths_.color(), 0, GL_FALSE, 0, GL_WRITE_ONLY, GL_RG32F);
  gl::dispatch(std::size_t(across) * std::size_t(down));
  glMemoryBarrier(GL_TEXTURE_FETCH_BARRIER_BIT);

  drawn_before_.reserve(drawn_.bytes());
  drawn_behind_.reserve(drawn_.bytes());
  divide_quads_.use();
  raster_.set(divide_quads_);
  projection_.bindEllipses(divide_quads_);
  glUniform2i(divide_quads_.at("tiles"), across, down);
  glBindTexture(GL_TEXTURE_2D, tile_depths_.color());
  drawn_.bind(4);
  drawn_before_.bind(5);
  drawn_behind_.bind(6);
  drawnTally().bind(7);
  drawnTally().dispatchGroups();
  gl::storageBarrier();
}

void SplatRenderer::drawQuads(const gl::Target& target, const gl::Buffer& drawn, Quads what) const {
  glViewport(0, 0, target.width(), target.height());
  const std::array<float, 4> nothing{};
  glClearBufferfv(GL_COLOR, 0, nothing.data());
  if (target.second()) glClearBufferfv(GL_COLOR, 1, nothing.data());
  blendOver();
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(what == Quads::kBehind ? GL_GREATER : GL_LEQUAL);
  glDepthMask(GL_FALSE);
  const gl::Program& program = what == Quads::kBehind ? quads_behind_ : quads_;
  program.use();
  raster_.set(program);
  program.set("picture", target.width(), target.height());
  program.set("up", raster_.top_first ? -1.0f : 1.0f);
  program.set("raw_depth", int(what == Quads::kDepth));
  projection_.bindEllipses(program);
  drawn.bind(4);
  projection_.depthRange().bind(5);
  drawnTally().bind(6);
  drawnTally().drawQuads();
}

void SplatRenderer::layOver(const gl::Program& program, GLuint framebuffer,
                            const gl::Target& target, GLint x, GLint y) const {
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer);
  glViewport(x, y, target.width(), target.height());
  program.use();
  glUniform2i(program.at("corner"), x, y);
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, target.second());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.color());
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void SplatRenderer::draw(const SplatCamera& camera, const MapState& map,
                         const RenderSettings& settings, Canvas canvas,
                         const DrawTranslucent& translucent) {
  gl::Stopwatch stopwatch(settings.profile);
  if (translucent) {
    GLint samples = 0;
    glGetIntegerv(GL_SAMPLES, &samples);
    samples = std::max(samples, 1);
    if (translucent_.width() != camera.width || translucent_.height() != camera.height ||
        translucent_.samples() != samples) {
      translucent_ = gl::SampledDepth(camera.width, camera.height, samples);
    }
    const gl::DepthScope scope(translucent_);
    translucent();
    stopwatch.lap("translucent");
  }
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  const bool floats = settings.float_blending.value_or(!accelerated_);
  setTarget(color_, floats ? GL_RGBA32F : GL_RGBA16F, camera, settings, canvas);
  bool unknown = prepare(camera, map, settings, stopwatch);
  glFlush();  // the graphics card begins while the rest is submitted
  const gl::DrawScope scope(color_);
  copyDepth(canvas, guard.drawFramebuffer(), x, y, color_);
  if (translucent) {
    divide();
    stopwatch.lap("divide");
  }
  const gl::Target* behind = translucent ? &behind_ : nullptr;
  bool in_tiles = settings.rasterizer == Rasterizer::kTiles ||
                  (settings.rasterizer == Rasterizer::kAuto && accelerated_);
  while (true) {
    if (in_tiles) {
      if (!tiles_.listed(color_)) {
        const std::size_t most = order_.given ? order_.count : projection_.room();
        tiles_.list(projection_, drawn_, drawnTally(), most, color_, stopwatch,
                    [this] { tallies_.ask(); });
        unknown = true;
      }
      tiles_.blend(projection_, color_, behind, raster_);
      stopwatch.lap("blend");
    } else {
      if (unknown) tallies_.ask();
      if (behind) {
        divideQuads();
        const gl::DrawScope behind_scope(behind_, color_.depth());
        glActiveTexture(GL_TEXTURE0);
        glBindTexture(GL_TEXTURE_2D, behind_.depth());
        drawQuads(behind_, drawn_behind_, Quads::kBehind);
        scope.bind();
      }
      drawQuads(color_, behind ? drawn_before_ : drawn_, Quads::kColour);
      stopwatch.lap("quads");
    }
    // All is submitted: the graphics card goes on while this waits for what it counted first.
    if (!unknown || checkRoom(map, in_tiles)) break;
    unknown = prepare(camera, map, settings, stopwatch);
  }
  prepared_ = Prepared{camera, settings, map.origin, map.antialiased};
  rasterizer_ = in_tiles ? "tiles" : "quads";
  if (canvas != Canvas::kNone) {
    blendOver();
    glDisable(GL_DEPTH_TEST);
    layOver(composite_, guard.drawFramebuffer(), behind ? behind_ : color_, x, y);
    stopwatch.lap("composite");
  }
  profile_ = stopwatch.laps();
}

void SplatRenderer::hideFarther() const {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const gl::DrawScope scope(behind_);
  resetState();
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  layOver(hide_, guard.drawFramebuffer(), behind_, viewport[0], viewport[1]);
}

void SplatRenderer::drawBefore() const {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const gl::DrawScope scope(color_);
  resetState();
  blendOver();
  glDisable(GL_DEPTH_TEST);
  layOver(composite_, guard.drawFramebuffer(), color_, viewport[0], viewport[1]);
}

void SplatRenderer::drawSurface(const SplatCamera& camera, const MapState& map,
                                const RenderSettings& settings, Canvas canvas, double far_clip) {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  setTarget(surface_depth_, GL_RGBA32F, camera, settings, canvas);
  prepareAndCheck(camera, map, settings);
  const gl::DrawScope scope(surface_depth_);
  copyDepth(canvas, guard.drawFramebuffer(), x, y, surface_depth_);
  drawQuads(surface_depth_, drawn_, Quads::kDepth);
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  surface_.use();
  surface_.set("far_clip", static_cast<float>(far_clip));
  layOver(surface_, guard.drawFramebuffer(), surface_depth_, x, y);
}

void SplatRenderer::drawPick(const SplatCamera& camera, const MapState& map,
                             const RenderSettings& settings, Canvas canvas, std::uint32_t handle) {
  const gl::StateGuard guard;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  const GLint x = viewport[0], y = viewport[1];
  setTarget(pick_depth_, GL_RGBA16F, camera, settings, canvas);
  prepareAndCheck(camera, map, settings);
  const gl::DrawScope scope(pick_depth_);
  copyDepth(canvas, guard.drawFramebuffer(), x, y, pick_depth_);

  const int width = pick_depth_.width(), height = pick_depth_.height();
  picked_.reserve(sizeof(std::uint32_t) * std::size_t(width) * std::size_t(height));
  const std::vector<std::uint32_t> nothing(std::size_t(width) * std::size_t(height), kNoSlot);
  picked_.write(0, nothing.data(), nothing.size() * sizeof(std::uint32_t));
  if (drawn_count_ > 0) {
    const int across = (width + 15) / 16, down = (height + 15) / 16;
    pick_.use();
    projection_.bindEllipses(pick_);
    projection_.bindVisible();
    raster_.set(pick_);
    glUniform2i(pick_.at("tiles"), across, down);
    glUniform2i(pick_.at("picture"), width, height);
    pick_.set("top_first", int(raster_.top_first));
    pick_.set("words", (store_.capacity() + 31u) / 32u);
    drawn_.bind(4);
    picked_.bind(7);
    drawnTally().bind(8);
    glActiveTexture(GL_TEXTURE0);
    glBindTexture(GL_TEXTURE_2D, pick_depth_.depth());
    gl::dispatch(std::size_t(across) * std::size_t(down));
    gl::storageBarrier();
  }
  if (canvas == Canvas::kNone) return;

  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  pick_colour_.use();
  pick_colour_.set("width", width);
  pick_colour_.set("handle", handle);
  picked_.bind(7);
  layOver(pick_colour_, guard.drawFramebuffer(), pick_depth_, x, y);
}

std::vector<std::uint32_t> SplatRenderer::readPick() const {
  const std::size_t columns = static_cast<std::size_t>(pick_depth_.width()),
                    rows = static_cast<std::size_t>(pick_depth_.height());
  std::vector<std::uint32_t> slots(columns * rows);
  for (std::size_t i = 0; i < rows; ++i) {
    const std::size_t target_row = raster_.top_first ? i : rows - 1 - i;
    picked_.read(target_row * columns * sizeof(std::uint32_t), &slots[i * columns],
                 columns * sizeof(std::uint32_t));
  }
  return slots;
}

std::vector<SplatValues> SplatRenderer::readSlots(const std::vector<std::uint32_t>& slots) const {
  std::vector<SplatValues> splats;
  for (const std::uint32_t slot : slots) splats.push_back(store_.read(slot));
  return splats;
}

std::vector<float> SplatRenderer::readColor() const {
  const std::size_t row = 4 * static_cast<std::size_t>(color_.width());
  std::vector<float> pixels(row * static_cast<std::size_t>(color_.height()));
  const gl::StateGuard guard;
  const gl::DrawScope scope(color_);
  glReadPixels(0, 0, color_.width(), color_.height(), GL_RGBA, GL_FLOAT, pixels.data());
  if (!raster_.top_first) {
    for (std::size_t top = 0, bottom = pixels.size() - row; top < bottom;
         top += row, bottom -= row) {
      std::swap_ranges(&pixels[top], &pixels[top] + row, &pixels[bottom]);
    }
  }
  return pixels;
}

std::vector<float> SplatRenderer::readDepth() {
  const gl::StateGuard guard;
  if (depth_.width() != color_.width() || depth_.height() != color_.height()) {
    depth_ = gl::Target(GL_RGBA32F, color_.width(), color_.height());
  }
  const int width = depth_.width(), height = depth_.height();
  glDisable(GL_ALPHA_TEST);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_CULL_FACE);
  const gl::DrawScope color(color_);
  const gl::DrawScope scope(depth_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, color.framebuffer());
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  drawQuads(depth_, drawn_, Quads::kDepth);
  const std::size_t columns = static_cast<std::size_t>(width),
                    rows = static_cast<std::size_t>(height);
  std::vector<float> blended(4 * columns * rows), depths(columns * rows);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, scope.framebuffer());
  glReadPixels(0, 0, width, height, GL_RGBA, GL_FLOAT, blended.data());
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
  return store_.bytes() + projection_.bytes() + sort_.bytes() + tiles_.bytes() +
         order_.slots.bytes() + drawn_.bytes() + color_.bytes() + depth_.bytes() +
         translucent_.bytes() + behind_.bytes() + tile_depths_.bytes() + drawn_before_.bytes() +
         drawn_behind_.bytes() + surface_depth_.bytes() + pick_depth_.bytes() + picked_.bytes();
}

}  // namespace rosplat
