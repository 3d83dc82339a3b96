// Several maps in one picture.

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "drawn_scenes.hpp"
#include "gl/pixels.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

// Two maps that reach through each other, as two displays of a process show them, and the map of
// all their splats, those of the second in pages of their own. All have the same origin.
struct Union {
  Union() {
    const OwnedBatch all = manySplats().splats;
    Splats halves[2], whole;
    std::vector<std::uint32_t> slots;
    for (std::uint32_t half : {0u, 1u}) {
      const auto add = [&](const std::array<float, 3>& position, const std::array<float, 3>& colour,
                           float size) {
        slots.push_back(kSecond * half + halves[half].splats.count);
        halves[half].add(position, colour, size);
        whole.add(position, colour, size);
      };
      add({0, 0, -10}, {}, 1e-3f);  // the origin, which nobody sees
      for (std::uint32_t i = half; i < kSplats; i += 2) {
        const auto three = [i](const std::vector<float>& of) -> std::array<float, 3> {
          return {of[3 * i], of[3 * i + 1], of[3 * i + 2]};
        };
        add(three(all.position), three(all.harmonics), 0.3f);
      }
    }
    first.apply(halves[0].batch(1, {}));
    second.apply(halves[1].batch(1, {}));
    both.apply(whole.batch(1, slots));
  }

  static constexpr std::uint32_t kSecond = 3072;
  std::shared_ptr<Renderers> renderers = std::make_shared<Renderers>(shaders());
  SplatScene first{renderers}, second{renderers}, both{renderers};
};

// As displays draw them that call the view each by a name of its own.
std::vector<float> pictureOf(SplatScene& first, const RenderSettings& of_first, SplatScene& second,
                             const RenderSettings& of_second) {
  SplatScene::Picture picture;
  const auto add = [&](SplatScene& scene, const char* view, const RenderSettings& settings) {
    SplatCamera mine = camera();
    mine.extent_scale = extentScale(settings);
    scene.setCamera(view, 1, mine);
    scene.upload(settings, true);
    EXPECT_TRUE(picture.takes(scene));
    picture.add(scene, scene.layer(view, settings, true));
  };
  add(first, "first's view", of_first);
  add(second, "second's view", of_second);
  picture.begin(Canvas::kNone);
  picture.draw({});
  return first.readColor();
}

void beginPicture(SplatScene& scene, const std::string& view, const RenderSettings& settings) {
  scene.upload(settings, true);
  SplatScene::Picture picture;
  picture.add(scene, scene.layer(view, settings, true));
  picture.begin(Canvas::kNone);
}

}  // namespace

TEST_F(SplatRendererTest, DrawsMapsInOneOrder) {
  Union maps;
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  const auto together = pictureOf(maps.first, settings, maps.second, settings);
  const FrameReport first = maps.first.report("first's view"),
                    second = maps.second.report("second's view");
  EXPECT_EQ(together, picture(maps.both, Rasterizer::kTiles, OrderSource::kAuto));
  EXPECT_EQ(first.order_source, "gpu");
  EXPECT_EQ(first.maps, 2u);
  EXPECT_EQ(second.maps, 2u);
  EXPECT_GT(first.splats, 1000u);
  EXPECT_GT(second.splats, 1000u);
  EXPECT_EQ(first.splats + second.splats, maps.both.report("view").splats);
}

// Ogre may end a picture between its two steps; a view's next one begins anew.
TEST_F(SplatRendererTest, PicturesThatWereBegunAndNeverDrawnChangeNoOther) {
  SplatScene scene(shaders());
  fill(scene);
  const auto expected = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  SplatCamera aside = camera();
  aside.translation[0] += 1;
  for (const std::string view : {"view", "other view"}) {
    scene.setCamera(view, 2, aside);
    beginPicture(scene, view, settings);
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected);
  }
  beginPicture(scene, "other view", settings);
  scene.forget("other view");
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected);
}

TEST_F(SplatRendererTest, ShowsTheMouseWhatIsSeenWhosesoeverItIs) {
  Union maps;
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  pictureOf(maps.first, settings, maps.second, settings);
  picture(maps.both, Rasterizer::kTiles, OrderSource::kAuto);
  const std::vector<std::uint32_t> expected = picked(maps.both);
  SplatScene::Picture all;
  all.add(maps.first, maps.first.layerUnderMouse("first's view", settings, camera()));
  all.add(maps.second, maps.second.layerUnderMouse("second's view", settings, camera()));
  constexpr std::uint32_t kNumber = 0x123456;
  // What is left of the window: a number where there are picks, the surface.
  const auto left = [](const std::function<void()>& draw) {
    const Framebuffer window(GL_DEPTH24_STENCIL8, 0, 1);
    draw();
    return gl::readPixels(kSize, kSize);
  };
  const auto numbered = left([&] { all.drawPick(Canvas::kWindow, kNumber); });
  std::vector<Pick> picks = maps.first.pick();
  ASSERT_EQ(picks.size(), 2u);
  const Pick::Slots of_first = picks[0].slots(), of_second = picks[1].slots();
  std::size_t found[2] = {0, 0};
  for (int i = 0; i < kSize * kSize; ++i) {
    const std::uint32_t slot = expected[std::size_t(i)];
    const bool second = slot != kNoSlot && slot >= Union::kSecond;
    ASSERT_EQ(of_first[std::size_t(i)], second ? kNoSlot : slot);
    ASSERT_EQ(of_second[std::size_t(i)], second ? slot - Union::kSecond : kNoSlot);
    found[second] += slot != kNoSlot;
    const std::size_t at = 4 * std::size_t(kSize * (kSize - 1 - i / kSize) + i % kSize);
    const auto byte = [&](std::size_t k) {
      return std::uint32_t(std::lround(255 * numbered[at + k]));
    };
    ASSERT_EQ(byte(0) << 16 | byte(1) << 8 | byte(2), slot == kNoSlot ? 0 : kNumber);
  }
  EXPECT_GT(found[0], 100u);
  EXPECT_GT(found[1], 100u);

  const auto surface = left([&] { all.drawSurface(Canvas::kWindow, 100); });
  EXPECT_GT(*std::max_element(surface.begin(), surface.end()), 0);
  EXPECT_EQ(surface,
            left([&] { underMouse(maps.both, settings).drawSurface(Canvas::kWindow, 100); }));
}

