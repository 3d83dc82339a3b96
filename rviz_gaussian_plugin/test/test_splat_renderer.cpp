// The renderer in an OpenGL context without a window: what drivers may do to it, and it to others.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <sstream>
#include <string>
#include <thread>
#include <type_traits>
#include <utility>
#include <vector>

#include "gpu/slot_store.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"
#include "windowless_display.hpp"

using namespace rosplat;

namespace {

constexpr int kSize = 64;  // of the picture [px]
// What colours of two differ by if one stops at a transmittance of 1e-4, as the processor does.
constexpr float kApart = 3e-4f;
constexpr std::uint32_t kSplats = 5000;  // of the map

// rviz's kind of context, the compatibility profile, made current; null where there is none to be
// had. It shares nothing with others.
EGLContext makeContext() {
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
SplatCamera camera() {
  SplatCamera camera =
      makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 40, 40, 32, 32, kSize, kSize, 0.1, 100);
  camera.ndc_scale = (100 + 0.1) / (100 - 0.1);
  camera.ndc_offset = -2 * 100 * 0.1 / (100 - 0.1);
  return camera;
}

// The same of four times as many pixels across and down, so that there are several macro tiles.
SplatCamera largeCamera() {
  SplatCamera large = makeCamera({0, 0, 0}, {0, 0, 0, 1}, false, 160, 160, 128, 128, 4 * kSize,
                                 4 * kSize, 0.1, 100);
  large.ndc_scale = camera().ndc_scale;
  large.ndc_offset = camera().ndc_offset;
  return large;
}

// What a depth buffer holds at a distance.
float windowDepth(double z) {
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
Splats manySplats(float size = 0.3f) {
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

void fill(SplatScene& scene) { scene.apply(manySplats().batch(1, {})); }

// Splat i sits at (i, 0, 5).
OwnedBatch splatsInARow(std::uint32_t count, std::uint8_t sh_degree) {
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

std::vector<float> picture(SplatScene& scene, Rasterizer rasterizer, OrderSource order,
                           Canvas canvas = Canvas::kNone, const SplatCamera& seen_by = camera()) {
  RenderSettings settings;
  settings.float_blending = true;
  settings.rasterizer = rasterizer;
  settings.order = order;
  scene.setCamera("view", 1, seen_by);
  scene.draw("view", settings, canvas, true);
  return scene.readColor();
}

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
  settings.float_blending = true;
  settings.rasterizer = Rasterizer::kTiles;
  settings.order = OrderSource::kSidecar;
  scene.setCamera("view", 1, camera());
  scene.offer(order);
  scene.draw("view", settings, Canvas::kNone);
  return scene.readColor();
}

std::vector<std::uint32_t> picked(SplatScene& scene, const SplatCamera& seen_by = camera()) {
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  SplatScene::drawPick({{&scene, "view", settings, seen_by}}, Canvas::kNone, 0);
  return scene.pick().front().slots();
}

std::size_t gpuBytes(const SplatScene& scene) {
  return scene.bytes().gpu + scene.bytes().shared_gpu;
}

// NaN where there is no splat.
bool sameDepths(const std::vector<float>& a, const std::vector<float>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](float one, float other) {
    return one == other || (std::isnan(one) && std::isnan(other));
  });
}

float greatestDifference(const std::vector<float>& a, const std::vector<float>& b) {
  float greatest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) greatest = std::max(greatest, std::abs(a[i] - b[i]));
  return greatest;
}

// What others may have set, and rely on: values by name, unit or index, component.
using State = std::map<std::array<GLuint, 3>, GLint>;

State state() {
  State values;
  const auto get = [&](GLenum name, GLuint of = 0, GLuint count = 1) {
    std::array<GLint, 4> got{};
    glGetIntegerv(name, got.data());
    for (GLuint i = 0; i < count; ++i) values[{name, of, i}] = got[i];
  };
  for (const GLenum name : {GL_CURRENT_PROGRAM,
                            GL_VERTEX_ARRAY_BINDING,
                            GL_ARRAY_BUFFER_BINDING,
                            GL_DRAW_FRAMEBUFFER_BINDING,
                            GL_READ_FRAMEBUFFER_BINDING,
                            GL_RENDERBUFFER_BINDING,
                            GL_COPY_READ_BUFFER_BINDING,
                            GL_COPY_WRITE_BUFFER_BINDING,
                            GL_DRAW_INDIRECT_BUFFER_BINDING,
                            GL_DISPATCH_INDIRECT_BUFFER_BINDING,
                            GL_PIXEL_PACK_BUFFER_BINDING,
                            GL_PACK_ROW_LENGTH,
                            GL_PACK_ALIGNMENT,
                            GL_PACK_SKIP_PIXELS,
                            GL_UNPACK_ROW_LENGTH,
                            GL_DEPTH_TEST,
                            GL_DEPTH_FUNC,
                            GL_DEPTH_WRITEMASK,
                            GL_BLEND,
                            GL_BLEND_SRC_RGB,
                            GL_BLEND_DST_RGB,
                            GL_BLEND_SRC_ALPHA,
                            GL_BLEND_DST_ALPHA,
                            GL_BLEND_EQUATION_RGB,
                            GL_ALPHA_TEST,
                            GL_CULL_FACE,
                            GL_SCISSOR_TEST,
                            GL_STENCIL_TEST,
                            GL_POLYGON_OFFSET_FILL,
                            GL_SAMPLE_ALPHA_TO_COVERAGE,
                            GL_FRAMEBUFFER_SRGB,
                            GL_ATTRIB_STACK_DEPTH,
                            GL_CLIENT_ATTRIB_STACK_DEPTH,
                            GL_MATRIX_MODE,
                            GL_DRAW_BUFFER,
                            GL_READ_BUFFER,
                            GL_ACTIVE_TEXTURE}) {
    get(name);
  }
  for (const GLenum name : {GL_VIEWPORT, GL_SCISSOR_BOX, GL_COLOR_WRITEMASK}) get(name, 0, 4);
  get(GL_POLYGON_MODE, 0, 2);
  for (GLuint unit = 0; unit < 7; ++unit) {
    glActiveTexture(GL_TEXTURE0 + unit);
    for (const GLenum name :
         {GL_TEXTURE_BINDING_2D, GL_TEXTURE_BINDING_2D_MULTISAMPLE, GL_TEXTURE_2D}) {
      get(name, unit);
    }
  }
  glActiveTexture(static_cast<GLenum>(values[{GL_ACTIVE_TEXTURE, 0, 0}]));
  for (GLuint i = 0; i < 16; ++i) {
    glGetIntegeri_v(GL_SHADER_STORAGE_BUFFER_BINDING, i,
                    &values[{GL_SHADER_STORAGE_BUFFER_BINDING, i, 0}]);
  }
  for (GLuint i = 0; i < 4; ++i) {
    glGetIntegeri_v(GL_IMAGE_BINDING_NAME, i, &values[{GL_IMAGE_BINDING_NAME, i, 0}]);
  }
  return values;
}

