#include <gtest/gtest.h>

#include <cmath>
#include <tuple>
#include <vector>

#include "rosplat_core/painter/depth_warp.hpp"

namespace rosplat {
namespace {

constexpr int kWidth = 60, kHeight = 40;

SplatCamera camera(bool orthographic) {
  SplatCamera camera;
  camera.orthographic = orthographic;
  camera.fx = camera.fy = orthographic ? 10 : 50;
  camera.cx = kWidth / 2;
  camera.cy = kHeight / 2;
  camera.width = kWidth;
  camera.height = kHeight;
  std::tie(camera.ndc_scale, camera.ndc_offset) = depthBuffer(orthographic, 1, 100);
  return camera;
}

float windowDepth(const SplatCamera& camera, double depth) {
  const double w = camera.orthographic ? 1 : depth;
  return static_cast<float>(0.5 * (camera.ndc_scale * depth + camera.ndc_offset) / w + 0.5);
}

// A wall from column 20 to 39, so deep.
std::vector<float> wall(const SplatCamera& camera, double depth) {
  std::vector<float> depths(kWidth * kHeight, 1.0f);
  for (int row = 0; row < kHeight; ++row) {
    for (int column = 20; column < 40; ++column) {
      depths[row * kWidth + column] = windowDepth(camera, depth);
    }
  }
  return depths;
}

TEST(WarpDepths, leaves_those_of_the_same_camera) {
  for (const bool orthographic : {false, true}) {
    const std::vector<float> depths = wall(camera(orthographic), 5);
    const std::vector<float> warped =
        warpDepths(depths, camera(orthographic), camera(orthographic));
    for (std::size_t i = 0; i < depths.size(); ++i) ASSERT_NEAR(warped[i], depths[i], 1e-6);
  }
}

TEST(WarpDepths, moves_what_is_there_and_closes_gaps) {
  const SplatCamera before = camera(false);
  SplatCamera nearer = before;
  nearer.translation = {0.5, 0, -1};  // of a wall 5 m away: by 50 / 4 * 0.5 pixels, 5 / 4 as large
  const std::vector<float> warped = warpDepths(wall(before, 5), before, nearer);
  const float expected = windowDepth(nearer, 4);
  for (int row = 0; row < kHeight; ++row) {
    for (int column = 0; column < kWidth; ++column) {
      const double x = (column + 0.5 - kWidth / 2 - 6.25) / 1.25;
      const float depth = warped[row * kWidth + column];
      if (std::fabs(x) < 9) ASSERT_NEAR(depth, expected, 1e-6) << column << ", " << row;
      if (std::fabs(x) > 11) ASSERT_EQ(depth, 1) << column << ", " << row;
    }
  }
}

}  // namespace
}  // namespace rosplat
