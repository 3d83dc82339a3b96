#pragma once

#include <cstddef>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/object.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/painter/picture_mesh.hpp"

namespace rosplat {

// A texture of a picture, or its depths, that the processor has made; top row first.
class OverlayTexture {
 public:
  // Both throw gl::Error if the driver has no texture of this size [px].
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

// Draws the processor's pictures on a canvas. Needs only OpenGL 2.1, as rviz itself does.
class Overlay {
 public:
  // Throws gl::Error.
  explicit Overlay(const ShaderSource& source);

  // Blends a texture over the canvas: the cells of a mesh that are covered, all or in part. Keeps
  // the depth test as it is set.
  void draw(const CanvasScope& canvas, const OverlayTexture& texture,
            const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells) const;
  // Draws window depths alone, on the partly covered cells. Keeps the depth test as it is set.
  void drawDepth(const CanvasScope& canvas, const OverlayTexture& texture,
                 const PictureMesh::CornerGrid& mesh, const PictureMesh::Cells& cells) const;
  // Replaces the whole canvas with a texture of its size, except where alpha is 0.
  void draw(const CanvasScope& canvas, const OverlayTexture& texture) const;

 private:
  gl::Program colour_, depth_;
};

}  // namespace rosplat
