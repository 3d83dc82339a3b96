// Levels of detail on the graphics card.

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

bool isRead(GLenum, GLsizeiptr, const void*, GLbitfield access) { return access & GL_MAP_READ_BIT; }

}  // namespace

TEST_F(SplatRendererTest, DrawsTheCutOfTheProcessor) {
  SplatScene scene(shaders()), other(shaders());
  Splats splats = manySplats();
  addWall(splats, 30000, 0);
  for (SplatScene* each : {&scene, &other}) each->apply(splats.batch(1, {}));
  const auto full = cutPicture(scene, detailed("full", Rasterizer::kTiles));
  const std::size_t all = scene.report("view").splats;
  for (const char* detail : {"0.5px", "1px", "2px", "3px", "5px", "9px", "30px", "200px"}) {
    const auto tiles = cutPicture(scene, detailed(detail, Rasterizer::kTiles));
    const FrameReport report = scene.report("view");
    EXPECT_EQ(report.detail_error, "");
    const auto processor = cutPicture(other, detailed(detail, Rasterizer::kProcessor));
    EXPECT_EQ(report.error, other.report("view").error) << detail;
    EXPECT_LT(greatestDifference(tiles, processor), 3e-3f) << detail;
  }
  EXPECT_LT(scene.report("view").splats, all / 100);
  for (const DrawMode mode : {DrawMode::kFlatBall, DrawMode::kNormals, DrawMode::kOpacity}) {
    RenderSettings settings = detailed("3px", Rasterizer::kTiles);
    settings.mode = mode;
    const auto tiles = cutPicture(scene, settings);
    settings.rasterizer = Rasterizer::kProcessor;
    const auto processor = cutPicture(other, settings);
    std::size_t others = 0;  // at the rims of balls a pixel is of one or of the other
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      others += std::abs(tiles[i] - processor[i]) > 5e-3f;
    }
    EXPECT_LT(others, tiles.size() / 100) << int(mode);
  }
  EXPECT_LT(greatestDifference(cutPicture(scene, detailed("full", Rasterizer::kTiles)), full),
            1e-6f);
}

TEST_F(SplatRendererTest, HasLevelsWhileAViewWantsThem) {
  SplatScene scene(shaders());
  fill(scene);
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  // What uploads lie in grows by itself while the card is busy.
  const auto held = [&] { return scene.bytes().map + scene.bytes().shared_gpu; };
  const std::size_t bytes = held();
  EXPECT_EQ(scene.bytes().levels, 0u);
  cutPicture(scene, detailed("20px", Rasterizer::kTiles));
  cutPicture(scene, detailed("5px", Rasterizer::kTiles), "other");
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  EXPECT_GT(scene.bytes().levels, 0u);
  scene.forget("other");
  EXPECT_EQ(scene.bytes().levels, 0u);
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  EXPECT_LE(held(), bytes + bytes / 10);
  // An order that is given, and picks, show slots.
  cutPicture(scene, detailed("200px", Rasterizer::kTiles));
  EXPECT_LT(scene.report("view").splats, kSplats / 10);
  RenderSettings given = detailed("200px", Rasterizer::kTiles);
  given.order = OrderSource::kOff;
  cutPicture(scene, given);
  EXPECT_EQ(scene.report("view").error, 0);
  EXPECT_EQ(scene.report("view").detail_error, "a given order has no levels of detail");
  EXPECT_EQ(scene.bytes().levels, 0u);
  SplatScene full(shaders());
  fill(full);
  picture(full, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_EQ(picked(scene), picked(full));
}

TEST_F(SplatRendererTest, KeepsABudgetOfAPictureThatIsWaitedFor) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  for (const char* most : {"100", "1500", "10k"}) {
    cutPicture(scene, detailed(most, Rasterizer::kTiles));
    const auto amount = static_cast<std::size_t>(parseDetail(most).amount);
    EXPECT_LE(scene.report("view").splats, amount);
    EXPECT_GT(scene.report("view").splats, amount / 5);
  }
  cutPicture(scene, detailed("1M", Rasterizer::kTiles));
  EXPECT_EQ(scene.report("view").error, 0);
}

