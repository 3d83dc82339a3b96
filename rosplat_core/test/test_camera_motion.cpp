#include <gtest/gtest.h>

#include <cmath>

#include "rosplat_core/views/camera_motion.hpp"

namespace rosplat {
namespace {

// Looks at the origin from a place on a circle around it, tilted.
SplatCamera onOrbit(double angle) {
  const double half = 0.5 * angle;
  const Placement turn = makePlacement({}, {0, std::sin(half), 0, std::cos(half)});
  const Placement tilt = makePlacement({0, 0.3, 4}, {0.2, 0, 0, 1});
  SplatCamera camera;
  camera.rotation = {};
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      for (int j = 0; j < 3; ++j) {
        camera.rotation[3 * i + k] += tilt.rotation[3 * i + j] * turn.rotation[3 * j + k];
      }
    }
  }
  camera.translation = tilt.translation;
  return camera;
}

void expectAlike(const SplatCamera& a, const SplatCamera& b, double within) {
  for (int i = 0; i < 9; ++i) EXPECT_NEAR(a.rotation[i], b.rotation[i], within);
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(a.translation[i], b.translation[i], within);
}

TEST(CameraMotion, goes_on_along_an_orbit) {
  for (const double step : {1e-9, 1e-5, 0.02, 0.5, -1.5}) {
    const CameraMotion motion = motionBetween(onOrbit(1), onOrbit(1 + step), 0.1);
    expectAlike(moved(onOrbit(1), motion, 0.1), onOrbit(1 + step), 1e-12);
    expectAlike(moved(onOrbit(1 + step), motion, 0.25), onOrbit(1 + 3.5 * step), 1e-9);
  }
}

TEST(CameraMotion, goes_straight_on) {
  SplatCamera from, to;
  from.translation = {1, 2, 3};
  to.translation = {1.5, 2, 2};
  const CameraMotion motion = motionBetween(from, to, 2);
  EXPECT_EQ(motion.shift, (std::array<double, 3>{0.25, 0, -0.5}));
  EXPECT_EQ(moved(to, motion, 2).translation, (std::array<double, 3>{2, 2, 1}));
}

TEST(CameraMotion, knows_no_way_around_half_a_turn) {
  EXPECT_TRUE(motionBetween(onOrbit(0), onOrbit(M_PI), 1).none());
}

TEST(MotionTracker, finds_steady_motion_and_rest) {
  MotionTracker tracker;
  EXPECT_TRUE(tracker.follow(onOrbit(0), 10).none());
  CameraMotion motion;
  for (int frame = 1; frame <= 20; ++frame) {
    const double time = frame / 30.0;
    motion = tracker.follow(onOrbit(0.5 * time), 10 + time);
  }
  expectAlike(moved(onOrbit(0), motion, 1), onOrbit(0.5), 1e-9);
  const SplatCamera end = onOrbit(0.5 * 20 / 30.0);
  EXPECT_FALSE(tracker.follow(end, 10.70).none());
  EXPECT_TRUE(tracker.follow(end, 10.73).none());
}

}  // namespace
}  // namespace rosplat
