// Rays and discs beside ellipses. tests/test_renderer.py holds their pictures to the reference.

#include <gtest/gtest.h>

#include <map>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"

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
