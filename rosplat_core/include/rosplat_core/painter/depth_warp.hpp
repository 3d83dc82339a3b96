#pragma once

#include <vector>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Moves the window depths of a camera's picture (1: nothing there) to where another camera of the
// same scene and picture size sees them: pixel by pixel, then closes gaps one pixel wide.
std::vector<float> warpDepths(const std::vector<float>& depths, const SplatCamera& camera,
                              const SplatCamera& other);

}  // namespace rosplat
