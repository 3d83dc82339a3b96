#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "../src/imu_panel/imu_history.hpp"

using namespace rosplat;

namespace {

ImuSample at(double stamp) {
  ImuSample sample;
  sample.stamp = stamp;
  return sample;
}

}  // namespace

TEST(ImuHistory, KeepsTheWindow) {
  ImuHistory history(2);
  for (int i = 0; i <= 50; ++i) history.add(at(0.125 * i));
  EXPECT_EQ(history.samples().size(), 17u);
  EXPECT_EQ(history.samples().front().stamp, 4.25);
  EXPECT_EQ(history.samples().back().stamp, 6.25);
}

TEST(ImuHistory, ANarrowerWindowForgetsAtOnceAWiderFillsUp) {
  ImuHistory history(2);
  for (int i = 0; i <= 8; ++i) history.add(at(0.25 * i));
  history.setWindow(1);
  EXPECT_EQ(history.samples().size(), 5u);
  history.setWindow(4);
  EXPECT_EQ(history.samples().size(), 5u);
  history.add(at(2.25));
  EXPECT_EQ(history.samples().size(), 6u);
}

TEST(ImuHistory, TimeThatRunsBackIsANewStart) {
  ImuHistory history(10);
  history.add(at(100));
  history.add(at(101));
  history.add(at(3));
  ASSERT_EQ(history.samples().size(), 1u);
  EXPECT_EQ(history.samples().front().stamp, 3);
}

TEST(ImuHistory, ALateMessageIsLeftOut) {
  ImuHistory history(10);
  history.add(at(1.00));
  history.add(at(1.02));
  history.add(at(1.01));
  history.add(at(1.03));
  ASSERT_EQ(history.samples().size(), 3u);
  EXPECT_EQ(history.samples().back().stamp, 1.03);
}

TEST(ImuHistory, AJumpAheadLeavesTheNewOnly) {
  ImuHistory history(10);
  history.add(at(1));
  history.add(at(1000));
  ASSERT_EQ(history.samples().size(), 1u);
  EXPECT_EQ(history.samples().front().stamp, 1000);
}

TEST(ImuHistory, MemoryIsBoundedAtAnyRateAndWithoutTime) {
  ImuHistory fast(1000), timeless(1000);
  for (std::size_t i = 0; i < ImuHistory::kCapacity + 100; ++i) {
    fast.add(at(1e-4 * static_cast<double>(i)));
    timeless.add(at(0));
  }
  EXPECT_EQ(fast.samples().size(), ImuHistory::kCapacity);
  EXPECT_NEAR(fast.samples().front().stamp, 0.01, 1e-9);
  EXPECT_EQ(timeless.samples().size(), ImuHistory::kCapacity);
}

TEST(ImuHistory, KeepsGaps) {
  ImuHistory history(10);
  ImuSample gap = at(1);
  gap.axes[4] = std::numeric_limits<double>::quiet_NaN();
  history.add(gap);
  history.add(at(2));
  EXPECT_TRUE(std::isnan(history.samples().front().axes[4]));
  EXPECT_EQ(history.samples().back().axes[4], 0);
}
