#pragma once

#include <array>

namespace rosplat {

// Where a frame is in another, in double precision: takes points of the frame to the other.
struct Placement {
  std::array<double, 9> rotation{1, 0, 0, 0, 1, 0, 0, 0, 1};  // rows
  std::array<double, 3> translation{};                        // [m]

  std::array<double, 3> operator()(const std::array<double, 3>& point) const;
  // First the other placement, then this one.
  Placement operator*(const Placement& first) const;
  Placement inverse() const;
};

// A frame's pose in another: position [m], quaternion x y z w of any length but zero.
Placement makePlacement(const std::array<double, 3>& position,
                        const std::array<double, 4>& orientation);

// A rotation's quaternion x y z w, not of unit length.
std::array<double, 4> quaternionOf(const std::array<double, 9>& rotation);

// The product of matrices, as rows.
std::array<double, 9> product(const std::array<double, 9>& a, const std::array<double, 9>& b);

}  // namespace rosplat
