// Rays and discs beside ellipses. tests/test_renderer.py holds their pictures to the reference.

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "gl/pixels.hpp"

using namespace rosplat;

namespace {

RenderSettings drawnAs(Model model, const char* detail = "full",
                       Rasterizer rasterizer = Rasterizer::kTiles) {
  RenderSettings settings = detailed(detail, rasterizer);
  settings.model = model;
  return settings;
}

}  // namespace

TEST_F(SplatRendererTest, GoesFromModelToModelAndBack) {
  SplatScene scene(shaders());
  scene.apply(manySplats(0.08f).batch(1, {}));
  std::map<Model, std::vector<float>> drawn;
  for (int round = 0; round < 2; ++round) {
    for (const Model model :
         {Model::kEwa, Model::kRay, Model::kDisc, Model::kEwaAntialiased, Model::kRay}) {
      const auto found = cutPicture(scene, drawnAs(model));
      EXPECT_EQ(drawn.emplace(model, found).first->second, found) << int(model);
    }
  }
  EXPECT_GT(greatestDifference(drawn[Model::kEwa], drawn[Model::kRay]), 0.01f);
}

TEST_F(SplatRendererTest, DrawsLevelsOfRaysAndDiscsAsTheProcessor) {
  SplatScene scene(shaders()), other(shaders());
  Splats splats = manySplats();
  addWall(splats, 30000, 0);
  for (SplatScene* each : {&scene, &other}) each->apply(splats.batch(1, {}));
  for (const Model model : {Model::kRay, Model::kDisc}) {
    for (const char* detail : {"full", "1px", "5px"}) {
      const auto tiles = cutPicture(scene, drawnAs(model, detail));
      const auto processor = cutPicture(other, drawnAs(model, detail, Rasterizer::kProcessor));
      EXPECT_LT(greatestDifference(tiles, processor), 3e-3f) << int(model) << " at " << detail;
    }
  }
}

TEST_F(SplatRendererTest, DrawsRaysAndDiscsOutOfSmallBuffers) {
  const OwnedBatch small = manySplats(0.08f).batch(1, {});
  SplatScene whole(shaders());
  whole.apply(small);
  const auto rays = cutPicture(whole, drawnAs(Model::kRay));
  const auto discs = cutPicture(whole, drawnAs(Model::kDisc));
  const auto bytes = static_cast<GLint64>(kSlots / 3 * Shaders::ellipseBytes(Shapes::kDiscs));
  const Disguise disguise(bytes, 0);
  SplatScene scene(shaders());
  scene.apply(small);
  EXPECT_EQ(cutPicture(scene, drawnAs(Model::kRay)), rays);
  EXPECT_EQ(cutPicture(scene, drawnAs(Model::kDisc)), discs);
}

// A leaf that stands at 60 degrees, alone and beside a map of rays.
TEST_F(SplatRendererTest, ADepthIsThatOfAnEllipsesPlane) {
  constexpr float kFar = 100;
  const float slope = -std::sqrt(3.0f) * 5 / 40;  // [m/px]
  SplatScene leaf(shaders()), rays(shaders());
  OwnedBatch one(1), aside(1);
  one.add({0, 0, 5}, {4, 4, 0.001f}, 0.95f, {0, 0, 0}, {0, 0.5f, 0, std::sqrt(0.75f)});
  aside.add({6, 0, 10}, {0.1f, 0.1f, 0.1f}, 0.95f);
  leaf.apply(one.look());
  rays.apply(aside.look());
  for (const Rasterizer rasterizer : {Rasterizer::kTiles, Rasterizer::kProcessor}) {
    const RenderSettings ellipses = drawnAs(Model::kEwa, "full", rasterizer);
    const auto colour = cutPicture(leaf, ellipses);
    const auto depths = leaf.readDepth();
    EXPECT_EQ(leaf.readColor(), colour);
    RenderSettings with_depths = ellipses;
    with_depths.depths = true;
    leaf.setCamera("other view", 1, camera());
    leaf.draw("other view", with_depths, Canvas::kNone, true);
    EXPECT_LT(greatestDifference(leaf.readColor(), colour), 1e-6f);
    EXPECT_EQ(leaf.readDepth()[32 * kSize + 40], depths[32 * kSize + 40]);
    const Framebuffer window(GL_DEPTH24_STENCIL8, 0, 1);
    cutPicture(rays, drawnAs(Model::kRay, "full", rasterizer));
    leaf.draw("view", ellipses, Canvas::kWindow, true);
    underMouse(leaf, ellipses).drawSurface(Canvas::kWindow, kFar);
    std::vector<std::vector<float>> surfaces{gl::readPixels(kSize, kSize)};
    if (rasterizer == Rasterizer::kTiles) {
      SplatScene::Picture both = underMouse(leaf, ellipses);
      both.add(rays, rays.layerUnderMouse("view", drawnAs(Model::kRay), camera()));
      both.drawSurface(Canvas::kWindow, kFar);
      surfaces.push_back(gl::readPixels(kSize, kSize));
    }
    for (int column = 20; column < 44; ++column) {
      const float expected = 5 + slope * (float(column) + 0.5f - 32);
      EXPECT_NEAR(depths[std::size_t(32 * kSize + column)], expected, 1e-2f) << column;
      for (const std::vector<float>& surface : surfaces) {
        const float* rgb = &surface[4 * std::size_t(31 * kSize + column)];  // bottom row first
        const float found = (rgb[0] * 65536 + rgb[1] * 256 + rgb[2]) * 255 / 16777215 * kFar;
        EXPECT_NEAR(found, expected, 1e-2f) << column;
      }
    }
  }
}
