// The renderer in an OpenGL context without a window: what drivers may do to it, and it to others.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "../src/splats/splat_scene.hpp"

using namespace rosplat;

namespace {

constexpr int kSize = 64;  // of the picture [px]

// rviz's kind of context: the compatibility profile. False where there is none to be had.
bool makeContext() {
  const EGLDisplay display =
      eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
  const std::vector<EGLint> wanted{EGL_CONTEXT_MAJOR_VERSION,
                                   4,
                                   EGL_CONTEXT_MINOR_VERSION,
                                   4,
                                   EGL_CONTEXT_OPENGL_PROFILE_MASK,
                                   EGL_CONTEXT_OPENGL_COMPATIBILITY_PROFILE_BIT,
                                   EGL_NONE};
  if (!eglInitialize(display, nullptr, nullptr) || !eglBindAPI(EGL_OPENGL_API)) return false;
  const EGLContext context =
      eglCreateContext(display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, wanted.data());
  return context && eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context);
}

// What a driver gets wrong: shaders with a text replaced by another.
using Fault = std::pair<std::string, std::string>;

ShaderSource shaders(const Fault& fault = {}) {
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
  Framebuffer(GLenum depth_format, int samples, float depth) {
    glGenFramebuffers(1, &id_);
    glGenRenderbuffers(2, buffers_.data());
    glBindFramebuffer(GL_FRAMEBUFFER, id_);
    attach(0, GL_RGBA8, GL_COLOR_ATTACHMENT0, samples);
    if (depth_format) attach(1, depth_format, GL_DEPTH_ATTACHMENT, samples);
    glViewport(0, 0, kSize, kSize);
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
  void attach(std::size_t i, GLenum format, GLenum where, int samples) {
    glBindRenderbuffer(GL_RENDERBUFFER, buffers_[i]);
    glRenderbufferStorageMultisample(GL_RENDERBUFFER, samples, format, kSize, kSize);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, where, GL_RENDERBUFFER, buffers_[i]);
  }

  GLuint id_ = 0;
  std::array<GLuint, 2> buffers_{};
};

// Looks along z, with a far plane 100 m away.
SplatCamera camera() {
  SplatCamera camera =
      makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 40, 40, 32, 32, kSize, kSize, 0.1, 100);
  camera.ndc_scale = (100 + 0.1) / (100 - 0.1);
  camera.ndc_offset = -2 * 100 * 0.1 / (100 - 0.1);
  return camera;
}

// What a depth buffer holds at a distance.
float windowDepth(double z) {
  return static_cast<float>(0.5 + 0.5 * (camera().ndc_scale + camera().ndc_offset / z));
}

// Many coloured splats 5 to 15 m away, in no order.
void fill(SplatScene& scene) {
  constexpr std::uint32_t kCount = 5000;
  std::vector<float> positions, orientations, scales, opacities, sh;
  for (std::uint32_t i = 0; i < kCount; ++i) {
    const auto part = [i](double step) { return static_cast<float>(std::fmod(step * i, 1.0)); };
    const float z = 5 + 10 * part(0.6180339887);
    positions.insert(positions.end(), {0.8f * z * (part(0.7548776662) - 0.5f),
                                       0.8f * z * (part(0.5698402909) - 0.5f), z});
    orientations.insert(orientations.end(), {0, 0, 0, 1});
    scales.insert(scales.end(), 3, 0.3f);
    opacities.push_back(0.6f);
    sh.insert(sh.end(),
              {4 * part(0.8191725134) - 2, 4 * part(0.6710436067) - 2, 4 * part(0.5497004779) - 2});
  }
  GaussianBatch batch;
  batch.map_id = "map";
  batch.revision = 1;
  batch.count = kCount;
  batch.positions = {positions.data(), positions.size()};
  batch.orientations = {orientations.data(), orientations.size()};
  batch.scales = {scales.data(), scales.size()};
  batch.opacities = {opacities.data(), opacities.size()};
  batch.sh = {sh.data(), sh.size()};
  scene.apply(batch);
}

std::vector<float> picture(SplatScene& scene, Rasterizer rasterizer, OrderSource order,
                           Canvas canvas = Canvas::kNone) {
  RenderSettings settings;
  settings.float_blending = true;
  settings.rasterizer = rasterizer;
  settings.order = order;
  settings.wait_for_order = true;
  scene.setCamera("view", 1, camera());
  scene.draw("view", settings, canvas);
  return scene.readColor();
}

