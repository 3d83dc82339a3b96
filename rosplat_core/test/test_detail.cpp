#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <stdexcept>
#include <string>

#include "owned_batch.hpp"
#include "rosplat_core/levels/detail.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"

namespace rosplat {
namespace {

using Kind = Detail::Kind;

// A plain of splats before a camera that looks along it, in groups that lie beside one another.
struct Plain {
  explicit Plain(std::uint32_t count, std::uint32_t groups = 1)
      : levels(std::make_shared<ThreadTeam>(2)) {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> unit(-1, 1);
    const std::uint32_t each = count / groups;
    const std::uint32_t room = (each + SlotPage::kSlots - 1) / SlotPage::kSlots * SlotPage::kSlots;
    for (std::uint32_t group = 0; group < groups; ++group) {
      OwnedBatch batch(group + 1, group == 0 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT,
                       group * room);
      batch.group = group;
      const float wide = 30.0f / float(groups), middle = wide * float(2 * group + 1) - 30;
      for (std::uint32_t i = 0; i < each; ++i) {
        batch.add({middle + wide * unit(random), 2, 31 + 30 * unit(random)}, {0.03f, 0.001f, 0.03f},
                  0.9f);
      }
      BatchReport report;
      slots.apply(*map.apply(batch.look(), report), 0);
    }
    levels.advance(slots, [] { return false; });
    PictureLayer& layer = request.layers.emplace_back();
    layer.slots = &slots;
    layer.map = &map.state();
    layer.camera.fx = layer.camera.fy = 300;
    layer.camera.cx = 160;
    layer.camera.cy = 120;
    layer.camera.width = 320;
    layer.camera.height = 240;
    layer.levels = &levels;
  }

  SplatPicture draw(double error) {
    request.layers[0].error = error;
    CpuRasterizer rasterizer(std::make_shared<ThreadTeam>(2));
    SplatPicture picture;
    EXPECT_TRUE(rasterizer.draw(request, picture));
    return picture;
  }
  double choose(DetailControl& control, const Detail& detail, bool at_once = false) const {
    RenderSettings settings;
    settings.detail = detail;
    settings.interactive = !at_once;
    control.expect({levels.samples(), request.layers[0].camera, slots.index().groups(), settings});
    return control.choose(settings);
  }
  // At once; how many pictures it took, too.
  SplatPicture draw(DetailControl& control, std::size_t most, int* pictures = nullptr) {
    request.layers[0].settings.detail = {Kind::kSplats, double(most)};
    SplatPicture picture = draw(choose(control, request.layers[0].settings.detail, true));
    for (int i = 1;; ++i) {
      if (pictures) *pictures = i;
      const auto error = control.adjust(picture.layers[0].error, picture.layers[0].drawn);
      if (!error) return picture;
      picture = draw(*error);
    }
  }
  CutEstimate estimate(bool blends = true) const {
    RenderSettings settings;
    settings.detail = {Kind::kSplats, 1};
    settings.interactive = blends;
    return {levels.samples(), request.layers[0].camera, slots.index().groups(), settings};
  }

