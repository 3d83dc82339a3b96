#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/overlay.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/painter/painter.hpp"
#include "rosplat_core/views/camera_motion.hpp"
#include "rosplat_core/views/splat_camera.hpp"
#include "view_names.hpp"

namespace rosplat {

// Draws maps without a graphics card: a painter makes the pictures, and OpenGL only lays them over
// the window. The maps of a view share one picture, sorted together. Knows no Ogre. Render thread
// only, which waits for a picture only if that isn't interactive.
class SoftwareRenderer {
 public:
  // Throws gl::Error if the driver can't compile the shaders.
  explicit SoftwareRenderer(const ShaderSource& source) : overlay_(source) {}

  // Its thread also takes the maps' edits.
  Painter& painter() { return painter_; }
  // Has a picture made that no window shows, unless it is being made or ready().
  void request(const PaintedPicture& picture);
  // Whether the picture, of its maps as they were at request(), is finished or has failed.
  bool ready(const PaintedPicture& picture) const;
  // Shows a view as SplatRenderer::draw() does. An interactive view shows the newest finished
  // picture, warped to this camera. Returns the picture that is shown, null if there is none yet.
  // It may lack some of these maps, and hold others. Throws PictureError.
  PaintingPtr draw(const PaintedPicture& picture, Canvas canvas, const Surroundings& around = {});
  // Whether the picture that draw() showed is of its very camera, and of the maps as they were then
  // or at request().
  bool exact() const { return exact_; }
  // Time of the last draw() of that view after which exact() was true. [s]
  double exactUntil() const { return drawn_ ? drawn_->exact_until : 0; }
  // After a draw() with translucent objects; see SplatRenderer.
  void hideFarther() const;
  void drawBefore() const;

  // See SplatRenderer. Uses the surface of the picture that the view shows.
  void drawSurface(const PaintedPicture& picture, Canvas canvas, double far_clip);
  // See SplatRenderer. Marks where the shown picture has splats; the painter finds which ones.
  void drawPick(const PaintedPicture& picture, Canvas canvas, std::uint32_t number);
  // Once after drawPick(): the picked splats of each of its maps.
  std::vector<Pick> pick() { return painter_.pick(std::exchange(picked_, {})); }

  // What draw() showed last; see SplatRenderer. Throw PictureError if that was interactive.
  const std::vector<float>& readColor() const;
  const std::vector<float>& readDepth() const;

  void forget(const std::string& view_id);
  std::size_t hostBytes() const { return painter_.bytes(); }  // beside the maps
  std::size_t gpuBytes() const;

 private:
  // A view that one or more displays show together.
  struct ShownView {
    PaintRequestPtr asked;
    MotionTracker motion;  // of the camera
    PaintingPtr shown;
    double exact_until = 0;  // see exactUntil()
    OverlayTexture colour, behind, hiding;
  };

  PaintRequest requestOf(const PaintedPicture& picture) const;
  // Joins the views of the layers to one view, and returns its name.
  const std::string& join(const PaintedPicture& picture);
  // The view that shows a picture's first layer; null if none does.
  const ShownView* viewOf(const PaintedPicture& picture) const;
  // Whether the view's last request equals this one, for the same states of its maps.
  static bool asked(const ShownView& view, const PaintRequest& request);
  void ask(const std::string& name, PaintRequestPtr request);
  // Whether a painting is what was asked for, although the map may have been edited since. No later
  // painting would show the present state of a map that is edited all the time.
  static bool overtaken(const ShownView& view, const Painting& painting,
                        const PaintRequest& request);
  void show(ShownView& view, const PaintingPtr& painting);
  // Depths of the shown picture's splats, by pixel of the maps' camera [m]; NaN where they are less
  // opaque than least_alpha or behind the opaque scene. Empty if the view shows none of the maps.
  std::vector<double> depthsShown(const PaintedPicture& picture,
                                  const std::vector<float>& scene_depth, float least_alpha) const;
  // Writes a number of 24 bits to each pixel, top row first. A 0 writes nothing.
  void drawNumbers(const CanvasScope& window, const SplatCamera& camera,
                   const std::vector<std::uint32_t>& numbers);
  void drop(const std::string& name);

  Overlay overlay_;
  Painter painter_;
  ViewNames names_;
  std::map<std::string, ShownView> views_;  // by name
  OverlayTexture bytes_;
  PaintRequest picked_;  // what drawPick() has marked last

  // Of the last draw().
  const ShownView* drawn_ = nullptr;
  Canvas canvas_ = Canvas::kNone;
  PictureMesh::CornerGrid mesh_;  // the picture, as that draw()'s camera saw it
  bool exact_ = false;
};

}  // namespace rosplat
