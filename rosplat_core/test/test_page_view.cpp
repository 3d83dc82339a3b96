#include <gtest/gtest.h>

#include <algorithm>
#include <bitset>
#include <random>
#include <vector>

#include "rosplat_core/levels/lattice.hpp"
#include "rosplat_core/views/page_shelf.hpp"
#include "rosplat_core/views/seen_group.hpp"
#include "sorted_slots.hpp"

namespace rosplat {
namespace {

constexpr std::size_t kSplats = 64;  // of a page

// One slot more, at a position.
void add(GaussianEdit& edit, const std::array<float, 3>& position, float extent) {
  edit.slots.resize(edit.slots.size() + kSlotWords);
  std::memcpy(&edit.slots[edit.slots.size() - kSlotWords], position.data(), sizeof(position));
  edit.extents.push_back(extent);
}

// A page of splats around a place, with the arrays that sorters take.
struct Page {
  Page(std::mt19937& random, const std::array<float, 3>& centre, float size, float extent) {
    std::uniform_real_distribution<float> within(-1, 1);
    GaussianEdit edit;
    edit.sh_degree = 0;
    edit.runs = {{0, kSplats}};
    for (std::size_t i = 0; i < kSplats; ++i) {
      std::array<float, 3> position = centre;
      for (float& x : position) x += size * within(random);
      positions.insert(positions.end(), position.begin(), position.end());
      add(edit, position, extent * std::abs(within(random)));
    }
    pages.apply(edit);
    extents = edit.extents;
  }
  const SlotPage& bounds() const { return pages.pages().front(); }

  SlotPages pages;
  std::vector<float> positions, extents;
};

SplatCamera camera(bool orthographic) {
  return makeCamera({1, -2, 0.5}, {0.1, 0.3, -0.2, 0.9}, orthographic, orthographic ? 20 : 500,
                    orthographic ? 25 : 520, 300, 250, 640, 480, 0.1, 60);
}

// The sorters' test in double precision.
bool isInPicture(const SortView& view, const float* position, double extent) {
  std::array<double, 3> p;
  for (int i = 0; i < 3; ++i) {
    p[i] = view.translation[i];
    for (int k = 0; k < 3; ++k) p[i] += double(view.rotation[3 * i + k]) * position[k];
  }
  const double w = view.orthographic ? 1 : p[2];
  return p[2] > view.near_clip && p[2] < view.far_clip &&
         std::fabs(view.fx * p[0] + view.offset_x * w) <=
             view.half_width * w + view.slope_x * extent &&
         std::fabs(view.fy * p[1] + view.offset_y * w) <=
             view.half_height * w + view.slope_y * extent;
}

TEST(PageView, LosesNoPageOfWhichASplatIsSeenAndMostOfTheOthers) {
  for (const bool orthographic : {false, true}) {
    const SeenGroup group(camera(orthographic), {}, {});
    DepthOrder sorter(1);
    std::mt19937 random(5);
    std::uniform_real_distribution<float> where(-40, 40), log_size(-6, 0);
    int seen = 0, kept = 0;
    for (int i = 0; i < 20000; ++i) {
      const Page page(random, {where(random), where(random), where(random)},
                      std::exp(log_size(random)), std::exp(log_size(random)));
      const bool shown = !sortedSlots(sorter, group.view, page.positions, page.extents).empty();
      const bool may_show = group.pages.mayShow(page.bounds());
      EXPECT_TRUE(may_show || !shown) << i;
      seen += shown;
      kept += may_show;
    }
    EXPECT_GT(seen, 1000);
    EXPECT_LT(kept, 1.2 * seen);
  }
}

TEST(PageView, LosesNoPageWhoseBoundsAreBeyondFloat32) {
  DepthOrder sorter(1);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(-1, 1);
  const auto anywhere = [&](double octaves) {
    return std::copysign(std::exp2(octaves * (1 + unit(random)) / 2), unit(random));
  };
  int seen = 0;
  for (int i = 0; i < 20000; ++i) {
    const bool orthographic = i % 2;
    SplatCamera from = camera(orthographic);
    from.fx = from.fy = std::fabs(anywhere(24));
    from.far_clip = std::fabs(anywhere(127)) + 100;
    Group group;
    group.origin = {anywhere(127), anywhere(127), anywhere(127)};
    // Around the camera or the origin, and one splat of them anywhere.
    std::array<float, 3> centre{};
    const std::array<double, 3> eye = eyeOf(from, group.originOrZero());
    for (std::size_t k = 0; i % 5 && k < 3; ++k) centre[k] = float(eye[k]);
    Page page(random, centre, 10, 1);
    GaussianEdit edit;
    edit.sh_degree = 0;
    edit.runs = {{kSplats, 1}};
    std::array<float, 3> position;
    for (float& x : position) x = float(anywhere(127));
    add(edit, position, std::fabs(float(anywhere(127))));
    page.pages.apply(edit);
    page.positions.insert(page.positions.end(), position.begin(), position.end());
    page.extents.push_back(edit.extents[0]);

    const SeenGroup of(from, group, {});
    const auto shown = sortedSlots(sorter, of.view, page.positions, page.extents);
    // The sorters show more than there is where both sides of their test are infinite.
    const bool in_picture = std::any_of(shown.begin(), shown.end(), [&](std::uint32_t slot) {
      return isInPicture(of.view, &page.positions[3 * slot], page.extents[slot]);
    });
    EXPECT_TRUE(!in_picture || of.pages.mayShow(page.bounds())) << i;
    seen += in_picture;
  }
  EXPECT_GT(seen, 500);
}

TEST(PageView, LeavesOutWhatIsOutsideOfTheBox) {
  std::mt19937 random(5);
  const SplatCamera all = camera(true);
  // In the middle of the picture, ten metres away.
  std::array<float, 3> centre{};
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 3; ++i) {
      centre[k] += float(all.rotation[3 * i + k] * ((i == 2 ? 10 : 0) - all.translation[i]));
    }
  }
  // In a group that is 100 metres away, turned by 45 degrees about z; the camera is there, too.
  const double half_turn = M_PI / 8;
  Group group;
  group.pose = {{100, 0, 0}, {0, 0, std::sin(half_turn), std::cos(half_turn)}};
  group.place = makePlacement(group.pose.position, group.pose.orientation);
  const std::array<double, 3> there{-group.place.rotation[0] * 100, -group.place.rotation[1] * 100,
                                    -group.place.rotation[2] * 100};
  const Placement back{
      {group.place.rotation[0], group.place.rotation[3], group.place.rotation[6],
       group.place.rotation[1], group.place.rotation[4], group.place.rotation[7], 0, 0, 1},
      there};
  const SplatCamera from = inFrameOf(back, all);
  const Page page(random, centre, 0.5f, 0.1f);
  const auto mayShow = [&](const ClipBox& box) {
    return SeenGroup(from, group, box).pages.mayShow(page.bounds());
  };
  const std::array<double, 3> middle = group.place({centre[0], centre[1], centre[2]});
  ClipBox box;
  for (int i = 0; i < 3; ++i) box.centre[i] = float(middle[i]);
  EXPECT_TRUE(mayShow(box));
  box.enabled = true;
  EXPECT_TRUE(mayShow(box));
  box.centre[1] += 1.1f;  // 0.5 of the box, 0.7 of what is turned
  EXPECT_TRUE(mayShow(box));
  box.centre[1] += 0.2f;
  EXPECT_FALSE(mayShow(box));
  box.enabled = false;
  EXPECT_TRUE(mayShow(box));
}

