#pragma once

#include <string>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/map/map_sample.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// In which of the places a map and its views are where pictures are known to fail, and what helps:
// a sentence each. docs/stability.md measures these places, and names those that need no warning.
std::vector<std::string> hardRegimes(const MapState& map, const MapSample& sample,
                                     const Groups& groups, const RenderSettings& settings,
                                     const std::vector<SplatCamera>& cameras);

}  // namespace rosplat
