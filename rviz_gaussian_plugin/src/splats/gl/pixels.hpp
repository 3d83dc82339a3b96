#pragma once

#include <epoxy/gl.h>

#include <vector>

namespace rosplat::gl {

// Within the scope, pixels go to and come from plain memory, whatever buffers and offsets were set.
class PixelScope {
 public:
  PixelScope();
  ~PixelScope();
  PixelScope(const PixelScope&) = delete;
  PixelScope& operator=(const PixelScope&) = delete;

 private:
  GLint pack_buffer_ = 0, unpack_buffer_ = 0;
};

// Returns window depths of the framebuffer that is bound for reading, the picture's top row first.
// top_first: the framebuffer's first row is the picture's top.
std::vector<float> readDepths(int x, int y, int width, int height, bool top_first);

// Returns colours of the framebuffer that is bound for reading, in its order of rows: GL_RGBA, or
// one of its channels.
std::vector<float> readPixels(int width, int height, GLenum channels = GL_RGBA);

}  // namespace rosplat::gl
