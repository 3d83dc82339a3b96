#include <gtest/gtest.h>

#include <cmath>

#include "owned_batch.hpp"
#include "rosplat_core/views/hard_regimes.hpp"

namespace rosplat {

namespace {

// A splat of a decimetre two metres ahead of a camera that sees 50 degrees.
constexpr float kAhead = 2.0f;

MapSample sampleOf(const SampledSplat& splat, std::uint32_t count = 3) {
  MapSample sample;
  for (std::uint32_t slot = 0; slot < count; ++slot) sample.set(slot, splat);
  return sample;
}

SampledSplat decimetre(float x = 0, float z = kAhead) { return {{x, 0, z}, 0.1f, 0.9f}; }

SplatCamera camera() {
  SplatCamera camera;
  camera.width = 640;
  camera.height = 480;
  camera.fx = camera.fy = 700;
  camera.cx = 320;
  camera.cy = 240;
  return camera;
}

// A map's only group.
Groups groupAt(const std::array<double, 3>& origin) {
  Groups groups;
  groups.write(7, origin);
  return groups;
}

std::string said(const MapSample& sample, const SplatCamera& from = camera(),
                 const RenderSettings& settings = {}, const MapState& map = {},
                 const Groups& groups = groupAt({})) {
  std::string text;
  for (const std::string& sentence : hardRegimes(map, sample, groups, settings, {from})) {
    text += sentence;
  }
  return text;
}

bool tells(const std::string& text, const char* words) {
  return text.find(words) != std::string::npos;
}

}  // namespace

TEST(HardRegimes, areNotFoundInAnOrdinaryView) {
  EXPECT_EQ(said(sampleOf(decimetre())), "");
  EXPECT_EQ(said({}), "");
}

TEST(HardRegimes, holdPositionsWhoseFloatsAreCoarserThanTheirSplats) {
  EXPECT_FALSE(tells(said(sampleOf(decimetre(1e4f))), "origin"));
  EXPECT_TRUE(tells(said(sampleOf(decimetre(1e6f))), "relative to an origin"));
  SplatCamera there = camera();
  there.translation[0] = -1e6;
  EXPECT_EQ(said(sampleOf(decimetre()), there, {}, {}, groupAt({1e6, 0, 0})), "");  // floats small
  Groups placed = groupAt({});
  placed.move({7, {{1e6, 0, 0}, {0, 0, 0, 1}}});
  EXPECT_EQ(said(sampleOf(decimetre()), there, {}, {}, placed), "");
}

TEST(HardRegimes, holdPerspectivesOfMoreThan100Degrees) {
  SplatCamera wide = camera();
  for (const double degrees : {99.0, 101.0}) {
    wide.fx = wide.fy = 320 / std::tan(0.5 * degrees * M_PI / 180);
    EXPECT_EQ(tells(said(sampleOf(decimetre()), wide), "100 degrees"), degrees > 100) << degrees;
  }
  wide.orthographic = true;
  EXPECT_EQ(said(sampleOf(decimetre()), wide), "");
  SplatCamera beside = camera();  // as narrow, but an edge is far from the axis
  beside.cx = -600;
  EXPECT_TRUE(tells(said(sampleOf(decimetre()), beside), "100 degrees"));
}

TEST(HardRegimes, holdSplatsSmallerThanPixelsUnlessTheyAreCompensated) {
  const MapSample far = sampleOf(decimetre(0, 200));  // 0.35 px
  EXPECT_TRUE(tells(said(far), "smaller than a pixel"));
  EXPECT_EQ(said(sampleOf(decimetre(0, 100))), "");
  EXPECT_EQ(said(sampleOf(decimetre(5000, 200))), "") << "none of them is in the picture";
  RenderSettings settings;
  settings.scale = 2;
  EXPECT_EQ(said(far, camera(), settings), "");
  settings.scale = 1;
  settings.model = Model::kEwaAntialiased;
  EXPECT_EQ(said(far, camera(), settings), "");
  settings.model = std::nullopt;
  MapState map;
  map.model = Model::kEwaAntialiased;
  EXPECT_EQ(said(far, camera(), settings, map), "");
  settings.model = Model::kEwa;
  EXPECT_TRUE(tells(said(far, camera(), settings, map), "smaller than a pixel"));
}

TEST(HardRegimes, holdSplatsThatAreTooFaint) {
  SampledSplat faint = decimetre();
  faint.opacity = 0.003f;
  EXPECT_TRUE(tells(said(sampleOf(faint)), "fainter than 1/255"));
  RenderSettings settings;
  settings.opacity = 0.004f;
  EXPECT_TRUE(tells(said(sampleOf(decimetre()), camera(), settings), "fainter than 1/255"));
}

TEST(HardRegimes, holdViewersWhoseCoordinatesAreRoundedByPixels) {
  SplatCamera shaken = camera();
  shaken.rounding = 0.001;  // 0.35 px where the splats are
  EXPECT_EQ(said(sampleOf(decimetre()), shaken), "");
  shaken.rounding = 0.01;
  EXPECT_TRUE(tells(said(sampleOf(decimetre()), shaken), "Fixed Frame"));
}

TEST(MapSample, keepsEvenlySpacedSlotsOfLargeMaps) {
  MapSample sample = sampleOf(decimetre(), 100'000);
  const std::size_t count = sample.splats().size();
  EXPECT_GT(count, MapSample::kMost / 2);
  EXPECT_LE(count, MapSample::kMost);
  sample.drop(64);
  sample.drop(65);  // not in it
  EXPECT_EQ(sample.splats().size(), count - 1);
}

TEST(MapSample, followsTheMap) {
  GaussianMap map;
  BatchReport report;
  OwnedBatch batch(1);
  batch.add({1, 2, 3}, {0.1f, 0.3f, 0.2f}, 0.5f);
  batch.add({4, 5, 6}, {1, 1, 1}, 0.5f, {0, 0, 0}, {0, 0, 0, 0});  // that means nothing
  map.apply(batch.look(), report);
  ASSERT_EQ(map.sample().splats().size(), 1u);
  EXPECT_NEAR(map.sample().splats().at(0).size, 0.3f, 1e-4f);  // as slots have it
  EXPECT_EQ(map.sample().splats().at(0).position[2], 3.0f);
  OwnedBatch empty(2, GaussianBatch::DELETE);
  empty.count = 1;
  map.apply(empty, report);
  EXPECT_TRUE(map.sample().splats().empty());
}

}  // namespace rosplat