TEST(PageView, ShowsNoPageThatNothingCanBeSeenOf) {
  SlotPage page;
  page.least.fill(-1000);
  page.most.fill(1000);
  const PageView view = SeenGroup(camera(false), {}, {}).pages;
  EXPECT_FALSE(view.mayShow(page));
  page.extent = 0;
  EXPECT_TRUE(view.mayShow(page));
}

TEST(PageShelf, LosesNoPageThatMayBeShown) {
  const SeenGroup group(camera(false), {}, {});
  std::mt19937 random(7);
  std::uniform_real_distribution<float> step(-2, 2), size(0, 1);
  std::vector<SlotPage> pages;
  std::array<float, 3> at{};
  for (int i = 0; i < 5000; ++i) {
    for (float& x : at) x = std::clamp(x + step(random), -60.0f, 60.0f);
    pages.push_back(Page(random, at, size(random), size(random)).bounds());
    pages.back().group = std::uint32_t(i / 700);
  }
  std::size_t next = 0, skipped = 0, shelves = 0, across = 0;
  for (const PageShelf& shelf : shelve(pages, [](const SlotPage&) { return kBoundless; })) {
    ASSERT_EQ(shelf.begin, next);
    next = shelf.end;
    const bool shown = group.pages.mayShow(shelf.bounds);
    const std::uint32_t sides = group.pages.sidesAcross(shelf.bounds);
    const auto tested = group.pages.mayShow(shelf.pages, sides);
    if (shown) {
      ++shelves;
      across += std::bitset<6>(sides).count();
    }
    for (std::size_t i = shelf.begin; i < shelf.end; ++i) {
      EXPECT_EQ(pages[i].group, shelf.bounds.group);
      EXPECT_TRUE(shown || !group.pages.mayShow(pages[i])) << i;
      EXPECT_EQ(tested[i - shelf.begin] == 1, group.pages.mayShow(pages[i])) << i;
    }
    if (!shown) skipped += shelf.end - shelf.begin;
  }
  EXPECT_EQ(next, pages.size());
  EXPECT_GT(skipped, pages.size() / 4);
  EXPECT_GT(across, shelves);
  EXPECT_LT(across, 4 * shelves);  // of six
}

}  // namespace
}  // namespace rosplat