// Beside the processor, which draws them by another program.
TEST_F(SplatRendererTest, DrawsEachMapByItsOwnSettings) {
  Union maps;
  const auto drawn = [&](RenderSettings of_first, RenderSettings of_second, Rasterizer rasterizer) {
    for (RenderSettings* settings : {&of_first, &of_second}) {
      settings->rasterizer = rasterizer;
    }
    return pictureOf(maps.first, of_first, maps.second, of_second);
  };
  std::vector<RenderSettings> others(8);
  others[0].opacity = 0.3f;
  others[1].scale = 2;
  others[1].model = Model::kEwaAntialiased;
  others[2].clip_box = {true, {0, 0, 9}, {3, 3, 6}};
  others[3].detail = parseDetail("6px");
  others[4].detail = parseDetail("500");
  others[5].mode = DrawMode::kDepth;
  others[6].mode = DrawMode::kFlatBall;
  others[7].mode = DrawMode::kGaussianBall;
  for (std::size_t i = 0; i < others.size(); ++i) {
    for (const bool first : {true, false}) {
      const RenderSettings& a = first ? others[i] : RenderSettings();
      const RenderSettings& b = first ? RenderSettings() : others[i];
      const auto processor = drawn(a, b, Rasterizer::kProcessor);
      const double error = maps.second.report("second's view").error;
      const auto card = drawn(a, b, Rasterizer::kTiles);
      if (others[i].detail.kind == Detail::Kind::kSplats) {
        // Each keeps it by what it draws itself, so their errors differ.
        const SplatScene& of = first ? maps.first : maps.second;
        EXPECT_LE(of.report(first ? "first's view" : "second's view").splats, 500u);
        continue;
      }
      std::size_t different = 0;  // at the rims of balls a pixel is of one or of the other
      for (std::size_t k = 0; k < card.size(); ++k) {
        different += std::abs(card[k] - processor[k]) > 6e-3f;
      }
      EXPECT_LE(different, drawsBalls(others[i].mode) ? card.size() / 50 : 0) << i;
      EXPECT_EQ(maps.second.report("second's view").error, error) << i;
    }
  }
}

TEST_F(SplatRendererTest, MapsShareWhatTheyAreDrawnWith) {
  Union maps;
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.profile = true;
  const auto together = pictureOf(maps.first, settings, maps.second, settings);
  const std::size_t shared = maps.first.bytes().shared_gpu;
  EXPECT_EQ(maps.second.bytes().shared_gpu, shared);
  EXPECT_EQ(pictureOf(maps.first, settings, maps.second, settings), together);
  EXPECT_EQ(maps.second.report("second's view").profile.count("project"), 0u);  // it is there
  // Whosever display goes: the view is the other's, until that goes as well.
  maps.first.forget("first's view");
  EXPECT_EQ(maps.second.bytes().shared_gpu, shared);
  maps.second.draw("second's view", settings, Canvas::kNone);
  const auto alone = maps.second.readColor();
  EXPECT_NE(alone, together);
  maps.second.forget("second's view");
  EXPECT_LT(maps.second.bytes().shared_gpu, shared);
  EXPECT_EQ(pictureOf(maps.first, settings, maps.second, settings), together);
}

// A metre to the side in the frame of another map: origins differ, and so does rounding.
TEST_F(SplatRendererTest, DrawsMapsOfOtherFramesInOneOrder) {
  const auto renderers = std::make_shared<Renderers>(shaders());
  SplatScene first(renderers), second(renderers), both(renderers);
  const OwnedBatch all = manySplats().splats;
  Splats halves[2];
  for (std::uint32_t i = 0; i < kSplats; ++i) {
    const float aside = i % 2 ? 1000 : 0;
    halves[i % 2].add(
        {all.position[3 * i] - aside, all.position[3 * i + 1], all.position[3 * i + 2]},
        {all.harmonics[3 * i], all.harmonics[3 * i + 1], all.harmonics[3 * i + 2]});
  }
  first.apply(halves[0].batch(1, {}));
  second.apply(halves[1].batch(1, {}));
  fill(both);
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  first.setCamera("first's view", 1, camera());
  SplatCamera moved = camera();
  moved.translation[0] += 1000;
  second.setCamera("second's view", 1, moved);
  for (SplatScene* scene : {&first, &second}) scene->upload(settings, true);
  SplatScene::Picture picture_of_both;
  picture_of_both.add(first, first.layer("first's view", settings, true));
  picture_of_both.add(second, second.layer("second's view", settings, true));
  picture_of_both.begin(Canvas::kNone);
  picture_of_both.draw({});
  const auto together = first.readColor();
  const auto expected = picture(both, Rasterizer::kTiles, OrderSource::kAuto);
  double squares = 0;
  for (std::size_t i = 0; i < together.size(); ++i) {
    squares += std::pow(double(together[i]) - double(expected[i]), 2);
  }
  EXPECT_GT(-10 * std::log10(squares / double(together.size())), 60);
}
