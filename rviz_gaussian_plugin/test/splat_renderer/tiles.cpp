// Lists of tiles, the memory that they take, and pictures in regions.

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "gl/driver.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

// NaN where there is no splat.
bool sameDepths(const std::vector<float>& a, const std::vector<float>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](float one, float other) {
    return one == other || (std::isnan(one) && std::isnan(other));
  });
}

}  // namespace

TEST_F(SplatRendererTest, BlendsLongListsInSegments) {
  // Some 5,000 on each of four tiles, faint and small, so that all of them count.
  Splats splats;
  std::minstd_rand random;
  const auto part = [&] { return float(random() % 4096) / 4096; };
  for (int i = 0; i < 20000; ++i) {
    const float z = 5 + 10 * part(), across = 0.4f * z * (part() - 0.5f), down = part() - 0.5f;
    splats.splats.add({across, 0.4f * z * down, z}, {0.01f, 0.02f, 0.01f}, 0.02f,
                      {2 * part() - 1, 2 * part() - 1, 2 * part() - 1});
  }
  SplatScene scene(shaders());
  scene.apply(splats.batch(1, {}));
  const auto expected = picture(scene, Rasterizer::kProcessor, OrderSource::kAuto);
  const auto found = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_LT(greatestDifference(found, expected), kApart);
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), found);
  // Those of a wall before them don't.
  Splats wall;
  for (int i = 0; i < 40; ++i) wall.add({0, 0, 3}, {1, 0, float(i % 2)}, 2.0f);
  std::vector<std::uint32_t> slots(40);
  std::iota(slots.begin(), slots.end(), 20000u);
  scene.apply(wall.batch(2, slots));
  EXPECT_LT(greatestDifference(picture(scene, Rasterizer::kTiles, OrderSource::kAuto),
                               picture(scene, Rasterizer::kProcessor, OrderSource::kAuto)),
            kApart);
}

TEST_F(SplatRendererTest, ListsSplatsByMacroTiles) {
  // 36 of these, of which the left ones have one row of tiles alone: of 4,000 splats, one is across
  // more tiles than a box has bits for, and 100 are needles across some.
  constexpr int kWidth = 1100, kHeight = 200;
  SplatCamera wide = makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 200, 200, 0.5 * kWidth,
                                0.5 * kHeight, kWidth, kHeight, 0.1, 100);
  wide.ndc_scale = camera().ndc_scale;
  wide.ndc_offset = camera().ndc_offset;
  OwnedBatch batch(1, GaussianBatch::REPLACE);
  std::minstd_rand random;
  const auto part = [&] { return float(random() % 4096) / 4096; };
  for (int i = 0; i < 3999; ++i) {
    const float z = 5 + 10 * part(), right = z * (3 * part() - 0.8f);
    const float length = i % 40 == 0 ? 1.5f : 0.04f;
    batch.add({right, z * (part() - 0.5f), z}, {length, 0.03f, 0.02f}, 0.5f,
              {4 * part() - 2, 4 * part() - 2, 4 * part() - 2});
    const std::array<float, 4> turned{0, 0, 0.38f, 0.92f};
    if (i % 40 == 0) std::copy(turned.begin(), turned.end(), batch.orientation.end() - 4);
  }
  batch.add({0, 0, 20}, {40, 0.1f, 0.1f}, 0.5f, {1, 1, 1});
  SplatScene scene(shaders());
  scene.apply(batch.look());
  std::vector<std::vector<float>> pictures;
  for (const Rasterizer rasterizer : {Rasterizer::kProcessor, Rasterizer::kTiles}) {
    RenderSettings settings;
    settings.rasterizer = rasterizer;
    scene.setCamera("view", 1, wide);
    scene.draw("view", settings, Canvas::kNone, true);
    pictures.push_back(scene.readColor());
  }
  EXPECT_EQ(scene.report("view").rasterizer, "tiles");
  EXPECT_GT(scene.report("view").splats, 3000u);
  // Where a splat ends, at an alpha of 1/255, the two round apart.
  EXPECT_LT(greatestDifference(pictures[1], pictures[0]), 1 / 255.0f);
  std::size_t apart = 0;
  for (std::size_t i = 0; i < pictures[0].size(); ++i) {
    apart += std::abs(pictures[1][i] - pictures[0][i]) > kApart;
  }
  EXPECT_LT(apart, 20u);
}