// What isn't as it was before, nothing at best.
State changed(const State& before) {
  State now = state();
  for (const auto& [name, value] : before) {
    if (now[name] == value) now.erase(name);
  }
  return now;
}

// Leaves the state as awkward as an Ogre that has drawn other things might.
class OthersState {
 public:
  OthersState() {
    glGenTextures(4, textures_.data());
    for (GLenum unit = 0; unit < 3; ++unit) {
      glActiveTexture(GL_TEXTURE0 + unit);
      glBindTexture(GL_TEXTURE_2D, textures_[unit]);
    }
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, textures_[3]);
    glActiveTexture(GL_TEXTURE0);
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, textures_[3]);
    glActiveTexture(GL_TEXTURE1);
    glBindTexture(GL_TEXTURE_2D_MULTISAMPLE, textures_[3]);
    glGenBuffers(2, buffers_.data());
    glBindBuffer(GL_ARRAY_BUFFER, buffers_[0]);
    glBindBuffer(GL_PIXEL_PACK_BUFFER, buffers_[1]);
    for (const GLenum target :
         {GL_COPY_READ_BUFFER, GL_COPY_WRITE_BUFFER, GL_DISPATCH_INDIRECT_BUFFER}) {
      glBindBuffer(target, 0);
    }
    glBindBuffersBase(GL_SHADER_STORAGE_BUFFER, 0, 16, nullptr);
    glBindImageTextures(0, 4, nullptr);
    glPixelStorei(GL_PACK_ROW_LENGTH, 7);
    glPixelStorei(GL_PACK_SKIP_PIXELS, 1);
    for (const GLenum on : kOn) glEnable(on);
    glAlphaFunc(GL_NEVER, 0);
    glStencilFunc(GL_NEVER, 0, 0xff);
    glScissor(1, 2, 3, 4);
    glCullFace(GL_FRONT_AND_BACK);
    glDepthFunc(GL_NEVER);
    glDepthMask(GL_FALSE);
    glColorMask(GL_FALSE, GL_TRUE, GL_FALSE, GL_TRUE);
    glBlendFunc(GL_ZERO, GL_ZERO);
    glBlendEquation(GL_FUNC_SUBTRACT);
    glPolygonMode(GL_FRONT_AND_BACK, GL_LINE);
  }
  ~OthersState() {
    glDeleteTextures(4, textures_.data());
    glDeleteBuffers(2, buffers_.data());
    glPixelStorei(GL_PACK_ROW_LENGTH, 0);
    glPixelStorei(GL_PACK_SKIP_PIXELS, 0);
    for (const GLenum on : kOn) glDisable(on);
    glDepthFunc(GL_LESS);
    glDepthMask(GL_TRUE);
    glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
    glBlendEquation(GL_FUNC_ADD);
    glPolygonMode(GL_FRONT_AND_BACK, GL_FILL);
  }
  OthersState(const OthersState&) = delete;
  OthersState& operator=(const OthersState&) = delete;

 private:
  static constexpr std::array<GLenum, 8> kOn{GL_ALPHA_TEST,
                                             GL_STENCIL_TEST,
                                             GL_SCISSOR_TEST,
                                             GL_CULL_FACE,
                                             GL_DEPTH_TEST,
                                             GL_POLYGON_OFFSET_FILL,
                                             GL_SAMPLE_ALPHA_TO_COVERAGE,
                                             GL_BLEND};
  std::array<GLuint, 4> textures_{};
  std::array<GLuint, 2> buffers_{};
};

// A driver that is said to have buffers of a size, and subgroups of one or (0) none; notes the
// shaders that it gets.
class Disguise {
 public:
  Disguise(GLint64 largest_buffer, GLint subgroup_size) {
    largest_buffer_ = largest_buffer;
    subgroup_size_ = subgroup_size;
    epoxy_glGetInteger64v = [](GLenum name, GLint64* value) {
      real<PFNGLGETINTEGER64VPROC>("glGetInteger64v")(name, value);
      if (name == GL_MAX_SHADER_STORAGE_BLOCK_SIZE) *value = largest_buffer_;
    };
    epoxy_glGetIntegerv = [](GLenum name, GLint* value) {
      const bool subgroup =
          name >= GL_SUBGROUP_SIZE_KHR && name <= GL_SUBGROUP_SUPPORTED_FEATURES_KHR;
      if (!subgroup) return real<PFNGLGETINTEGERVPROC>("glGetIntegerv")(name, value);
      *value = name == GL_SUBGROUP_SIZE_KHR ? subgroup_size_ : ~0;
    };
    // The last of its extensions is another.
    epoxy_glGetStringi = [](GLenum name, GLuint index) {
      GLint count = 0;
      glGetIntegerv(GL_NUM_EXTENSIONS, &count);
      if (name == GL_EXTENSIONS && index + 1 == static_cast<GLuint>(count)) {
        return reinterpret_cast<const GLubyte*>("GL_KHR_shader_subgroup");
      }
      return real<PFNGLGETSTRINGIPROC>("glGetStringi")(name, index);
    };
    epoxy_glShaderSource = [](GLuint shader, GLsizei count, const GLchar* const* text,
                              const GLint* length) {
      GLint stage = 0;
      glGetShaderiv(shader, GL_SHADER_TYPE, &stage);
      noted.emplace(*text, static_cast<GLenum>(stage));
      real<PFNGLSHADERSOURCEPROC>("glShaderSource")(shader, count, text, length);
    };
  }
  ~Disguise() {
    epoxy_glGetInteger64v = real<PFNGLGETINTEGER64VPROC>("glGetInteger64v");
    epoxy_glGetIntegerv = real<PFNGLGETINTEGERVPROC>("glGetIntegerv");
    epoxy_glGetStringi = real<PFNGLGETSTRINGIPROC>("glGetStringi");
    epoxy_glShaderSource = real<PFNGLSHADERSOURCEPROC>("glShaderSource");
  }
  Disguise(const Disguise&) = delete;
  Disguise& operator=(const Disguise&) = delete;

  static inline std::map<std::string, GLenum> noted;  // their stages

 private:
  template <typename Function>
  static Function real(const char* name) {
    return reinterpret_cast<Function>(eglGetProcAddress(name));
  }

  static inline GLint64 largest_buffer_ = 0;
  static inline GLint subgroup_size_ = 0;
};

bool anyCall(...) { return true; }

// Counts the calls of a function of the driver, or those whose arguments `counts` wants.
template <auto* function, auto counts = anyCall>
class Calls {
 public:
  Calls() : real_(*function) {
    count_ = 0;
    driver_ = real_;
    *function = counting(real_);
  }
  ~Calls() { *function = real_; }
  Calls(const Calls&) = delete;
  Calls& operator=(const Calls&) = delete;

  static int count() { return count_; }

 private:
  using Pointer = std::remove_reference_t<decltype(*function)>;

  template <typename Result, typename... Args>
  static Pointer counting(Result (*)(Args...)) {
    return [](Args... args) {
      count_ += counts(args...);
      return driver_(args...);
    };
  }

  static inline int count_ = 0;
  static inline Pointer driver_ = nullptr;
  Pointer real_;
};
using Waits = Calls<&epoxy_glFinish>;  // for the graphics card

