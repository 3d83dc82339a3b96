#include "gl/target.hpp"

#include <array>

#include "gl/driver.hpp"

namespace rosplat::gl {

namespace {

std::size_t pixelBytes(GLenum format) {
  switch (format) {
    case GL_RGBA32F:
      return 16;
    case GL_DEPTH_COMPONENT16:
      return 2;
    case GL_DEPTH24_STENCIL8:
    case GL_DEPTH_COMPONENT32:
    case GL_DEPTH_COMPONENT32F:
      return 4;
    default:
      return 8;
  }
}

}  // namespace

Target::Target(GLenum color_format, int width, int height, GLenum depth_format,
               GLenum second_format)
    : format_(color_format), depth_format_(depth_format), width_(width), height_(height) {
  const auto texture = [&](GLenum format) {
    GLuint id = 0;
    glGenTextures(1, &id);
    glBindTexture(GL_TEXTURE_2D, id);
    glTexStorage2D(GL_TEXTURE_2D, 1, format, width, height);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
    bytes_ +=
        pixelBytes(format) * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    return Object(GL_TEXTURE, id);
  };
  color_ = texture(color_format);
  if (second_format) second_ = texture(second_format);
  depth_ = texture(depth_format);
}

bool Target::become(GLenum color_format, int width, int height, GLenum depth_format,
                    GLenum second_format) {
  if (format_ == color_format && width_ == width && height_ == height &&
      depth_format_ == depth_format && (second() != 0) == (second_format != 0)) {
    return false;
  }
  for (Object* texture : {&color_, &second_, &depth_}) {
    texture->release();  // first, so that the old and the new memory never exist at once
  }
  *this = Target(color_format, width, height, depth_format, second_format);
  return true;
}

DrawScope::DrawScope(const Target& target) {
  glGenFramebuffers(1, &framebuffer_);
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, target.color(), 0);
  const bool stencil =
      target.depthFormat() == GL_DEPTH24_STENCIL8 || target.depthFormat() == GL_DEPTH32F_STENCIL8;
  glFramebufferTexture2D(GL_FRAMEBUFFER,
                         stencil ? GL_DEPTH_STENCIL_ATTACHMENT : GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D,
                         target.depth(), 0);
  if (target.second()) {
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT1, GL_TEXTURE_2D, target.second(), 0);
    constexpr std::array<GLenum, 2> both{GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};
    glDrawBuffers(GLsizei(both.size()), both.data());
  }
  if (glCheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    glDeleteFramebuffers(1, &framebuffer_);
    throw Error("the graphics driver can't blend into a floating-point picture of " +
                std::to_string(target.width()) + "x" + std::to_string(target.height()) + " pixels");
  }
  glGenVertexArrays(1, &vertex_array_);
  glBindVertexArray(vertex_array_);
}

DrawScope::~DrawScope() {
  glDeleteVertexArrays(1, &vertex_array_);
  glDeleteFramebuffers(1, &framebuffer_);
}

}  // namespace rosplat::gl