TEST_F(SplatRendererTest, DrawsTheSameOutOfSmallBuffers) {
  const OwnedBatch small = manySplats(0.08f).batch(1, {});
  SplatScene whole(shaders());
  whole.apply(small);
  const auto of = [](SplatScene& scene) {
    return picture(scene, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kNone, largeCamera());
  };
  const auto expected = of(whole);
  const auto depths = whole.readDepth();
  const auto expected_picks = picked(whole, largeCamera());
  const auto buffersOf = [](std::size_t splats) {
    return Disguise(static_cast<GLint64>(splats * Shaders::ellipseBytes(Shapes::kEllipses)), 0);
  };
  // In two parts; and in four, which leave no room for the lists of all tiles.
  for (const std::size_t parts : {2u, 4u}) {
    const Disguise disguise = buffersOf(kSlots / parts);
    SplatScene scene(shaders());
    scene.apply(small);
    for (int frame = 0; frame < 3; ++frame) EXPECT_EQ(of(scene), expected);
    EXPECT_TRUE(sameDepths(scene.readDepth(), depths));
    EXPECT_EQ(picked(scene, largeCamera()), expected_picks);
  }
  const Disguise disguise = buffersOf(kSlots / 5);  // there are four parts at most
  SplatScene scene(shaders());
  scene.apply(small);
  EXPECT_THROW(of(scene), gl::Error);
}

// Lists that find no room are made region by region; as soon as they find it, at once.
TEST_F(SplatRendererTest, DrawsInRegionsWhereListsAreTooMuch) {
  const Disguise disguise(
      static_cast<GLint64>(kSlots / 4 * Shaders::ellipseBytes(Shapes::kEllipses)), 0);
  SplatScene scene(shaders());
  scene.apply(manySplats(0.08f).batch(1, {}));
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);  // what isn't called yet isn't counted
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  std::uint64_t sequence = 0;
  // How much a frame submits that looks from a place beside the map's middle. [m]
  const auto submits = [&](double x) {
    SplatCamera moved = largeCamera();
    moved.translation[0] = -x;
    scene.setCamera("view", ++sequence, moved);
    const Calls<&epoxy_glDispatchCompute> dispatches;
    scene.draw("view", settings, Canvas::kNone);
    return dispatches.count();
  };
  submits(6);
  const int once = submits(6.1), kept = submits(6.1);
  EXPECT_LT(kept, once);
  submits(0);
  EXPECT_GT(submits(0.1), once);
  EXPECT_GT(submits(0.1), kept);  // no lists of the whole are left
  for (int frame = 0; frame < 8; ++frame) submits(6.2 + 0.1 * frame);
  EXPECT_EQ(submits(6.1), once);
}

// Where a single macro tile has more than there is memory for.
TEST_F(SplatRendererTest, SaysThatSplatsAreLeftOut) {
  const Disguise disguise(
      static_cast<GLint64>(kSlots / 4 * Shaders::ellipseBytes(Shapes::kEllipses)), 0);
  SplatScene scene(shaders());
  const auto see = [&](float size) {
    scene.apply(manySplats(size).batch(1, {}));
    for (int frame = 0; frame < 4; ++frame) {
      picture(scene, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kNone, largeCamera());
    }
    return scene.warning();
  };
  EXPECT_EQ(see(0.08f), "");
  EXPECT_NE(see(20).find("missing"), std::string::npos);
  EXPECT_EQ(see(0.08f), "");
}

