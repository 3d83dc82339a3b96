#pragma once

#include <memory>
#include <utility>

#include "drawer.hpp"
#include "gl/shaders.hpp"
#include "rosplat_core/map/arrivals.hpp"
#include "rosplat_core/order/built_in_sorter.hpp"
#include "software_renderer.hpp"
#include "splat_renderer.hpp"

namespace rosplat {

// What draws maps, on a graphics card and without: each is there while a map is drawn by it. Maps
// that have the same are drawn together. Render thread only.
class Renderers {
 public:
  explicit Renderers(ShaderSource shaders) : shaders_(std::move(shaders)) {}
  // Those that the maps of a process share.
  static std::shared_ptr<Renderers> ofProcess(const ShaderSource& shaders);

  // Throw gl::Error where the driver can't do it.
  std::shared_ptr<SplatRenderer> onCard();
  std::shared_ptr<SoftwareRenderer> onProcessor();
  // A map's side of one of them, without anything in it.
  std::unique_ptr<Drawer> makeDrawer(DrawnBy by, const Arrivals::Taker& taker,
                                     BuiltInSorter& sorter);

 private:
  ShaderSource shaders_;
  std::weak_ptr<SplatRenderer> card_;
  std::weak_ptr<SoftwareRenderer> processor_;
};

// Where a rasterizer draws. Auto: on the processor if there is no graphics card that can. Render
// thread only.
DrawnBy drawnBy(Rasterizer rasterizer);

}  // namespace rosplat
