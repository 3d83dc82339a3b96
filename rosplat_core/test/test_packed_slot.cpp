#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "rosplat_core/slots/packed_slot.hpp"

using namespace rosplat;

namespace {

Splat packed(const Splat& splat) {
  std::array<std::uint32_t, kSlotWords> slot{};
  packSlot(splat, nullptr, 0, slot.data(), {});
  return unpackSlot(slot.data());
}

}  // namespace

TEST(PackedSlot, KeepsRandomSplatsWithinItsSteps) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform;
  for (int i = 0; i < 10000; ++i) {
    Splat splat;
    for (float& v : splat.position) v = 1000 * normal(random);
    for (float& v : splat.orientation) v = normal(random);
    for (float& v : splat.scale) v = std::exp(3 * normal(random) - 3);
    for (float& v : splat.color) v = normal(random);
    splat.opacity = uniform(random);
    const Splat kept = packed(splat);
    EXPECT_EQ(kept.position, splat.position);
    EXPECT_NEAR(kept.opacity, splat.opacity, 0.51 / 65535);
    double along = 0, length = 0, unit = 0;
    for (int k = 0; k < 4; ++k) {
      along += double(kept.orientation[k]) * splat.orientation[k];
      length += double(splat.orientation[k]) * splat.orientation[k];
      unit += double(kept.orientation[k]) * kept.orientation[k];
    }
    EXPECT_NEAR(unit, 1, 1e-6);
    EXPECT_GT(std::fabs(along) / std::sqrt(length * unit), 1 - 2e-9);  // 1.3e-4 rad
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(kept.scale[k] / splat.scale[k], 1, 3.5e-4);
      EXPECT_NEAR(kept.color[k], splat.color[k], std::fabs(splat.color[k]) / 2048 + 1e-7);
    }
  }
}

TEST(PackedSlot, ExtremesBecomeTheNearestThatItHolds) {
  Splat splat;
  splat.orientation = {0, 0, 0, -2};
  splat.scale = {0, 1e-20f, 3e38f};
  splat.color = {1e30f, -1e30f, 1e-7f};
  splat.opacity = 1;
  const Splat kept = packed(splat);
  EXPECT_EQ(kept.orientation, (std::array<float, 4>{0, 0, 0, 1}));
  EXPECT_EQ(kept.scale, (std::array<float, 3>{0, 0, 16777216}));
  EXPECT_EQ(kept.color[0], 65504);
  EXPECT_EQ(kept.color[1], -65504);
  EXPECT_NEAR(kept.color[2], 1e-7f, 3e-8f);
  EXPECT_EQ(kept.opacity, 1);
}

TEST(PackedSlot, CoefficientsAreFractionsOfTheLargest) {
  std::vector<float> sh(45);
  for (int i = 0; i < 45; ++i) sh[i] = 0.01f * float(i - 22);
  sh[44] = -0.5f;
  std::array<std::uint32_t, kSlotWords> slot{};
  std::array<std::uint32_t, 15> words{};
  packSlot({{}, {0, 0, 0, 1}}, sh.data(), 3, slot.data(),
           {nullptr, &words[0], &words[3], &words[8]});
  const auto kept = unpackHarmonics(slot.data(), 3, {nullptr, &words[0], &words[3], &words[8]});
  ASSERT_EQ(kept.size(), sh.size());
  for (int i = 0; i < 45; ++i) {
    EXPECT_NEAR(kept[i], sh[i], 0.5 * 0.51 / (i % 3 < 2 ? 1023 : 511));
  }
}