// A driver that refuses buffers of more bytes than a limit, if they are multiples of so many.
class BufferLimit {
 public:
  explicit BufferLimit(GLsizeiptr most = std::numeric_limits<GLsizeiptr>::max(),
                       GLsizeiptr multiple = 1)
      : before_(epoxy_glBufferData) {
    largest = 0;
    most_ = most;
    multiple_ = multiple;
    epoxy_glBufferData = [](GLenum target, GLsizeiptr bytes, const void* data, GLenum usage) {
      largest = std::max(largest, bytes);
      const bool refused = bytes > most_ && bytes % multiple_ == 0;
      reinterpret_cast<PFNGLBUFFERDATAPROC>(eglGetProcAddress("glBufferData"))(
          target, refused ? -1 : bytes, data, usage);
    };
  }
  ~BufferLimit() {
    epoxy_glBufferData = before_;
    most_ = std::numeric_limits<GLsizeiptr>::max();
  }
  BufferLimit(const BufferLimit&) = delete;
  BufferLimit& operator=(const BufferLimit&) = delete;

  static inline GLsizeiptr largest = 0;  // that was asked for

 private:
  static inline GLsizeiptr most_ = 0, multiple_ = 1;
  PFNGLBUFFERDATAPROC before_;
};

class SplatRendererTest : public testing::Test {
 protected:
  void SetUp() override {
    static const EGLContext context = makeContext();
    if (!context) GTEST_SKIP() << "no OpenGL 4.4 without a window here";
  }
  void TearDown() override { EXPECT_EQ(glGetError(), GLenum(GL_NO_ERROR)); }
};

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
    settings.float_blending = true;
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

TEST_F(SplatRendererTest, LaysSplatsOverATextureAsOverAWindow) {
  SplatScene scene(shaders());
  fill(scene);
  std::vector<std::vector<std::uint8_t>> pictures;
  for (const bool texture : {false, true}) {
    const Framebuffer framebuffer(GL_DEPTH24_STENCIL8, 0, 1);
    GLuint picture_of = 0;
    glGenTextures(1, &picture_of);
    glBindTexture(GL_TEXTURE_2D, picture_of);
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA8, kSize, kSize);
    if (texture) {
      glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, picture_of, 0);
    }
    glClearColor(0.2f, 0.4f, 0.6f, 1);
    glClear(GL_COLOR_BUFFER_BIT);
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kTexture);
    pictures.emplace_back(4 * kSize * kSize);
    glReadPixels(0, 0, kSize, kSize, GL_RGBA, GL_UNSIGNED_BYTE, pictures.back().data());
    glDeleteTextures(1, &picture_of);
  }
  int greatest = 0;
  for (std::size_t i = 0; i < pictures[0].size(); ++i) {
    greatest = std::max(greatest, std::abs(int(pictures[0][i]) - int(pictures[1][i])));
  }
  EXPECT_LE(greatest, 1);  // of 255, by rounding
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
  settings.float_blending = true;
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
  EXPECT_EQ(scene.report("view").order_source, "nobody");
  EXPECT_EQ(scene.report("view").splats, 1024u + 1);
  EXPECT_LT(greatestDifference(picture(scene, Rasterizer::kProcessor, OrderSource::kOff), drawn),
            1e-4f);
  EXPECT_EQ(scene.report("view").order_source, "nobody");
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
    return Disguise(static_cast<GLint64>(splats * Shaders::kEllipseBytes), 0);
  };
  // In two parts; and in four, which leave no room for the lists of all tiles.
  for (const std::size_t parts : {2u, 4u}) {
    const Disguise disguise = buffersOf(kSplats / parts);
    SplatScene scene(shaders());
    scene.apply(small);
    for (int frame = 0; frame < 3; ++frame) EXPECT_EQ(of(scene), expected);
    EXPECT_TRUE(sameDepths(scene.readDepth(), depths));
    EXPECT_EQ(picked(scene, largeCamera()), expected_picks);
  }
  const Disguise disguise = buffersOf(kSplats / 5);  // there are four parts at most
  SplatScene scene(shaders());
  scene.apply(small);
  EXPECT_THROW(of(scene), gl::Error);
}

// Lists that find no room are made region by region; as soon as they find it, at once.
TEST_F(SplatRendererTest, DrawsInRegionsWhereListsAreTooMuch) {
  const Disguise disguise(static_cast<GLint64>(kSplats / 4 * Shaders::kEllipseBytes), 0);
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
  const Disguise disguise(static_cast<GLint64>(kSplats / 4 * Shaders::kEllipseBytes), 0);
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
    SplatCamera moved = largeCamera();
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
  fillWith(300000);
  const std::size_t most = bytesDrawn();
  fillWith(1000);
  std::size_t left = most;
  for (int frame = 0; frame < kFrames; ++frame) left = bytesDrawn();
  EXPECT_EQ(scene.report("view").splats, 1000u);
  EXPECT_LT(left, most / 2);
}

