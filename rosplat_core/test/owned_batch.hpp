#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"

namespace rosplat {

// A batch with arrays of its own, which it shows once look() is called.
struct OwnedBatch : GaussianBatch {
  explicit OwnedBatch(std::uint64_t revision = 0, std::uint8_t operation = REPLACE,
                      std::uint32_t first_slot = 0) {
    map_id = "map";
    this->revision = revision;
    this->operation = operation;
    this->first_slot = first_slot;
  }

  // One splat more, with all its coefficients.
  void add(const std::array<float, 3>& at, const std::array<float, 3>& size, float alpha,
           const std::vector<float>& coefficients = {0, 0, 0},
           const std::array<float, 4>& turn = {0, 0, 0, 1}) {
    ++count;
    position.insert(position.end(), at.begin(), at.end());
    orientation.insert(orientation.end(), turn.begin(), turn.end());
    scale.insert(scale.end(), size.begin(), size.end());
    opacity.push_back(alpha);
    harmonics.insert(harmonics.end(), coefficients.begin(), coefficients.end());
  }

  const GaussianBatch& look() {
    slots = slot_list;
    groups = group_list;
    positions = position;
    orientations = orientation;
    scales = scale;
    opacities = opacity;
    sh = harmonics;
    channels = values;
    return *this;
  }

  std::vector<std::uint32_t> slot_list, group_list;
  std::vector<float> position, orientation, scale, opacity, harmonics, values;
};

}  // namespace rosplat
