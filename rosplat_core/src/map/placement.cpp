#include "rosplat_core/map/placement.hpp"

namespace rosplat {

Placement makePlacement(const std::array<double, 3>& position,
                        const std::array<double, 4>& orientation) {
  const auto& [x, y, z, w] = orientation;
  const double s = 2 / (x * x + y * y + z * z + w * w);
  return {{1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y), s * (x * y + w * z),
           1 - s * (x * x + z * z), s * (y * z - w * x), s * (x * z - w * y), s * (y * z + w * x),
           1 - s * (x * x + y * y)},
          position};
}

std::array<double, 3> Placement::operator()(const std::array<double, 3>& point) const {
  std::array<double, 3> there = translation;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) there[i] += rotation[3 * i + k] * point[k];
  }
  return there;
}

}  // namespace rosplat
