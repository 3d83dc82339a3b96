#pragma once

// Maps, cameras and windows for tests of the renderer in an OpenGL context without a window.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "splat_scene.hpp"
#include "windowless_display.hpp"

namespace rosplat {

constexpr int kSize = 64;  // of the picture [px]
// What colours of two differ by if one stops at a transmittance of 1e-4, as the processor does.
constexpr float kApart = 3e-4f;
constexpr std::uint32_t kSplats = 5000;                 // of the map
constexpr std::uint32_t kSlots = 5 * SlotPage::kSlots;  // of its pages

// rviz's kind of context, the compatibility profile, made current; null where there is none to be
// had. It shares nothing with others.
inline EGLContext makeContext() {
  const EGLDisplay display = windowlessDisplay();
  const std::vector<EGLint> wanted{EGL_CONTEXT_MAJOR_VERSION,
                                   4,
                                   EGL_CONTEXT_MINOR_VERSION,
                                   4,
                                   EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                   EGL_CONTEXT_OPENGL_COMPATIBILITY_PROFILE_BIT,
                                   EGL_NONE};
  if (!eglInitialize(display, nullptr, nullptr) || !eglBindAPI(EGL_OPENGL_API)) return nullptr;
  const EGLContext context =
      eglCreateContext(display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, wanted.data());
  const bool current = context && eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context);
  return current ? context : nullptr;
}

// What a driver gets wrong: shaders with a text replaced by another.
using Fault = std::pair<std::string, std::string>;

inline ShaderSource shaders(const Fault& fault = {}) {
  return [fault](const std::string& name) {
    std::ifstream file(ROSPLAT_MEDIA "/" + name);
    std::stringstream text;
    text << file.rdbuf();
    std::string source = text.str();
    for (auto at = source.find(fault.first); !fault.first.empty() && at != std::string::npos;
         at = source.find(fault.first, at + fault.second.size())) {
      source.replace(at, fault.first.size(), fault.second);
    }
    return source;
  };
}

// A framebuffer as a window may have one, with an opaque scene at a depth.
class Framebuffer {
 public:
  Framebuffer(GLenum depth_format, int samples, float depth, int size = kSize) {
    glGenFramebuffers(1, &id_);
    glGenRenderbuffers(2, buffers_.data());
    glBindFramebuffer(GL_FRAMEBUFFER, id_);
    const auto attach = [&](std::size_t i, GLenum format, GLenum where) {
      glBindRenderbuffer(GL_RENDERBUFFER, buffers_[i]);
      glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, format, size, size);
      glFramebufferRenderbuffer(GL_FRAMEBUFFER, where, GL_RENDERBUFFER, buffers_[i]);
    };
    attach(0, GL_RGBA8, GL_COLOR_ATTACHMENT0);
    if (depth_format) attach(1, depth_format, GL_DEPTH_ATTACHMENT);
    glViewport(0, 0, size, size);
    glClearColor(0, 0, 0, 0);
    glClearDepth(depth);
    glDepthMask(GL_TRUE);
    glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  }
  ~Framebuffer() {
    glDeleteFramebuffers(1, &id_);
    glDeleteRenderbuffers(2, buffers_.data());
  }
  Framebuffer(const Framebuffer&) = delete;
  Framebuffer& operator=(const Framebuffer&) = delete;

 private:
  GLuint id_ = 0;
  std::array<GLuint, 2> buffers_{};
};

// Looks along z, with a far plane 100 m away.
inline SplatCamera camera() {
  SplatCamera camera =
      makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 40, 40, 32, 32, kSize, kSize, 0.1, 100);
  camera.ndc_scale = (100 + 0.1) / (100 - 0.1);
  camera.ndc_offset = -2 * 100 * 0.1 / (100 - 0.1);
  return camera;
}

// The same of four times as many pixels across and down, so that there are several macro tiles.
inline SplatCamera largeCamera() {
  SplatCamera large = makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 160, 160, 128, 128, 4 * kSize,
                                 4 * kSize, 0.1, 100);
  large.ndc_scale = camera().ndc_scale;
  large.ndc_offset = camera().ndc_offset;
  return large;
}

// What a depth buffer holds at a distance.
inline float windowDepth(double z) {
  return static_cast<float>(0.5 + 0.5 * (camera().ndc_scale + camera().ndc_offset / z));
}

// Coloured splats of one size.
struct Splats {
  void add(const std::array<float, 3>& position, const std::array<float, 3>& colour,
           float size = 0.3f) {
    splats.add(position, {size, size, size}, 0.6f, {colour.begin(), colour.end()});
  }

  OwnedBatch batch(std::uint64_t revision, const std::vector<std::uint32_t>& slots) const {
    OwnedBatch batch = splats;
    batch.revision = revision;
    batch.operation = revision == 1 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT;
    batch.slot_list = slots;
    batch.look();
    return batch;
  }

  OwnedBatch splats;
};

