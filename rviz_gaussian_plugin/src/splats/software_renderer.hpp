#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "cpu/painter.hpp"
#include "gl/canvas.hpp"
#include "gl/overlay.hpp"
#include "gl/shaders.hpp"
#include "map/gaussian_map.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// Draws a map where no graphics card does: a painter makes its pictures, and OpenGL only lays them
// over the window. Knows no Ogre; runs in the render thread only, which waits for a picture if it
// isn't asynchronous, and never otherwise.
class SoftwareRenderer {
 public:
  // Throws gl::Error where the driver can't do it.
  SoftwareRenderer(const ShaderSource& source, Painter::NextEdit next_edit);

  // There are edits to take.
  void wake() { painter_.wake(); }
  // Where the map goes, or comes from, if something else draws it at other times.
  Painter& painter() { return painter_; }
  // Has a picture made that isn't for a window; whether it is there, of the map as it is now.
  // order: null by depth.
  bool ready(const std::string& view_id, const SplatCamera& camera, const RenderSettings& settings,
             const OrderPtr& order, const MapState& map);
  // Shows a view as SplatRenderer::draw() does, or what there is of it: the newest picture, carried
  // over to this camera. What is shown, and null where nothing is yet. Throws PictureError.
  PaintingPtr draw(const std::string& view_id, const SplatCamera& camera,
                   const RenderSettings& settings, const OrderPtr& order, const MapState& map,
                   Canvas canvas, const Surroundings& around = {});
  // Whether that was this very camera, and the map as it is now.
  bool exact() const { return exact_; }
  // After a draw() with translucent objects; see SplatRenderer.
  void hideFarther() const;
  void drawBefore() const;

  // See SplatRenderer. Where the surface is in what a view shows.
  void drawSurface(const std::string& view_id, const SplatCamera& camera, Canvas canvas,
                   double far_clip);
  // See SplatRenderer. Where splats are in what a view shows; which, the painter finds.
  void drawPick(const std::string& view_id, const SplatCamera& camera,
                const RenderSettings& settings, Canvas canvas, std::uint32_t number);
  Pick pick() { return painter_.pick(picked_); }
  std::vector<SplatValues> readSlots(const std::vector<std::uint32_t>& slots) const {
    return painter_.read(slots);
  }

  // What draw() showed last; see SplatRenderer. Throw PictureError where it is asynchronous.
  const std::vector<float>& readColor() const;
  const std::vector<float>& readDepth() const;

  MapState map() const { return painter_.map(); }  // that is painted
  std::string mapError() const { return painter_.mapError(); }
  void forget(const std::string& view_id);
  std::size_t hostBytes() const { return painter_.bytes(); }
  std::size_t mapBytes() const { return painter_.mapBytes(); }
  std::size_t levelsBytes() const { return painter_.levelsBytes(); }
  std::size_t gpuBytes() const;

 private:
  struct View {
    PaintRequestPtr asked;
    MapState asked_of;
    PaintingPtr shown;
    OverlayTexture colour, behind, hiding;
  };

  // Whether a picture of this map as it is now is what was asked for last.
  static bool asked(const View& view, const PaintRequest& request, const MapState& map);
  void ask(const std::string& view_id, PaintRequestPtr request, const MapState& map);
  void show(View& view, const PaintingPtr& painting);
  // Writes a number of 24 bits, of the depth [m], where what a view shows has so much of splats
  // before what is opaque.
  void drawNumbers(const CanvasScope& window, const std::string& view_id, const SplatCamera& camera,
                   const std::vector<float>& scene_depth, float least_alpha,
                   const std::function<std::uint32_t(double)>& number);

  Overlay overlay_;
  Painter painter_;
  std::map<std::string, View> views_;
  OverlayTexture bytes_;
  PaintRequest picked_;  // what drawPick() has marked last

  // Of the last draw().
  const View* drawn_ = nullptr;
  Canvas canvas_ = Canvas::kNone;
  PictureMesh::View mesh_;  // how it saw the picture
  bool exact_ = false;
};

}  // namespace rosplat
