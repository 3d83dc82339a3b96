#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <fstream>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"

using namespace rosplat;
using Instructions = CpuRasterizer::Instructions;

namespace {

// A map of given splats without bands beyond 0, 5 m before a camera that looks along z.
struct Scene {
  void add(std::array<float, 3> position, float scale, float opacity, std::array<float, 3> colour) {
    for (float& c : colour) c = (c - 0.5f) / 0.28209479f;
    batch.add(position, {scale, scale, scale}, opacity, {colour.begin(), colour.end()});
  }

  void apply(OwnedBatch next) {
    next.revision = map.state().revision + 1;
    BatchReport report;
    const auto edit = map.apply(next.look(), report);
    slots.apply(*edit, 0);
  }
  // Writes the splats from a slot on and forgets them.
  void write(std::uint32_t first_slot = 0) {
    batch.operation = GaussianBatch::UPSERT;
    batch.first_slot = first_slot;
    apply(std::exchange(batch, OwnedBatch()));
  }
  void remove(std::uint32_t first_slot, std::uint32_t count) {
    OwnedBatch none(0, GaussianBatch::DELETE, first_slot);
    none.count = count;
    apply(none);
  }

  GaussianMap map;
  HostSlots slots;
  OwnedBatch batch;  // to be written
};

// 3000 splats of all sizes and opacities around the point that the camera looks at.
Scene cloud() {
  Scene scene;
  std::mt19937 random(1);
  std::normal_distribution<float> place(0, 0.8f);
  std::uniform_real_distribution<float> unit(0, 1);
  for (int i = 0; i < 3000; ++i) {
    const float size = 0.003f * std::exp(5 * unit(random));
    scene.add({place(random), place(random), 5 + place(random)}, size, unit(random),
              {unit(random), unit(random), unit(random)});
  }
  scene.write();
  return scene;
}

// Of these maps.
template <typename... Scenes>
PictureRequest request(int width, int height, const Scenes&... scenes) {
  SplatCamera camera;
  camera.fx = camera.fy = width;
  camera.cx = width / 2.0;
  camera.cy = height / 2.0;
  camera.width = width;
  camera.height = height;
  // ndc.z of a frustum from 1 m to 11 m
  camera.ndc_scale = 1.2;
  camera.ndc_offset = -2.2;
  PictureRequest request;
  for (const Scene* scene : {&scenes...}) {
    PictureLayer& layer = request.layers.emplace_back();
    layer.slots = &scene->slots;
    layer.map = &scene->map.state();
    layer.camera = camera;
  }
  return request;
}
PictureRequest request(const Scene& scene) { return request(150, 110, scene); }

float windowDepth(float z) { return 0.5f * (1.2f * z - 2.2f) / z + 0.5f; }

CpuRasterizer rasterizer(unsigned threads = 1, Instructions instructions = Instructions::kBest) {
  return CpuRasterizer(std::make_shared<ThreadTeam>(threads), instructions);
}

// As much address space more as long as this lives.
class AddressLimit {
 public:
  explicit AddressLimit(std::size_t bytes) {
    getrlimit(RLIMIT_AS, &before_);
    std::ifstream statm("/proc/self/statm");
    std::size_t pages = 0;
    statm >> pages;
    const rlimit limited{pages * std::size_t(sysconf(_SC_PAGESIZE)) + bytes, before_.rlim_max};
    setrlimit(RLIMIT_AS, &limited);
  }
  ~AddressLimit() { setrlimit(RLIMIT_AS, &before_); }

 private:
  rlimit before_;
};

SplatPicture draw(CpuRasterizer&& with, const PictureRequest& request) {
  SplatPicture picture;
  EXPECT_TRUE(with.draw(request, picture));
  return picture;
}

}  // namespace

TEST(CpuRasterizer, draws_nothing_of_an_empty_map) {
  const Scene scene;
  PictureRequest wanted = request(3, 2, scene);
  wanted.depth = PictureDepth::kMean;
  const SplatPicture picture = draw(rasterizer(), wanted);
  EXPECT_EQ(picture.layers[0].drawn, 0u);
  EXPECT_EQ(picture.colour, std::vector<float>(24));
  ASSERT_EQ(picture.depth.size(), 6u);
  for (const float depth : picture.depth) EXPECT_TRUE(std::isnan(depth));
}

