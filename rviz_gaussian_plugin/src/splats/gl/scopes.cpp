#include "gl/scopes.hpp"

#include "gl/driver.hpp"

namespace rosplat::gl {

namespace {
constexpr GLint kImageUnits = 3;  // as many as shaders use
}

ComputeScope::~ComputeScope() {
  glUseProgram(static_cast<GLuint>(program_));
  if (epoxy_gl_version() < 44) return;  // then nothing has bound the rest either
  glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, kStorageBindings, nullptr);
  for (const GLuint block : {0, 1}) glBindBufferBase(GL_UNIFORM_BUFFER, block, 0);
  glBindImageTextures(0, kImageUnits, nullptr);
  for (const GLenum target : {GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER}) glBindBuffer(target, 0);
}

StateGuard::StateGuard()
    : framebuffers_(hasFramebuffers()),
      vertex_arrays_(epoxy_gl_version() >= 30 ||
                     epoxy_has_gl_extension("GL_ARB_vertex_array_object")),
      sampled_textures_(epoxy_gl_version() >= 32) {
  if (framebuffers_) {
    GLint draw = 0, read = 0;
    glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &draw);
    glGetIntegerv(GL_READ_FRAMEBUFFER_BINDING, &read);
    draw_framebuffer_ = static_cast<GLuint>(draw);
    read_framebuffer_ = static_cast<GLuint>(read);
  }
  if (vertex_arrays_) glGetIntegerv(GL_VERTEX_ARRAY_BINDING, &vertex_array_);
  glGetIntegerv(GL_ARRAY_BUFFER_BINDING, &array_buffer_);
  glGetIntegerv(GL_ACTIVE_TEXTURE, &active_texture_);
  glActiveTexture(GL_TEXTURE0);
  glGetIntegerv(GL_TEXTURE_BINDING_2D, &texture_);
  if (sampled_textures_) glGetIntegerv(GL_TEXTURE_BINDING_2D_MULTISAMPLE, &sampled_texture_);
  // rviz's context is a compatibility profile: the attribute stack holds the rest.
  glPushAttrib(GL_ALL_ATTRIB_BITS);
}

StateGuard::~StateGuard() {
  // Framebuffers first: the attributes hold the draw and read buffers of the one that was bound.
  if (framebuffers_) {
    glBindFramebuffer(GL_DRAW_FRAMEBUFFER, draw_framebuffer_);
    glBindFramebuffer(GL_READ_FRAMEBUFFER, read_framebuffer_);
  }
  glPopAttrib();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, static_cast<GLuint>(texture_));
  if (sampled_textures_) {
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, static_cast<GLuint>(sampled_texture_));
  }
  glActiveTexture(static_cast<GLenum>(active_texture_));
  if (vertex_arrays_) glBindVertexArray(static_cast<GLuint>(vertex_array_));
  glBindBuffer(GL_ARRAY_BUFFER, static_cast<GLuint>(array_buffer_));
}

}  // namespace rosplat::gl