// Long lists whose segments find no memory are blended whole.
TEST_F(SplatRendererTest, DrawsTheSameWhereSegmentsFindNoMemory) {
  Splats splats;
  for (int i = 0; i < 40000; ++i) {
    splats.splats.add({0, 0, 5}, {0.025f, 0.025f, 0.025f}, 0.01f, {1, 1, 1});
  }
  SplatScene scene(shaders());
  scene.apply(splats.batch(1, {}));
  const auto of = [](SplatScene& drawn) {
    return picture(drawn, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kNone, largeCamera());
  };
  const auto expected = of(scene);
  scene.forget("view");
  // Of what a frame asks for, segments alone take a multiple of 4 KiB.
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

// Wherever slots are, and in whatever order they come: pages are found and numbered.
TEST_F(SplatRendererTest, DrawsTheSameFromSparseSlotsThatComeBackwards) {
  SplatScene dense(shaders());
  fill(dense);
  SplatScene sparse(shaders());
  const Splats all = manySplats();
  constexpr std::uint32_t kBatch = 500, kApart = 300;
  std::uint64_t revision = 0;
  for (std::uint32_t end = kSplats; end > 0; end -= kBatch) {
    Splats some;
    std::vector<std::uint32_t> slots;
    for (std::uint32_t i = end - kBatch; i < end; ++i) {
      some.add({all.splats.position[3 * i], all.splats.position[3 * i + 1],
                all.splats.position[3 * i + 2]},
               {all.splats.harmonics[3 * i], all.splats.harmonics[3 * i + 1],
                all.splats.harmonics[3 * i + 2]});
      slots.push_back(kApart * i);
    }
    sparse.apply(some.batch(++revision, slots));
  }
  EXPECT_EQ(picture(sparse, Rasterizer::kTiles, OrderSource::kAuto),
            picture(dense, Rasterizer::kTiles, OrderSource::kAuto));
  std::vector<std::uint32_t> picks = picked(dense);
  for (std::uint32_t& slot : picks) slot *= slot == kNoSlot ? 1 : kApart;
  EXPECT_EQ(picked(sparse), picks);
  const auto values = sparse.readSlots({kApart * 7, 1, kApart * 4999});
  EXPECT_FLOAT_EQ(float(values[0].position[0]), all.splats.position[3 * 7]);
  EXPECT_EQ(values[1].opacity, 0);
  EXPECT_FLOAT_EQ(float(values[2].position[2]), all.splats.position[3 * 4999 + 2]);
}

TEST_F(SplatRendererTest, UploadsEditsWithoutWaitingForTheCard) {
  SplatScene scene(shaders());
  fill(scene);
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  const Waits counted;
  Splats one;
  one.add({0, 0, 5}, {1, 0, 0});
  for (std::uint32_t edit = 0; edit < 20; ++edit) {
    scene.apply(one.batch(2 + edit, {131 * edit}));
    picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  }
  EXPECT_EQ(Waits::count(), 0);
}

TEST_F(SplatRendererTest, AMapThatGrowsWaitsOnceForEachArenaThatGrows) {
  constexpr std::uint32_t kBatch = 10 * SlotPage::kSlots;
  SplatScene scene(shaders());
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  scene.prepare(settings);
  const Waits counted;
  std::size_t bytes = 0;
  int grown = 0;
  for (std::uint32_t i = 0; i < 8; ++i) {
    OwnedBatch batch = splatsInARow(kBatch, 3);
    batch.revision = i + 1;
    batch.operation = i == 0 ? GaussianBatch::REPLACE : GaussianBatch::UPSERT;
    batch.first_slot = i * kBatch;
    scene.apply(batch.look());
    scene.upload(settings);
    if (scene.bytes().map != bytes) ++grown;
    bytes = scene.bytes().map;
  }
  EXPECT_GT(grown, 3);
  EXPECT_LE(Waits::count(), grown + 7);  // and for its own memory
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

namespace {

// What a store holds, arena by arena: of pages that are new only their slots are written at once.
std::vector<std::vector<std::uint32_t>> contents(const SlotStore& store, bool all = true) {
  std::vector<std::vector<std::uint32_t>> contents;
  const auto read = [&](const gl::Buffer& buffer) {
    contents.emplace_back(buffer.bytes() / sizeof(std::uint32_t));
    if (buffer.bytes() > 0) buffer.read(0, contents.back().data(), buffer.bytes());
  };
  for (const SlotStore::Arena& arena : store.arenas()) {
    read(arena.slots);
    if (!all) continue;
    for (const gl::Buffer& band : arena.bands) read(band);
    for (const gl::Buffer& channel : arena.channels) read(channel);
    read(arena.levels);
  }
  return contents;
}

// Splats of many values, with a channel.
OwnedBatch variedSplats(std::uint32_t count, std::uint8_t sh_degree, std::minstd_rand& random) {
  std::uniform_real_distribution<float> part(0.01f, 1);
  OwnedBatch batch = splatsInARow(count, sh_degree);
  batch.channel_names = {"age"};
  batch.values.resize(count);
  for (auto* values : {&batch.position, &batch.orientation, &batch.scale, &batch.opacity,
                       &batch.harmonics, &batch.values}) {
    for (float& value : *values) value = part(random);
  }
  return batch;
}

// Adds a splat of another batch, if that has any.
void addFrom(const OwnedBatch& from, std::uint32_t i, OwnedBatch& to) {
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

// A map's books, and its slots on the card.
struct Uploaded {
  Uploaded(gl::UploadRing& ring, const gl::Program& scatter) : store(ring, scatter) {}

  void apply(OwnedBatch batch, std::uint8_t operation) {
    batch.revision = books.state().revision + 1;
    batch.operation = operation;
    BatchReport report;
    store.apply(*books.apply(batch.look(), report), 7);
  }

  GaussianMap books;
  SlotStore store;
};

}  // namespace

// To the bit, in arenas of 16 pages. What is uploaded one by one is copied.
TEST_F(SplatRendererTest, ScatteredEditsLeaveTheBuffersAsOtherUploadsDo) {
  constexpr std::uint32_t kMany = 40 * SlotPage::kSlots, kSome = 900;
  const Disguise driver(1 << 20, 0);
  Shaders compiled(shaders());
  const gl::Program& scatter = compiled.compute({"slot_scatter.comp"});
  gl::UploadRing ring;
  Uploaded scattered(ring, scatter), whole(ring, scatter);
  std::minstd_rand random(1);

  // All but each seventh anew, in no order, and some of them with other values before that.
  const OwnedBatch before = variedSplats(kMany, 3, random), other = variedSplats(kMany, 3, random),
                   after = variedSplats(kMany, 3, random);
  OwnedBatch anew, all;
  std::vector<std::uint32_t> slots(kMany);
  std::iota(slots.begin(), slots.end(), 0u);
  for (const std::uint32_t slot : slots) addFrom(slot % 7 == 0 ? before : after, slot, all);
  std::shuffle(slots.begin(), slots.end(), random);
  for (const OwnedBatch* from : {&other, &after}) {
    for (const std::uint32_t slot : slots) {
      if (slot % 7 == 0 || (from == &other && slot % 3 != 0)) continue;
      addFrom(*from, slot, anew);
      anew.slot_list.push_back(slot);
    }
  }
  scattered.apply(before, GaussianBatch::REPLACE);
  scattered.apply(anew, GaussianBatch::UPSERT);
  whole.apply(all, GaussianBatch::REPLACE);
  ASSERT_EQ(whole.store.arenas().size(), 3u);
  EXPECT_TRUE(contents(scattered.store) == contents(whole.store));

  // Then fewer bands and no channel, beside levels of detail; none at all; and in pages that are
  // new.
  EntryLevels levels;
  for (std::size_t i = 0; i < levels.size(); ++i) levels[i] = std::uint8_t(i % 5);
  for (Uploaded* map : {&scattered, &whole}) {
    for (const std::uint32_t page : {0, 1, 20}) {
      map->store.setLevels(page * SlotPage::kSlots, levels);
    }
  }
  const auto both = [&](OwnedBatch batch, std::uint8_t operation, std::uint32_t first,
                        std::uint32_t range) {
    for (std::uint32_t i = 0; i < kSome; ++i) {
      batch.slot_list.push_back(first + i * 7919 % range / 2 * 2);
    }
    scattered.apply(batch, operation);
    for (std::uint32_t i = 0; i < kSome; ++i) {
      OwnedBatch one(0, operation, batch.slot_list[i]);
      addFrom(batch, i, one);
      whole.apply(one, operation);
    }
  };
  OwnedBatch some = variedSplats(kSome, 1, random), none;
  some.channel_names.clear();
  some.values.clear();
  none.count = kSome;
  both(some, GaussianBatch::UPSERT, 0, kMany);
  EXPECT_TRUE(contents(scattered.store) == contents(whole.store));
  both(none, GaussianBatch::DELETE, 0, kMany);
  EXPECT_TRUE(contents(scattered.store) == contents(whole.store));
  both(some, GaussianBatch::UPSERT, kMany, 2 * SlotPage::kSlots);
  EXPECT_TRUE(contents(scattered.store, false) == contents(whole.store, false));
}

TEST_F(SplatRendererTest, ScatteredEditsTakeFewCommands) {
  SplatScene scene(shaders());
  fill(scene);
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  Splats some;
  std::vector<std::uint32_t> slots;
  for (std::uint32_t i = 0; i < 1000; ++i) {
    some.add({0, 0, 5}, {1, 0, 0});
    slots.push_back(5 * i);
  }
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  const Calls<&epoxy_glCopyBufferSubData> copies;
  const Calls<&epoxy_glClearBufferSubData> clears;
  const Calls<&epoxy_glDispatchCompute> dispatches;
  scene.apply(some.batch(2, slots));
  scene.upload(settings);
  OwnedBatch none(3, GaussianBatch::DELETE);
  none.count = 1000;
  none.slot_list = slots;
  scene.apply(none.look());
  scene.upload(settings);
  EXPECT_EQ(scene.readSlots({5})[0].opacity, 0);
  EXPECT_LT(copies.count() + clears.count() + dispatches.count(), 20);
}

// More than there is to upload from, some of it twice: what is written anew waits its turn.
TEST_F(SplatRendererTest, KeepsWhatIsUploadedWhateverItsSize) {
  constexpr std::uint32_t kMany = 400'000;
  SplatScene scene(shaders());
  OwnedBatch all = splatsInARow(kMany, 3);
  all.revision = 1;
  scene.apply(all.look());
  OwnedBatch again = splatsInARow(kMany / 2, 1);
  again.revision = 2;
  again.operation = GaussianBatch::UPSERT;
  again.first_slot = kMany / 4;
  for (float& opacity : again.opacity) opacity = 0.25f;
  scene.apply(again.look());
  OwnedBatch none(3, GaussianBatch::DELETE, kMany / 2);
  none.count = kMany / 8;
  scene.apply(none);
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  std::vector<std::uint32_t> slots(kMany / 7);
  for (std::uint32_t i = 0; i < slots.size(); ++i) slots[i] = 7 * i;
  std::size_t wrong = 0;
  for (const SplatValues& splat : scene.readSlots(slots)) {
    const bool gone = splat.slot >= kMany / 2 && splat.slot < kMany * 5 / 8;
    const bool anew = splat.slot >= kMany / 4 && splat.slot < kMany * 3 / 4;
    const float opacity = gone ? 0 : anew ? 0.25f : 0.5f;
    const float place = float(anew ? splat.slot - kMany / 4 : splat.slot);
    const float last = splat.sh[47];  // band 3
    const bool right =
        std::fabs(splat.opacity - opacity) < 1e-4f &&
        (gone || (splat.position[0] == place && std::fabs(last - (anew ? 0 : 0.1f)) < 1e-3f));
    wrong += !right;
  }
  EXPECT_EQ(wrong, 0u);
}

TEST_F(SplatRendererTest, UploadsALargeBatchInPartsAndIsNotCompleteBefore) {
  constexpr std::uint32_t kMany = 400'000;  // 37 MiB
  SplatScene scene(shaders());
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  OwnedBatch all = splatsInARow(kMany, 3);
  all.revision = 1;
  scene.apply(all.look());
  const auto opacityOf = [&](std::uint32_t slot) { return scene.readSlots({slot})[0].opacity; };
  for (int frame = 0; frame < 2; ++frame) {
    scene.upload(settings);
    EXPECT_GT(opacityOf(0), 0);
    EXPECT_EQ(opacityOf(kMany - 1), 0);
    EXPECT_FALSE(scene.drawnMap().complete());
    EXPECT_EQ(scene.backlog().edits, 1u);
  }
  scene.upload(settings);
  EXPECT_GT(opacityOf(kMany - 1), 0);
  EXPECT_TRUE(scene.drawnMap().complete());
  EXPECT_EQ(scene.backlog().edits, 0u);
}

// What replaces a map shows when it is whole.
TEST_F(SplatRendererTest, ShowsAMapUntilAllOfWhatReplacesItIsThere) {
  constexpr std::uint32_t kMany = 200'000;  // 18 MiB
  SplatScene scene(shaders());
  RenderSettings settings;
  settings.rasterizer = Rasterizer::kTiles;
  OwnedBatch other = splatsInARow(kMany, 3);
  const auto replace = [&](std::uint64_t revision) {
    other.revision = revision;
    scene.apply(other.look());
    scene.upload(settings);
  };
  fill(scene);
  const auto first = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  replace(2);
  EXPECT_EQ(scene.drawnMap().revision, 1u);
  scene.draw("view", settings, Canvas::kNone);
  EXPECT_EQ(scene.drawnMap().revision, 2u);
  EXPECT_TRUE(scene.drawnMap().complete());
  EXPECT_EQ(scene.drawnMap().splats, kMany);
  EXPECT_NEAR(scene.readSlots({kMany - 1})[0].opacity, 0.5f, 1e-3f);
  replace(3);
  fill(scene);  // before that is there
  EXPECT_EQ(scene.drawnMap().revision, 2u);
  EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), first);
}

TEST_F(SplatRendererTest, LosesNothingWithThePagesThatAreOutsideOfThePicture) {
  Splats splats;
  std::vector<std::array<float, 2>> places;  // by which they are in order: pages lie side by side
  for (int i = 0; i < 20 * 1024; ++i) {
    const auto part = [i](double step) { return static_cast<float>(std::fmod(step * i, 1.0)); };
    places.push_back({40 * part(0.7548776662) - 20, 20 * part(0.5698402909) - 10});
  }
  std::sort(places.begin(), places.end());
  for (std::size_t i = 0; i < places.size(); ++i) {
    splats.add({places[i][0], places[i][1], 10}, {float(i % 3) - 1, float(i % 5) - 2, 0.5f});
  }
  SplatScene culled(shaders()), whole(shaders());
  culled.apply(splats.batch(1, {}));
  whole.apply(splats.batch(1, {}));
  // What was ever in a page widens its bounds: none is left out.
  Splats wide;
  std::vector<std::uint32_t> slots;
  for (std::uint32_t page = 0; page < 20; ++page) {
    for (const float far : {-1000.0f, 1000.0f}) {
      wide.add({far, far, far}, {});
      slots.push_back(1024 * page + (far > 0));
    }
  }
  whole.apply(wide.batch(2, slots));
  whole.apply(splats.batch(3, {}));
  EXPECT_EQ(picture(culled, Rasterizer::kTiles, OrderSource::kAuto),
            picture(whole, Rasterizer::kTiles, OrderSource::kAuto));
  EXPECT_EQ(culled.report("view").splats, whole.report("view").splats);
}

TEST_F(SplatRendererTest, NeedsMemoryForThePagesOfSlotsAlone) {
  constexpr std::size_t kPageBytes = 36 * 1024;
  SplatScene scene(shaders());
  Splats one;
  one.add({0, 0, 10}, {1, 1, 1});
  scene.apply(one.batch(1, {1u << 24}));
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_EQ(scene.bytes().map, kPageBytes);
  EXPECT_LT(gpuBytes(scene), std::size_t{1} << 20);
  Splats many;
  std::vector<std::uint32_t> slots;
  for (std::uint32_t keyframe = 0; keyframe < 32; ++keyframe) {
    many.add({0, 0, 10}, {1, 1, 1});
    slots.push_back(keyframe << 16 | 5);
  }
  scene.apply(many.batch(2, slots));
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_EQ(scene.report("view").splats, 33u);
  EXPECT_LE(scene.bytes().map, 33 * kPageBytes * 5 / 4);
  const std::vector<std::uint32_t> first{0};
  OwnedBatch cleared = one.batch(3, first);
  cleared.operation = GaussianBatch::REPLACE;
  scene.apply(cleared);
  picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_EQ(scene.bytes().map, kPageBytes);
}

// A depth is copied only to its own format.
TEST_F(SplatRendererTest, IsHiddenByAnOpaqueSceneInWhateverDepthFormat) {
  SplatScene scene(shaders());
  fill(scene);
  const auto all = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  std::vector<std::vector<float>> hidden;
  for (const GLenum format : {GL_DEPTH24_STENCIL8, GL_DEPTH_COMPONENT16, GL_DEPTH_COMPONENT24,
                              GL_DEPTH_COMPONENT32, GL_DEPTH_COMPONENT32F, GL_DEPTH32F_STENCIL8}) {
    for (const int samples : {0, 4}) {
      SCOPED_TRACE(testing::Message() << std::hex << format << ", samples " << samples);
      const Framebuffer window(format, samples, windowDepth(6));
      hidden.push_back(picture(scene, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kWindow));
      EXPECT_EQ(scene.warning(), "");
      EXPECT_EQ(glGetError(), GLenum(GL_NO_ERROR));
      // 16 bits put a splat near the scene's depth on the other side of it.
      EXPECT_LT(greatestDifference(hidden.back(), hidden.front()), 0.1f);
    }
  }
  EXPECT_GT(greatestDifference(all, hidden.front()), 0.2f);
}

// For whatever reason: no two drivers refuse the same.
TEST_F(SplatRendererTest, IsHiddenByNothingAndSaysSoWhereTheDriverKeepsTheDepth) {
  SplatScene scene(shaders());
  fill(scene);
  const auto all = picture(scene, Rasterizer::kTiles, OrderSource::kAuto);
  const Framebuffer window(GL_DEPTH24_STENCIL8, 4, windowDepth(6));
  epoxy_glBlitFramebuffer = [](GLint, GLint, GLint, GLint, GLint, GLint, GLint, GLint, GLbitfield,
                               GLenum) { glEnable(GL_NONE); };  // an error
  for (int frame = 0; frame < 2; ++frame) {
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto, Canvas::kWindow).size(),
              all.size());
    EXPECT_NE(scene.warning().find("no object hides"), std::string::npos);
  }
  const auto now = scene.readColor();
  for (std::size_t row = 0; row < kSize; ++row) {  // a window's first row is its last
    for (std::size_t i = 0; i < 4 * kSize; ++i) {
      EXPECT_NEAR(now[4 * kSize * row + i], all[4 * kSize * row + i], 1e-5f);
    }
  }
  epoxy_glBlitFramebuffer =
      reinterpret_cast<PFNGLBLITFRAMEBUFFERPROC>(eglGetProcAddress("glBlitFramebuffer"));
}

