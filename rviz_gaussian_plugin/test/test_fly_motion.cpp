#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "../src/display/fly_motion.hpp"

using namespace rosplat;

namespace {

constexpr float kPi = 3.14159265f;

void expectNear(const Ogre::Vector3& a, const Ogre::Vector3& b, float tolerance) {
  EXPECT_NEAR(a.x, b.x, tolerance);
  EXPECT_NEAR(a.y, b.y, tolerance);
  EXPECT_NEAR(a.z, b.z, tolerance);
}

FlyKeys forwardKey() {
  FlyKeys keys;
  keys.forward = true;
  return keys;
}

// Where a pilot is each second, who flies ahead for two, up and left at speed for one, then rests.
std::vector<Ogre::Vector3> flight(int rate, float smoothing) {
  FlyMotion motion;
  Ogre::Vector3 position(0, 0, 0);
  std::vector<Ogre::Vector3> path;
  for (int i = 0; i < 5 * rate; ++i) {
    FlyKeys keys;
    const int second = i / rate;
    keys.forward = second < 2;
    keys.up = keys.left = keys.fast = second == 2;
    const Ogre::Vector3 target = flyVelocity(keys, {0.7f, 0.3f}, 2);
    position += motion.advance(target, 1.0f / static_cast<float>(rate), smoothing);
    if (i % rate == rate - 1) path.push_back(position);
  }
  return path;
}

}  // namespace

TEST(FlyMotion, SamePathAtAnyFrameRate) {
  for (float smoothing : {0.0f, 0.15f, 1.0f}) {
    const auto slow = flight(10, smoothing), fast = flight(100, smoothing);
    for (std::size_t i = 0; i < slow.size(); ++i) expectNear(slow[i], fast[i], 1e-3f);
  }
}

TEST(FlyMotion, CoastsAsFarAsItLaggedBehind) {
  // An exponential approach gives back at the end what it took at the start.
  expectNear(flight(50, 0.15f).back(), flight(50, 0).back(), 1e-3f);
}

TEST(FlyMotion, SpeedsUpByTheTimeConstant) {
  FlyMotion motion;
  const Ogre::Vector3 target(1, 0, 0);
  const float way = motion.advance(target, 0.5f, 0.5f).x;
  EXPECT_NEAR(way, 0.5f * std::exp(-1.0f), 1e-6f);
}

TEST(FlyMotion, ComesToRest) {
  FlyMotion motion;
  motion.advance({3, 0, 0}, 1, 0.1f);
  motion.advance({0, 0, 0}, 2, 0.1f);
  EXPECT_EQ(motion.advance({0, 0, 0}, 1, 0.1f), Ogre::Vector3(0, 0, 0));
}

TEST(FlyMotion, StopIsAtOnce) {
  FlyMotion motion;
  motion.advance({3, 0, 0}, 1, 0.1f);
  motion.stop();
  EXPECT_EQ(motion.advance({0, 0, 0}, 1, 0.1f), Ogre::Vector3(0, 0, 0));
}

TEST(FlyVelocity, AheadIsWhereTheCameraLooks) {
  expectNear(flyVelocity(forwardKey(), {0, 0}, 2), {2, 0, 0}, 1e-6f);
  expectNear(flyVelocity(forwardKey(), {kPi / 2, 0}, 2), {0, 2, 0}, 1e-6f);
  expectNear(flyVelocity(forwardKey(), {0, kPi / 2}, 2), {0, 0, -2}, 1e-6f);
}

TEST(FlyVelocity, LeftIsLevelAndUpIsTheWorlds) {
  FlyKeys left, up;
  left.left = up.up = true;
  expectNear(flyVelocity(left, {0, 1}, 1), {0, 1, 0}, 1e-6f);
  expectNear(flyVelocity(up, {2, 1}, 1), {0, 0, 1}, 1e-6f);
}

TEST(FlyVelocity, NoFasterOnTheDiagonalAndOppositesCancel) {
  FlyKeys keys = forwardKey();
  keys.right = true;
  EXPECT_NEAR(flyVelocity(keys, {1, 0}, 3).length(), 3, 1e-5f);
  keys.fast = true;
  EXPECT_NEAR(flyVelocity(keys, {1, 0}, 3).length(), 3 * kFastFactor, 1e-5f);
  keys = forwardKey();
  keys.back = true;
  EXPECT_EQ(flyVelocity(keys, {1, 0}, 3), Ogre::Vector3(0, 0, 0));
}

TEST(Heading, IsThatOfItsForward) {
  for (float yaw : {-3.0f, -1.0f, 0.0f, 0.5f, 3.0f}) {
    for (float pitch : {-1.5f, -0.4f, 0.0f, 1.2f}) {
      const Heading heading = headingOf(Heading{yaw, pitch}.forward(), {0, 0, 1});
      EXPECT_NEAR(heading.yaw, yaw, 1e-5f);
      EXPECT_NEAR(heading.pitch, pitch, 1e-5f);
    }
  }
}

TEST(Heading, SeenStraightUpOrDownTheUpVectorTellsTheYaw) {
  const Heading down = headingOf({0, 0, -1}, {0, 1, 0});
  EXPECT_NEAR(down.yaw, kPi / 2, 1e-5f);
  EXPECT_NEAR(down.pitch, kPi / 2, 1e-5f);
  const Heading up = headingOf({0, 0, 1}, {0, -1, 0});
  EXPECT_NEAR(up.yaw, kPi / 2, 1e-5f);
  EXPECT_NEAR(up.pitch, -kPi / 2, 1e-5f);
}