TEST(CpuRasterizer, draws_one_splat_on_one_pixel) {
  Scene scene;
  scene.add({0, 0, 5}, 100, 0.6f, {1, 0.5f, 0.25f});
  scene.write();
  PictureRequest wanted = request(1, 1, scene);
  wanted.depth = PictureDepth::kMean;
  const SplatPicture picture = draw(rasterizer(), wanted);
  ASSERT_EQ(picture.colour.size(), 4u);
  EXPECT_NEAR(picture.colour[0], 0.6f, 1e-3);
  EXPECT_NEAR(picture.colour[1], 0.3f, 1e-3);
  EXPECT_NEAR(picture.colour[2], 0.15f, 1e-3);
  EXPECT_NEAR(picture.colour[3], 0.6f, 1e-4);
  EXPECT_NEAR(picture.depth[0], 5, 1e-5);
}

TEST(CpuRasterizer, sums_up_the_depths_of_each_tile) {
  const Scene scene = cloud();
  PictureRequest wanted = request(scene);
  wanted.depth = PictureDepth::kMean;
  const SplatPicture picture = draw(rasterizer(2), wanted);
  const int across = (picture.width + kTile - 1) / kTile,
            down = (picture.height + kTile - 1) / kTile;
  ASSERT_EQ(picture.tiles.size(), std::size_t(across * down));
  std::vector<double> depths(picture.tiles.size()), alphas(picture.tiles.size());
  for (int y = 0; y < picture.height; ++y) {
    for (int x = 0; x < picture.width; ++x) {
      const auto pixel = std::size_t(picture.width * y + x);
      const auto tile = std::size_t(across * (y / kTile) + x / kTile);
      const double alpha = picture.colour[4 * pixel + 3];
      if (alpha == 0) continue;
      alphas[tile] += alpha;
      depths[tile] += alpha / picture.depth[pixel];
    }
  }
  for (std::size_t tile = 0; tile < picture.tiles.size(); ++tile) {
    EXPECT_NEAR(picture.tiles[tile].alpha, alphas[tile], 1e-5 * alphas[tile]);
    EXPECT_NEAR(picture.tiles[tile].depth, depths[tile], 1e-5 * depths[tile]);
  }
}

// Of parallel projection, whose splats may be on both sides of the camera.
TEST(CpuRasterizer, a_median_depth_may_be_of_any_sign) {
  for (const float z : {-2.0f, 0.0f, 2.0f}) {
    Scene scene;
    scene.add({0, 0, z}, 0.2f, 1, {1, 1, 1});
    scene.write();
    PictureRequest wanted = request(8, 8, scene);
    SplatCamera& camera = wanted.layers[0].camera;
    camera.orthographic = true;
    camera.near_clip = -10;
    camera.ndc_scale = 0.1;
    camera.ndc_offset = 0;
    wanted.depth = PictureDepth::kMedian;
    const SplatPicture picture = draw(rasterizer(), wanted);
    EXPECT_EQ(picture.depth[8 * 4 + 4], z);
    EXPECT_TRUE(std::isnan(picture.depth[0]));
  }
}

TEST(CpuRasterizer, draws_the_same_to_the_bit_with_any_number_of_threads) {
  const Scene scene = cloud();
  const SplatPicture expected = draw(rasterizer(1), request(scene));
  EXPECT_GT(expected.layers[0].drawn, 2000u);
  for (const unsigned threads : {2u, 3u, 7u}) {
    const SplatPicture picture = draw(rasterizer(threads), request(scene));
    EXPECT_EQ(picture.colour, expected.colour) << threads << " threads";
    EXPECT_EQ(picture.layers[0].drawn, expected.layers[0].drawn);
  }
}

TEST(CpuRasterizer, draws_the_same_with_any_instructions) {
  const Scene scene = cloud();
  const SplatPicture expected = draw(rasterizer(1, Instructions::kPlain), request(scene));
  for (const auto instructions : {Instructions::kAvx2, Instructions::kAvx512}) {
    CpuRasterizer fast = rasterizer(1, instructions);
    const std::string name = fast.instructions();
    const SplatPicture picture = draw(std::move(fast), request(scene));
    float error = 0;
    for (std::size_t i = 0; i < picture.colour.size(); ++i) {
      error = std::max(error, std::fabs(picture.colour[i] - expected.colour[i]));
    }
    EXPECT_LT(error, 0.5f / 255) << name;  // where an alpha is next to the cutoff; else far less
    EXPECT_EQ(picture.layers[0].drawn, expected.layers[0].drawn) << name;
  }
}