// Neither spoils what others have set a picture, nor what is drawn here theirs.
TEST_F(SplatRendererTest, LeavesTheStateOfOthersAsItIs) {
  SplatScene scene(shaders());
  fill(scene);
  const Framebuffer window(GL_DEPTH24_STENCIL8, 4, windowDepth(6));
  const Surroundings around{true, [] {}};
  // Some of the same once more, which a shader uploads.
  OwnedBatch again(1, GaussianBatch::UPSERT);
  const OwnedBatch all = manySplats().batch(1, {});
  for (std::uint32_t i = 0; i < kSplats; i += 2) {
    addFrom(all, i, again);
    again.slot_list.push_back(i);
  }
  for (const Rasterizer rasterizer : {Rasterizer::kTiles, Rasterizer::kProcessor}) {
    RenderSettings settings;
    settings.rasterizer = rasterizer;
    const auto expected = picture(scene, rasterizer, OrderSource::kAuto, Canvas::kWindow);
    const auto depth = scene.readDepth();
    const OthersState others;
    const State before = state();
    ++again.revision;
    scene.apply(again.look());
    EXPECT_EQ(picture(scene, rasterizer, OrderSource::kAuto, Canvas::kWindow), expected);
    EXPECT_EQ(changed(before), State());
    const auto depth_now = scene.readDepth();
    for (std::size_t i = 0; i < depth.size(); ++i) {
      EXPECT_TRUE(depth_now[i] == depth[i] || std::isnan(depth[i])) << i;
    }
    EXPECT_EQ(changed(before), State());
    scene.draw("view", settings, Canvas::kWindow, false, around);
    EXPECT_EQ(changed(before), State());
    scene.hideFarther("view");
    scene.drawBefore("view");
    EXPECT_EQ(changed(before), State());
    SplatScene::drawSurface({{&scene, "view", settings, camera()}}, Canvas::kWindow, 100);
    EXPECT_EQ(changed(before), State());
    SplatScene::drawPick({{&scene, "view", settings, camera()}}, Canvas::kWindow, 0);
    scene.pick();
    scene.readSlots({1, 2, 3});
    EXPECT_EQ(changed(before), State());
  }
}

