// What drivers refuse, and who draws then.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <numeric>
#include <string>
#include <thread>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "gl/driver.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

// A driver without memory for buffers of so many bytes and more, until it ends.
class FullDriver {
 public:
  explicit FullDriver(GLsizeiptr least) {
    least_ = least;
    refused_ = 0;
    epoxy_glBufferData = [](GLenum target, GLsizeiptr bytes, const void* data, GLenum usage) {
      refused_ += bytes >= least_;
      glBufferDataOfDriver()(target, bytes >= least_ ? -1 : bytes, data, usage);
    };
  }
  ~FullDriver() { epoxy_glBufferData = glBufferDataOfDriver(); }
  FullDriver(const FullDriver&) = delete;
  FullDriver& operator=(const FullDriver&) = delete;

  static int refused() { return refused_; }

 private:
  static PFNGLBUFFERDATAPROC glBufferDataOfDriver() {
    return reinterpret_cast<PFNGLBUFFERDATAPROC>(eglGetProcAddress("glBufferData"));
  }
  static inline GLsizeiptr least_ = 0;
  static inline int refused_ = 0;
};

// Splats in a grid before the camera, in slots from a first one on.
OwnedBatch grid(std::uint64_t revision, std::uint32_t first_slot, std::uint32_t count, float z) {
  OwnedBatch batch(revision, revision == 1 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT,
                   first_slot);
  for (std::uint32_t i = first_slot; i < first_slot + count; ++i) {
    const auto x = static_cast<float>(i % 80), y = static_cast<float>(i / 80 % 80);
    batch.add({z * (x - 40) / 50, z * (y - 40) / 50, z}, {0.1f, 0.1f, 0.1f}, 0.5f,
              {static_cast<float>(i % 7) / 7, 0, 1});
  }
  batch.look();
  return batch;
}

// Draws until it is complete, or some seconds are over.
std::vector<float> pictureOnceComplete(SplatScene& scene, Rasterizer rasterizer) {
  std::vector<float> drawn;
  for (int i = 0; i < 100; ++i) {
    drawn = picture(scene, rasterizer, OrderSource::kAuto);
    if (scene.report("view").map.complete()) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return drawn;
}

}  // namespace

// With Auto, whatever it is that the card's driver can't do.
TEST_F(SplatRendererTest, TheProcessorDrawsWhereTheCardCannot) {
  SplatScene good(shaders()), scene(shaders({"+ earlier", "+ 0u"}));
  fill(good);
  fill(scene);
  epoxy_glGetString = [](GLenum name) {
    if (name == GL_RENDERER) return reinterpret_cast<const GLubyte*>("a card");
    return reinterpret_cast<PFNGLGETSTRINGPROC>(eglGetProcAddress("glGetString"))(name);
  };
  const auto found = picture(scene, Rasterizer::kAuto, OrderSource::kAuto);
  EXPECT_EQ(scene.report("view").rasterizer, "processor");
  EXPECT_NE(scene.error().find("sorts wrongly"), std::string::npos) << scene.error();
  epoxy_glGetString = reinterpret_cast<PFNGLGETSTRINGPROC>(eglGetProcAddress("glGetString"));
  EXPECT_EQ(found, picture(good, Rasterizer::kProcessor, OrderSource::kAuto));
}

