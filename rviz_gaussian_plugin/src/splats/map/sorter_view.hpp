#pragma once

#include <array>

#include "map/splat_camera.hpp"
#include "rosplat_sorter/depth_order.hpp"

namespace rosplat {

// The part of a camera that decides an order, relative to the map's origin.
rosplat_sorter::View sorterView(const SplatCamera& camera, const std::array<double, 3>& origin,
                                double overscan = rosplat_sorter::kOverscan);

}  // namespace rosplat
