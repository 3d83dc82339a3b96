#include "gl/canvas.hpp"

#include <algorithm>
#include <array>

#include "gl/depth.hpp"
#include "gl/driver.hpp"
#include "gl/pixels.hpp"

namespace rosplat {

namespace {

// Gives a pixel with nothing in its middle the nearest depth around it: an object there may be in
// some of the window's samples of the pixel. Dividing splats where nothing is changes nothing.
void widen(std::vector<float>& depths, int width, int height) {
  const auto columns = static_cast<std::size_t>(width), rows = static_cast<std::size_t>(height);
  const auto least = [](float a, float b, float c) { return std::min(std::min(a, b), c); };
  std::vector<float> along(depths.size());  // the least of three in a row
  for (std::size_t row = 0; row < rows; ++row) {
    const float* const from = &depths[columns * row];
    float* const to = &along[columns * row];
    for (std::size_t x = 1; x + 1 < columns; ++x) to[x] = least(from[x - 1], from[x], from[x + 1]);
    to[0] = std::min(from[0], from[columns > 1 ? 1 : 0]);
    to[columns - 1] = std::min(from[columns > 1 ? columns - 2 : 0], from[columns - 1]);
  }
  for (std::size_t row = 0; row < rows; ++row) {
    const float* const here = &along[columns * row];
    const float* const above = row > 0 ? here - columns : here;
    const float* const below = row + 1 < rows ? here + columns : here;
    float* const to = &depths[columns * row];
    for (std::size_t x = 0; x < columns; ++x) {
      to[x] = to[x] < 1.0f ? to[x] : least(above[x], here[x], below[x]);
    }
  }
}

// Returns the texture of a framebuffer's colour if shaders can write it as RGBA8, else 0.
GLuint imageOf(GLuint framebuffer) {
  if (framebuffer == 0 || epoxy_gl_version() < 44) return 0;
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer);
  const auto ask = [](GLenum what) {
    GLint value = 0;
    glGetFramebufferAttachmentParameteriv(GL_READ_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, what, &value);
    return value;
  };
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) != GL_TEXTURE) return 0;
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_TEXTURE_LEVEL) != 0) return 0;
  const auto texture = static_cast<GLuint>(ask(GL_FRAMEBUFFER_ATTACHMENT_OBJECT_NAME));
  GLint samples = 0, format = 0;
  glGetIntegerv(GL_SAMPLES, &samples);
  gl::dropErrors();
  glBindTexture(GL_TEXTURE_2D, texture);
  if (samples > 0 || glGetError() != GL_NO_ERROR) return 0;  // of several samples, or a cube's face
  glGetTexLevelParameteriv(GL_TEXTURE_2D, 0, GL_TEXTURE_INTERNAL_FORMAT, &format);
  return format == GL_RGBA8 ? texture : 0;
}

}  // namespace

CanvasScope::CanvasScope(Canvas canvas) : canvas_(canvas) {
  if (canvas != Canvas::kNone) depth_format_ = gl::depthFormat(guard_.drawFramebuffer());
  if (canvas == Canvas::kTexture) image_ = imageOf(guard_.drawFramebuffer());
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  x_ = viewport[0];
  y_ = viewport[1];
  // Ogre may have left these on, and each would spoil a pass.
  for (const GLenum off : {GL_ALPHA_TEST, GL_CULL_FACE, GL_SCISSOR_TEST, GL_STENCIL_TEST,
                           GL_POLYGON_OFFSET_FILL, GL_SAMPLE_ALPHA_TO_COVERAGE}) {
    glDisable(off);
  }
  if (epoxy_gl_version() >= 30) glDisable(GL_FRAMEBUFFER_SRGB);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
}

void CanvasScope::copyDepth(const gl::Target& target) const {
  if (!depth_format_) return clearDepth();
  glBindFramebuffer(GL_READ_FRAMEBUFFER, guard_.drawFramebuffer());
  glBlitFramebuffer(x_, y_, x_ + target.width(), y_ + target.height(), 0, 0, target.width(),
                    target.height(), GL_DEPTH_BUFFER_BIT, GL_NEAREST);
}

