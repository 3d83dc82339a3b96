#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "rosplat_core/slots/splats.hpp"

namespace rosplat {
namespace {

using Floats = std::vector<float>;

TEST(Splats, OfATrainersArraysAreWhatTheseMean) {
  Floats sh0 = {1, 2, 3, 4, 5, 6}, rest(18);
  for (std::size_t i = 0; i < rest.size(); ++i) rest[i] = 10 + static_cast<float>(i);
  const Splats splats = Splats::fromTrained({1, 2, 3, 4, 5, 6}, {9, 1, 2, 3, 8, 5, 6, 7},
                                            {0, 1, 2, 3, 4, 5}, {0, -2}, sh0, rest);
  EXPECT_EQ(splats.positions, (Floats{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(splats.orientations, (Floats{1, 2, 3, 9, 5, 6, 7, 8}));
  for (std::size_t k = 0; k < 6; ++k) EXPECT_FLOAT_EQ(splats.scales[k], std::exp(float(k)));
  EXPECT_FLOAT_EQ(splats.opacities[0], 0.5f);
  EXPECT_FLOAT_EQ(splats.opacities[1], 1 / (1 + std::exp(2.0f)));
  const SplatsView view = splats.view();
  EXPECT_EQ(view.arrays.sh_degree, 1);
  for (std::size_t i = 0; i < 2; ++i) {
    for (std::size_t k = 0; k < 12; ++k) {
      EXPECT_EQ(splats.sh[12 * i + k], k < 3 ? sh0[3 * i + k] : rest[9 * i + k - 3]);
    }
  }
  const Splats balls = Splats::fromTrained({0, 0, 0}, {1, 0, 0, 0}, {2}, {0}, {0, 0, 0});
  EXPECT_EQ(balls.scales, Floats(3, std::exp(2.0f)));
}

std::string errorOf(const std::function<void()>& call) {
  try {
    call();
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return "";
}

TEST(Splats, AnArrayOfAnotherLengthIsRefusedByName) {
  const std::vector<std::string> names = {"quaternions_wxyz", "log_scales", "logits", "sh0", "shN"};
  for (std::size_t longer = 0; longer < names.size(); ++longer) {
    std::vector<Floats> arrays = {Floats(8), Floats(6), Floats(2), Floats(6), Floats(90)};
    arrays[longer].push_back(0);
    const std::string error = errorOf([&] {
      Splats::fromTrained(Floats(6), arrays[0], arrays[1], arrays[2], arrays[3], arrays[4]);
    });
    EXPECT_EQ(error.rfind(names[longer] + ": expected", 0), 0u) << error;
  }
  Splats splats = Splats::fromTrained({0, 0, 0}, {1, 0, 0, 0}, {2}, {0}, {0, 0, 0});
  splats.scales.pop_back();
  EXPECT_EQ(errorOf([&] { splats.view(); }).rfind("scales: expected 3 values", 0), 0u);
  splats.scales.push_back(1);
  splats.channels = {{"label", {1}}, {"label", {2}}};
  EXPECT_EQ(errorOf([&] { splats.view(); }), "channel_names: 'label' is there twice");
}

}  // namespace
}  // namespace rosplat
