// Over a window, beside an opaque scene, and beside others' OpenGL.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "drawn_scenes.hpp"
#include "gl/object.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

namespace {

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

}  // namespace

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
    SplatScene::Picture divided;
    divided.add(scene, scene.layer("view", settings, false));
    divided.begin(Canvas::kWindow);
    divided.draw(around);
    EXPECT_EQ(changed(before), State());
    divided.hideFarther();
    divided.drawBefore();
    EXPECT_EQ(changed(before), State());
    underMouse(scene, settings).drawSurface(Canvas::kWindow, 100);
    EXPECT_EQ(changed(before), State());
    underMouse(scene, settings).drawPick(Canvas::kWindow, 0);
    scene.pick();
    scene.readSlots({1, 2, 3});
    EXPECT_EQ(changed(before), State());
  }
}

// As where a Qt slot removes a display beside a widget that draws with OpenGL.
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
