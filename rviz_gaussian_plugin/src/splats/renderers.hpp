#pragma once

#include <memory>
#include <utility>

#include "drawer.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "software_renderer.hpp"
#include "splat_renderer.hpp"

namespace rosplat {

// The renderers of the graphics card and of the processor. Each exists while a map is drawn by it.
// Only maps with the same renderer can share a picture. Render thread only.
class Renderers {
 public:
  explicit Renderers(ShaderSource shaders) : shaders_(std::move(shaders)) {}
  // The instance that all maps of a process share.
  static std::shared_ptr<Renderers> ofProcess(const ShaderSource& shaders);

  // Throw gl::Error if the driver lacks what the renderer needs.
  std::shared_ptr<SplatRenderer> onCard();
  std::shared_ptr<SoftwareRenderer> onProcessor();
  // Makes a Drawer of an empty map that draws with one of these renderers.
  std::unique_ptr<Drawer> makeDrawer(DrawnBy by, const Arrivals::Taker& taker);

 private:
  ShaderSource shaders_;
  std::weak_ptr<SplatRenderer> card_;
  std::weak_ptr<SoftwareRenderer> processor_;
};

// Where a rasterizer draws. Auto: on the processor if no card can draw. Render thread only.
DrawnBy drawnBy(Rasterizer rasterizer);

// Whether the processor would run a rasterizer's shaders, unless the user has told Mesa to emulate
// a card. Render thread only.
bool isEmulated(Rasterizer rasterizer);

}  // namespace rosplat
