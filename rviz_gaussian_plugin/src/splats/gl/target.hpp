#pragma once

#include <epoxy/gl.h>

#include <cstddef>

#include "gl/object.hpp"

namespace rosplat::gl {

// A single-sample colour texture with a depth texture and, if second_format isn't 0, a second
// colour texture.
class Target {
 public:
  Target() = default;
  Target(GLenum color_format, int width, int height, GLenum depth_format = GL_DEPTH24_STENCIL8,
         GLenum second_format = 0);

  // Makes the textures anew unless they have these formats and this size. Returns whether it did.
  bool become(GLenum color_format, int width, int height, GLenum depth_format = GL_DEPTH24_STENCIL8,
              GLenum second_format = 0);

  GLuint color() const { return color_.id(); }
  GLuint second() const { return second_.id(); }
  GLuint depth() const { return depth_.id(); }
  GLenum format() const { return format_; }
  GLenum depthFormat() const { return depth_format_; }
  int width() const { return width_; }
  int height() const { return height_; }
  std::size_t bytes() const { return bytes_; }

 private:
  Object color_, second_, depth_;
  GLenum format_ = 0, depth_format_ = 0;
  int width_ = 0, height_ = 0;
  std::size_t bytes_ = 0;
};

// A framebuffer and a vertex array for the duration of a scope: contexts share textures and
// buffers, but not framebuffers and vertex arrays, and rviz has a context for each window.
class DrawScope {
 public:
  explicit DrawScope(const Target& target);
  ~DrawScope();
  DrawScope(const DrawScope&) = delete;
  DrawScope& operator=(const DrawScope&) = delete;

  GLuint framebuffer() const { return framebuffer_; }

 private:
  GLuint framebuffer_ = 0, vertex_array_ = 0;
};

}  // namespace rosplat::gl
