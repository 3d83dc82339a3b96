#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Moves the window depths of a camera's picture (1: nothing there) to where another camera of the
// same scene and picture size sees them: pixel by pixel, then closes gaps one pixel wide.
std::vector<float> warpDepths(const std::vector<float>& depths, const SplatCamera& camera,
                              const SplatCamera& other);

// The surface of the splats in a picture, for cameras near the picture's own camera.
class PaintedSurface {
 public:
  PaintedSurface() = default;
  // depths: PictureDepth::kMean of the camera's picture [m]; of planes, where the camera rests.
  PaintedSurface(const SplatCamera& camera, std::vector<float> depths)
      : camera_(camera), depths_(std::move(depths)) {}

  // Returns the surface's depth at the centre of each pixel of a camera's picture, top row first
  // [m]; NaN where the alpha of the surface's own picture, rgba, is less than least_alpha. Exact if
  // the camera is the picture's own, or a part of it.
  std::vector<double> seenBy(const SplatCamera& camera, const std::vector<std::uint8_t>& rgba,
                             float least_alpha) const;

 private:
  SplatCamera camera_;
  std::vector<float> depths_;
};

}  // namespace rosplat