TEST(CpuRasterizer, hides_what_the_scene_hides) {
  Scene scene;
  scene.add({0, 0, 3}, 100, 0.5f, {1, 0, 0});
  scene.add({0, 0, 8}, 100, 0.5f, {0, 1, 0});
  scene.write();
  PictureRequest wanted = request(2, 1, scene);
  const std::vector<float> scene_depth = {windowDepth(5), 1};
  wanted.scene_depth = scene_depth;
  const SplatPicture picture = draw(rasterizer(), wanted);
  EXPECT_NEAR(picture.colour[0], 0.5f, 1e-3);
  EXPECT_NEAR(picture.colour[1], 0, 1e-3);
  EXPECT_NEAR(picture.colour[4 + 0], 0.5f, 1e-3);
  EXPECT_NEAR(picture.colour[4 + 1], 0.25f, 1e-3);
}

TEST(CpuRasterizer, divides_splats_at_translucent_objects) {
  Scene scene;
  scene.add({0, 0, 3}, 100, 0.5f, {1, 0, 0});
  scene.add({0, 0, 6}, 100, 0.5f, {0, 1, 0});
  scene.add({0, 0, 9}, 100, 0.5f, {0, 0, 1});
  scene.write();
  PictureRequest wanted = request(2, 1, scene);
  const std::vector<float> opaque = {windowDepth(8), 1}, veil = {windowDepth(5), 1};
  wanted.scene_depth = opaque;
  wanted.translucent_depth = veil;
  const SplatPicture picture = draw(rasterizer(), wanted);
  const auto expectColour = [](const float* rgba, std::array<float, 4> expected) {
    for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(rgba[i], expected[i], 1e-3) << i;
  };
  expectColour(&picture.colour[0], {0.5f, 0, 0, 0.5f});
  expectColour(&picture.behind[0], {0, 0.5f, 0, 0.5f});
  EXPECT_NEAR(picture.nearness[0], 0.5f * (1 - windowDepth(6)), 1e-4);
  EXPECT_NEAR(picture.nearness[1], 0.5f, 1e-4);
  expectColour(&picture.colour[4], {0.5f, 0.25f, 0.125f, 0.875f});
  expectColour(&picture.behind[4], {0, 0, 0, 0});
}

TEST(CpuRasterizer, a_splat_beyond_all_bounds_hides_no_other) {
  const std::vector<float> open(150 * 110, 1);  // behind which whole pages are looked for
  for (const float far : {1e19f, 1e30f, 1e36f, 1e38f, 3.4e38f}) {
    for (const std::array<float, 3>& at : {std::array<float, 3>{far, 0, 0},
                                           {0, -far, 0},
                                           {0, 0, far},
                                           {-far, far, far},
                                           {far, -far, -far}}) {
      for (const bool clips : {false, true}) {
        const Scene without = cloud();
        Scene with = cloud();
        const auto same = [&](const std::string& what) {
          PictureRequest expected = request(without), wanted = request(with);
          expected.scene_depth = wanted.scene_depth = open;
          for (PictureRequest* of : {&expected, &wanted}) {
            ClipBox& box = of->layers[0].settings.clip_box;
            box.enabled = clips;
            box.size = {10, 10, 100};
            of->layers[0].camera.fx = 1e5;  // the products are the larger
          }
          EXPECT_EQ(draw(rasterizer(), wanted).colour, draw(rasterizer(), expected).colour)
              << what << " at " << at[0] << " " << at[1] << " " << at[2];
        };
        with.add(at, 1, 1, {1, 1, 1});
        with.write(3000);
        same("a splat");
        with.remove(3000, 1);
        same("what is left of a splat");
      }
    }
  }
}

TEST(CpuRasterizer, a_group_beyond_all_bounds_hides_no_other) {
  const Scene without = cloud();
  for (const double far : {1e20, 1e37, 3e38, -1e300, 1.7e308}) {
    Scene with = cloud();
    with.batch = OwnedBatch();
    with.add({0, 0, 5}, 1, 1, {1, 1, 1});
    with.batch.group = 1;
    with.write(4096);
    OwnedBatch move(0, GaussianBatch::MOVE);
    move.group_list = {1};
    move.poses.push_back({{far, far, -far}, {0, 0, 0, 1}});
    with.apply(move);
    EXPECT_EQ(draw(rasterizer(), request(with)).colour, draw(rasterizer(), request(without)).colour)
        << far;
  }
}