// What lists take follows what is seen, and is tried again where memory was lacking.
TEST_F(SplatRendererTest, ListsTakeTheMemoryThatTheyNeedOfLate) {
  constexpr int kPatience = 64;
  Splats splats;
  for (int i = 0; i < 500; ++i) {
    const auto part = [i](double step) { return static_cast<float>(std::fmod(step * i, 1.0)); };
    splats.add({part(0.7548776662) - 0.5f, part(0.5698402909) - 0.5f, 2}, {1, 1, 1});
  }
  SplatScene scene(shaders());
  scene.apply(splats.batch(1, {}));
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  std::uint64_t sequence = 0;
  // Looks from so far away, and never twice from the same place. [m]
  const auto drawFrom = [&](double distance) {
    SplatCamera moved = largeCamera();
    moved.translation = {0.1 * distance + 1e-6 * double(sequence), 0.1 * distance, distance};
    scene.setCamera("view", ++sequence, moved);
    scene.draw("view", settings, Canvas::kNone);
    return scene.readColor();
  };
  const BufferLimit none;
  const auto expected = drawFrom(0);
  const GLsizeiptr list = BufferLimit::largest;
  const std::size_t near = scene.bytes().shared_gpu;
  for (int frame = 0; frame < 3 * kPatience; ++frame) drawFrom(50);
  const std::size_t far = scene.bytes().shared_gpu;
  EXPECT_LT(far + std::size_t(list) / 2, near);
  constexpr float kMoved = 0.02f;  // what a pixel changes where the edge of a splat comes or goes
  std::size_t limited = 0;
  {
    const BufferLimit limit(list / 2);
    EXPECT_LT(greatestDifference(drawFrom(0), expected), kMoved);  // region by region
    limited = scene.bytes().shared_gpu;
    EXPECT_LT(limited + std::size_t(list) / 2, near);
  }
  for (int frame = 0; frame < kPatience; ++frame) drawFrom(50);
  EXPECT_LT(greatestDifference(drawFrom(0), expected), kMoved);
  EXPECT_GT(scene.bytes().shared_gpu, limited + std::size_t(list) / 3);
}

TEST_F(SplatRendererTest, GivesBackTheMemoryOfSplatsThatItSeesNoMore) {
  constexpr int kFrames = 2 * 64;  // twice its patience
  SplatScene scene(shaders());
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  std::uint64_t sequence = 0;
  const auto bytesDrawn = [&] {
    SplatCamera moved = camera();
    moved.translation[2] = 1e-6 * double(++sequence);  // never twice from the same place
    scene.setCamera("view", sequence, moved);
    scene.draw("view", settings, Canvas::kNone);
    return scene.bytes().shared_gpu;
  };
  const auto fillWith = [&](int count) {
    OwnedBatch batch(1, GaussianBatch::REPLACE);
    for (int i = 0; i < count; ++i) {
      const float right = 0.01f * float(i % 600 - 300), down = 0.01f * float(i / 600 % 500 - 250);
      batch.add({right, down, 5}, {0.001f, 0.001f, 0.001f}, 0.1f);
    }
    scene.apply(batch.look());
  };
  fillWith(100000);
  const std::size_t most = bytesDrawn();
  fillWith(1000);
  std::size_t left = most;
  for (int frame = 0; frame < kFrames; ++frame) left = bytesDrawn();
  EXPECT_EQ(scene.report("view").splats, 1000u);
  EXPECT_LT(left, most / 2);
}

// Long lists whose segments find no memory are blended whole.
TEST_F(SplatRendererTest, DrawsTheSameWhereSegmentsFindNoMemory) {
  // Around the middle of a tile, so far from each other across and down. [m]
  const auto apart = [](float step, std::uint64_t revision) {
    Splats splats;
    for (int i = 0; i < 40000; ++i) {
      const float x = 0.25f + step * float(i % 200 - 100), y = 0.25f + step * float(i / 200 - 100);
      splats.splats.add({x, y, 5}, {0.025f, 0.025f, 0.025f}, 0.01f, {1, 1, 1});
    }
    return splats.batch(revision, {});
  };
  const auto of = [](SplatScene& drawn) {
    return picture(drawn, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kNone, largeCamera());
  };
  SplatScene whole(shaders());
  whole.apply(apart(0, 1));
  const auto expected = of(whole);
  SplatScene scene(shaders());
  scene.apply(apart(0.03f, 1));
  of(scene);  // has no segments
  scene.apply(apart(0, 2));
  // Of what more a frame asks for, segments alone take a multiple of 4 KiB.
  const BufferLimit limit(65536, 4096);
  for (int frame = 0; frame < 3; ++frame) {
    EXPECT_LT(greatestDifference(of(scene), expected), 1e-4f);
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto);  // lest the next is kept
  }
}