  GaussianMap map;
  HostSlots slots;
  Levels levels;
  PictureRequest request;
};

TEST(Detail, IsReadAndWritten) {
  EXPECT_EQ(parseDetail("Full"), Detail{});
  EXPECT_EQ(parseDetail("1.5 px"), (Detail{Kind::kError, 1.5}));
  EXPECT_EQ(parseDetail("800,000"), (Detail{Kind::kSplats, 800000}));
  EXPECT_EQ(parseDetail("800k"), (Detail{Kind::kSplats, 800000}));
  EXPECT_EQ(parseDetail("2M"), (Detail{Kind::kSplats, 2000000}));
  for (const char* text : {"full", "1.5px", "800000"}) {
    EXPECT_EQ(toText(parseDetail(text)), text);
  }
}

TEST(Detail, OfNothingOrOfNonsenseIsRefused) {
  for (const char* text :
       {"", "0", "0px", "-1px", "0.5", "px", "nan", "inf", "1e9", "40ms", "99999999999999999999px",
        "1..2px", "full!", "1,5px", "0,800", "80,00"}) {
    try {
      parseDetail(text);
      ADD_FAILURE() << text;
    } catch (const std::invalid_argument& error) {
      EXPECT_NE(std::string(error.what()).find(text), std::string::npos) << error.what();
    }
  }
}

TEST(CutEstimate, ComesCloseToWhatIsDrawn) {
  for (const std::uint32_t groups : {1u, 12u}) {
    Plain plain(60000, groups);
    const CutEstimate estimate = plain.estimate();
    for (const double error : {0.0, 2.0, 5.0, 10.0, 30.0}) {
      const auto drawn = double(plain.draw(error).layers[0].drawn);
      EXPECT_NEAR(estimate.drawn(error), drawn, 0.15 * drawn) << error << ", " << groups;
    }
  }
  const Plain plain(60000);
  const CutEstimate estimate = plain.estimate();
  EXPECT_NEAR(estimate.errorFor(estimate.drawn(10)), 10, 0.1);
  EXPECT_EQ(estimate.errorFor(1e6), 0);
  EXPECT_EQ(estimate.errorFor(0.5), kCoarsestError);
}

TEST(CutEstimate, ReadsNoMoreOfManyGroups) {
  const auto samples = [](const Plain& plain, std::size_t level) {
    std::size_t count = 0;
    for (const LevelSamples& of_group : plain.levels.samples()) count += of_group[level].size();
    return count;
  };
  const Plain one(60000), many(60000, 12);
  for (std::size_t level = 0; level < std::size_t(kLevels); ++level) {
    EXPECT_LE(samples(many, level), samples(one, level) + 2 * 12) << level;
  }
}

TEST(Budget, IsUsedAsSoonAsItSuffices) {
  const Plain plain(60000);
  DetailControl control;
  const double coarsest = plain.choose(control, {Kind::kSplats, 1});
  EXPECT_EQ(coarsest, kCoarsestError);
  control.adjust(coarsest, 8);
  EXPECT_LT(plain.choose(control, {Kind::kSplats, 5000}), 100);
}

TEST(Budget, IsKeptAndUsed) {
  Plain plain(60000);
  const std::size_t all = plain.draw(0).layers[0].drawn;
  for (const std::size_t most : {std::size_t{1000}, std::size_t{5000}, all / 2}) {
    DetailControl control;
    const std::size_t drawn = plain.draw(control, most).layers[0].drawn;
    EXPECT_LE(drawn, most);
    EXPECT_GE(drawn, 9 * most / 10);
    // The next one knows.
    int pictures = 0;
    plain.draw(control, most, &pictures);
    EXPECT_EQ(pictures, 1) << most;
  }
}

TEST(Budget, OfWhatThereIsDrawsAll) {
  Plain plain(60000);
  const std::size_t all = plain.draw(0).layers[0].drawn;
  for (const std::size_t most : {std::size_t{1000000}, all + all / 10}) {
    DetailControl control;
    EXPECT_EQ(plain.draw(control, most).layers[0].error, 0);
  }
}

// Half of what the cut leaves is hidden.
TEST(Budget, CountsWhatIsDrawn) {
  constexpr std::size_t kMost = 10000;
  const Plain plain(60000);
  const CutEstimate estimate = plain.estimate(false);
  const auto drawn = [&](double error) { return std::size_t(0.5 * estimate.drawn(error)); };
  DetailControl control;
  const double error = plain.choose(control, {Kind::kSplats, kMost}, true);
  EXPECT_LT(drawn(error), kMost / 2);
  const auto next = control.adjust(error, drawn(error));
  ASSERT_TRUE(next);
  EXPECT_NEAR(double(drawn(*next)), 0.95 * kMost, 0.01 * kMost);
  EXPECT_FALSE(control.adjust(*next, drawn(*next)));
  EXPECT_NEAR(plain.choose(control, {Kind::kSplats, kMost}, true), *next, 0.01 * *next);
}

// Where one error draws too many and the next too few, the coarser one is taken.
TEST(Budget, IsKeptWhereNoErrorUsesIt) {
  const Plain plain(60000);
  DetailControl control;
  double error = plain.choose(control, {Kind::kSplats, 10000}, true);
  const double step = 1.1 * error;
  const auto drawn = [&](double tried) { return std::size_t{tried < step ? 15000u : 4000u}; };
  int pictures = 1;
  for (; const auto next = control.adjust(error, drawn(error)); ++pictures) {
    error = *next;
    ASSERT_LT(pictures, 20);
  }
  EXPECT_EQ(drawn(error), 4000u);
  EXPECT_LE(pictures, 8);
}

TEST(Budget, OfOneSplatEndsAndSaysWhatTheLeastIs) {
  Plain plain(3000);
  DetailControl control;
  const SplatPicture picture = plain.draw(control, 1);
  const std::size_t drawn = picture.layers[0].drawn;
  EXPECT_GT(drawn, 1u);
  EXPECT_LE(drawn, 8u);  // the coarsest nodes are the least that can be drawn
  EXPECT_EQ(control.problem(), "no fewer than " + std::to_string(drawn) + " splats can be drawn");
  // A view that moves goes there at once.
  DetailControl moving;
  moving.adjust(0, 3000);
  const double error = plain.choose(moving, {Kind::kSplats, 1});
  EXPECT_FALSE(moving.adjust(error, plain.draw(error).layers[0].drawn));
  EXPECT_EQ(moving.problem(), control.problem());
  plain.draw(control, 1000);
  EXPECT_EQ(control.problem(), "");
}

// Where levels blend, both a node and what it stands for are drawn.
TEST(DetailControl, DrawsNoMoreThanThereIs) {
  Plain plain(60000);
  const double all = double(plain.draw(0).layers[0].drawn);
  const auto drawn = [&](double error) { return double(plain.draw(error).layers[0].drawn); };
  double most = 0;
  DetailControl moving, coarsening;
  moving.adjust(30, std::size_t(drawn(30)));
  coarsening.adjust(0, std::size_t(all));
  for (double error = 0.3; error < 30; error *= 1.3) {
    most = std::max(most, drawn(error));
    DetailControl control;
    EXPECT_LE(drawn(plain.choose(control, {Kind::kError, error})), all) << error;
  }
  EXPECT_GT(most, 1.1 * all);
  EXPECT_EQ(plain.choose(moving, {Kind::kError, 20}), 20);
  const auto follow = [&](DetailControl& control, const Detail& detail) {
    for (int i = 0; i < 200; ++i) {
      const double error = plain.choose(control, detail), now = drawn(error);
      EXPECT_LE(now, all) << error;
      control.adjust(error, std::size_t(now));
      if (control.settled()) break;
    }
    EXPECT_TRUE(control.settled());
  };
  follow(moving, {Kind::kSplats, 1e6});
  follow(coarsening, {Kind::kSplats, 1000});
}

TEST(DetailControl, DrawsAnErrorThatIsAskedForAtOnce) {
  const Plain plain(60000);
  DetailControl control;
  EXPECT_EQ(plain.choose(control, {}), 0);
  EXPECT_EQ(plain.choose(control, {Kind::kError, 12.5}), 12.5);
  control.adjust(12.5, 3000);
  EXPECT_EQ(plain.choose(control, {Kind::kError, 40}), 40);
  EXPECT_TRUE(control.settled());
}

TEST(DetailControl, MovesABudgetSlowlyUnlessAtOnce) {
  const Plain plain(60000);
  DetailControl control;
  const double coarse = plain.choose(control, {Kind::kSplats, 1000});
  EXPECT_NEAR(plain.estimate().drawn(coarse), 950, 1);  // at once, for nobody saw another
  const auto draw = [&](double error) {
    control.adjust(error, std::size_t(plain.estimate().drawn(error)));
  };
  draw(coarse);
  const double next = plain.choose(control, {Kind::kSplats, 20000});
  EXPECT_LT(next, coarse);
  EXPECT_GT(next, 0.8 * coarse);
  EXPECT_FALSE(control.settled());
  const double there = plain.choose(control, {Kind::kSplats, 20000}, true);
  EXPECT_NEAR(plain.estimate(false).drawn(there), 19000, 20);
  for (int i = 0; i < 100; ++i) draw(plain.choose(control, {Kind::kSplats, 20000}));
  EXPECT_TRUE(control.settled());
  EXPECT_EQ(plain.choose(control, {Kind::kSplats, 1e6}, true), 0);
}

}  // namespace
}  // namespace rosplat
