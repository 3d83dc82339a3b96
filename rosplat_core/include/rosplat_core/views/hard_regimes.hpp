#pragma once

#include <string>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/map/map_sample.hpp"
#include "rosplat_core/views/render_settings.hpp"
#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

// Finds which regimes that spoil pictures a map and its views are in. Returns a sentence for each,
// with what helps. docs/stability.md measures all regimes, and names those that need no warning.
std::vector<std::string> hardRegimes(const MapState& map, const MapSample& sample,
                                     const Groups& groups, const RenderSettings& settings,
                                     const std::vector<SplatCamera>& cameras);

}  // namespace rosplat
