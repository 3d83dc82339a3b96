#include <gtest/gtest.h>

#include <vector>

#include "gpu/picture_regions.hpp"

using rosplat::PictureRegions;

namespace {

// How many regions each macro tile is in.
std::vector<int> covered(PictureRegions& regions, int columns, int rows) {
  std::vector<int> counts(std::size_t(columns) * std::size_t(rows));
  regions.begin(0, columns, rows);
  for (std::size_t number = 0; number < regions.count(); ++number) {
    regions.begin(number, columns, rows);
    const auto [left, top, right, bottom] = regions.region();
    for (int row = top; row < bottom; ++row) {
      for (int column = left; column < right; ++column)
        ++counts[std::size_t(row * columns + column)];
    }
  }
  return counts;
}

void drawWhole(PictureRegions& regions, bool fits) {
  std::size_t number = 0;
  do {
    regions.begin(number, 15, 17);
    if (number % 2 == 1 && fits) regions.noteFit();
  } while (++number < regions.count());
}

}  // namespace

TEST(PictureRegions, CoverEachMacroTileOnce) {
  for (const auto& [columns, rows] : {std::pair(1, 1), {1, 9}, {15, 17}, {30, 34}, {7, 1}}) {
    PictureRegions regions;
    std::size_t last = 0;
    do {
      EXPECT_EQ(covered(regions, columns, rows),
                std::vector<int>(std::size_t(columns) * std::size_t(rows), 1));
      EXPECT_GT(regions.count(), last);
      last = regions.count();
    } while (regions.split(2));
    EXPECT_GE(last, std::size_t(columns) * std::size_t(rows));  // each macro tile is alone
    regions.begin(0, 1, 1);
    EXPECT_EQ(regions.count(), 1u);  // of a picture that has no more
  }
}

TEST(PictureRegions, AreHalvesOfThoseOfHalfAsMany) {
  PictureRegions few, many;
  for (PictureRegions* each : {&few, &many}) each->begin(0, 15, 17);
  ASSERT_TRUE(many.split(2));
  do {
    for (std::size_t number = 0; number < few.count(); ++number) {
      few.begin(number, 15, 17);
      many.begin(2 * number, 15, 17);
      const auto first = many.region();
      many.begin(2 * number + 1, 15, 17);
      const auto second = many.region(), both = few.region();
      EXPECT_EQ(first[0], both[0]);
      EXPECT_EQ(first[1], both[1]);
      EXPECT_EQ(second[2], both[2]);
      EXPECT_EQ(second[3], both[3]);
    }
  } while (few.split(2) && many.split(2));
}

TEST(PictureRegions, AreAsFewAsFit) {
  PictureRegions regions;
  regions.begin(0, 15, 17);
  ASSERT_TRUE(regions.split(5));
  EXPECT_EQ(regions.count(), 8u);
  drawWhole(regions, true);
  drawWhole(regions, false);
  EXPECT_EQ(regions.count(), 4u);  // by the picture before
  drawWhole(regions, true);
  EXPECT_EQ(regions.count(), 4u);
  regions.begin(0, 15, 17);
  EXPECT_EQ(regions.count(), 2u);
  regions.begin(0, 15, 17);  // of a picture that is begun anew, nothing is known
  EXPECT_EQ(regions.count(), 2u);
}
