#include <OgreQuaternion.h>
#include <gtest/gtest.h>

#include "../src/display/splat_outline.hpp"

namespace rosplat {

namespace {

SplatValues needle() {
  SplatValues splat;
  splat.position = {1, -2, 3};
  splat.orientation = {0.2f, -0.4f, 0.6f, 1.0f};  // of no unit length
  splat.scale = {0.5f, 0.1f, 0.02f};
  return splat;
}

// In standard deviations along the principal axes.
Ogre::Vector3 deviations(const SplatValues& splat, const Ogre::Vector3& point) {
  Ogre::Quaternion rotation(1.0f, 0.2f, -0.4f, 0.6f);
  rotation.normalise();
  const Ogre::Vector3 local = rotation.Inverse() * (point - Ogre::Vector3(1, -2, 3));
  return local / Ogre::Vector3(splat.scale[0], splat.scale[1], splat.scale[2]);
}

}  // namespace

TEST(SplatOutline, liesOnTheEllipsoidAndReachesTheEndsOfItsAxes) {
  const SplatValues splat = needle();
  const auto ends = outline(splat, 2);
  ASSERT_EQ(ends.size() % 2, 0u);
  Ogre::Vector3 farthest = Ogre::Vector3::ZERO;
  for (const Ogre::Vector3& end : ends) {
    const Ogre::Vector3 d = deviations(splat, end);
    EXPECT_NEAR(d.length(), 2, 1e-3);
    for (int i = 0; i < 3; ++i) farthest[i] = std::max(farthest[i], d[i]);
  }
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(farthest[i], 2, 1e-3);
}

TEST(SplatOutline, isClosed) {
  const auto ends = outline(needle(), 1);
  std::size_t loops = 0;
  Ogre::Vector3 start = ends.front();
  for (std::size_t i = 1; i < ends.size(); i += 2) {
    const bool last = i + 1 == ends.size();
    if (ends[i].positionEquals(start, 1e-5f)) {
      ++loops;
      if (!last) start = ends[i + 1];
    } else {
      ASSERT_FALSE(last);
      EXPECT_TRUE(ends[i].positionEquals(ends[i + 1], 1e-6f)) << i;
    }
  }
  EXPECT_EQ(loops, 3u);
}

TEST(SplatOutline, theBoxTouchesTheEllipsoidInAnotherFrame) {
  SplatValues stick;
  stick.position = {1, 0, 0};
  stick.orientation = {0, 0, 0, 1};
  stick.scale = {0.5f, 0.01f, 0.02f};
  // The map turned by a right angle about z, then put 10 m up: its x is the frame's y.
  Ogre::Affine3 map;
  map.makeTransform(Ogre::Vector3(0, 0, 10), Ogre::Vector3::UNIT_SCALE,
                    Ogre::Quaternion(Ogre::Degree(90), Ogre::Vector3::UNIT_Z));
  const Ogre::AxisAlignedBox box = boxAround(stick, 3, map);
  EXPECT_TRUE(box.getMinimum().positionEquals(Ogre::Vector3(-0.03f, 1 - 1.5f, 9.94f), 1e-5f));
  EXPECT_TRUE(box.getMaximum().positionEquals(Ogre::Vector3(0.03f, 1 + 1.5f, 10.06f), 1e-5f));
}

}  // namespace rosplat
