#include "gl/pixels.hpp"

#include <algorithm>
#include <cstddef>

namespace rosplat::gl {

PixelScope::PixelScope() {
  glGetIntegerv(GL_PIXEL_PACK_BUFFER_BINDING, &pack_buffer_);
  glGetIntegerv(GL_PIXEL_UNPACK_BUFFER_BINDING, &unpack_buffer_);
  glPushClientAttrib(GL_CLIENT_PIXEL_STORE_BIT);
  glBindBuffer(GL_PIXEL_PACK_BUFFER, 0);
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, 0);
  for (const GLenum none :
       {GL_PACK_ROW_LENGTH, GL_PACK_SKIP_ROWS, GL_PACK_SKIP_PIXELS, GL_PACK_SWAP_BYTES,
        GL_PACK_LSB_FIRST, GL_UNPACK_ROW_LENGTH, GL_UNPACK_SKIP_ROWS, GL_UNPACK_SKIP_PIXELS,
        GL_UNPACK_SWAP_BYTES, GL_UNPACK_LSB_FIRST}) {
    glPixelStorei(none, 0);
  }
}

PixelScope::~PixelScope() {
  glPopClientAttrib();
  glBindBuffer(GL_PIXEL_PACK_BUFFER, static_cast<GLuint>(pack_buffer_));
  glBindBuffer(GL_PIXEL_UNPACK_BUFFER, static_cast<GLuint>(unpack_buffer_));
}

std::vector<float> readDepths(int x, int y, int width, int height, bool top_first) {
  const auto columns = static_cast<std::size_t>(width), rows = static_cast<std::size_t>(height);
  std::vector<float> depths(columns * rows);
  const PixelScope scope;
  glReadPixels(x, y, width, height, GL_DEPTH_COMPONENT, GL_FLOAT, depths.data());
  for (std::size_t row = 0; !top_first && row < rows / 2; ++row) {
    float* const upper = &depths[columns * row];
    std::swap_ranges(upper, upper + columns, &depths[columns * (rows - 1 - row)]);
  }
  return depths;
}

std::vector<float> readPixels(int width, int height, GLenum channels) {
  const std::size_t of_pixel = channels == GL_RGBA ? 4 : 1;
  std::vector<float> pixels(of_pixel * static_cast<std::size_t>(width) *
                            static_cast<std::size_t>(height));
  const PixelScope scope;
  glReadPixels(0, 0, width, height, channels, GL_FLOAT, pixels.data());
  return pixels;
}

}  // namespace rosplat::gl