// As where a Qt slot removes a display beside a widget that draws with OpenGL.
// Levels of detail on the card, beside those of the processor.
RenderSettings detailed(const char* detail, Rasterizer rasterizer) {
  RenderSettings settings;
  settings.float_blending = true;
  settings.rasterizer = rasterizer;
  settings.detail = parseDetail(detail);
  return settings;
}

std::vector<float> cutPicture(SplatScene& scene, const RenderSettings& settings,
                              const char* view_id = "view", const SplatCamera& of = camera()) {
  scene.setCamera(view_id, 1, of);
  scene.draw(view_id, settings, Canvas::kNone, !settings.interactive);
  return scene.readColor();
}

// Small ones near each other, of which nodes are made: a wall 8 m away.
void addWall(Splats& splats, std::uint32_t count, std::uint32_t seed) {
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
void fillWithWall(SplatScene& scene, std::uint32_t count, std::uint32_t seed) {
  Splats splats;
  addWall(splats, count, seed);
  scene.apply(splats.batch(1, {}));
  cutPicture(scene, detailed("1px", Rasterizer::kTiles), "waited");
}

TEST_F(SplatRendererTest, IsDestroyedInAnotherContextWithoutHarmToEither) {
  const EGLDisplay display = eglGetCurrentDisplay();
  const EGLContext own = eglGetCurrentContext();
  const auto buffers = [] {
    GLuint count = 0;
    for (GLuint id = 1; id < 65536; ++id) count += glIsBuffer(id);
    return count;
  };
  gl::deleteAbandoned();
  const GLuint before = buffers();
  auto scene = std::make_unique<SplatScene>(shaders());
  fillWithWall(*scene, 30000, 0);  // with levels
  const GLuint drawn = buffers();
  EXPECT_GT(drawn, before);

  const EGLContext other = makeContext();
  ASSERT_TRUE(other);
  std::vector<GLuint> theirs(512);
  glGenBuffers(GLsizei(theirs.size()), theirs.data());
  for (const GLuint buffer : theirs) glBindBuffer(GL_ARRAY_BUFFER, buffer);
  scene.reset();
  gl::deleteAbandoned();
  for (const GLuint buffer : theirs) EXPECT_TRUE(glIsBuffer(buffer)) << buffer;

  eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, own);
  eglDestroyContext(display, other);
  EXPECT_EQ(buffers(), drawn);
  gl::deleteAbandoned();
  EXPECT_EQ(buffers(), before);
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
      each.float_blending = true;
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
  const Disguise disguise(static_cast<GLint64>(kSplats / 2 * Shaders::kEllipseBytes), 0);
  SplatScene scene(shaders());
  scene.apply(batch);
  const auto found = pictures(scene);
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(found[i], expected[i]) << i;
  EXPECT_LT(scene.bytes().shared_gpu, whole.bytes().shared_gpu);
}