TEST(CpuRasterizer, a_splat_whose_reach_is_beyond_float32_is_hidden_by_none_of_the_tiles) {
  Scene scene;
  scene.add({-5e34f, 0, 1e37f}, 1e35f, 1, {1, 1, 1});  // 25 pixels from the left
  scene.write();
  PictureRequest wanted = request(scene);
  wanted.layers[0].camera.fx = 1e4;
  wanted.layers[0].camera.fy = 10;  // it is in one row of tiles
  wanted.layers[0].camera.far_clip = 3e38;
  std::vector<float> depth(150 * 110, 1);
  for (int i = 0; i < 150 * 110; ++i) depth[std::size_t(i)] = i % 150 < 16 ? 0.0f : 1.0f;
  const std::size_t drawn = draw(rasterizer(), wanted).layers[0].drawn;
  EXPECT_EQ(drawn, 1u);
  wanted.scene_depth = depth;
  for (const auto with : {Instructions::kPlain, Instructions::kBest}) {
    EXPECT_EQ(draw(rasterizer(1, with), wanted).layers[0].drawn, drawn);
  }
}

TEST(CpuRasterizer, nothing_is_left_behind_where_a_translucent_object_was) {
  Scene scene;
  scene.add({0, 0, 6}, 100, 0.5f, {0, 1, 0});
  scene.write();
  PictureRequest wanted = request(40, 20, scene);
  const auto divided = [&](std::size_t pixel, SplatPicture& picture) {
    std::vector<float> veil(40 * 20, 1.0f);
    veil[pixel] = windowDepth(5);
    wanted.translucent_depth = veil;
    ASSERT_TRUE(rasterizer().draw(wanted, picture));
  };
  SplatPicture again, anew;
  divided(0, again);
  EXPECT_NEAR(again.behind[1], 0.5f, 1e-3);
  divided(40 * 20 - 1, again);
  divided(40 * 20 - 1, anew);
  EXPECT_EQ(again.behind, anew.behind);
  EXPECT_EQ(again.nearness, anew.nearness);
}

TEST(CpuRasterizer, draws_a_given_order_and_nothing_else) {
  Scene scene;
  scene.add({0, 0, 3}, 100, 0.5f, {1, 0, 0});
  scene.add({0, 0, 6}, 100, 0.5f, {0, 1, 0});
  scene.add({0, 0, 9}, 100, 0.5f, {0, 0, 1});
  scene.write(1000);
  PictureRequest wanted = request(1, 1, scene);
  const std::vector<std::uint32_t> order = {1000, 1002, 77};  // the farthest one last
  wanted.order = order;
  const SplatPicture picture = draw(rasterizer(), wanted);
  EXPECT_EQ(picture.layers[0].drawn, 2u);
  EXPECT_NEAR(picture.colour[2], 0.5f, 1e-3);
  EXPECT_NEAR(picture.colour[0], 0.25f, 1e-3);
  EXPECT_NEAR(picture.colour[1], 0, 1e-3);
}

TEST(CpuRasterizer, picks_what_contributes_most) {
  Scene scene;
  scene.add({0, 0, 9}, 100, 0.9f, {0, 0, 1});
  scene.add({0, 0, 3}, 100, 0.3f, {1, 0, 0});
  scene.add({0, 0, 12}, 100, 0.9f, {0, 0, 1});
  scene.write(2000);
  CpuRasterizer with = rasterizer();
  PictureRequest wanted = request(2, 1, scene);
  EXPECT_EQ(with.pick(wanted), (std::vector<PickedSplat>{{0, 2000}, {0, 2000}}));
  const std::vector<float> scene_depth = {windowDepth(5), windowDepth(2)};
  wanted.scene_depth = scene_depth;
  EXPECT_EQ(with.pick(wanted), (std::vector<PickedSplat>{{0, 2001}, {0, kNoSlot}}));
}

