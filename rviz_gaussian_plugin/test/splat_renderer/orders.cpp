// Who sorts, and that it sorts rightly.

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "gl/driver.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

// The picture of manySplats() in an order by depth that a sidecar might send.
std::vector<float> sortedPicture(SplatScene& scene) {
  const std::vector<float> positions = manySplats().splats.position;
  const auto depth = [&](std::uint32_t slot) { return positions[3 * slot + 2]; };
  const std::shared_ptr<Order> order = scene.newOrder();
  order->view_id = "view";
  order->sequence = 1;
  order->map_id = scene.state().id;
  order->revision = scene.state().revision;
  order->source = "sidecar";
  order->bound = kSplats;
  order->slots.resize(kSplats);
  std::iota(order->slots.rbegin(), order->slots.rend(), 0u);
  std::stable_sort(order->slots.begin(), order->slots.end(),
                   [&](std::uint32_t a, std::uint32_t b) { return depth(a) > depth(b); });
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.order = OrderSource::kSidecar;
  scene.setCamera("view", 1, camera());
  scene.offer(order);
  scene.draw("view", settings, Canvas::kNone);
  return scene.readColor();
}

}  // namespace

TEST_F(SplatRendererTest, SortsOnTheGpuAsTheProcessorDoes) {
  SplatScene scene(shaders());
  fill(scene);
  const auto expected = sortedPicture(scene);
  EXPECT_EQ(scene.report("view").order_source, "sidecar");
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected);
  EXPECT_EQ(scene.report("view").order_source, "gpu");
  EXPECT_EQ(scene.report("view").rasterizer, "tiles");
  EXPECT_EQ(scene.warning(), "");
  EXPECT_LT(
      greatestDifference(picture(scene, Rasterizer::kProcessor, OrderSource::kAuto), expected),
      kApart);
}

TEST_F(SplatRendererTest, ReportsWhoSortsUntilAnOrderComes) {
  SplatScene scene(shaders());
  fill(scene);
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.order = OrderSource::kSidecar;
  scene.setCamera("view", 1, camera());
  const FrameReport report = scene.draw("view", settings, Canvas::kNone);
  EXPECT_EQ(report.order_source, "gpu");
  EXPECT_GT(report.splats, kSplats / 2);
  EXPECT_TRUE(report.order_fresh);
}

// A sidecar's order is of a map as it was: what has come since would be missing.
TEST_F(SplatRendererTest, SortsItselfWhereTheMapHasChangedSinceTheOrder) {
  SplatScene scene(shaders());
  fill(scene);
  sortedPicture(scene);
  Splats more;
  more.add({0, 0, 2}, {1, 0, 2});
  scene.apply(more.batch(2, {kSplats}));
  const auto expected = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.order = OrderSource::kSidecar;
  EXPECT_EQ(scene.draw("view", settings, Canvas::kNone).order_source, "gpu");
  EXPECT_EQ(scene.readColor(), expected);
}

TEST_F(SplatRendererTest, UnsortedSlotsFarApartCostTheirPages) {
  SplatScene scene(shaders());
  Splats splats;
  splats.add({0, 0, 5}, {1, 0, 0});
  splats.add({0, 0, 6}, {0, 1, 0});
  scene.apply(splats.batch(1, {0, 5 << 16}));
  const auto drawn = picture(scene, Rasterizer::kTiles, OrderSource::kOff);
  EXPECT_EQ(scene.report("view").order_source, "unsorted");
  EXPECT_EQ(scene.report("view").splats, 1024u + 1);
  EXPECT_LT(greatestDifference(picture(scene, Rasterizer::kProcessor, OrderSource::kOff), drawn),
            1e-4f);
  EXPECT_EQ(scene.report("view").order_source, "unsorted");
  EXPECT_EQ(scene.report("view").splats, 2u);
}

// Where lanes don't vote as the driver says. Without subgroups, nothing of this runs.
TEST_F(SplatRendererTest, SortsWithoutSubgroupsThatVoteWrongly) {
  SplatScene scene(shaders({"subgroupBallot(vote).x", "subgroupBallot(vote).x & 0xffffu"}));
  fill(scene);
  const auto expected = sortedPicture(scene);
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected);
  EXPECT_EQ(scene.report("view").order_source, "gpu");
  const bool subgroups = epoxy_has_gl_extension("GL_KHR_shader_subgroup");
  EXPECT_EQ(scene.warning().find("subgroups") != std::string::npos, subgroups);
}

// As drivers may run them, with what stands in for subgroups.
TEST_F(SplatRendererTest, SortsInWarpsOfAnyWidth) {
  SplatScene processor(shaders());
  fill(processor);
  const auto expected = sortedPicture(processor);
  for (const char* width : {"8", "16", "32", "64"}) {
    SplatScene scene(
        shaders({"#pragma optionNV(unroll all)",
                 std::string("#undef SUBGROUPS\n#undef WARP\n#define WARP ") + width}));
    fill(scene);
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected) << width;
    EXPECT_EQ(scene.report("view").order_source, "gpu") << width;
    EXPECT_EQ(scene.warning(), "") << width;
  }
}

TEST_F(SplatRendererTest, IsRefusedWhereTheGpuSortsWrongly) {
  // One that isn't stable, and one that loses keys.
  for (const Fault& fault :
       {Fault{"+ earlier", "+ 0u"}, Fault{"i < size) sorted_values", "i > 9u) sorted_values"}}) {
    SplatScene scene(shaders(fault));
    fill(scene);
    EXPECT_THROW(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), gl::Error);
  }
}

TEST_F(SplatRendererTest, AGivenOrderThatGrowsWaitsSeldom) {
  constexpr std::uint32_t kBatches = 20, kFirst = 260 * SlotPage::kSlots;
  SplatScene scene(shaders());
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.order = OrderSource::kOff;
  scene.setCamera("view", 1, camera());
  const auto grow = [&](std::uint32_t i) {
    OwnedBatch batch = splatsInARow(i == 0 ? kFirst : SlotPage::kSlots, 0);
    batch.revision = i + 1;
    batch.operation = i == 0 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT;
    // Behind the camera, so that the order alone grows.
    for (std::size_t axis = 2; axis < batch.position.size(); axis += 3) batch.position[axis] = -5;
    batch.first_slot = i == 0 ? 0 : kFirst + (i - 1) * SlotPage::kSlots;
    scene.apply(batch.look());
    scene.draw("view", settings, Canvas::kNone);
  };
  grow(0);
  const Waits counted;
  for (std::uint32_t i = 1; i < kBatches; ++i) grow(i);
  EXPECT_LT(Waits::count(), int(kBatches) / 2);
}
