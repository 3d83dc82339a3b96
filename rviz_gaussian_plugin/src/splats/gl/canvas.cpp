#include "gl/canvas.hpp"

#include <array>

namespace rosplat {

CanvasScope::CanvasScope(Canvas canvas) : canvas_(canvas) {
  if (canvas != Canvas::kNone) depth_format_ = gl::depthFormat(guard_.drawFramebuffer());
  std::array<GLint, 4> viewport{};
  glGetIntegerv(GL_VIEWPORT, viewport.data());
  x_ = viewport[0];
  y_ = viewport[1];
  // What Ogre may have left that would spoil a pass.
  for (const GLenum off :
       {GL_ALPHA_TEST, GL_CULL_FACE, GL_SCISSOR_TEST, GL_STENCIL_TEST, GL_POLYGON_OFFSET_FILL,
        GL_SAMPLE_ALPHA_TO_COVERAGE, GL_FRAMEBUFFER_SRGB}) {
    glDisable(off);
  }
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
}

void CanvasScope::copyDepth(const gl::Target& target) const {
  if (!depth_format_) return clearDepth();
  glBindFramebuffer(GL_READ_FRAMEBUFFER, guard_.drawFramebuffer());
  glBlitFramebuffer(x_, y_, x_ + target.width(), y_ + target.height(), 0, 0, target.width(),
                    target.height(), GL_DEPTH_BUFFER_BIT, GL_NEAREST);
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
