#include "gl/overlay.hpp"

#include <algorithm>
#include <string>

#include "gl/driver.hpp"
#include "gl/pixels.hpp"

namespace rosplat {

namespace {

gl::Program programOf(const ShaderSource& source, const char* fragment) {
  const std::string version = "#version 120\n";
  gl::Program program;
  program.attach(GL_VERTEX_SHADER, "overlay.vert", version + source("overlay.vert"));
  program.attach(GL_FRAGMENT_SHADER, fragment, version + source(fragment));
  program.link(fragment);
  return program;
}

using Cover = PictureMesh::Cover;

// Draws the cells of a cover. Not from vertex arrays: their state is that of the previous drawing.
void draw(const CanvasScope& canvas, const OverlayTexture& texture,
          const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells, Cover cover) {
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, texture.id());
  // In an unmoved mesh, texels lie on pixels: there is nothing to smooth.
  const GLint filter = mesh.moved ? GL_LINEAR : GL_NEAREST;
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, filter);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, filter);
  const float up = canvas.canvas() == Canvas::kTexture ? -1.0f : 1.0f;
  const auto put = [up](const PictureMesh::Corner& corner) {
    glTexCoord2f(corner.u, corner.v);
    glVertex4f(corner.x, up * corner.y, 0.0f, corner.w);
  };
  const std::size_t columns = mesh.columns - 1;
  for (std::size_t row = 0; row < cells.size() / columns; ++row) {
    const auto first = cells.begin() + static_cast<std::ptrdiff_t>(columns * row);
    const auto last = first + static_cast<std::ptrdiff_t>(columns);
    const PictureMesh::Corner* const corners = &mesh.corners[mesh.columns * row];
    for (auto begin = std::find(first, last, cover), end = begin; begin != last;
         begin = std::find(end, last, cover)) {
      end = std::find_if(begin, last, [cover](Cover of) { return of != cover; });
      // In an unmoved mesh, the corners in between lie on a line.
      const auto step = mesh.moved ? 1 : end - begin;
      glBegin(GL_TRIANGLE_STRIP);
      for (auto column = begin - first; column <= end - first; column += step) {
        put(corners[column]);
        put(corners[column + static_cast<std::ptrdiff_t>(mesh.columns)]);
      }
      glEnd();
    }
  }
}

}  // namespace

void OverlayTexture::write(int width, int height, const std::vector<std::uint8_t>& rgba) {
  write(width, height, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE, rgba.data(), rgba.size());
}

void OverlayTexture::write(int width, int height, const std::vector<float>& window_depths) {
  write(width, height, GL_DEPTH_COMPONENT24, GL_DEPTH_COMPONENT, GL_FLOAT, window_depths.data(),
        window_depths.size() * sizeof(window_depths[0]));
}

void OverlayTexture::write(int width, int height, GLint stored_as, GLenum format, GLenum type,
                           const void* data, std::size_t bytes) {
  const bool fits = id() && width_ == width && height_ == height && stored_as_ == stored_as;
  GLuint texture = id();
  if (!texture) glGenTextures(1, &texture);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, texture);
  if (!id()) texture_ = gl::Object(GL_TEXTURE, texture);
  const gl::PixelScope pixels;
  if (fits) {
    glTexSubImage2D(GL_TEXTURE_2D, 0, 0, 0, width, height, format, type, data);
    return;
  }
  gl::dropErrors();
  glTexImage2D(GL_TEXTURE_2D, 0, stored_as, width, height, 0, format, type, data);
  if (glGetError() != GL_NO_ERROR) {
    throw gl::Error("the graphics driver has no texture of " + std::to_string(width) + "x" +
                    std::to_string(height) + " pixels");
  }
  for (const GLenum along : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T}) {
    glTexParameteri(GL_TEXTURE_2D, along, GL_CLAMP_TO_EDGE);
  }
  stored_as_ = stored_as;
  width_ = width;
  height_ = height;
  bytes_ = bytes;
}

Overlay::Overlay(const ShaderSource& source)
    : colour_(programOf(source, "overlay.frag")), depth_(programOf(source, "overlay_depth.frag")) {}

void Overlay::draw(const CanvasScope& canvas, const OverlayTexture& texture,
                   const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells) const {
  colour_.use();
  // All samples of a pixel get one colour, which saves software a fifth of the time. drawDepth()
  // needs each sample: a shader writes its depths.
  glDisable(GL_MULTISAMPLE);
  glDisable(GL_BLEND);  // takes software a third of the time; fully covered cells hide all anyway
  rosplat::draw(canvas, texture, mesh, cells, Cover::kAll);
  blendOver();
  rosplat::draw(canvas, texture, mesh, cells, Cover::kSome);
}

void Overlay::drawDepth(const CanvasScope& canvas, const OverlayTexture& texture,
                        const PictureMesh::CornerGrid& mesh,
                        const PictureMesh::Cells& cells) const {
  depth_.use();
  rosplat::draw(canvas, texture, mesh, cells, Cover::kSome);
}

void Overlay::draw(const CanvasScope& canvas, const OverlayTexture& texture) const {
  static const PictureMesh::CornerGrid whole{
      2, {{-1, 1, 1, 0, 0}, {1, 1, 1, 1, 0}, {-1, -1, 1, 0, 1}, {1, -1, 1, 1, 1}}, false};
  draw(canvas, texture, whole, {Cover::kAll});
}

}  // namespace rosplat