float greatestDifference(const std::vector<float>& a, const std::vector<float>& b) {
  float greatest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) greatest = std::max(greatest, std::abs(a[i] - b[i]));
  return greatest;
}

class SplatRendererTest : public testing::Test {
 protected:
  void SetUp() override {
    static const bool context = makeContext();
    if (!context) GTEST_SKIP() << "no OpenGL 4.4 without a window here";
  }
  void TearDown() override { EXPECT_EQ(glGetError(), GLenum(GL_NO_ERROR)); }
};

}  // namespace

TEST_F(SplatRendererTest, SortsOnTheGpuAsTheProcessorDoes) {
  SplatScene scene(shaders());
  fill(scene);
  const auto expected = picture(scene, Rasterizer::kQuads, OrderSource::kBuiltIn);
  EXPECT_EQ(scene.report("view").order_source, "built-in");
  EXPECT_EQ(picture(scene, Rasterizer::kQuads, OrderSource::kGpu), expected);
  EXPECT_EQ(scene.report("view").order_source, "gpu");
  EXPECT_LT(greatestDifference(picture(scene, Rasterizer::kTiles, OrderSource::kGpu), expected),
            1e-4f);
  EXPECT_STREQ(scene.report("view").rasterizer.c_str(), "tiles");
  EXPECT_EQ(scene.warning(), "");
}

// Where lanes don't vote as the driver says. Without subgroups, nothing of this runs.
TEST_F(SplatRendererTest, SortsWithoutSubgroupsThatVoteWrongly) {
  SplatScene scene(shaders({"subgroupBallot(valid).x", "subgroupBallot(valid).x & 0xffffu"}));
  fill(scene);
  const auto expected = picture(scene, Rasterizer::kQuads, OrderSource::kBuiltIn);
  EXPECT_EQ(picture(scene, Rasterizer::kQuads, OrderSource::kGpu), expected);
  EXPECT_EQ(scene.report("view").order_source, "gpu");
  const bool subgroups = epoxy_has_gl_extension("GL_KHR_shader_subgroup");
  EXPECT_EQ(scene.warning().find("subgroups") != std::string::npos, subgroups);
}

TEST_F(SplatRendererTest, DrawsTheProcessorsOrderWhereTheGpuSortsWrongly) {
  SplatScene good(shaders());
  fill(good);
  const auto expected = picture(good, Rasterizer::kQuads, OrderSource::kBuiltIn);
  // One that isn't stable, and one that loses keys.
  for (const Fault& fault :
       {Fault{"+ earlier", "+ 0u"}, Fault{"i < size) sorted_values", "i > 9u) sorted_values"}}) {
    SplatScene scene(shaders(fault));
    fill(scene);
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kGpu), expected);
    EXPECT_EQ(scene.report("view").order_source, "built-in");
    EXPECT_EQ(scene.report("view").rasterizer, "quads");
    EXPECT_NE(scene.warning().find("sorts wrongly"), std::string::npos);
  }
}

// A depth is copied only to its own format.
TEST_F(SplatRendererTest, IsHiddenByAnOpaqueSceneInWhateverDepthFormat) {
  SplatScene scene(shaders());
  fill(scene);
  const auto all = picture(scene, Rasterizer::kQuads, OrderSource::kBuiltIn);
  std::vector<std::vector<float>> hidden;
  for (const GLenum format : {GL_DEPTH24_STENCIL8, GL_DEPTH_COMPONENT16, GL_DEPTH_COMPONENT24,
                              GL_DEPTH_COMPONENT32, GL_DEPTH_COMPONENT32F, GL_DEPTH32F_STENCIL8}) {
    for (const int samples : {0, 4}) {
      SCOPED_TRACE(testing::Message() << std::hex << format << ", samples " << samples);
      const Framebuffer window(format, samples, windowDepth(6));
      for (const Rasterizer rasterizer : {Rasterizer::kQuads, Rasterizer::kTiles}) {
        hidden.push_back(picture(scene, rasterizer, OrderSource::kGpu, Canvas::kWindow));
        EXPECT_EQ(scene.warning(), "");
        EXPECT_EQ(glGetError(), GLenum(GL_NO_ERROR));
        // 16 bits put a splat near the scene's depth on the other side of it.
        EXPECT_LT(greatestDifference(hidden.back(), hidden.front()), 0.1f);
      }
    }
  }
  EXPECT_GT(greatestDifference(all, hidden.front()), 0.2f);
}
