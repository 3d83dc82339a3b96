#pragma once

#include <array>

namespace rosplat {

// Where a map's frame is in a scene, in double precision.
struct Placement {
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // map -> scene, rows
  std::array<double, 3> translation{};                        // [m]

  std::array<double, 3> operator()(const std::array<double, 3>& point) const;
};

// A frame's pose in another: position [m], quaternion x y z w of any length but zero.
Placement makePlacement(const std::array<double, 3>& position,
                        const std::array<double, 4>& orientation);

}  // namespace rosplat
