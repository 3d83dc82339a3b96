#pragma once

#include <algorithm>
#include <cstdint>
#include <random>
#include <vector>

#include "map/gaussian_batch.hpp"

namespace rosplat {

// A batch with arrays of its own; its views look into them once look() is called.
struct OwnedBatch : GaussianBatch {
  std::vector<std::uint32_t> slot_list, group_list;
  std::vector<float> position, orientation, scale, opacity, harmonics, values;

  // Good splats of random positions for all of `count`; nothing for a DELETE or a MOVE.
  void fill(std::mt19937& random) {
    const std::size_t n = operation >= DELETE ? 0 : count;
    std::uniform_real_distribution<float> place(-10, 10), part(0.01f, 1);
    position.resize(3 * n);
    for (float& x : position) x = place(random);
    orientation.assign(4 * n, 0.5f);
    scale.assign(3 * n, 0.1f);
    opacity.resize(n);
    for (float& alpha : opacity) alpha = part(random);
    harmonics.resize(3u * (sh_degree + 1u) * (sh_degree + 1u) * n);
    for (float& c : harmonics) c = part(random);
    if (n == 0) channel_names.clear();
    values.resize(channel_names.size() * n);
    for (float& value : values) value = part(random);
    look();
  }

  void look() {
    slots = {slot_list.data(), slot_list.size()};
    groups = {group_list.data(), group_list.size()};
    positions = {position.data(), position.size()};
    orientations = {orientation.data(), orientation.size()};
    scales = {scale.data(), scale.size()};
    opacities = {opacity.data(), opacity.size()};
    sh = {harmonics.data(), harmonics.size()};
    channels = {values.data(), values.size()};
  }
};

// Makes a batch a MOVE of some of the groups below a number, each once.
inline void chooseMoves(OwnedBatch& batch, std::uint32_t below, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  batch.operation = GaussianBatch::MOVE;
  batch.first_slot = batch.count = 0;
  batch.slot_list.clear();
  for (std::uint32_t group = 0; group < below; ++group) {
    if (unit(random) < 0) continue;
    batch.group_list.push_back(group);
    batch.poses.push_back({{10 * unit(random), 10 * unit(random), 10 * unit(random)},
                           {unit(random), unit(random), unit(random), 1.1 + unit(random)}});
  }
}

// Which slots a batch touches: a range or a list, which may name a slot twice.
inline void chooseSlots(OwnedBatch& batch, std::uint32_t below, std::uint32_t most,
                        std::mt19937& random) {
  const auto upTo = [&](std::uint32_t end) {
    return std::uniform_int_distribution<std::uint32_t>(0, end)(random);
  };
  batch.count = upTo(most);
  batch.slot_list.clear();
  if (batch.count > 0 && upTo(1) == 0) {
    for (std::uint32_t i = 0; i < batch.count; ++i) batch.slot_list.push_back(upTo(below - 1));
  } else {
    batch.count = std::min(batch.count, below);
    batch.first_slot = upTo(below - batch.count);
  }
}

}  // namespace rosplat