// Of a splat in view: ellipse, box and place in the order; of its pair with a macro tile: key and
// value, twice; of a pair with a tile: a word, and another one where a long list is cut into
// segments.
TEST_F(SplatRendererTest, TakesFewBytesForWhatIsInView) {
  constexpr std::size_t kCount = 20480, kTiles = 16;
  // Of splats of a size in the middles of tiles.
  const auto bytesOf = [](std::size_t count, float size) {
    Splats splats;
    for (std::size_t i = 0; i < count; ++i) {
      splats.add({2 * float(i % 4) - 3, 2 * float(i / 4 % 4) - 3, 5}, {1, 1, 1}, size);
    }
    SplatScene scene(shaders());
    scene.apply(splats.batch(1, {}));
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
    return double(scene.bytes().shared_gpu);
  };
  const auto each = [&](float size) {  // less what is there once
    return (bytesOf(2 * kCount, size) - bytesOf(kCount, size)) / kCount;
  };
  const double on_one_tile = each(0.1f), on_all = each(20);
  EXPECT_LT(on_one_tile, 70);
  // There is an eighth as room for the next frame.
  EXPECT_LT((on_all - on_one_tile) / ((kTiles - 1) * 9.0 / 8), 8.5);
}

// As with a second window, a Camera display and a mouse beside.
TEST_F(SplatRendererTest, KeepsWhatEachViewSees) {
  SplatScene scene(shaders());
  fill(scene);
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.profile = true;
  const auto stages = [&](const std::string& view, int size) {
    SplatCamera camera =
        makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 40, 40, 32, 32, size, size, 0.1, 100);
    scene.setCamera(view, 1, camera);
    scene.draw(view, settings, Canvas::kNone);
    std::string names;
    for (const auto& [name, time] : scene.report(view).profile) names += name + " ";
    return names;
  };
  EXPECT_EQ(stages("window", 64), "bin blend list project sort ");
  const auto expected = scene.readColor();
  const std::size_t alone = gpuBytes(scene);
  EXPECT_EQ(stages("camera", 48), "bin blend list project sort ");
  picked(scene);
  for (int frame = 0; frame < 2; ++frame) {
    EXPECT_EQ(stages("camera", 48), "blend ");
    EXPECT_EQ(stages("window", 64), "blend ");
    EXPECT_EQ(scene.readColor(), expected);
  }
  const std::size_t both = gpuBytes(scene);
  EXPECT_GT(both, alone);
  scene.forget("camera");
  EXPECT_LT(gpuBytes(scene), both);
  scene.forget("window");
  EXPECT_TRUE(scene.readColor().empty());
}

// Whatever is drawn, and however.
TEST_F(SplatRendererTest, DrawsAllTheSameInRegions) {
  Splats splats = manySplats(0.2f);
  addWall(splats, 3000, 0);
  const OwnedBatch batch = splats.batch(1, {});
  std::vector<RenderSettings> settings(5);
  settings[1].mode = DrawMode::kGaussianBall;
  settings[2].mode = DrawMode::kDepth;  // coloured by the depths of all
  settings[3].order = OrderSource::kOff;
  settings[4].detail = parseDetail("3px");
  const auto pictures = [&](SplatScene& scene) {
    std::vector<std::vector<float>> drawn;
    for (RenderSettings each : settings) {
      each.rasterizer = Rasterizer::kTiles;
      scene.setCamera("view", 1, largeCamera());
      for (const bool divided : {false, true}) {
        Surroundings around;
        if (divided) {
          around.translucent = [] {  // a wall in their middle
            const GLfloat depth = windowDepth(9);
            glDepthMask(GL_TRUE);
            glClearBufferfv(GL_DEPTH, 0, &depth);
          };
        }
        const Framebuffer window(GL_DEPTH24_STENCIL8, 0, 1, 4 * kSize);
        scene.draw("view", each, Canvas::kWindow, true, around);
        drawn.push_back(scene.readColor());
        const std::vector<float> depths = scene.readDepth();
        drawn.emplace_back();
        std::remove_copy_if(depths.begin(), depths.end(), std::back_inserter(drawn.back()),
                            [](float depth) { return std::isnan(depth); });
      }
    }
    return drawn;
  };
  SplatScene whole(shaders());
  whole.apply(batch);
  const auto expected = pictures(whole);
  EXPECT_NE(expected[2], expected[0]);  // divided
  // One that leaves no room for the lists of all tiles.
  const Disguise disguise(
      static_cast<GLint64>(kSlots / 2 * Shaders::ellipseBytes(Shapes::kEllipses)), 0);
  SplatScene scene(shaders());
  scene.apply(batch);
  const auto found = pictures(scene);
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(found[i], expected[i]) << i;
  EXPECT_LT(scene.bytes().shared_gpu, whole.bytes().shared_gpu);
}
