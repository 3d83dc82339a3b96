#include "rosplat_core/map/placement.hpp"

#include <cstddef>

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

std::array<double, 4> quaternionOf(const std::array<double, 9>& r) {
  const double trace = r[0] + r[4] + r[8];
  if (trace > 0) return {r[7] - r[5], r[2] - r[6], r[3] - r[1], 1 + trace};
  const std::size_t i = r[0] >= r[4] && r[0] >= r[8] ? 0 : r[4] >= r[8] ? 1 : 2;
  const std::size_t j = (i + 1) % 3, k = (i + 2) % 3;
  const auto at = [&r](std::size_t row, std::size_t column) { return r[3 * row + column]; };
  std::array<double, 4> q;
  q[i] = 1 + at(i, i) - at(j, j) - at(k, k);
  q[j] = at(j, i) + at(i, j);
  q[k] = at(k, i) + at(i, k);
  q[3] = at(k, j) - at(j, k);
  return q;
}

std::array<double, 9> product(const std::array<double, 9>& a, const std::array<double, 9>& b) {
  std::array<double, 9> c{};
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      for (int j = 0; j < 3; ++j) c[3 * i + j] += a[3 * i + k] * b[3 * k + j];
    }
  }
  return c;
}

Placement Placement::operator*(const Placement& first) const {
  return {product(rotation, first.rotation), (*this)(first.translation)};
}

Placement Placement::inverse() const {
  Placement back;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      back.rotation[3 * i + k] = rotation[3 * k + i];
      back.translation[i] -= rotation[3 * k + i] * translation[k];
    }
  }
  return back;
}

std::array<double, 3> Placement::operator()(const std::array<double, 3>& point) const {
  std::array<double, 3> there = translation;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) there[i] += rotation[3 * i + k] * point[k];
  }
  return there;
}

}  // namespace rosplat
