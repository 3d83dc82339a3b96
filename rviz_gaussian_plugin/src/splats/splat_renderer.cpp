// How it works. A picture takes two calls, so that the card works while Ogre draws the scene.
// begin():
// 1. chooseDetail: which nodes of its levels stand for splats of each map.
// 2. ViewState::prepare: culls pages and slots, projects, sorts by depth (ordered_splats.hpp).
// 3. ViewState::list: lists by tiles (tile_rasterizer.hpp). Kept, as step 2, where camera, map,
//    settings and order are those of the view's last frame. draw():
// 4. copyDepth of the opaque scene; divide at the translucent objects. 5. ViewState::blend.
// 6. checkRoom, keepBudgets: only the card knows how many splats show, so the steps work in the
//    room that earlier frames needed. Where that was too little, 2 to 5 run again: no picture lacks
//    any.
// 7. composite: lays the picture over the window.

#include "splat_renderer.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "gl/depth.hpp"
#include "gl/driver.hpp"
#include "gl/object.hpp"
#include "gl/pixels.hpp"
#include "gl/scopes.hpp"

namespace rosplat {

namespace {

// Once the states of views take more, a new view takes over the oldest state. [bytes]
constexpr std::size_t kMostViewBytes = std::size_t{1} << 30;
constexpr const char* kMouseView = "mouse";  // of drawPick() and drawSurface()

const ShaderSource& checked(const ShaderSource& source) {
  if (const std::string reason = gl::unsupported(); !reason.empty()) throw gl::Error(reason);
  return source;
}

// Gives the layers whose maps missed a budget the error that keeps it. Returns whether there are
// any.
bool keepBudgets(Frame& frame, const std::vector<std::size_t>& drawn, const CardPicture& picture) {
  bool any = false;
  for (std::size_t i = 0; i < frame.layers.size(); ++i) {
    FrameLayer& layer = frame.layers[i];
    const Layer<std::shared_ptr<CardMap>>& of = picture.layers[i];
    const auto next = of.map->adjustDetail(of.view_id, layer.cuts() ? layer.error : 0, drawn[i]);
    layer.error = next.value_or(layer.error);
    any = any || next;
  }
  return any;
}

}  // namespace

SplatRenderer::SplatRenderer(const ShaderSource& source)
    : shaders_(checked(source)),
      scatter_(shaders_.compute({"slot_scatter.comp"})),
      reader_(shaders_),
      sort_(shaders_),
      picker_(shaders_),
      divide_(shaders_.draw({"splat_composite.vert"}, {"splat_divide.frag"})),
      composite_(shaders_.draw({"splat_composite.vert"}, {"splat_composite.frag"})),
      compute_composite_(shaders_.compute({"splat_composite.comp"})),
      hide_(shaders_.draw({"splat_composite.vert"}, {"splat_hide.frag"})),
      surface_(shaders_.draw({"splat_composite.vert"}, {"splat_surface.frag"})) {
  const gl::ComputeScope scope;
  if (!sort_.check()) throw gl::Error("the graphics driver sorts wrongly");
  const ViewState compiled(shaders_, sort_);  // compiles the programs that all views draw with
}

double SplatRenderer::clock() const {
  const std::chrono::duration<double> age = std::chrono::steady_clock::now() - start_;
  return std::fmod(age.count() * kTicksPerSecond, 65536.0);
}

std::string SplatRenderer::warning() const {
  std::string text;
  const auto add = [&text](const char* what) {
    text += (text.empty() ? "" : "; ") + std::string(what);
  };
  if (sort_.lostBallots()) add("the graphics driver's subgroups don't work; sorting avoids them");
  if (std::any_of(copies_depth_.begin(), copies_depth_.end(),
                  [](const auto& of) { return !of.second; })) {
    add("the graphics driver doesn't give the depth of the opaque scene; no object hides splats");
  }
  if (leaves_out_) {
    add("the graphics card has no memory to list all splats; some of the farthest are missing");
  }
  return text;
}

SplatRenderer::RenderedView& SplatRenderer::view(const std::string& name) {
  auto found = views_.find(name);
  if (found == views_.end()) {
    std::size_t bytes = 0;
    auto oldest = views_.begin();
    for (auto at = views_.begin(); at != views_.end(); ++at) {
      bytes += at->second.state->bytes();
      if (at->second.used < oldest->second.used) oldest = at;
    }
    if (bytes > kMostViewBytes) {
      if (drawn_ && oldest->second.state.get() == drawn_->view) drawn_.reset();
      auto node = views_.extract(oldest);
      node.key() = name;
      found = views_.insert(std::move(node)).position;
    } else {
      found = views_.emplace(name, std::make_unique<ViewState>(shaders_, sort_)).first;
    }
  }
  found->second.used = ++used_;
  return found->second;
}

const ViewState* SplatRenderer::stateOf(const std::string& view_id) const {
  const std::string* const name = names_.of(view_id);
  const auto found = name ? views_.find(*name) : views_.end();
  return found == views_.end() ? nullptr : found->second.state.get();
}

void SplatRenderer::forget(const std::string& view_id) {
  names_.forget(view_id, [this](const std::string& name) { drop(name); });
}

void SplatRenderer::drop(const std::string& name) {
  const auto found = views_.find(name);
  if (found == views_.end()) return;
  if (drawn_ && found->second.state.get() == drawn_->view) drawn_.reset();
  if (begun_ && found->second.state.get() == begun_->view) begun_.reset();
  views_.erase(found);
}

Frame SplatRenderer::frame(const CardPicture& picture, Canvas canvas,
                           gl::Stopwatch& stopwatch) const {
  Frame frame{{}, picture.order(), canvas != Canvas::kWindow, clock(), stopwatch};
  for (const auto& [map, view_id, camera, settings, order, state] : picture.layers) {
    map->await();
    frame.layers.push_back({map->store(), map->nodes(), camera, state, settings});
  }
  return frame;
}

void SplatRenderer::copyDepth(const CanvasScope& window, const gl::Target& target) {
  const auto [copies, is_new] = copies_depth_.emplace(window.depthFormat(), true);
  if (!copies->second) return clearDepth();
  // Asks for errors once per format: a driver with threads of its own has to wait for these.
  if (is_new) gl::dropErrors();
  window.copyDepth(target);
  if (!is_new || glGetError() == GL_NO_ERROR) return;
  copies->second = false;
  clearDepth();
}

// Draws the depth of the translucent objects, in as many samples as the framebuffer has.
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

// view.color begins with the opaque scene's depth. Copies that to view.behind, then lowers the
// depth in view.color to the translucent objects, so that only splats before these pass.
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

void SplatRenderer::composite(const CanvasScope& window, const gl::Target& splats) const {
  if (window.isImage()) return window.computeOver(compute_composite_, splats);
  const gl::DrawScope scope(splats);
  blendOver();
  glDisable(GL_DEPTH_TEST);
  window.layOver(composite_, splats);
}

SplatRenderer::Begun::Begun(const SplatRenderer& renderer, const CardPicture& of, Canvas on)
    : picture(of),
      canvas(on),
      stopwatch(of.settings().profile),
      frame(renderer.frame(picture, canvas, stopwatch)) {}

void SplatRenderer::begin(const CardPicture& picture, Canvas canvas) {
  begun_.reset();
  drawn_.reset();  // whose maps may have been replaced
  const gl::Turn turn(sort_is_free_);
  const gl::ComputeScope scope;
  gl::deleteAbandoned();
  const auto& name = names_.join(picture, [this](const std::string& unused) { drop(unused); });
  ViewState& view = *this->view(name).state;
  std::vector<CardMap::Chosen> chosen;
  const bool ordered = picture.order() != nullptr;
  for (const auto& [map, view_id, camera, settings, order, state] : picture.layers) {
    chosen.push_back(map->chooseDetail(view_id, settings, camera, ordered, clock()));
  }
  auto begun = std::make_unique<Begun>(*this, picture, canvas);
  begun->chosen = std::move(chosen);
  begun->view = &view;
  Frame& frame = begun->frame;
  frame.depths = picture.settings().depths;
  for (std::size_t i = 0; i < frame.layers.size(); ++i) {
    frame.layers[i].error = begun->chosen[i].error;
  }
  view.prepare(frame);
  glFlush();  // the graphics card begins while the rest is submitted
  view.list(begun->stopwatch);
  glFlush();
  begun_ = std::move(begun);
}

std::vector<SplatRenderer::OfMap> SplatRenderer::draw(const Surroundings& around) {
  const std::unique_ptr<Begun> begun = std::move(begun_);
  const std::function<void()>& translucent = around.translucent;
  auto& [picture, chosen, canvas, of_view, stopwatch, frame] = *begun;
  const gl::Turn turn(sort_is_free_, true);  // after that of begin()
  ViewState& view = *of_view;
  stopwatch.lap("");  // of the scene
  const SplatCamera& camera = frame.camera();
  if (translucent) {
    keepTranslucent(view, camera, translucent);
    stopwatch.lap("translucent");
  }
  const CanvasScope window(canvas);
  view.use();
  const bool fresh =
      view.color.become(GL_RGBA32F, camera.width, camera.height, window.targetDepth());
  const bool open = !around.opaque && !translucent;
  if (fresh || !view.open || !open) {  // making a framebuffer takes the driver 20 us
    const gl::DrawScope scope(view.color);
    if (around.opaque) {
      copyDepth(window, view.color);
    } else {
      clearDepth();
    }
    if (translucent) {
      divide(view);
      stopwatch.lap("divide");
    }
  }
  view.open = open;
  view.blend(stopwatch, bool(translucent));
  glFlush();
  // All is submitted: the graphics card works on while the loop waits for its first counts.
  for (const auto& [map, view_id, camera_in_map, settings, order, state] : picture.layers) {
    map->expectDetail(view_id, settings, camera_in_map);
  }
  while (!view.checkRoom() || keepBudgets(frame, view.splats().countsOfLayers(), picture)) {
    view.prepare(frame);
    view.blend(stopwatch, bool(translucent));
  }
  if (canvas != Canvas::kNone) {
    composite(window, translucent ? view.behind : view.color);
    stopwatch.lap("composite");
  }
  std::vector<OfMap> drawn;
  for (std::size_t i = 0; i < frame.layers.size(); ++i) {
    const double error = frame.layers[i].cuts() ? frame.layers[i].error : 0;
    std::string& problem = chosen[i].problem;
    if (problem.empty()) problem = picture.layers[i].map->detailProblem(picture.layers[i].view_id);
    drawn.push_back({view.splats().countsOfLayers()[i], error, std::move(problem)});
  }
  leaves_out_ = view.tiles().leavesOut();
  profile_ = stopwatch.laps();
  drawn_ = {std::move(picture), {}, canvas, &view};
  for (const FrameLayer& layer : frame.layers) drawn_->errors.push_back(layer.error);
  return drawn;
}

void SplatRenderer::hideFarther(const std::string& view_id) const {
  const ViewState* const view = stateOf(view_id);
  if (!view) return;
  const CanvasScope window(Canvas::kWindow);
  const gl::DrawScope scope(view->behind);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  window.layOver(hide_, view->behind);
}

void SplatRenderer::drawBefore(const std::string& view_id) const {
  const ViewState* const view = stateOf(view_id);
  if (!view) return;
  const CanvasScope window(Canvas::kWindow);
  composite(window, view->color);
}

void SplatRenderer::blendDepth(ViewState& view, Frame& frame, PictureDepth depth,
                               const gl::Target& target) {
  frame.depths = true;
  do {
    view.prepare(frame);
    view.blendDepth(depth, target);
  } while (!view.checkRoom());
}

void SplatRenderer::drawSurface(const CardPicture& picture, Canvas canvas, double far_clip) {
  const gl::Turn turn(sort_is_free_);
  gl::Stopwatch stopwatch(false);
  const CanvasScope window(canvas);
  ViewState& view = *this->view(kMouseView).state;
  Frame frame = this->frame(picture, canvas, stopwatch);
  const SplatCamera& camera = frame.camera();
  surface_depth_.become(GL_RGBA32F, camera.width, camera.height, window.targetDepth());
  const gl::DrawScope scope(surface_depth_);
  copyDepth(window, surface_depth_);
  blendDepth(view, frame, PictureDepth::kMean, surface_depth_);
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  surface_.use();
  surface_.set("far_clip", static_cast<float>(far_clip));
  window.layOver(surface_, surface_depth_);
}

void SplatRenderer::drawPick(const CardPicture& picture, Canvas canvas, std::uint32_t number) {
  const gl::Turn turn(sort_is_free_);
  gl::Stopwatch stopwatch(false);
  const CanvasScope window(canvas);
  ViewState& view = *this->view(kMouseView).state;
  const Frame frame = this->frame(picture, canvas, stopwatch);
  const SplatCamera& camera = frame.camera();
  pick_depth_.become(GL_RGBA16F, camera.width, camera.height, window.targetDepth());
  const gl::DrawScope scope(pick_depth_);
  copyDepth(window, pick_depth_);
  do {
    view.prepare(frame);
    picker_.begin(view.splats(), pick_depth_, view.topFirst());
    view.inRegions(stopwatch, [&] { picker_.pick(view.splats(), view.tiles(), pick_depth_); });
  } while (!view.checkRoom());
  picked_layers_ = picture.layers.size();
  if (canvas != Canvas::kNone) picker_.draw(window, pick_depth_, number);
}

std::vector<Pick> SplatRenderer::readPick() const {
  std::vector<Pick> picks;
  for (std::size_t layer = 0; layer < picked_layers_; ++layer) {
    picks.emplace_back(picker_.read(layer));
  }
  return picks;
}

std::vector<SplatValues> SplatRenderer::readSlots(const CardMap& map,
                                                  const std::vector<std::uint32_t>& slots) const {
  const gl::ComputeScope scope;
  map.await();
  return reader_.read(map.store(), slots);
}

std::vector<float> SplatRenderer::readColor() const {
  if (!drawn_) return {};
  const ViewState& view = *drawn_->view;
  const gl::Target& color = view.color;
  const std::size_t row = 4 * static_cast<std::size_t>(color.width());
  const gl::StateGuard guard;
  const gl::DrawScope scope(color);
  std::vector<float> pixels = gl::readPixels(color.width(), color.height());
  if (!view.topFirst()) {
    for (std::size_t top = 0, bottom = pixels.size() - row; top < bottom;
         top += row, bottom -= row) {
      std::swap_ranges(&pixels[top], &pixels[top] + row, &pixels[bottom]);
    }
  }
  return pixels;
}

const gl::Target& SplatRenderer::drawDepth(PictureDepth depth) {
  const gl::Turn turn(sort_is_free_);
  gl::Stopwatch stopwatch(false);
  const CanvasScope window(Canvas::kNone);
  ViewState& view = *drawn_->view;
  const gl::Target& color = view.color;
  const int width = color.width(), height = color.height();
  depth_.become(GL_RGBA32F, width, height, color.depthFormat());
  const gl::DrawScope drawn(color);
  const gl::DrawScope scope(depth_);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, drawn.framebuffer());
  glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  Frame frame = this->frame(drawn_->picture, drawn_->canvas, stopwatch);
  for (std::size_t i = 0; i < frame.layers.size(); ++i) {
    frame.layers[i].error = drawn_->errors[i];
  }
  blendDepth(view, frame, depth, depth_);
  return depth_;
}

