#pragma once

#include <array>
#include <cstdint>

#include "rosplat_core/levels/lattice.hpp"
#include "rosplat_core/slots/constants.hpp"
#include "rosplat_core/slots/packed_slot.hpp"

namespace rosplat {

// extentOf() a node, whose opacity is in units of kMostNodeOpacity.
float nodeExtentOf(const PackedSlot& node);

// Merges all that is in a cell into one Gaussian of the same mean, covariance, mean harmonics and
// mass. Each Gaussian counts by its mass: its opacity times the area that it covers.
// tests/merged_levels.py is its plain twin.
class Mixture {
 public:
  Mixture(Cell cell, int sh_degree);

  // opacity_unit: 1 for splats, kMostNodeOpacity for nodes. Empty slots are left out.
  void add(const PackedSlot& slot, float opacity_unit);
  // Returns the node; a Gaussian that is alone in its cell stays as it is.
  PackedSlot pack() const;
  bool empty() const { return count_ == 0; }

 private:
  using Symmetric = std::array<double, 6>;  // xx, xy, xz, yy, yz, zz

  double areaOf(const Symmetric& covariance) const;

  int sh_degree_;
  std::size_t coefficients_;
  std::array<double, 3> corner_;
  double size_;

  int count_ = 0;
  PackedSlot only_;
  float only_unit_ = 1;
  std::uint16_t change_ = 0;  // the latest
  double mass_ = 0;
  std::array<double, 3> mean_{};  // from here on: sums weighted by mass; relative to the corner
  Symmetric square_{};
  std::array<double, 3> color_{};
  std::array<float, 45> sh_{};
};

}  // namespace rosplat
