#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <string>

#include "rosplat_core/views/splat_camera.hpp"

namespace rosplat {

namespace {

SplatCamera view() {
  return makeCamera({1, 2, 3}, {0.1, 0.2, 0.3, 1}, false, 500, 400, 310, 250, 640, 480, 0.1, 100);
}

}  // namespace

TEST(SplatCamera, aPartHasTheSamePixels) {
  const SplatCamera part = crop(view(), 100, 50, 20, 10);
  // What the whole shows at (105, 52), the part shows at (5, 2): rays count from the principal
  // point.
  EXPECT_EQ(5 - part.cx, 105 - view().cx);
  EXPECT_EQ(2 - part.cy, 52 - view().cy);
  EXPECT_EQ(part.whole().width, 640);
  EXPECT_EQ(part.whole().cx, 310);
  const SplatCamera again = crop(part, 3, 3, 2, 2);  // a part of the same whole
  EXPECT_EQ(again.whole().width, 640);
  EXPECT_EQ(again.whole().cy, 250);
}

TEST(SplatCamera, aPartIsFoundAtAnyResolution) {
  SplatCamera part = crop(view(), 100, 50, 20, 10);
  part.part_of = {};
  part.fx /= 2, part.fy /= 4, part.cx /= 2, part.cy /= 4;  // as rviz shrinks large rectangles
  ASSERT_TRUE(makePart(part, view()));
  // The tangents at the whole picture's edges are the same.
  const SplatCamera::Whole whole = part.whole();
  EXPECT_DOUBLE_EQ((whole.width - whole.cx) / part.fx, (640.0 - 310) / 500);
  EXPECT_DOUBLE_EQ(-whole.cy / part.fy, -250.0 / 400);
}

TEST(SplatCamera, picturesThatNobodyCanHoldAreRefused) {
  const auto picture = [](double width, double height) {
    return makeCamera({}, {0, 0, 0, 1}, false, 500, 400, 0, 0, width, height, 0.1, 100);
  };
  EXPECT_NO_THROW(picture(16384, 2048));
  EXPECT_NO_THROW(picture(1, 16384));
  EXPECT_THROW(picture(16384, 2049), std::invalid_argument);
  EXPECT_THROW(picture(16385, 1), std::invalid_argument);
}

// Ogre ends the process over a matrix that overflows.
TEST(SplatCamera, whatIsNoMatrixOf32BitFloatsIsRefused) {
  struct Numbers {
    bool orthographic = false;
    double x = 0, fx = 500, fy = 400, cx = 310, cy = 250, near_clip = 0.1, far_clip = 100;
  };
  // The field that is refused once these numbers are changed.
  const auto fault = [](Numbers n, const auto& change) -> std::string {
    change(n);
    try {
      makeCamera({n.x, 0, 0}, {0, 0, 0, 1}, n.orthographic, n.fx, n.fy, n.cx, n.cy, 640, 480,
                 n.near_clip, n.far_clip);
    } catch (const std::invalid_argument& error) {
      const std::string what = error.what();
      return what.substr(0, what.find(' '));
    }
    return "";
  };
  for (const bool orthographic : {false, true}) {
    Numbers good;
    good.orthographic = orthographic;
    for (const double bad : {1e308, 1e100, 1e38, 1e13, 1e-38, 1e-45, 1e-100}) {
      EXPECT_EQ(fault(good, [&](Numbers& n) { n.fx = bad; }), "fx") << bad;
      EXPECT_EQ(fault(good, [&](Numbers& n) { n.fy = bad; }), "fy") << bad;
      if (bad < 1) continue;
      EXPECT_EQ(fault(good, [&](Numbers& n) { n.cx = -bad; }), "cx") << bad;
      EXPECT_EQ(fault(good, [&](Numbers& n) { n.cy = bad; }), "cy") << bad;
      const auto far_away = [&](Numbers& n) {
        n.near_clip = orthographic ? -bad : bad;
        n.far_clip = std::numeric_limits<double>::infinity();
      };
      EXPECT_EQ(fault(good, far_away), "near_clip") << bad;
    }
    const auto range = [&](double near_clip, double far_clip) {
      return fault(good, [&](Numbers& n) { n.near_clip = near_clip, n.far_clip = far_clip; });
    };
    EXPECT_EQ(range(1, 1 + 1e-15), "near_clip");
    EXPECT_EQ(range(orthographic ? 0 : 1e-100, 1e-30), "near_clip");
    EXPECT_EQ(range(1, 1.001), "");
    EXPECT_EQ(range(1e-6, std::numeric_limits<double>::infinity()), "");
    EXPECT_EQ(fault(good, [](Numbers& n) { n.x = 1e30; }), "pose.position");
  }
}

TEST(SplatCamera, noPartOfAPictureFromElsewhere) {
  for (const SplatCamera& other :
       {makeCamera({1, 2, 3.1}, {0.1, 0.2, 0.3, 1}, false, 500, 400, 310, 250, 640, 480, 0.1, 100),
        makeCamera({1, 2, 3}, {0.1, 0.21, 0.3, 1}, false, 500, 400, 310, 250, 640, 480, 0.1, 100),
        makeCamera({1, 2, 3}, {0.1, 0.2, 0.3, 1}, true, 500, 400, 310, 250, 640, 480, 0.1, 100)}) {
    SplatCamera part = crop(view(), 100, 50, 20, 10);
    part.part_of = {};
    EXPECT_FALSE(makePart(part, other));
    EXPECT_EQ(part.whole().width, 20);
  }
}

}  // namespace rosplat
