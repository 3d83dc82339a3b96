#pragma once

#include <functional>
#include <vector>

#include "gl/gl_objects.hpp"

namespace rosplat {

// What the current framebuffer and viewport are to those that draw splats.
enum class Canvas {
  kWindow,   // the opaque scene; its first row is the picture's bottom
  kTexture,  // the same with the picture's top first
  kNone,     // nothing: there is no opaque scene, and the picture is only read back
};

// A part of a picture, from its top left. [px]
struct PictureRect {
  int left = 0, top = 0, right = 0, bottom = 0;
};

// What else is seen on a canvas.
struct Surroundings {
  bool opaque = true;                 // something that is may have been drawn there
  std::function<void()> translucent;  // draws what is, and comes next; null where nothing is
  PictureRect translucent_in;         // where it is at most
};

// Draws into targets and, from there, over what was the current framebuffer and viewport when the
// scope began; at its end OpenGL's state is again as Ogre believes it.
class CanvasScope {
 public:
  explicit CanvasScope(Canvas canvas);

  Canvas canvas() const { return canvas_; }
  // The format that a target's depth must have for copyDepth(); 0 where there is no scene or no
  // depth.
  GLenum depthFormat() const { return depth_format_; }
  // The same for any target.
  GLenum targetDepth() const { return depth_format_ ? depth_format_ : GL_DEPTH24_STENCIL8; }
  // The opaque scene's depth into the target that is bound, resolved to one sample a pixel. Where
  // there is none, nothing is hidden.
  void copyDepth(const gl::Target& target) const;
  // The same in the processor's memory: window depths, the picture's top row first; empty where
  // there are none, or the driver keeps them.
  std::vector<float> readDepth(int width, int height) const;
  // Draws a target over the canvas by a program that knows how.
  void layOver(const gl::Program& program, const gl::Target& target) const;
  // The same by a compute program, as splat_composite.comp; only where shaders can write there.
  bool isImage() const { return image_ != 0; }
  void computeOver(const gl::Program& program, const gl::Target& target) const;

 private:
  gl::StateGuard guard_;
  Canvas canvas_;
  GLenum depth_format_ = 0;
  GLuint image_ = 0;     // the texture that is drawn to, if it is one of RGBA8 without samples
  GLint x_ = 0, y_ = 0;  // of the viewport
};

// The window depths of what Ogre draws in a call in a part of a picture, without anything else of
// its scene, the picture's top row first; empty where nothing is in sight, or OpenGL has no
// framebuffer objects.
std::vector<float> depthsOf(Canvas canvas, int width, int height, const PictureRect& part,
                            const std::function<void()>& draw);

// Makes a target as deep as can be: nothing hides what is drawn there.
void clearDepth();

// Has premultiplied colours blended over what is there.
void blendOver();

}  // namespace rosplat
