#pragma once

#include <epoxy/gl.h>

#include <array>
#include <cstddef>

#include "gl/object.hpp"

namespace rosplat::gl {

// Returns the format of a texture that a framebuffer's depth can be copied to, 0 without a depth.
// Binds the framebuffer for reading.
GLenum depthFormat(GLuint framebuffer);

// A depth texture with as many samples a pixel as a window has.
class SampledDepth {
 public:
  SampledDepth() = default;
  SampledDepth(int width, int height, int samples);

  GLuint texture() const { return texture_.id(); }
  int width() const { return width_; }
  int height() const { return height_; }
  int samples() const { return samples_; }
  std::size_t bytes() const { return bytes_; }

 private:
  Object texture_;
  int width_ = 0, height_ = 0, samples_ = 0;
  std::size_t bytes_ = 0;
};

// Within the scope, all that Ogre draws leaves its depth alone, in a texture that is cleared first.
class DepthScope {
 public:
  explicit DepthScope(const SampledDepth& depth);
  ~DepthScope();
  DepthScope(const DepthScope&) = delete;
  DepthScope& operator=(const DepthScope&) = delete;

 private:
  GLuint framebuffer_ = 0;
  GLint draw_framebuffer_ = 0, read_framebuffer_ = 0;
  std::array<GLint, 4> viewport_{};
};

// A framebuffer of depths alone. The constructor binds it.
class DepthFramebuffer {
 public:
  DepthFramebuffer(GLenum format, int width, int height);
  ~DepthFramebuffer();
  DepthFramebuffer(const DepthFramebuffer&) = delete;
  DepthFramebuffer& operator=(const DepthFramebuffer&) = delete;

  GLuint id() const { return id_; }

 private:
  GLuint id_ = 0, depths_ = 0;
};

}  // namespace rosplat::gl
