#pragma once

#include <functional>
#include <vector>

#include "gl/program.hpp"
#include "gl/scopes.hpp"
#include "gl/target.hpp"

namespace rosplat {

// What the current framebuffer and viewport are when splats are drawn.
enum class Canvas {
  kWindow,   // the opaque scene; the framebuffer's first row is the picture's bottom
  kTexture,  // the opaque scene; the framebuffer's first row is the picture's top
  kNone,     // nothing: there is no opaque scene, and the picture is only read back
};

// A part of a picture, from its top left. [px]
struct PictureRect {
  int left = 0, top = 0, right = 0, bottom = 0;
};

// The scene's objects beside the splats.
struct Surroundings {
  bool opaque = true;                 // opaque objects may have been drawn on the canvas
  std::function<void()> translucent;  // draws the translucent objects, which come next; or null
  PictureRect translucent_in;         // contains all that `translucent` draws
};

// Within the scope, splats are drawn into targets, and targets over the canvas: the framebuffer and
// viewport that were current at the start. The end restores the state that Ogre believes is set.
class CanvasScope {
 public:
  explicit CanvasScope(Canvas canvas);

  Canvas canvas() const { return canvas_; }
  // The format that a target's depth must have for copyDepth(); 0 without a scene or its depth.
  GLenum depthFormat() const { return depth_format_; }
  // The depth format of any target: depthFormat() or, where that is 0, a default.
  GLenum targetDepth() const { return depth_format_ ? depth_format_ : GL_DEPTH24_STENCIL8; }
  // Copies the opaque scene's depth into `target`, which must be bound, resolved to one sample a
  // pixel. Without a scene depth, clears the target's depth: nothing hides splats.
  void copyDepth(const gl::Target& target) const;
  // Returns the opaque scene's window depths, the picture's top row first; empty without a scene
  // depth, or if the driver refuses.
  std::vector<float> readDepth(int width, int height) const;
  // Draws a target over the canvas. The program covers the viewport (splat_composite.vert) and
  // reads the target's colours as textures 0 and 1.
  void layOver(const gl::Program& program, const gl::Target& target) const;
  // The same by a compute program (splat_composite.comp). Needs isImage(): shaders can write there.
  bool isImage() const { return image_ != 0; }
  void computeOver(const gl::Program& program, const gl::Target& target) const;

 private:
  gl::StateGuard guard_;
  Canvas canvas_;
  GLenum depth_format_ = 0;
  GLuint image_ = 0;     // the canvas's texture, if it is RGBA8 with one sample a pixel; else 0
  GLint x_ = 0, y_ = 0;  // of the viewport
};

// Returns the window depths of what `draw` draws, without anything else of Ogre's scene: of the
// whole picture, top row first, 1 outside `part`. Empty if `draw` draws nothing in `part`, or
// OpenGL has no framebuffer objects.
std::vector<float> depthsOf(Canvas canvas, int width, int height, const PictureRect& part,
                            const std::function<void()>& draw);

// Clears the bound target's depth to the farthest: nothing hides what is drawn there.
void clearDepth();

// Turns on blending of premultiplied colours over what is there.
void blendOver();

}  // namespace rosplat
