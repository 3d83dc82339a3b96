#include "gl/depth.hpp"

#include "gl/driver.hpp"

namespace rosplat::gl {

GLenum depthFormat(GLuint framebuffer) {
  if (!hasFramebuffers()) {
    GLint bits = 0;
    glGetIntegerv(GL_DEPTH_BITS, &bits);
    return bits > 0 ? GL_DEPTH24_STENCIL8 : 0;
  }
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer);
  const GLenum attachment = framebuffer == 0 ? GL_DEPTH : GL_DEPTH_ATTACHMENT;
  const auto ask = [attachment](GLenum what) {
    GLint value = 0;
    glGetFramebufferAttachmentParameteriv(GL_READ_FRAMEBUFFER, attachment, what, &value);
    return value;
  };
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_OBJECT_TYPE) == GL_NONE) return 0;
  const GLint bits = ask(GL_FRAMEBUFFER_ATTACHMENT_DEPTH_SIZE);
  if (ask(GL_FRAMEBUFFER_ATTACHMENT_COMPONENT_TYPE) == GL_FLOAT) {
    return ask(GL_FRAMEBUFFER_ATTACHMENT_STENCIL_SIZE) > 0 ? GL_DEPTH32F_STENCIL8
                                                           : GL_DEPTH_COMPONENT32F;
  }
  return bits == 16   ? GL_DEPTH_COMPONENT16
         : bits == 32 ? GL_DEPTH_COMPONENT32
                      : GL_DEPTH24_STENCIL8;
}

SampledDepth::SampledDepth(int width, int height, int samples)
    : width_(width), height_(height), samples_(samples) {
  bytes_ = 4 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
           static_cast<std::size_t>(samples);
  GLint bound = 0;
  glGetIntegerv(GL_TEXTURE_BINDING_2D_MULTISAMPLE, &bound);
  GLuint id = 0;
  glGenTextures(1, &id);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, id);
  texture_ = Object(GL_TEXTURE, id);
  // Not of immutable storage: Mesa 22.3 attaches such a texture to a framebuffer only once.
  glTexImage2DMultisample(GL_TEXTURE_2D_MULTISAMPLE, samples, GL_DEPTH_COMPONENT24, width, height,
                          GL_TRUE);
  glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, static_cast<GLuint>(bound));
}

DepthScope::DepthScope(const SampledDepth& depth) {
  glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &draw_framebuffer_);
  glGetIntegerv(GL_READ_FRAMEBUFFER_BINDING, &read_framebuffer_);
  glGetIntegerv(GL_VIEWPORT, viewport_.data());
  glGenFramebuffers(1, &framebuffer_);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D_MULTISAMPLE,
                         depth.texture(), 0);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
  glViewport(0, 0, depth.width(), depth.height());
  glPushAttrib(GL_DEPTH_BUFFER_BIT | GL_SCISSOR_BIT);
  glDisable(GL_SCISSOR_TEST);
  glDepthMask(GL_TRUE);
  const GLfloat farthest = 1.0f;
  glClearBufferfv(GL_DEPTH, 0, &farthest);
  glPopAttrib();
}

DepthScope::~DepthScope() {
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, static_cast<GLuint>(draw_framebuffer_));
  glBindFramebuffer(GL_READ_FRAMEBUFFER, static_cast<GLuint>(read_framebuffer_));
  glDeleteFramebuffers(1, &framebuffer_);
  glViewport(viewport_[0], viewport_[1], viewport_[2], viewport_[3]);
}

DepthFramebuffer::DepthFramebuffer(GLenum format, int width, int height) {
  GLint bound = 0;
  glGetIntegerv(GL_RENDERBUFFER_BINDING, &bound);
  glGenRenderbuffers(1, &depths_);
  glBindRenderbuffer(GL_RENDERBUFFER, depths_);
  glRenderbufferStorage(GL_RENDERBUFFER, format, width, height);
  glBindRenderbuffer(GL_RENDERBUFFER, static_cast<GLuint>(bound));
  glGenFramebuffers(1, &id_);
  glBindFramebuffer(GL_FRAMEBUFFER, id_);
  const bool stencil = format == GL_DEPTH24_STENCIL8 || format == GL_DEPTH32F_STENCIL8;
  glFramebufferRenderbuffer(GL_FRAMEBUFFER,
                            stencil ? GL_DEPTH_STENCIL_ATTACHMENT : GL_DEPTH_ATTACHMENT,
                            GL_RENDERBUFFER, depths_);
  glDrawBuffer(GL_NONE);
  glReadBuffer(GL_NONE);
}

DepthFramebuffer::~DepthFramebuffer() {
  glDeleteFramebuffers(1, &id_);
  glDeleteRenderbuffers(1, &depths_);
}

}  // namespace rosplat::gl