std::vector<float> SplatRenderer::readDepth() {
  if (!drawn_) return {};
  const gl::StateGuard guard;
  const gl::DrawScope scope(drawDepth(PictureDepth::kMean));
  const ViewState& view = *drawn_->view;
  const int width = depth_.width(), height = depth_.height();
  const std::size_t columns = static_cast<std::size_t>(width),
                    rows = static_cast<std::size_t>(height);
  const std::vector<float> sums = gl::readPixels(width, height, GL_RED);
  const std::vector<float> weights = gl::readPixels(width, height, GL_ALPHA);
  std::vector<float> depths(columns * rows);
  for (std::size_t row = 0; row < rows; ++row) {
    const std::size_t from = columns * (view.topFirst() ? row : rows - 1 - row);
    for (std::size_t column = 0; column < columns; ++column) {
      const float weight = weights[from + column];
      depths[columns * row + column] =
          weight > 0.0f ? sums[from + column] / weight : std::numeric_limits<float>::quiet_NaN();
    }
  }
  return depths;
}

std::size_t SplatRenderer::gpuBytes() const {
  std::size_t bytes = sort_.bytes() + picker_.bytes() + depth_.bytes() + surface_depth_.bytes() +
                      pick_depth_.bytes();
  for (const auto& [id, view] : views_) bytes += view.state->bytes();
  return bytes;
}

}  // namespace rosplat
