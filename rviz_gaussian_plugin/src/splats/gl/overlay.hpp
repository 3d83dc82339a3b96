#pragma once

#include <cstddef>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/painter/picture_mesh.hpp"

namespace rosplat {

// A texture of what the processor has made, its top row first.
class OverlayTexture {
 public:
  // Throws gl::Error where it is too large.
  void write(int width, int height, const std::vector<std::uint8_t>& rgba);
  void write(int width, int height, const std::vector<float>& window_depths);

  GLuint id() const { return texture_.id(); }
  std::size_t bytes() const { return bytes_; }

 private:
  void write(int width, int height, GLint stored_as, GLenum format, GLenum type, const void* data,
             std::size_t bytes);

  gl::Object texture_;
  GLint stored_as_ = 0;
  int width_ = 0, height_ = 0;
  std::size_t bytes_ = 0;
};

// Draws on a canvas what the processor has made. Needs no more of OpenGL than rviz itself: 2.1.
class Overlay {
 public:
  // Throws gl::Error.
  explicit Overlay(const ShaderSource& source);

  // A texture on the cells of a mesh where there is something, blended over what is there, with the
  // depth test that is set.
  void draw(const CanvasScope& canvas, const OverlayTexture& texture,
            const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells) const;
  // Its depths alone, with the depth test that is set.
  void drawDepth(const CanvasScope& canvas, const OverlayTexture& texture,
                 const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells) const;
  // One as large as the canvas, all of it, in the place of what is there.
  void draw(const CanvasScope& canvas, const OverlayTexture& texture) const;

 private:
  gl::Program colour_, depth_;
};

}  // namespace rosplat