// In no order.
inline Splats manySplats(float size = 0.3f) {
  Splats splats;
  for (std::uint32_t i = 0; i < kSplats; ++i) {
    const auto part = [i](double step) { return static_cast<float>(std::fmod(step * i, 1.0)); };
    const float z = 5 + 10 * part(0.6180339887);
    splats.add({0.8f * z * (part(0.7548776662) - 0.5f), 0.8f * z * (part(0.5698402909) - 0.5f), z},
               {4 * part(0.8191725134) - 2, 4 * part(0.6710436067) - 2, 4 * part(0.5497004779) - 2},
               size);
  }
  return splats;
}

inline void fill(SplatScene& scene) { scene.apply(manySplats().batch(1, {})); }

// Splat i sits at (i, 0, 5).
inline OwnedBatch splatsInARow(std::uint32_t count, std::uint8_t sh_degree) {
  OwnedBatch batch;
  batch.count = count;
  batch.sh_degree = sh_degree;
  batch.position.assign(3 * count, 5);
  for (std::uint32_t i = 0; i < count; ++i) {
    batch.position[3 * i] = float(i);
    batch.position[3 * i + 1] = 0;
  }
  batch.orientation.assign(4 * count, 0.5f);
  batch.scale.assign(3 * count, 0.1f);
  batch.opacity.assign(count, 0.5f);
  batch.harmonics.assign(3u * (sh_degree + 1u) * (sh_degree + 1u) * count, 0.1f);
  batch.look();
  return batch;
}

inline std::vector<float> picture(SplatScene& scene, Rasterizer rasterizer, OrderSource order,
                                  Canvas canvas = Canvas::kNone,
                                  const SplatCamera& seen_by = camera()) {
  RenderSettings settings;
  settings.rasterizer = rasterizer;
  settings.order = order;
  scene.setCamera("view", 1, seen_by);
  scene.draw("view", settings, canvas, true);
  return scene.readColor();
}

// What rviz's mouse tools draw of a map.
inline SplatScene::Picture underMouse(SplatScene& scene, const RenderSettings& settings,
                                      const SplatCamera& seen_by = camera()) {
  SplatScene::Picture picture;
  picture.add(scene, scene.layerUnderMouse("view", settings, seen_by));
  return picture;
}

inline std::vector<std::uint32_t> picked(SplatScene& scene, const SplatCamera& seen_by = camera()) {
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  underMouse(scene, settings, seen_by).drawPick(Canvas::kNone, 0);
  return scene.pick().front().slots();
}

inline std::size_t gpuBytes(const SplatScene& scene) {
  return scene.bytes().gpu + scene.bytes().shared_gpu;
}

inline float greatestDifference(const std::vector<float>& a, const std::vector<float>& b) {
  float greatest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) greatest = std::max(greatest, std::abs(a[i] - b[i]));
  return greatest;
}

class SplatRendererTest : public testing::Test {
 protected:
  void SetUp() override {
    static const EGLContext context = makeContext();
    if (!context) GTEST_SKIP() << "no OpenGL 4.4 without a window here";
  }
  void TearDown() override { EXPECT_EQ(glGetError(), GLenum(GL_NO_ERROR)); }
};

// Adds a splat of another batch, if that has any.
inline void addFrom(const OwnedBatch& from, std::uint32_t i, OwnedBatch& to) {
  for (const auto values : {&OwnedBatch::position, &OwnedBatch::orientation, &OwnedBatch::scale,
                            &OwnedBatch::opacity, &OwnedBatch::harmonics, &OwnedBatch::values}) {
    const std::size_t width = (from.*values).size() / from.count;
    const auto at = (from.*values).begin() + std::ptrdiff_t(width * i);
    (to.*values).insert((to.*values).end(), at, at + std::ptrdiff_t(width));
  }
  to.sh_degree = from.sh_degree;
  to.channel_names = from.channel_names;
  ++to.count;
}

inline RenderSettings detailed(const char* detail, Rasterizer rasterizer) {
  RenderSettings settings;
  settings.rasterizer = rasterizer;
  settings.detail = parseDetail(detail);
  return settings;
}

inline std::vector<float> cutPicture(SplatScene& scene, const RenderSettings& settings,
                                     const char* view_id = "view",
                                     const SplatCamera& of = camera()) {
  scene.setCamera(view_id, 1, of);
  scene.draw(view_id, settings, Canvas::kNone, !settings.interactive);
  return scene.readColor();
}

// Small ones near each other, of which nodes are made: a wall 8 m away.
inline void addWall(Splats& splats, std::uint32_t count, std::uint32_t seed) {
  const auto part = [seed](double step, std::uint32_t i) {
    return static_cast<float>(std::fmod(step * (i + 1000.0 * seed), 1.0));
  };
  for (std::uint32_t i = 0; i < count; ++i) {
    splats.add(
        {12 * part(0.7548776662, i) - 6, 12 * part(0.5698402909, i) - 6, 8 + part(0.6180339887, i)},
        {4 * part(0.8191725134, i) - 2, 4 * part(0.6710436067, i) - 2, 1}, 0.1f);
  }
}

// A map that is a wall, and its levels.
inline void fillWithWall(SplatScene& scene, std::uint32_t count, std::uint32_t seed) {
  Splats splats;
  addWall(splats, count, seed);
  scene.apply(splats.batch(1, {}));
  cutPicture(scene, detailed("1px", Rasterizer::kTiles), "waited");
}

}  // namespace rosplat