// What is drawn corrects what is wanted next: the error comes to rest all the same.
TEST_F(SplatRendererTest, KeepsTheErrorOfABudgetAtRest) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  for (const char* most : {"1500", "5k", "10k"}) {
    RenderSettings settings = detailed(most, Rasterizer::kTiles);
    settings.interactive = true;
    std::vector<double> errors;
    for (int frame = 0; frame < 20; ++frame) {
      cutPicture(scene, settings, most);
      errors.push_back(scene.report(most).error);
    }
    EXPECT_GT(errors.back(), 0) << most;
    EXPECT_EQ(std::count(errors.end() - 10, errors.end(), errors.back()), 10) << most;
  }
}

// A picture's budget is estimated from the camera of the one before.
TEST_F(SplatRendererTest, ComesToRestAfterTheCameraWithABudget) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  RenderSettings settings = detailed("5k", Rasterizer::kTiles);
  settings.interactive = true;
  SplatCamera half = camera();  // the left one
  half.cx *= 2;
  half.fx *= 2;
  const auto rest = [&](const char* view_id, const SplatCamera& at) {
    for (int frame = 0; frame < 30; ++frame) cutPicture(scene, settings, view_id, at);
    return scene.report(view_id).error;
  };
  const double of_whole = rest("jumps", camera()), of_half = rest("rests", half);
  EXPECT_GT(of_half, 1.5 * of_whole);  // its cells are twice as wide in the picture
  EXPECT_NEAR(rest("jumps", half), of_half, 0.05 * of_half);
  EXPECT_NEAR(rest("jumps", camera()), of_whole, 0.05 * of_whole);
}

// Until the nodes of an edit stand, the picture has no holes that it hasn't before or afterwards;
// and in the end all is in them.
TEST_F(SplatRendererTest, RepairsLevelsBesideTheFrames) {
  SplatScene scene(shaders());
  const RenderSettings waited = detailed("6px", Rasterizer::kTiles);
  RenderSettings settings = waited;
  settings.interactive = true;
  Splats splats;
  addWall(splats, 20000, 0);
  scene.apply(splats.batch(1, {}));
  cutPicture(scene, detailed("full", Rasterizer::kTiles));  // from which they begin
  auto before = cutPicture(scene, waited, "waited");
  for (std::uint32_t edit = 1; edit <= 15; ++edit) {
    Splats some;
    addWall(some, 1000, edit);
    std::vector<std::uint32_t> slots(1000);
    std::iota(slots.begin(), slots.end(), 1291 * edit);
    scene.apply(some.batch(edit + 1, slots));
    std::vector<std::vector<float>> pictures;
    for (int frame = 0; frame < 3; ++frame) pictures.push_back(cutPicture(scene, settings));
    const auto after = cutPicture(scene, waited, "waited");
    for (const auto& picture : pictures) {
      for (std::size_t i = 3; i < picture.size(); i += 4) {
        ASSERT_GT(picture[i], std::min(before[i], after[i]) - 0.05f) << "edit " << edit;
      }
    }
    before = after;
  }
  scene.forget("waited");
  const auto repaired = cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  const std::size_t drawn = scene.report("view").splats;
  cutPicture(scene, detailed("full", Rasterizer::kTiles));  // which drops them
  EXPECT_EQ(scene.bytes().levels, 0u);
  EXPECT_EQ(greatestDifference(cutPicture(scene, detailed("6px", Rasterizer::kTiles)), repaired),
            0);
  EXPECT_EQ(scene.report("view").splats, drawn);
  // Another map has none of those nodes.
  Splats other;
  addWall(other, 10, 77);
  scene.apply(other.batch(1, {}));
  EXPECT_EQ(greatestDifference(cutPicture(scene, settings),
                               cutPicture(scene, detailed("full", Rasterizer::kTiles))),
            0);
}

// What comes after that is taken as it comes, and not read back.
TEST_F(SplatRendererTest, ReadsTheMapForItsLevelsOnce) {
  constexpr std::uint32_t kCount = 2 * SlotPage::kSlots;
  SplatScene scene(shaders());
  const auto grow = [&](std::uint32_t batch) {
    Splats some;
    addWall(some, kCount, batch);
    std::vector<std::uint32_t> slots(kCount);
    std::iota(slots.begin(), slots.end(), kCount * batch);
    scene.apply(some.batch(batch + 1, slots));
  };
  grow(0);
  cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  const Calls<&epoxy_glBufferStorage, isRead> counted;
  for (std::uint32_t batch = 1; batch < 4; ++batch) {
    grow(batch);
    cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  }
  EXPECT_EQ(counted.count(), 0);
  EXPECT_GT(scene.report("view").error, 0);
}
