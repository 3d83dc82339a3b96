#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "../src/display/view_fit.hpp"

namespace rosplat {

namespace {

using Point = std::array<double, 3>;
const double kSlope = std::tan(3.14159265358979323846 / 8);  // rviz's view is 45 degrees high

// The most of half a picture's width, and of half its height, that points of an orbit's view take.
std::array<double, 2> filled(const OrbitView& view, const std::vector<Point>& points,
                             double aspect) {
  const double cos = std::cos(view.yaw), sin = std::sin(view.yaw);
  const double flat = std::cos(view.pitch), high = std::sin(view.pitch);
  std::array<double, 2> most{};
  for (const Point& point : points) {
    const double x = point[0] - view.target[0], y = point[1] - view.target[1];
    const double z = point[2] - view.target[2];
    const double out = x * cos + y * sin;  // towards the camera, without its pitch
    const double depth = view.distance - (out * flat + z * high);
    most[0] = std::max(most[0], std::abs(y * cos - x * sin) / (depth * kSlope * aspect));
    most[1] = std::max(most[1], std::abs(z * flat - out * high) / (depth * kSlope));
  }
  return most;
}

}  // namespace

TEST(ViewFit, FitsTheBulkIntoAWindowOfAnyShape) {
  std::vector<Point> box;
  for (int i = 0; i < 1000; ++i) {
    box.push_back({3.0 + i % 10, 0.2 * (i / 10 % 10), 0.1 * (i / 100)});
  }
  const std::vector<Point> bulk = box;
  box.push_back({1e4, 0, 0});
  for (const double aspect : {0.3, 0.7, 1.0, 16.0 / 9, 4.0}) {
    const auto [across, upright] = filled(orbitAround(box, aspect), bulk, aspect);
    EXPECT_LT(across, 1.05) << aspect;
    EXPECT_LT(upright, 1.05) << aspect;
    EXPECT_GT(std::max(across, upright), 0.3) << aspect;
  }
}

TEST(ViewFit, MovesAnOfferedCameraAwayForANarrowWindow) {
  const Point eye{3, 4, 0}, target{};
  EXPECT_DOUBLE_EQ(orbitOf(eye, target, 1.5, 1.5).distance, 5);
  EXPECT_DOUBLE_EQ(orbitOf(eye, target, 1.5, 3).distance, 5);
  EXPECT_DOUBLE_EQ(orbitOf(eye, target, 1.5, 0.5).distance, 15);
  EXPECT_DOUBLE_EQ(orbitOf(eye, target, 0, 0.5).distance, 5);  // within a room
}

}  // namespace rosplat
