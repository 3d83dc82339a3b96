#pragma once

#include <array>
#include <vector>

#include "cpu/cpu_rasterizer.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// Where a picture is more splats than void, for cameras that are near the one that saw it.
class PaintedSurface {
 public:
  PaintedSurface() = default;
  // Of a picture with its mean depth, and the camera that sees it.
  PaintedSurface(const SplatCamera& camera, const SplatPicture& picture);

  // How deep it is in the middle of a pixel of a camera's picture [m]; NaN where there is none. Of
  // the camera of the picture, or a part of that, exactly.
  double depthAt(const SplatCamera& camera, int column, int row) const;

 private:
  double depthOf(const std::array<double, 3>& point) const;  // of what hides a point, or is there

  SplatCamera camera_;
  std::vector<float> depths_;  // by pixel [m]
};

}  // namespace rosplat