std::vector<float> CanvasScope::readDepth(int width, int height) const {
  if (!depth_format_) return {};
  gl::dropErrors();
  GLint samples = 0;
  glGetIntegerv(GL_SAMPLES, &samples);
  std::vector<float> depths;
  if (samples > 0 && gl::hasFramebuffers()) {
    const gl::DepthFramebuffer resolved(depth_format_, width, height);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, guard_.drawFramebuffer());
    glBlitFramebuffer(x_, y_, x_ + width, y_ + height, 0, 0, width, height, GL_DEPTH_BUFFER_BIT,
                      GL_NEAREST);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, resolved.id());
    depths = gl::readDepths(0, 0, width, height, canvas_ == Canvas::kTexture);
    glBindFramebuffer(GL_FRAMEBUFFER, guard_.drawFramebuffer());
  } else {
    depths = gl::readDepths(x_, y_, width, height, canvas_ == Canvas::kTexture);
  }
  if (glGetError() != GL_NO_ERROR) depths.clear();
  return depths;
}

void CanvasScope::layOver(const gl::Program& program, const gl::Target& target) const {
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, guard_.drawFramebuffer());
  glViewport(x_, y_, target.width(), target.height());
  program.use();
  glUniform2i(program.at("corner"), x_, y_);
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, target.second());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.color());
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

void CanvasScope::computeOver(const gl::Program& program, const gl::Target& target) const {
  program.use();
  glUniform2i(program.at("corner"), x_, y_);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, target.color());
  glBindImageTexture(0, image_, 0, GL_FALSE, 0, GL_READ_WRITE, GL_RGBA8);
  gl::dispatchInvocations(static_cast<std::size_t>(target.width()) *
                          static_cast<std::size_t>(target.height()));
  glMemoryBarrier(GL_FRAMEBUFFER_BARRIER_BIT | GL_TEXTURE_FETCH_BARRIER_BIT |
                  GL_TEXTURE_UPDATE_BARRIER_BIT);
}

std::vector<float> depthsOf(Canvas canvas, int width, int height, const PictureRect& part,
                            const std::function<void()>& draw) {
  const int columns = part.right - part.left, rows = part.bottom - part.top;
  if (columns < 1 || rows < 1 || !gl::hasFramebuffers()) return {};
  GLint drawn = 0, read = 0, samples = 0;
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_SAMPLES, &samples);
  glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &drawn);
  glGetIntegerv(GL_READ_FRAMEBUFFER_BINDING, &read);
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  // Depths are read as floats: software clears and converts depths of 24 bits value by value.
  const bool floats =
      epoxy_gl_version() >= 30 || epoxy_has_gl_extension("GL_ARB_depth_buffer_float");
  const gl::DepthFramebuffer framebuffer(floats ? GL_DEPTH_COMPONENT32F : GL_DEPTH_COMPONENT24,
                                         columns, rows);
  const bool top_first = canvas == Canvas::kTexture;
  glViewport(-part.left, top_first ? -part.top : part.bottom - height, width, height);
  glPushAttrib(GL_DEPTH_BUFFER_BIT | GL_SCISSOR_BIT);
  glDisable(GL_SCISSOR_TEST);
  glDepthMask(GL_TRUE);
  glClearDepth(1.0);
  glClear(GL_DEPTH_BUFFER_BIT);
  glPopAttrib();
  draw();
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer.id());
  std::vector<float> depths = gl::readDepths(0, 0, columns, rows, top_first);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, static_cast<GLuint>(drawn));
  glBindFramebuffer(GL_READ_FRAMEBUFFER, static_cast<GLuint>(read));
  glViewport(viewport[0], viewport[1], viewport[2], viewport[3]);
  if (std::all_of(depths.begin(), depths.end(), [](float depth) { return depth >= 1; })) return {};
  if (samples > 1) widen(depths, columns, rows);
  if (columns == width && rows == height) return depths;
  std::vector<float> whole(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 1);
  for (int row = 0; row < rows; ++row) {
    std::copy_n(depths.begin() + std::ptrdiff_t{row} * columns, columns,
                whole.begin() + std::ptrdiff_t{part.top + row} * width + part.left);
  }
  return whole;
}

void clearDepth() {
  const GLfloat farthest = 1.0f;
  glDepthMask(GL_TRUE);
  glClearBufferfv(GL_DEPTH, 0, &farthest);
}

void blendOver() {
  glEnable(GL_BLEND);
  glBlendEquation(GL_FUNC_ADD);
  glBlendFunc(GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
}

}  // namespace rosplat
