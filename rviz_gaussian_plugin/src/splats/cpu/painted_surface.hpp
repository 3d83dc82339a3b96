#pragma once

#include <array>
#include <vector>

#include "cpu/cpu_rasterizer.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// Where splats are that a picture shows, for cameras that are near the one that saw it.
class PaintedSurface {
 public:
  PaintedSurface() = default;
  // Of a picture with its mean depth, and the camera that sees it.
  PaintedSurface(const SplatCamera& camera, const SplatPicture& picture);

  // How deep they are in the middle of each pixel of a camera's picture, top row first [m]; NaN
  // where they cover less than so much of it. Of the camera of the picture, or a part of that,
  // exactly.
  std::vector<double> seenBy(const SplatCamera& camera, float least_alpha) const;

 private:
  struct Pixel {
    float alpha, depth;  // [m]
  };

  // Of what hides a point, or is there.
  double depthOf(const std::array<double, 3>& point, float least_alpha) const;

  SplatCamera camera_;
  std::vector<Pixel> pixels_;
};

}  // namespace rosplat
