#include <gtest/gtest.h>

#include <random>
#include <vector>

#include "map/page_view.hpp"
#include "order/built_in_sorter.hpp"

namespace rosplat {
namespace {

constexpr std::size_t kSplats = 64;  // of a page

// A page of splats around a place, with the arrays that sorters take.
struct Page {
  Page(std::mt19937& random, const std::array<float, 3>& centre, float size, float extent) {
    std::uniform_real_distribution<float> within(-1, 1);
    GaussianEdit edit;
    edit.sh_degree = 0;
    edit.runs = {{0, kSplats}};
    for (std::size_t i = 0; i < kSplats; ++i) {
      for (const float c : centre) edit.positions.push_back(c + size * within(random));
      edit.extents.push_back(extent * std::abs(within(random)));
    }
    pages.apply(edit);
    positions = edit.positions;
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

TEST(PageView, LosesNoPageOfWhichASplatIsSeenAndMostOfTheOthers) {
  for (const bool orthographic : {false, true}) {
    const rosplat_sorter::View view = sorterView(camera(orthographic), {0, 0, 0}, 1.0);
    const PageView pages(view, {}, {0, 0, 0});
    rosplat_sorter::DepthOrder sorter(1);
    std::mt19937 random(5);
    std::uniform_real_distribution<float> where(-40, 40), log_size(-6, 0);
    int seen = 0, kept = 0;
    for (int i = 0; i < 20000; ++i) {
      const Page page(random, {where(random), where(random), where(random)},
                      std::exp(log_size(random)), std::exp(log_size(random)));
      const bool shown =
          !sorter.sort(view, page.positions.data(), page.extents.data(), kSplats).empty();
      const bool may_show = pages.mayShow(page.bounds());
      EXPECT_TRUE(may_show || !shown) << i;
      seen += shown;
      kept += may_show;
    }
    EXPECT_GT(seen, 1000);
    EXPECT_LT(kept, 1.2 * seen);
  }
}

TEST(PageView, LeavesOutWhatIsOutsideOfTheBox) {
  std::mt19937 random(5);
  const rosplat_sorter::View view = sorterView(camera(true), {0, 0, 0}, 1.0);
  const SplatCamera all = camera(true);
  // In the middle of the picture, ten metres away.
  std::array<float, 3> centre{};
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < 3; ++i) {
      centre[k] += float(all.rotation[3 * i + k] * ((i == 2 ? 10 : 0) - all.translation[i]));
    }
  }
  const Page page(random, centre, 0.5f, 0.1f);
  ClipBox box;
  box.centre = centre;
  const std::array<double, 3> origin{100, 0, 0};
  box.centre[0] += 100;
  EXPECT_TRUE(PageView(view, box, origin).mayShow(page.bounds()));
  box.enabled = true;
  EXPECT_TRUE(PageView(view, box, origin).mayShow(page.bounds()));
  box.centre[1] += 1.1f;  // 0.5 each
  EXPECT_FALSE(PageView(view, box, origin).mayShow(page.bounds()));
}

TEST(PageView, ShowsNoPageThatNothingCanBeSeenOf) {
  SlotPage page;
  page.least.fill(-1000);
  page.most.fill(1000);
  const PageView view(sorterView(camera(false), {0, 0, 0}, 1.0), {}, {0, 0, 0});
  EXPECT_FALSE(view.mayShow(page));
  page.extent = 0;
  EXPECT_TRUE(view.mayShow(page));
}

}  // namespace
}  // namespace rosplat
