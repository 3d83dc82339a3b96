#pragma once

#include <vector>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Window depths of a camera's picture, 1 where nothing is, as another of the same scene, of as many
// pixels, would see what is there: by pixel, with gaps of one closed.
std::vector<float> warpDepths(const std::vector<float>& depths, const SplatCamera& camera,
                              const SplatCamera& other);

}  // namespace rosplat
