#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <limits>
#include <memory>
#include <random>
#include <thread>
#include <vector>

#include "rosplat_core/order/depth_order.hpp"
#include "sorted_slots.hpp"

namespace rosplat {
namespace {

using Slots = std::vector<std::uint32_t>;

constexpr double kIdentity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
constexpr double kHere[3] = {0, 0, 0};

SortView lookAhead(bool orthographic = false, double near_clip = 0.1, double far_clip = 100) {
  const double focal = orthographic ? 10 : 500;
  return makeSortView(kIdentity, kHere, focal, focal, 320, 240, 640, 480, near_clip, far_clip,
                      orthographic);
}

// Splats on the optical axis, at the given depths.
struct Row {
  explicit Row(const std::vector<float>& depths) : extents(depths.size(), 0.1f) {
    for (const float depth : depths) positions.insert(positions.end(), {0.0f, 0.0f, depth});
  }
  Slots sort(const SortView& view, unsigned threads = 1) const {
    DepthOrder sorter(threads);
    return sortedSlots(sorter, view, positions, extents);
  }
  std::vector<float> positions;
  std::vector<float> extents;
};

// A cloud large enough to be shared among threads, some of it empty, many depths alike.
Row cloud(std::size_t count, float step) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  Row row(std::vector<float>(count, 0.0f));
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      row.positions[3 * i + axis] = std::floor(uniform(random) * 20 / step) * step;
    }
    row.extents[i] = uniform(random) < -0.8f ? -1.0f : 0.05f;
  }
  return row;
}

TEST(DepthOrder, IsBackToFrontWithTheHigherSlotFirstInTies) {
  EXPECT_EQ(Row({3, 1, 2, 1}).sort(lookAhead()), (Slots{0, 2, 3, 1}));
}

TEST(DepthOrder, SeesNothingOfWhatIsBeyondFloat32) {
  Row row({1, 2, 3});
  row.extents = {1, 1e30f, std::numeric_limits<float>::max()};
  for (const bool orthographic : {false, true}) {
    const double focal = orthographic ? 10 : 500;
    for (const double far : {1e39, -1e300, std::numeric_limits<double>::infinity()}) {
      for (int axis = 0; axis < 3; ++axis) {
        double translation[3] = {};
        translation[axis] = far;
        EXPECT_EQ(row.sort(makeSortView(kIdentity, translation, focal, focal, 320, 240, 640, 480,
                                        0.1, std::numeric_limits<float>::max(), orthographic)),
                  Slots());
      }
    }
  }
}

TEST(DepthOrder, OrdersNegativeDepthsAndBothZerosOfOrthographicViews) {
  EXPECT_EQ(Row({-1, 2, -3, 0.0f, -0.0f}).sort(lookAhead(true, -10, 10)), (Slots{1, 4, 3, 0, 2}));
}

TEST(DepthOrder, LeavesOutWhatIsEmptyBeyondTheClipsOrNotANumber) {
  Row row({5, 5, 0.1f, 100, 200, -5, std::numeric_limits<float>::quiet_NaN(), 5});
  row.extents[0] = -1;
  EXPECT_EQ(row.sort(lookAhead()), (Slots{7, 1}));
}

TEST(DepthOrder, KeepsSplatsWhoseFootprintReachesIntoThePicture) {
  Row row({10, 10, 10});
  row.positions[0] = 7.9f;  // half the picture, with overscan, is 8 m wide there
  row.positions[3] = 8.1f;  // 5 px outside, 0.1 m are 6 px and more
  row.positions[6] = 10.0f;
  EXPECT_EQ(row.sort(lookAhead()), (Slots{1, 0}));
}

TEST(SortView, IsThatOfTheTwinInPython) {  // test_view.py asserts the same numbers
  const SortView view =
      makeSortView(kIdentity, kHere, 517.3, 516.5, 318.6, 255.3, 640, 480, 0.05, 50, false, 1.7);
  EXPECT_EQ(view.fx, 0x1.02a666p+9f);
  EXPECT_EQ(view.fy, 0x1.024p+9f);
  EXPECT_EQ(view.offset_x, -0x1.666666p+0f);
  EXPECT_EQ(view.offset_y, 0x1.e9999ap+3f);
  EXPECT_EQ(view.half_width, 402.5f);
  EXPECT_EQ(view.half_height, 302.5f);
  EXPECT_EQ(view.slope_x, 0x1.1a7f08p+10f);
  EXPECT_EQ(view.slope_y, 0x1.03e01cp+10f);
  EXPECT_EQ(view.near_clip, 0x1.99999ap-5f);
}

TEST(DepthOrder, OfNothingIsEmpty) { EXPECT_TRUE(Row({}).sort(lookAhead(), 2).empty()); }

void expectStableSort(const Row& row, const SortView& view) {
  const auto depth = [&](std::uint32_t slot) {
    return DepthOrder::depth(view, &row.positions[3 * slot]);
  };
  const Slots one = row.sort(view);
  ASSERT_GT(one.size(), 1000u);
  Slots expected = one;
  std::sort(expected.begin(), expected.end());
  std::stable_sort(expected.begin(), expected.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return depth(a) < depth(b); });
  std::reverse(expected.begin(), expected.end());
  EXPECT_EQ(one, expected);
  for (const unsigned threads : {2u, 3u, 8u}) EXPECT_EQ(row.sort(view, threads), expected);
}

TEST(DepthOrder, EqualsAStableSortWithAnyNumberOfThreads) {
  for (const float step : {1.0f, 1e-4f}) {
    const Row row = cloud(200000, step);
    for (const bool orthographic : {false, true}) {
      expectStableSort(row, lookAhead(orthographic, orthographic ? -15 : 0.1, 15));
    }
  }
}

