#include <gtest/gtest.h>

#include "rosplat_core/map/printable.hpp"

namespace rosplat {

TEST(Printable, LeavesALineAsItIs) {
  EXPECT_EQ(printable("a map's frame: 'büro'"), "a map's frame: 'büro'");
}

TEST(Printable, EscapesWhatEndsLinesOrSteersTerminals) {
  EXPECT_EQ(printable("a\nb\r\x1b[2Jc\x7f" + std::string(1, '\0')),
            "a\\x0ab\\x0d\\x1b[2Jc\\x7f\\x00");
}

TEST(Printable, SaysHowMuchIsLeftOut) {
  EXPECT_EQ(printable(std::string(10, 'x'), 10), "xxxxxxxxxx");
  EXPECT_EQ(printable(std::string(5'000'000, 'x'), 10), "xxxxxxxxxx... (5000000 bytes)");
  EXPECT_LT(printable(std::string(5'000'000, '\n'), 10).size(), 40u);
  EXPECT_LT(printable(std::string(5'000'000, '\x80'), 10).size(), 40u);  // no UTF-8
}

TEST(Printable, CutsBetweenCharacters) { EXPECT_EQ(printable("aüü", 2), "aü... (5 bytes)"); }

}  // namespace rosplat
