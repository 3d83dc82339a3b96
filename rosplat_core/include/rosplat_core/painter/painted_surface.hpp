#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Where splats are that a picture shows, for cameras that are near the one that saw it.
class PaintedSurface {
 public:
  PaintedSurface() = default;
  // Of a picture's mean depths, and the camera that sees it.
  PaintedSurface(const SplatCamera& camera, std::vector<float> depths)
      : camera_(camera), depths_(std::move(depths)) {}

  // How deep they are in the middle of each pixel of a camera's picture, top row first [m]; NaN
  // where they cover less than so much of it, by the picture as bytes. Of the camera of the
  // picture, or a part of that, exactly.
  std::vector<double> seenBy(const SplatCamera& camera, const std::vector<std::uint8_t>& rgba,
                             float least_alpha) const;

 private:
  SplatCamera camera_;
  std::vector<float> depths_;
};

}  // namespace rosplat