// Drivers take more than the language has, each something else; the reference compiler doesn't.
TEST_F(SplatRendererTest, GivesAnyDriverShadersThatConform) {
  if (std::system("glslangValidator --version >/dev/null") != 0)
    GTEST_SKIP() << "no glslangValidator";
  Disguise::noted.clear();
  for (const GLint64 largest_buffer : {GLint64{1} << 27, (GLint64{1} << 31) - 1}) {
    for (const GLint subgroup_size : {0, 8, 32, 64}) {
      const Disguise disguise(largest_buffer, subgroup_size);
      try {
        // Not the very texts of other tests, whose programs would be used again.
        const SplatRenderer renderer(shaders({"void main() {", "void main() {  // noted\n"}));
      } catch (const gl::Error&) {  // no subgroups after all: but it got the shader
      }
    }
  }
  gl::dropErrors();
  {  // what only pictures of other models need
    const Disguise disguise(GLint64{1} << 27, 0);
    SplatScene scene(shaders({"void main() {", "void main() {  // noted\n"}));
    fill(scene);
    for (const Model model : {Model::kRay, Model::kDisc}) {
      for (const char* detail : {"full", "5px"}) {
        RenderSettings settings = detailed(detail, Rasterizer::kTiles);
        settings.model = model;
        cutPicture(scene, settings);
        scene.readDepth();
        underMouse(scene, settings).drawPick(Canvas::kNone, 0);
      }
    }
  }
  const auto count = [](const std::string& text) {
    return std::count_if(Disguise::noted.begin(), Disguise::noted.end(), [&](const auto& shader) {
      return shader.first.find(text) != std::string::npos;
    });
  };
  EXPECT_GT(count("#define PARTS 1\n"), 20);
  EXPECT_GT(count("#define PARTS 4\n"), 15);
  EXPECT_GT(count("#define DISCS\n"), 5);
  EXPECT_EQ(count("#define SUBGROUPS\n"), 6);
  const std::string prefix = testing::TempDir() + "rosplat_" + std::to_string(getpid()) + "_";
  std::string command = "glslangValidator";
  std::vector<std::string> files;
  for (const auto& [text, stage] : Disguise::noted) {
    const char* const suffix = stage == GL_COMPUTE_SHADER  ? ".comp"
                               : stage == GL_VERTEX_SHADER ? ".vert"
                                                           : ".frag";
    files.push_back(prefix + std::to_string(files.size()) + suffix);
    std::ofstream(files.back()) << text;
    command += " " + files.back();
  }
  EXPECT_EQ(std::system(command.c_str()), 0);
  for (const std::string& file : files) std::remove(file.c_str());
}

TEST_F(SplatRendererTest, WhatTheDriverRefusesIsMissingUntilItIsUploaded) {
  constexpr std::uint32_t kFirst = 70000, kMore = 200000;
  SplatScene scene(shaders()), whole(shaders());
  for (SplatScene* of : {&scene, &whole}) of->apply(grid(1, 0, kFirst, 8));
  whole.apply(grid(2, kFirst, kMore, -6));
  whole.apply(grid(3, 0, 100, 4));
  const auto expected = picture(whole, Rasterizer::kTiles, OrderSource::kAuto);
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_TRUE(scene.report("view").map.complete());
  {
    const FullDriver full(4 << 20);
    scene.apply(grid(2, kFirst, kMore, -6));
    scene.apply(grid(3, 0, 100, 4));
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
    EXPECT_GT(FullDriver::refused(), 0);
    EXPECT_FALSE(scene.report("view").map.complete());
    EXPECT_EQ(scene.report("view").map.revision, 1u);
    EXPECT_NE(scene.error(), "");
    EXPECT_EQ(scene.backlog().edits, 2u);
  }
  EXPECT_EQ(pictureOnceComplete(scene, Rasterizer::kTiles), expected);
  EXPECT_EQ(scene.report("view").map.revision, 3u);
  EXPECT_GT(scene.readSlots({kFirst + kMore - 1}).front().opacity, 0);
  EXPECT_EQ(scene.error(), "");
  EXPECT_EQ(scene.backlog().edits, 0u);
}

TEST_F(SplatRendererTest, LevelsEndWithTheirMapThoughTheNextOneIsRefused) {
  constexpr std::uint32_t kGroups = 20, kEach = 4096, kMore = 100000;
  SplatScene scene(shaders());
  for (std::uint32_t group = 0; group < kGroups; ++group) {
    OwnedBatch part = grid(group + 1, kEach * group, kEach, 4 + 0.2f * static_cast<float>(group));
    part.group = group;
    scene.apply(part);
  }
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  settings.detail = parseDetail("8px");
  scene.setCamera("view", 1, camera());
  scene.draw("view", settings, Canvas::kNone, true);
  EXPECT_GT(scene.bytes().levels, 0u);
  OwnedBatch next = grid(kGroups + 1, 0, kMore, 8);
  next.operation = GaussianBatch::REPLACE;
  {
    const FullDriver full(1 << 20);
    scene.apply(next);
    scene.draw("view", settings, Canvas::kNone, true);
    EXPECT_GT(FullDriver::refused(), 0);
    EXPECT_FALSE(scene.report("view").map.complete());
  }
  pictureOnceComplete(scene, Rasterizer::kTiles);
  EXPECT_EQ(scene.report("view").splats, kMore);
}