// Two maps that reach through each other, and the map of all their splats, those of the second in
// pages of their own.
struct Union {
  Union() {
    std::mt19937 random(3);
    std::normal_distribution<float> place(0, 0.8f);
    std::uniform_real_distribution<float> unit(0, 1);
    for (Scene* scene : {&first, &second}) {
      for (int i = 0; i < 2000; ++i) {
        const std::array<float, 3> position{place(random), place(random), 5 + place(random)};
        const std::array<float, 3> colour{unit(random), unit(random), unit(random)};
        const float size = 0.003f * std::exp(5 * unit(random)), opacity = unit(random);
        scene->add(position, size, opacity, colour);
        both.add(position, size, opacity, colour);
      }
      scene->write();
      both.write(scene == &first ? 0 : kSecond);
    }
  }

  static constexpr std::uint32_t kSecond = 2048;
  Scene first, second, both;
};

TEST(CpuRasterizer, draws_maps_in_one_order) {
  const Union maps;
  PictureRequest wanted = request(150, 110, maps.first, maps.second);
  wanted.depth = PictureDepth::kMean;
  const SplatPicture picture = draw(rasterizer(2), wanted);
  wanted.layers = request(maps.both).layers;
  const SplatPicture expected = draw(rasterizer(1), wanted);
  EXPECT_EQ(picture.colour, expected.colour);
  EXPECT_EQ(0, std::memcmp(picture.depth.data(), expected.depth.data(),
                           expected.depth.size() * sizeof(float)));  // NaN as well
  ASSERT_EQ(picture.layers.size(), 2u);
  EXPECT_GT(picture.layers[0].drawn, 1000u);
  EXPECT_GT(picture.layers[1].drawn, 1000u);
  EXPECT_EQ(picture.layers[0].drawn + picture.layers[1].drawn, expected.layers[0].drawn);

  const std::vector<PickedSplat> picked =
      rasterizer().pick(request(150, 110, maps.first, maps.second));
  std::vector<PickedSplat> in_both = rasterizer().pick(request(maps.both));
  for (PickedSplat& splat : in_both) {
    if (splat.slot != kNoSlot && splat.slot >= Union::kSecond)
      splat = {1, splat.slot - Union::kSecond};
  }
  EXPECT_EQ(picked, in_both);
}

// By the clip boxes that part a map, each part in a mode of its own, where no splat is in both.
TEST(CpuRasterizer, draws_each_map_by_its_own_settings) {
  Scene scene;
  scene.add({-1, 0, 4}, 0.1f, 0.4f, {1, 0, 0});
  scene.add({1, 0, 6}, 0.15f, 0.4f, {0, 1, 0});
  scene.write();
  const auto alone = [&](float x, DrawMode mode, float opacity) {
    PictureLayer layer = request(scene).layers.front();
    layer.settings.mode = mode;
    layer.settings.opacity = opacity;
    layer.settings.clip_box = {true, {x, 0, 5}, {1, 1, 4}};
    return layer;
  };
  PictureRequest wanted;
  for (const DrawMode mode : {DrawMode::kFlatBall, DrawMode::kGaussianBall, DrawMode::kDepth}) {
    wanted.layers = {alone(-1, mode, 1)};
    const SplatPicture left = draw(rasterizer(), wanted);
    wanted.layers = {alone(1, DrawMode::kColor, 0.5f)};
    const SplatPicture right = draw(rasterizer(), wanted);
    wanted.layers = {alone(-1, mode, 1), alone(1, DrawMode::kColor, 0.5f)};
    const SplatPicture picture = draw(rasterizer(), wanted);
    for (std::size_t i = 0; i < picture.colour.size(); ++i) {
      ASSERT_EQ(picture.colour[i], left.colour[i] + right.colour[i]) << "mode " << int(mode);
    }
  }
}

TEST(CpuRasterizer, gives_up_when_it_is_told_to) {
  const Scene scene = cloud();
  PictureRequest wanted = request(scene);
  std::atomic<bool> cancelled{true};
  wanted.cancelled = &cancelled;
  CpuRasterizer with = rasterizer();
  SplatPicture picture;
  EXPECT_FALSE(with.draw(wanted, picture));
  EXPECT_TRUE(with.pick(wanted).empty());
  Contributions contributions;
  EXPECT_FALSE(with.contribute(wanted, contributions));
  cancelled = false;
  EXPECT_TRUE(with.draw(wanted, picture));
}

