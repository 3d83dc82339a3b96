#pragma once

#include <algorithm>
#include <cstdint>
#include <random>

#include "owned_batch.hpp"

namespace rosplat {

// Good splats of random positions for all of a batch's `count`; nothing for a DELETE or a MOVE.
inline void fill(OwnedBatch& batch, std::mt19937& random) {
  const std::size_t n = batch.operation >= GaussianBatch::DELETE ? 0 : batch.count;
  std::uniform_real_distribution<float> place(-10, 10), part(0.01f, 1);
  batch.position.resize(3 * n);
  for (float& x : batch.position) x = place(random);
  batch.orientation.assign(4 * n, 0.5f);
  batch.scale.assign(3 * n, 0.1f);
  batch.opacity.resize(n);
  for (float& alpha : batch.opacity) alpha = part(random);
  batch.harmonics.resize(3u * (batch.sh_degree + 1u) * (batch.sh_degree + 1u) * n);
  for (float& c : batch.harmonics) c = part(random);
  if (n == 0) batch.channel_names.clear();
  batch.values.resize(batch.channel_names.size() * n);
  for (float& value : batch.values) value = part(random);
  batch.look();
}

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