TEST_F(SplatRendererTest, DrawsTheCutOfTheProcessor) {
  SplatScene scene(shaders()), other(shaders());
  Splats splats = manySplats();
  addWall(splats, 30000, 0);
  for (SplatScene* each : {&scene, &other}) each->apply(splats.batch(1, {}));
  const auto full = cutPicture(scene, detailed("full", Rasterizer::kTiles));
  const std::size_t all = scene.report("view").splats;
  for (const char* detail : {"0.5px", "1px", "2px", "3px", "5px", "9px", "30px", "200px"}) {
    const auto tiles = cutPicture(scene, detailed(detail, Rasterizer::kTiles));
    const FrameReport report = scene.report("view");
    EXPECT_EQ(report.detail_error, "");
    const auto processor = cutPicture(other, detailed(detail, Rasterizer::kProcessor));
    EXPECT_EQ(report.error, other.report("view").error) << detail;
    EXPECT_LT(greatestDifference(tiles, processor), 3e-3f) << detail;
  }
  EXPECT_LT(scene.report("view").splats, all / 100);
  for (const DrawMode mode : {DrawMode::kFlatBall, DrawMode::kNormals, DrawMode::kOpacity}) {
    RenderSettings settings = detailed("3px", Rasterizer::kTiles);
    settings.mode = mode;
    const auto tiles = cutPicture(scene, settings);
    settings.rasterizer = Rasterizer::kProcessor;
    const auto processor = cutPicture(other, settings);
    std::size_t others = 0;  // at the rims of balls a pixel is of one or of the other
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      others += std::abs(tiles[i] - processor[i]) > 5e-3f;
    }
    EXPECT_LT(others, tiles.size() / 100) << int(mode);
  }
  EXPECT_LT(greatestDifference(cutPicture(scene, detailed("full", Rasterizer::kTiles)), full),
            1e-6f);
}

TEST_F(SplatRendererTest, HasLevelsWhileAViewWantsThem) {
  SplatScene scene(shaders());
  fill(scene);
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  // What uploads lie in grows by itself while the card is busy.
  const auto held = [&] { return scene.bytes().map + scene.bytes().shared_gpu; };
  const std::size_t bytes = held();
  EXPECT_EQ(scene.bytes().levels, 0u);
  cutPicture(scene, detailed("20px", Rasterizer::kTiles));
  cutPicture(scene, detailed("5px", Rasterizer::kTiles), "other");
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  EXPECT_GT(scene.bytes().levels, 0u);
  scene.forget("other");
  EXPECT_EQ(scene.bytes().levels, 0u);
  cutPicture(scene, detailed("full", Rasterizer::kTiles));
  EXPECT_LE(held(), bytes + bytes / 10);
  // An order that is given, and picks, show slots.
  cutPicture(scene, detailed("200px", Rasterizer::kTiles));
  EXPECT_LT(scene.report("view").splats, kSplats / 10);
  RenderSettings given = detailed("200px", Rasterizer::kTiles);
  given.order = OrderSource::kOff;
  cutPicture(scene, given);
  EXPECT_EQ(scene.report("view").error, 0);
  EXPECT_EQ(scene.report("view").detail_error, "a given order has no levels of detail");
  EXPECT_EQ(scene.bytes().levels, 0u);
  SplatScene full(shaders());
  fill(full);
  picture(full, Rasterizer::kTiles, OrderSource::kAuto);
  EXPECT_EQ(picked(scene), picked(full));
}

TEST_F(SplatRendererTest, KeepsABudgetOfAPictureThatIsWaitedFor) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  for (const char* most : {"100", "1500", "10k"}) {
    cutPicture(scene, detailed(most, Rasterizer::kTiles));
    const auto amount = static_cast<std::size_t>(parseDetail(most).amount);
    EXPECT_LE(scene.report("view").splats, amount);
    EXPECT_GT(scene.report("view").splats, amount / 5);
  }
  cutPicture(scene, detailed("1M", Rasterizer::kTiles));
  EXPECT_EQ(scene.report("view").error, 0);
}

// What is drawn corrects what is wanted next: the error comes to rest all the same.
TEST_F(SplatRendererTest, KeepsTheErrorOfABudgetAtRest) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  for (const char* most : {"1500", "5k", "10k"}) {
    RenderSettings settings = detailed(most, Rasterizer::kTiles);
    settings.interactive = true;
    std::vector<double> errors;
    for (int frame = 0; frame < 20; ++frame) {
      cutPicture(scene, settings, most);
      errors.push_back(scene.report(most).error);
    }
    EXPECT_GT(errors.back(), 0) << most;
    EXPECT_EQ(std::count(errors.end() - 10, errors.end(), errors.back()), 10) << most;
  }
}

// A picture's budget is estimated from the camera of the one before.
TEST_F(SplatRendererTest, ComesToRestAfterTheCameraWithABudget) {
  SplatScene scene(shaders());
  fillWithWall(scene, 40000, 3);
  RenderSettings settings = detailed("5k", Rasterizer::kTiles);
  settings.interactive = true;
  SplatCamera half = camera();  // the left one
  half.cx *= 2;
  half.fx *= 2;
  const auto rest = [&](const char* view_id, const SplatCamera& at) {
    for (int frame = 0; frame < 30; ++frame) cutPicture(scene, settings, view_id, at);
    return scene.report(view_id).error;
  };
  const double of_whole = rest("jumps", camera()), of_half = rest("rests", half);
  EXPECT_GT(of_half, 1.5 * of_whole);  // its cells are twice as wide in the picture
  EXPECT_NEAR(rest("jumps", half), of_half, 0.05 * of_half);
  EXPECT_NEAR(rest("jumps", camera()), of_whole, 0.05 * of_whole);
}