// As a RenderService asks for a picture, once a frame.
TEST_F(SplatRendererTest, APictureComesOfAMapThatIsEditedAllTheTime) {
  SplatScene scene(shaders());
  scene.apply(grid(1, 0, 20000, 8));
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kProcessor;
  scene.setCamera("service", 1, camera());
  std::uint64_t revision = 1;
  for (int picture = 1; picture <= 3; ++picture) {
    const std::uint64_t asked = ++revision;
    scene.apply(grid(asked, 0, 10, 8));
    scene.request("service", settings, true);
    for (int frame = 0; !scene.ready("service", settings, true); ++frame) {
      ASSERT_LT(frame, 1000);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      scene.apply(grid(++revision, 0, 10, 8));
      scene.request("service", settings, true);
    }
    scene.draw("service", settings, Canvas::kNone, true);
    EXPECT_GE(scene.report("service").map.revision, asked) << picture;
    EXPECT_FALSE(scene.readColor().empty());
  }
}

TEST_F(SplatRendererTest, WhoDrawsGoesOnWhereAnotherCannot) {
  SplatScene scene(shaders()), whole(shaders());
  const OwnedBatch first = grid(1, 0, 60000, 8), second = grid(2, 0, 5000, 6);
  for (SplatScene* of : {&scene, &whole}) of->apply(first);
  whole.apply(second);
  const auto on_card = picture(whole, Rasterizer::kTiles, OrderSource::kAuto);
  const auto by_processor = picture(whole, Rasterizer::kProcessor, OrderSource::kAuto);
  picture(scene, Rasterizer::kProcessor, OrderSource::kAuto);
  {
    const FullDriver full(1 << 20);
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
    const int refused = FullDriver::refused();
    EXPECT_GT(refused, 0);
    EXPECT_NE(scene.error().find("the rasterizer wasn't changed"), std::string::npos)
        << scene.error();
    EXPECT_TRUE(scene.report("view").map.complete());
    scene.apply(second);
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), by_processor);
    EXPECT_EQ(scene.report("view").rasterizer, "processor");
    EXPECT_EQ(FullDriver::refused(), refused);  // not tried with each frame
  }
  EXPECT_EQ(picture(scene, Rasterizer::kProcessor, OrderSource::kAuto), by_processor);
  EXPECT_EQ(scene.error(), "");
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), on_card);
  EXPECT_EQ(scene.error(), "");
}

TEST_F(SplatRendererTest, SwitchesUnderEditsLoseNone) {
  constexpr std::uint32_t kSwitches = 200, kSlotsEach = 40;
  const auto renderers = std::make_shared<Renderers>(shaders());
  const auto card = renderers->onCard();  // or its shaders would be compiled each time
  SplatScene scene(renderers);
  scene.apply(grid(1, 0, kSlotsEach, 8));
  std::atomic<bool> enough{false};
  std::uint64_t revision = 1;
  std::thread publisher([&] {
    while (!enough && revision < 5000) {
      ++revision;
      scene.apply(grid(revision, kSlotsEach * std::uint32_t(revision - 1), kSlotsEach, 8));
      std::this_thread::yield();
    }
  });
  RenderSettings settings;
  scene.setCamera("view", 1, camera());
  for (std::uint32_t i = 0; i < kSwitches; ++i) {
    settings.rasterizer = i % 2 == 0 ? Rasterizer::kProcessor : Rasterizer::kTiles;
    scene.upload(settings);
  }
  enough = true;
  publisher.join();
  settings.rasterizer = Rasterizer::kProcessor;
  scene.draw("view", settings, Canvas::kNone, true);
  std::vector<std::uint32_t> slots(kSlotsEach * revision);
  std::iota(slots.begin(), slots.end(), 0u);
  std::size_t lost = 0;
  for (const SplatValues& splat : scene.readSlots(slots)) lost += splat.opacity == 0;
  EXPECT_EQ(lost, 0u) << "of " << slots.size();
  EXPECT_EQ(scene.drawnMap().revision, revision);
}
