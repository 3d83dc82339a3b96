#include <gtest/gtest.h>

#include <stdexcept>

#include "map/splat_camera.hpp"

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
