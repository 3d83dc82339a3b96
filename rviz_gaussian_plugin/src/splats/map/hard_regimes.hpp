#pragma once

#include <string>
#include <vector>

#include "map/gaussian_map.hpp"
#include "map/groups.hpp"
#include "map/map_sample.hpp"
#include "map/render_settings.hpp"
#include "map/splat_camera.hpp"

namespace rosplat {

// In which of the places a map and its views are where pictures are known to fail, and what helps:
// a sentence each. docs/stability.md measures these places, and names those that need no warning.
std::vector<std::string> hardRegimes(const MapState& map, const MapSample& sample,
                                     const Groups& groups, const RenderSettings& settings,
                                     const std::vector<SplatCamera>& cameras);

}  // namespace rosplat
