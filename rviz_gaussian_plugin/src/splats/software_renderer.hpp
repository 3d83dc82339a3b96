#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "gl/canvas.hpp"
#include "gl/overlay.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/painter/painter.hpp"
#include "rosplat_core/views/camera_motion.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"
#include "view_names.hpp"
#include "viewed_map.hpp"

namespace rosplat {

using ViewedMap = Viewed<PaintedMap>;

// Draws maps where no graphics card does: a painter makes their pictures, and OpenGL only lays them
// over the window. Maps of one view are in one picture, by depth. Knows no Ogre; runs in the render
// thread only, which waits for a picture if it isn't interactive, and never otherwise.
class SoftwareRenderer {
 public:
  // Throws gl::Error where the driver can't do it.
  explicit SoftwareRenderer(const ShaderSource& source) : overlay_(source) {}

  // Who takes the maps' edits.
  Painter& painter() { return painter_; }
  // Has a picture made of a map that isn't for a window; whether it is there, of the map as it is
  // now.
  bool ready(const ViewedMap& map);
  // Shows a view as SplatRenderer::draw() does, or what there is of it: the newest picture, carried
  // over to this camera. What is shown, and null where nothing is yet; not all of these maps have
  // to be in it, and others may. Throws PictureError.
  PaintingPtr draw(const std::vector<ViewedMap>& maps, Canvas canvas,
                   const Surroundings& around = {});
  // Whether that was this very camera, and the maps as they are now.
  bool exact() const { return exact_; }
  // After a draw() with translucent objects; see SplatRenderer.
  void hideFarther() const;
  void drawBefore() const;

  // See SplatRenderer. Where the surface is in what a view shows.
  void drawSurface(const std::vector<ViewedMap>& maps, Canvas canvas, double far_clip);
  // See SplatRenderer. Where maps are in what their view shows; which splats, the painter finds.
  void drawPick(const std::vector<ViewedMap>& maps, Canvas canvas, std::uint32_t number);
  // After drawPick(), of each of its maps.
  std::vector<Pick> pick() { return painter_.pick(picked_); }

  // What draw() showed last; see SplatRenderer. Throw PictureError where it is interactive.
  const std::vector<float>& readColor() const;
  const std::vector<float>& readDepth() const;

  void forget(const std::string& view_id);
  std::size_t hostBytes() const { return painter_.bytes(); }  // beside the maps
  std::size_t gpuBytes() const;

 private:
  // What displays show together.
  struct ShownView {
    PaintRequestPtr asked;
    std::vector<MapState> asked_of;
    MotionTracker motion;  // of the camera
    PaintingPtr shown;
    OverlayTexture colour, behind, hiding;
  };

  PaintRequest requestOf(const std::vector<ViewedMap>& maps) const;
  // The name of the view that maps are in.
  const std::string& join(const std::vector<ViewedMap>& maps);
  // Whether a picture of these maps as they are now is what was asked for last.
  static bool asked(const ShownView& view, const PaintRequest& request,
                    const std::vector<ViewedMap>& maps);
  void ask(const std::string& name, PaintRequestPtr request, const std::vector<ViewedMap>& maps);
  void show(ShownView& view, const PaintingPtr& painting);
  // Of what the view of maps shows, how deep it is for their cameras, where it has so much of
  // splats before what is opaque [m]; NaN elsewhere, and none where it shows nothing.
  std::vector<double> depthsShown(const std::vector<ViewedMap>& maps,
                                  const std::vector<float>& scene_depth, float least_alpha) const;
  // Writes numbers of 24 bits by pixel, top row first; nothing where one is 0.
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
  PictureMesh::CornerGrid mesh_;  // how it saw the picture
  bool exact_ = false;
};

}  // namespace rosplat