TEST(CpuRasterizer, says_so_where_there_is_no_memory) {
  const Scene scene = cloud();
  CpuRasterizer with = rasterizer();
  SplatPicture picture;
  const AddressLimit limit(std::size_t{512} << 20);
  try {
    with.draw(request(8192, 8192, scene), picture);
    FAIL();
  } catch (const PictureError& error) {
    EXPECT_STREQ(error.what(), "there is no memory for a picture of 8192 x 8192 pixels");
  }
  EXPECT_TRUE(with.draw(request(scene), picture));
}

TEST(CpuRasterizer, refuses_pictures_that_are_none) {
  const Scene scene = cloud();
  for (const int width : {0, 40000}) {
    SplatPicture picture;
    PictureRequest wanted = request(scene);
    wanted.layers[0].camera.width = width;
    EXPECT_THROW(rasterizer().draw(wanted, picture), PictureError);
  }
  PictureRequest wanted = request(scene);
  const std::vector<float> depth = {1};
  wanted.scene_depth = depth;
  SplatPicture picture;
  EXPECT_THROW(rasterizer().draw(wanted, picture), PictureError);
}

TEST(CpuRasterizer, draws_8192_pixels_in_width_and_height) {
  Scene scene;
  scene.add({0, 0, 5}, 0.001f, 1, {1, 1, 1});
  scene.add({2.49f, 2.49f, 5}, 0.001f, 1, {1, 1, 1});
  scene.write();
  const SplatPicture picture = draw(rasterizer(2), request(8192, 8192, scene));
  const auto alpha = [&](std::size_t x, std::size_t y) {
    return picture.colour[4 * (8192 * y + x) + 3];
  };
  EXPECT_GT(alpha(4096, 4096), 0.8f);
  EXPECT_GT(alpha(8175, 8175), 0.8f);
  EXPECT_EQ(alpha(6000, 6000), 0);
}

// A part of a picture has fewer splats, and fewer slices of depth.
TEST(CpuRasterizer, draws_slices_of_depth_as_it_draws_all_at_once) {
  Scene scene;
  std::mt19937 random(2);
  std::uniform_real_distribution<float> unit(0, 1);
  for (int i = 0; i < 1200000; ++i) {
    const float z = 2 + 20 * unit(random);
    scene.add({z * (unit(random) - 0.5f), z * (unit(random) - 0.5f), z}, 0.004f * z, unit(random),
              {unit(random), unit(random), unit(random)});
  }
  scene.write();
  PictureRequest wanted = request(320, 320, scene);
  wanted.depth = PictureDepth::kMean;
  const SplatPicture whole = draw(rasterizer(2), wanted);
  EXPECT_LT(whole.layers[0].drawn, 900000u);  // what is behind isn't looked at
  const SplatPicture again = draw(rasterizer(1), wanted);
  EXPECT_EQ(whole.colour, again.colour);
  EXPECT_EQ(whole.depth, again.depth);
  wanted.layers[0].camera = crop(wanted.layers[0].camera, 64, 128, 96, 48);
  const SplatPicture part = draw(rasterizer(2), wanted);
  int apart = 0;  // pixels where a splat's contour ends within a hair of the centre
  for (std::size_t y = 0; y < 48; ++y) {
    for (std::size_t x = 0; x < 96; ++x) {
      const std::size_t i = 96 * y + x, k = 320 * (y + 128) + x + 64;
      float most = 0;
      for (std::size_t c = 0; c < 4; ++c) {
        most = std::max(most, std::fabs(part.colour[4 * i + c] - whole.colour[4 * k + c]));
      }
      ASSERT_LT(most, 1.0f / 255) << x << ", " << y;
      if (most > 3e-5f && ++apart) continue;
      ASSERT_NEAR(part.depth[i], whole.depth[k], 2e-3);
    }
  }
  EXPECT_LE(apart, 4);
}