TEST(DepthOrder, EqualsAStableSortHoweverDepthsAreSpread) {
  std::mt19937 random(2);
  std::normal_distribution<float> normal;
  std::vector<float> wall(400000), walls(400000), octaves(400000), same(400000, 5.0f);
  for (std::size_t i = 0; i < wall.size(); ++i) {
    wall[i] = i % 100 == 0 ? 1 + i * 2e-4f : 10 + 1e-4f * normal(random);
    walls[i] = (i % 2 == 0 ? 1 : 90) * (1 + 1e-6f * normal(random));
    octaves[i] = std::exp2(2 * normal(random));
  }
  for (const Row& row : {Row(wall), Row(walls), Row(octaves), Row(same)}) {
    expectStableSort(row, lookAhead());
  }
}

TEST(DepthOrder, OfPagesIsThatOfTheirSlotsEachSeenByItsView) {
  constexpr std::uint32_t kSlots = SortPage::kSlots, kPages = 150;
  Row row = cloud(kPages * kSlots, 0.5f);
  for (std::size_t i = 0; i < 5000; ++i) row.positions[3 * (20 * i) + 2] = 5;  // ties
  std::vector<SortView> views(3, lookAhead());
  views[1].translation[2] = 1;  // whole steps of the cloud: ties among groups
  views[2].rotation[0] = views[2].rotation[8] = -1;
  std::vector<SortPage> pages;
  Slots listed;
  Row seen(std::vector<float>{});  // these, where the views see them, for a camera at the origin
  for (std::uint32_t page = 0; page < kPages; ++page) {
    // With gaps between the slots; their rows lie in another order.
    pages.push_back(
        {(page < 70 ? page : 2 * page + 1000) * kSlots, page * 7 % kPages, page * 5 % 3});
    const SortView& view = views[pages.back().view];
    for (std::uint32_t i = 0; i < kSlots; ++i) {
      const float* at = &row.positions[3 * (std::size_t{pages.back().place} * kSlots + i)];
      listed.push_back(pages.back().first_slot + i);
      seen.extents.push_back(row.extents[std::size_t{pages.back().place} * kSlots + i]);
      for (int k = 0; k < 3; ++k) {
        seen.positions.push_back(view.rotation[4 * k] * at[k] + view.translation[k]);
      }
    }
  }
  Slots expected = seen.sort(lookAhead());
  for (std::uint32_t& slot : expected) slot = listed[slot];
  EXPECT_GT(expected.size(), 10000u);
  for (const unsigned threads : {1u, 2u, 3u}) {
    Slots order;
    DepthOrder(threads).sort(views.data(), row.positions.data(), row.extents.data(), pages.data(),
                             pages.size(), [&](std::size_t total) {
                               order.resize(total);
                               return order.data();
                             });
    EXPECT_EQ(order, expected);
  }
}

TEST(DepthOrder, CanBeUsedAgainForSmallerAndLargerMaps) {
  DepthOrder sorter(2);
  for (const std::size_t count : {70000u, 10u, 300000u, 0u}) {
    const Row row = cloud(count, 0.01f);
    EXPECT_EQ(sortedSlots(sorter, lookAhead(), row.positions, row.extents), row.sort(lookAhead()));
  }
}

TEST(ThreadTeam, DoesEachTaskOnce) {
  ThreadTeam team(4);
  std::vector<int> runs(9, 0);
  std::atomic<bool> strangers{false};
  for (int round = 0; round < 1000; ++round) {
    team.run(1 + round % 9, [&](unsigned number, unsigned member) {
      ++runs[number];
      if (member >= 4) strangers = true;
    });
  }
  EXPECT_EQ(runs, (std::vector<int>{1000, 888, 777, 666, 555, 444, 333, 222, 111}));
  EXPECT_FALSE(strangers);
}

TEST(ThreadTeam, MembersWorkSideBySide) {
  ThreadTeam team(2);
  std::atomic<unsigned> here{0};
  team.run(2, [&](unsigned, unsigned) {
    ++here;
    while (here < 2) std::this_thread::yield();
  });
  EXPECT_EQ(here, 2u);
}

#ifdef __linux__
long threadsOfThisProcess() {
  const auto tasks = std::filesystem::directory_iterator("/proc/self/task");
  return std::distance(begin(tasks), end(tasks));
}

TEST(ThreadTeam, BeginsWithItsFirstWork) {
  const long before = threadsOfThisProcess();
  const DepthOrder idle(8);
  ThreadTeam team(8);
  EXPECT_EQ(threadsOfThisProcess(), before);
  team.run(3, [](unsigned, unsigned) {});
  EXPECT_EQ(threadsOfThisProcess(), before + 2);
  team.run(2, [](unsigned, unsigned) {});
  EXPECT_EQ(threadsOfThisProcess(), before + 2);
}
#endif

TEST(ThreadTeam, IsOneForAllViewers) {
  const auto team = ThreadTeam::ofViewers();
  EXPECT_EQ(ThreadTeam::ofViewers(), team);
  EXPECT_LE(team->size(), 16u);
}

TEST(ThreadTeam, ServesItsCallersInTurn) {
  const auto team = std::make_shared<ThreadTeam>(3);
  const Row row = cloud(200000, 0.5f);
  const Slots expected = row.sort(lookAhead());
  const auto sortOften = [&] {
    DepthOrder sorter(team);
    for (int i = 0; i < 20; ++i) {
      EXPECT_EQ(sortedSlots(sorter, lookAhead(), row.positions, row.extents), expected);
    }
  };
  std::thread other(sortOften);
  sortOften();
  other.join();
}

}  // namespace
}  // namespace rosplat