// Until the nodes of an edit stand, the picture has no holes that it hasn't before or afterwards;
// and in the end all is in them.
TEST_F(SplatRendererTest, RepairsLevelsBesideTheFrames) {
  SplatScene scene(shaders());
  const RenderSettings waited = detailed("6px", Rasterizer::kTiles);
  RenderSettings settings = waited;
  settings.interactive = true;
  Splats splats;
  addWall(splats, 20000, 0);
  scene.apply(splats.batch(1, {}));
  cutPicture(scene, detailed("full", Rasterizer::kTiles));  // from which they begin
  auto before = cutPicture(scene, waited, "waited");
  for (std::uint32_t edit = 1; edit <= 15; ++edit) {
    Splats some;
    addWall(some, 1000, edit);
    std::vector<std::uint32_t> slots(1000);
    std::iota(slots.begin(), slots.end(), 1291 * edit);
    scene.apply(some.batch(edit + 1, slots));
    std::vector<std::vector<float>> pictures;
    for (int frame = 0; frame < 3; ++frame) pictures.push_back(cutPicture(scene, settings));
    const auto after = cutPicture(scene, waited, "waited");
    for (const auto& picture : pictures) {
      for (std::size_t i = 3; i < picture.size(); i += 4) {
        ASSERT_GT(picture[i], std::min(before[i], after[i]) - 0.05f) << "edit " << edit;
      }
    }
    before = after;
  }
  scene.forget("waited");
  const auto repaired = cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  const std::size_t drawn = scene.report("view").splats;
  cutPicture(scene, detailed("full", Rasterizer::kTiles));  // which drops them
  EXPECT_EQ(scene.bytes().levels, 0u);
  EXPECT_EQ(greatestDifference(cutPicture(scene, detailed("6px", Rasterizer::kTiles)), repaired),
            0);
  EXPECT_EQ(scene.report("view").splats, drawn);
  // Another map has none of those nodes.
  Splats other;
  addWall(other, 10, 77);
  scene.apply(other.batch(1, {}));
  EXPECT_EQ(greatestDifference(cutPicture(scene, settings),
                               cutPicture(scene, detailed("full", Rasterizer::kTiles))),
            0);
}

bool isRead(GLenum, GLsizeiptr, const void*, GLbitfield access) { return access & GL_MAP_READ_BIT; }

// What comes after that is taken as it comes, and not read back.
TEST_F(SplatRendererTest, ReadsTheMapForItsLevelsOnce) {
  constexpr std::uint32_t kCount = 2 * SlotPage::kSlots;
  SplatScene scene(shaders());
  const auto grow = [&](std::uint32_t batch) {
    Splats some;
    addWall(some, kCount, batch);
    std::vector<std::uint32_t> slots(kCount);
    std::iota(slots.begin(), slots.end(), kCount * batch);
    scene.apply(some.batch(batch + 1, slots));
  };
  grow(0);
  cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  const Calls<&epoxy_glBufferStorage, isRead> counted;
  for (std::uint32_t batch = 1; batch < 4; ++batch) {
    grow(batch);
    cutPicture(scene, detailed("6px", Rasterizer::kTiles));
  }
  EXPECT_EQ(counted.count(), 0);
  EXPECT_GT(scene.report("view").error, 0);
}

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
  const std::vector<SplatScene::InView> parts{{&first, "first's view", of_first},
                                              {&second, "second's view", of_second}};
  for (const SplatScene::InView& part : parts) {
    SplatCamera mine = camera();
    mine.extent_scale = extentScale(part.settings);
    part.scene->setCamera(part.view_id, 1, mine);
    part.scene->prepare(part.settings);
  }
  EXPECT_TRUE(SplatScene::together(first, second));
  SplatScene::draw(SplatScene::begin(parts, Canvas::kNone, true), {});
  return first.readColor();
}

TEST_F(SplatRendererTest, DrawsMapsInOneOrder) {
  Union maps;
  RenderSettings settings;
  settings.float_blending = true;
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
  settings.float_blending = true;
  settings.rasterizer = Rasterizer::kTiles;
  SplatCamera aside = camera();
  aside.translation[0] += 1;
  for (const std::string view : {"view", "other view"}) {
    scene.setCamera(view, 2, aside);
    SplatScene::begin({{&scene, view, settings}}, Canvas::kNone, true);
    EXPECT_EQ(picture(scene, Rasterizer::kTiles, OrderSource::kAuto), expected);
  }
  SplatScene::begin({{&scene, "other view", settings}}, Canvas::kNone, true);
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
  const std::vector<SplatScene::InView> all{{&maps.first, "first's view", settings, camera()},
                                            {&maps.second, "second's view", settings, camera()}};
  constexpr std::uint32_t kNumber = 0x123456;
  // What is left of the window: a number where there are picks, the surface.
  const auto left = [](const std::function<void()>& draw) {
    const Framebuffer window(GL_DEPTH24_STENCIL8, 0, 1);
    draw();
    return gl::readPixels(kSize, kSize);
  };
  const auto numbered = left([&] { SplatScene::drawPick(all, Canvas::kWindow, kNumber); });
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

  const auto surface = left([&] { SplatScene::drawSurface(all, Canvas::kWindow, 100); });
  EXPECT_GT(*std::max_element(surface.begin(), surface.end()), 0);
  EXPECT_EQ(surface, left([&] {
              SplatScene::drawSurface({{&maps.both, "view", settings, camera()}}, Canvas::kWindow,
                                      100);
            }));
}

// Beside the processor, which draws them by another program.
TEST_F(SplatRendererTest, DrawsEachMapByItsOwnSettings) {
  Union maps;
  const auto drawn = [&](RenderSettings of_first, RenderSettings of_second, Rasterizer rasterizer) {
    for (RenderSettings* settings : {&of_first, &of_second}) {
      settings->float_blending = true;
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
  settings.float_blending = true;
  settings.rasterizer = Rasterizer::kTiles;
  first.setCamera("first's view", 1, camera());
  SplatCamera moved = camera();
  moved.translation[0] += 1000;
  second.setCamera("second's view", 1, moved);
  for (SplatScene* scene : {&first, &second}) scene->prepare(settings);
  const auto picture_of_both =
      SplatScene::begin({{&first, "first's view", settings}, {&second, "second's view", settings}},
                        Canvas::kNone, true);
  SplatScene::draw(picture_of_both, {});
  const auto together = first.readColor();
  const auto expected = picture(both, Rasterizer::kTiles, OrderSource::kAuto);
  double squares = 0;
  for (std::size_t i = 0; i < together.size(); ++i) {
    squares += std::pow(double(together[i]) - double(expected[i]), 2);
  }
  EXPECT_GT(-10 * std::log10(squares / double(together.size())), 60);
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
  const auto count = [](const std::string& text) {
    return std::count_if(Disguise::noted.begin(), Disguise::noted.end(), [&](const auto& shader) {
      return shader.first.find(text) != std::string::npos;
    });
  };
  EXPECT_GT(count("#define PARTS 1\n"), 20);
  EXPECT_GT(count("#define PARTS 4\n"), 15);
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
    for (int frame = 0; !scene.ready("service", settings, true); ++frame) {
      ASSERT_LT(frame, 1000);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      scene.apply(grid(++revision, 0, 10, 8));
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