TEST(CpuRasterizer, draws_more_pairs_of_splat_and_tile_than_there_is_room_for) {
  Scene scene;
  for (int i = 0; i < 300; ++i) {  // on each of 65,536 tiles: 20 million pairs
    scene.add({0, 0, 5 + 0.01f * float(i)}, 1000, 0.02f, {1, 1, 1});
  }
  scene.write();
  CpuRasterizer with = rasterizer(2);
  SplatPicture picture;
  ASSERT_TRUE(with.draw(request(4096, 4096, scene), picture));
  EXPECT_LT(with.bytes(), std::size_t{1} << 30);
  const float expected = 1 - std::pow(1 - 0.02f, 300.0f);
  for (std::size_t i = 3; i < picture.colour.size(); i += 4 * 4097) {
    ASSERT_NEAR(picture.colour[i], expected, 1e-3);
  }
}

TEST(CpuRasterizer, colours_by_the_depths_of_more_pairs_than_there_is_room_for) {
  Scene scene;
  for (int i = 0; i < 4096; ++i) {  // on each of 8,192 tiles: 34 million pairs
    scene.add({0, 0, 5 + 0.001f * float(i)}, 1000, 0.5f, {1, 1, 1});
  }
  scene.write();
  PictureRequest by_depth = request(2048, 1024, scene);
  by_depth.layers[0].settings.mode = DrawMode::kDepth;
  const SplatPicture found = draw(rasterizer(), by_depth);
  by_depth.layers[0].settings.depth_range = {5, 5 + 0.001f * 4095};
  EXPECT_EQ(found.colour, draw(rasterizer(), by_depth).colour);
}

TEST(CpuRasterizer, rounds_to_bytes) {
  std::vector<float> values = {0, 1, -0.5f, 1e9f, 0.5f / 255, 0.49f / 255, 254.4f / 255, 0.6f};
  values.insert(values.end(), 9, 0.1f);  // more than a vector, and some
  std::vector<std::uint8_t> expected = {0, 255, 0, 255, 1, 0, 254, 153};
  expected.insert(expected.end(), 9, 26);
  std::vector<std::uint8_t> bytes(values.size());
  toBytes(values.data(), values.size(), bytes.data());
  EXPECT_EQ(bytes, expected);
}

TEST(HostSlots, hold_what_was_written_last) {
  Scene scene;
  scene.add({1, 2, 3}, 0.5f, 0.5f, {1, 1, 1});
  scene.add({4, 5, 6}, 0.25f, 1, {0, 0, 0});
  scene.write(1023);  // on two pages
  scene.remove(1024, 1);
  const std::vector<SplatValues> values = scene.slots.read({1023, 1024, 33000000});
  EXPECT_EQ(values[0].position, (std::array<double, 3>{1, 2, 3}));
  EXPECT_NEAR(values[0].scale[0], 0.5f, 1e-3);
  EXPECT_NEAR(values[0].sh[0], 0.5f / 0.28209479f, 1e-3);
  EXPECT_EQ(values[1].opacity, 0);
  EXPECT_EQ(values[2].opacity, 0);
  EXPECT_EQ(values[2].slot, 33000000u);
}

TEST(HostSlots, hold_splats_of_all_degrees_in_one_page) {
  Scene scene;
  const auto coefficient = [](int degree, int i) { return 0.01f * float(10 * degree + i % 10); };
  const std::vector<int> degrees = {1, 0, 3, 2};  // by slot, as they come
  for (std::uint32_t slot = 0; slot < degrees.size(); ++slot) {
    const int degree = degrees[slot];
    std::vector<float> coefficients;
    const int count = 3 * (degree + 1) * (degree + 1);
    for (int i = 0; i < count; ++i) coefficients.push_back(coefficient(degree, i));
    scene.batch.sh_degree = static_cast<std::uint8_t>(degree);
    scene.batch.add({0, 0, 5}, {1, 1, 1}, 0.5f, coefficients);
    scene.write(slot);
  }
  for (const SplatValues& values : scene.slots.read({0, 1, 2, 3})) {
    const int degree = degrees[values.slot];
    ASSERT_EQ(values.sh.size(), 48u);
    for (int i = 0; i < 48; ++i) {
      const bool has = i < 3 * (degree + 1) * (degree + 1);
      EXPECT_NEAR(values.sh[std::size_t(i)], has ? coefficient(degree, i) : 0, 1e-3);
    }
  }
}

TEST(HostSlots, take_memory_for_pages_in_use_alone) {
  Scene scene;
  scene.add({0, 0, 5}, 0.1f, 1, {1, 1, 1});
  scene.write(kMaxSlots - 1);
  EXPECT_LT(scene.slots.bytes(), 50000u);
}
