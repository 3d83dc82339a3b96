// How it works. What is read is read once, and nothing is uploaded but a camera:
// 1. The bodies' picture is copied within the card, then drawn as the opaque scene (bodies.frag).
// 2. SplatRenderer draws the maps over it, as in rviz, and once more for the depths of surfaces.
// 3. A shader packs bytes and depths (picture_words.comp) to memory that the processor reads.

#include "card_renderer.hpp"

#include <array>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <tuple>
#include <utility>

#include "gl/buffer.hpp"
#include "gl/depth.hpp"

namespace rosplat {

namespace {
constexpr const char* kView = "picture";
}

CardRenderer::CardRenderer(const std::string& media) : context_(std::make_shared<EglContext>()) {
  const EglContext::Scope scope(*context_);
  graphics_ = std::string(reinterpret_cast<const char*>(glGetString(GL_RENDERER))) + ", OpenGL " +
              reinterpret_cast<const char*>(glGetString(GL_VERSION));
  const ShaderSource source = [media](const std::string& name) {
    std::ifstream file(media + "/" + name);
    if (!file) throw std::runtime_error(name + " is not in " + media);
    return std::string(std::istreambuf_iterator<char>(file), {});
  };
  renderer_.emplace(source);
  shaders_.emplace(source);
}

CardRenderer::~CardRenderer() = default;

CardRenderer::Map& CardRenderer::addMap() {
  const EglContext::Scope scope(*context_);
  maps_.push_back(std::make_unique<Map>());
  maps_.back()->card = renderer_->makeMap();
  return *maps_.back();
}

BatchReport CardRenderer::apply(Map& map, const GaussianBatch& batch) {
  const EglContext::Scope scope(*context_);
  BatchReport report;
  map.books.apply(batch, report, [&](const auto& edit, const MapState& state) {
    map.card->apply(edit, renderer_->clock());
    map.state = state;
  });
  return report;
}

void CardRenderer::draw(SplatCamera camera, GLuint bodies, const Memory& to) {
  const EglContext::Scope scope(*context_);
  std::tie(camera.ndc_scale, camera.ndc_offset) = depthBuffer(
      camera.orthographic, camera.near_clip, depthRange(camera.near_clip, camera.far_clip));
  camera.extent_scale = extentScale(settings);
  CardPicture picture;
  for (const auto& map : maps_) {
    map->card->advanceLevels(renderer_->clock());
    picture.layers.push_back({map->card, kView, camera, settings, {}, map->state});
    picture.layers.back().settings.depths = true;
  }
  const gl::StateGuard guard;
  canvas_.become(GL_RGBA8, camera.width, camera.height, GL_DEPTH_COMPONENT32F, GL_R32F);
  const gl::DrawScope onto(canvas_);
  glViewport(0, 0, camera.width, camera.height);
  renderer_->begin(picture, Canvas::kTexture);
  if (bodies) {
    layBodies(camera, bodies);
    glBindFramebuffer(GL_FRAMEBUFFER, onto.framebuffer());
  } else {
    const std::array<GLfloat, 4> black{}, nowhere{std::numeric_limits<float>::infinity()};
    glClearBufferfv(GL_COLOR, 0, black.data());
    glClearBufferfv(GL_COLOR, 1, nowhere.data());
  }
  renderer_->draw({bodies != 0, nullptr, {}});
  read(renderer_->drawDepth(PictureDepth::kMedian), to);
}

void CardRenderer::layBodies(const SplatCamera& camera, GLuint bodies) {
  const int width = camera.width, height = camera.height;
  bodies_.become(GL_RGBA8, width, height, gl::depthFormat(bodies));
  {
    const gl::DrawScope copy(bodies_);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, bodies);
    glBlitFramebuffer(0, 0, width, height, 0, 0, width, height,
                      GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  }
  const gl::DrawScope onto(canvas_);
  const gl::Program& program = shaders_->draw({"splat_composite.vert"}, {"bodies.frag"});
  program.use();
  program.set("clip", camera.near_clip, camera.far_clip);
  program.set("ndc_depth", camera.ndc_scale, camera.ndc_offset);
  program.set("orthographic", int(camera.orthographic));
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, bodies_.depth());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, bodies_.color());
  for (const GLenum off : {GL_BLEND, GL_ALPHA_TEST, GL_CULL_FACE, GL_SCISSOR_TEST}) glDisable(off);
  glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_ALWAYS);
  glDepthMask(GL_TRUE);
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void CardRenderer::read(const gl::Target& splats, const Memory& to) {
  const std::size_t pixels = std::size_t(splats.width()) * std::size_t(splats.height());
  const std::size_t fours = (pixels + 3) / 4;
  if (!readback_ || readback_->bytes() != 8 * fours * sizeof(GLuint)) {
    readback_.emplace(8 * fours);
    gl::settle();
  }
  const gl::Program& program = shaders_->compute({"picture_words.comp"});
  program.use();
  program.bind("Words", readback_->slice());
  GLenum unit = GL_TEXTURE0;
  for (const GLuint texture : {canvas_.color(), canvas_.second(), splats.color()}) {
    glActiveTexture(unit++);
    glBindTexture(GL_TEXTURE_2D, texture);
  }
  gl::dispatchInvocations(fours);
  readback_->written();
  const GLuint* const words = readback_->wait();
  std::memcpy(to.colours, words, 3 * pixels);
  std::memcpy(to.surfaces, words + 3 * fours, pixels);
  std::memcpy(to.depths, words + 4 * fours, pixels * sizeof(float));
}

}  // namespace rosplat
