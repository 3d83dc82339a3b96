// What the processor paints beside the render thread, and what that shows meanwhile.

#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <condition_variable>
#include <fstream>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/threads/clock.hpp"
#include "software_renderer.hpp"
#include "windowless_display.hpp"

using namespace rosplat;

namespace {

bool makeContext() {
  const EGLDisplay display = windowlessDisplay();
  if (!eglInitialize(display, nullptr, nullptr) || !eglBindAPI(EGL_OPENGL_API)) return false;
  const EGLContext context = eglCreateContext(display, EGL_NO_CONFIG_KHR, EGL_NO_CONTEXT, nullptr);
  return context && eglMakeCurrent(display, EGL_NO_SURFACE, EGL_NO_SURFACE, context);
}

ShaderSource shaders() {
  return [](const std::string& name) {
    std::ifstream file(ROSPLAT_MEDIA "/" + name);
    std::stringstream text;
    text << file.rdbuf();
    return text.str();
  };
}

// A window of 8-bit colours with nothing in it.
class Window {
 public:
  Window(int width, int height) : width_(width), height_(height) {
    glGenFramebuffers(1, &id_);
    glGenRenderbuffers(2, buffers_.data());
    glBindFramebuffer(GL_FRAMEBUFFER, id_);
    attach(0, GL_RGBA8, GL_COLOR_ATTACHMENT0);
    attach(1, GL_DEPTH_COMPONENT24, GL_DEPTH_ATTACHMENT);
    clear();
  }
  ~Window() {
    glDeleteFramebuffers(1, &id_);
    glDeleteRenderbuffers(2, buffers_.data());
  }
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  void clear(double depth = 1) const {
    glBindFramebuffer(GL_FRAMEBUFFER, id_);
    glViewport(0, 0, width_, height_);
    glClearColor(0, 0, 0, 0);
    glClearDepth(depth);
    glDepthMask(GL_TRUE);
    glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
  }
  std::vector<std::uint8_t> pixels() const {
    std::vector<std::uint8_t> pixels(4 * std::size_t(width_) * std::size_t(height_));
    glBindFramebuffer(GL_FRAMEBUFFER, id_);
    glReadPixels(0, 0, width_, height_, GL_RGBA, GL_UNSIGNED_BYTE, pixels.data());
    return pixels;
  }

 private:
  void attach(std::size_t i, GLenum format, GLenum where) {
    glBindRenderbuffer(GL_RENDERBUFFER, buffers_[i]);
    glRenderbufferStorage(GL_RENDERBUFFER, format, width_, height_);
    glFramebufferRenderbuffer(GL_FRAMEBUFFER, where, GL_RENDERBUFFER, buffers_[i]);
  }

  int width_, height_;
  GLuint id_ = 0;
  std::array<GLuint, 2> buffers_{};
};

// Looks along z from a place beside the origin [m].
SplatCamera camera(double x = 0, int width = 64, int height = 48) {
  SplatCamera camera = makeCamera({x, 0, 0}, {0, 0, 0, 1}, false, 40, 40, width / 2.0, height / 2.0,
                                  width, height, 0.1, 100);
  camera.ndc_scale = (100 + 0.1) / (100 - 0.1);
  camera.ndc_offset = -2 * 100 * 0.1 / (100 - 0.1);
  return camera;
}

// A map whose edits reach the painter when they are let through.
class Source {
 public:
  // Splats 5 to 15 m away, all over the picture.
  void add(std::uint32_t count) {
    OwnedBatch batch(map.state().revision + 1, GaussianBatch::UPSERT, map.state().capacity);
    for (std::uint32_t i = 0; i < count; ++i) {
      const auto part = [i](double step) { return static_cast<float>(std::fmod(step * i, 1.0)); };
      const float z = 5 + 10 * part(0.6180339887);
      batch.add({1.4f * z * (part(0.7548776662) - 0.5f), 1.1f * z * (part(0.5698402909) - 0.5f), z},
                {0.4f, 0.4f, 0.4f}, 0.7f, {3 * part(0.8191725134), 3 * part(0.6710436067), 0});
    }
    BatchReport report;
    const auto edit = map.apply(batch.look(), report);
    const std::lock_guard lock(mutex_);
    waiting_.push_back({edit, map.state()});
  }
  bool next(const Arrivals::Apply& apply) {
    std::unique_lock lock(mutex_);
    if (held_) {
      reached_ = true;
      changed_.notify_all();
      changed_.wait(lock, [this] { return !held_; });
    }
    if (waiting_.empty()) return false;
    const auto [edit, state] = waiting_.front();
    waiting_.erase(waiting_.begin());
    lock.unlock();
    apply({edit, state});
    return true;
  }
  // Whoever asks for edits is held.
  void hold() {
    const std::lock_guard lock(mutex_);
    held_ = true;
    reached_ = false;
  }
  void waitUntilReached() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return reached_; });
  }
  void letGo() {
    const std::lock_guard lock(mutex_);
    held_ = false;
    changed_.notify_all();
  }

  GaussianMap map;

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::pair<std::shared_ptr<const GaussianEdit>, MapState>> waiting_;
  bool held_ = false, reached_ = false;
};

class SoftwareRendererTest : public testing::Test {
 protected:
  void SetUp() override {
    if (!makeContext()) GTEST_SKIP() << "no OpenGL without a window";
    renderer_ = std::make_unique<SoftwareRenderer>(shaders());
    map_ = addMap(source_);
    source_.add(2000);
  }
  void TearDown() override {
    source_.letGo();
    renderer_.reset();
  }

  PaintedMapPtr addMap(Source& source) {
    auto map = std::make_shared<PaintedMap>(
        [&source](const Arrivals::Apply& apply) { return source.next(apply); });
    renderer_->painter().add(map);
    return map;
  }
  Layer<PaintedMapPtr> viewed(const SplatCamera& camera, bool interactive = true,
                              const char* view = "view") const {
    RenderSettings settings;
    settings.interactive = interactive;
    return {map_, view, camera, settings, {}, source_.map.state()};
  }
  PaintingPtr draw(const SplatCamera& camera, bool interactive = true, const char* view = "view") {
    return renderer_->draw({{viewed(camera, interactive, view)}}, Canvas::kWindow);
  }
  // Until the picture of this camera is shown.
  void rest(const Window& window, const SplatCamera& camera, const char* view = "view") {
    do {
      std::this_thread::yield();
      window.clear();
      draw(camera, true, view);
    } while (!renderer_->exact());
  }
  std::vector<std::uint8_t> expected(const Window& window, const SplatCamera& camera) {
    window.clear();
    draw(camera, false, "expected");
    return window.pixels();
  }

  Source source_;
  std::unique_ptr<SoftwareRenderer> renderer_;
  PaintedMapPtr map_;
};

TEST_F(SoftwareRendererTest, DrawsGoOnWhileThePainterPaints) {
  const Window window(64, 48);
  source_.hold();
  EXPECT_EQ(draw(camera(0)), nullptr);  // nothing is there yet
  source_.waitUntilReached();           // and the painter is busy
  for (int frame = 1; frame <= 20; ++frame) {
    EXPECT_EQ(draw(camera(0.01 * frame)), nullptr);
  }
  source_.letGo();
  rest(window, camera(0.2));
  // What had come in between was never painted.
  EXPECT_EQ(window.pixels(), expected(window, camera(0.2)));
}

TEST_F(SoftwareRendererTest, TheNewestPictureIsShownMeanwhileNearToWhereItIs) {
  const Window window(64, 48);
  const auto farther = expected(window, camera(0.3));
  rest(window, camera(0));
  const auto stale = window.pixels();
  source_.hold();
  renderer_->painter().wake();
  source_.waitUntilReached();
  const double at_rest = now();
  draw(camera(0));
  window.clear();
  EXPECT_NE(draw(camera(0.3)), nullptr);
  EXPECT_FALSE(renderer_->exact());
  EXPECT_GE(renderer_->exactUntil(), at_rest);  // however old the picture is
  const auto carried = window.pixels();
  const auto error = [&](const std::vector<std::uint8_t>& shown) {
    double sum = 0;
    for (std::size_t i = 0; i < shown.size(); ++i) sum += std::abs(shown[i] - farther[i]);
    return sum;
  };
  EXPECT_LT(error(carried), 0.5 * error(stale));
  source_.letGo();
  rest(window, camera(0.3));
  EXPECT_EQ(window.pixels(), farther);
}

TEST_F(SoftwareRendererTest, TheSurfaceIsThatOfTheNewestPictureWhileThePainterPaints) {
  constexpr double kFar = 100;
  const Window window(64, 48), pixel(1, 1);
  // Depths [m] by pixel, top row first; 0 where there is none.
  const auto exact = [&](const SplatCamera& camera) {
    expected(window, camera);
    std::vector<float> depths = renderer_->readDepth();
    const std::vector<float>& colour = renderer_->readColor();
    for (std::size_t i = 0; i < depths.size(); ++i) {
      if (!(colour[4 * i + 3] >= 0.5f)) depths[i] = 0;
    }
    return depths;
  };
  const auto surface = [&](const Window& of, const SplatCamera& camera, double scene_depth = 1) {
    of.clear(scene_depth);
    renderer_->drawSurface({{viewed(camera)}}, Canvas::kWindow, kFar);
    const auto bytes = of.pixels();
    std::vector<float> depths;
    for (int row = camera.height - 1; row >= 0; --row) {  // a window's first row is its last
      for (int column = 0; column < camera.width; ++column) {
        const std::uint8_t* rgb = &bytes[4 * std::size_t(row * camera.width + column)];
        depths.push_back(float(kFar * (rgb[0] << 16 | rgb[1] << 8 | rgb[2]) / 0xffffff));
      }
    }
    return depths;
  };
  const auto error = [](const std::vector<float>& a, const std::vector<float>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += std::fabs(a[i] - b[i]);
    return sum;
  };
  EXPECT_EQ(error(surface(window, camera()), std::vector<float>(64 * 48)), 0);  // nothing yet
  const auto here = exact(camera()), there = exact(camera(0.3));
  rest(window, camera());
  source_.hold();
  renderer_->painter().wake();
  source_.waitUntilReached();
  const auto found = surface(window, camera());
  for (std::size_t i = 0; i < here.size(); ++i) ASSERT_NEAR(found[i], here[i], 2e-5) << i;
  const std::size_t middle = 24 * 64 + 32;
  ASSERT_GT(here[middle], 0);
  const auto part = surface(pixel, crop(camera(), 32, 24, 1, 1));
  EXPECT_NEAR(part[0], here[middle], 2e-5);
  // What is opaque hides what is behind it: here half of all.
  auto sorted = here;
  std::nth_element(sorted.begin(), sorted.begin() + 24 * 64, sorted.end());
  const float between = sorted[24 * 64];
  ASSERT_GT(between, 5);
  const double window_depth = 0.5 + 0.5 * (camera().ndc_scale + camera().ndc_offset / between);
  const auto nearest = surface(window, camera(), window_depth);
  for (std::size_t i = 0; i < here.size(); ++i) {
    if (std::fabs(here[i] - between) < 1e-3f) continue;
    ASSERT_NEAR(nearest[i], here[i] < between ? here[i] : 0, 2e-5);
  }
  // The camera has moved on.
  EXPECT_LT(error(surface(window, camera(0.3)), there), 0.6 * error(here, there));
}

TEST_F(SoftwareRendererTest, PicksAreMarkedAtOnceAndFoundBeside) {
  constexpr std::uint32_t kNumber = 0x123456;
  const Window window(64, 48);
  const auto pick = [&](const SplatCamera& part) {
    window.clear();
    renderer_->drawPick({{viewed(part, false)}}, Canvas::kWindow, kNumber);
    return std::move(renderer_->pick().front());
  };
  const auto marked = [&](int row, int column) {  // the window's first row is the picture's last
    const auto pixels = window.pixels();
    const std::uint8_t* rgb = &pixels[4 * std::size_t((47 - row) * 64 + column)];
    return std::uint32_t(rgb[0] << 16 | rgb[1] << 8 | rgb[2]);
  };
  expected(window, camera());
  const std::vector<float> colour = renderer_->readColor();
  rest(window, camera());
  source_.hold();
  draw(camera(0.1));
  source_.waitUntilReached();  // and the painter is busy
  Pick whole = pick(camera());
  std::vector<std::uint32_t> marks;
  for (int i = 0; i < 64 * 48; ++i) marks.push_back(marked(i / 64, i % 64));
  for (std::size_t i = 0; i < marks.size(); ++i) {
    ASSERT_EQ(marks[i], colour[4 * i + 3] >= kLeastPicked ? kNumber : 0) << i;
  }
  pick(camera());  // given up
  Pick part = pick(crop(camera(), 20, 10, 5, 3));
  EXPECT_FALSE(whole.found() || part.found());
  source_.letGo();
  const Pick::Slots slots = whole.slots(), of_part = part.slots();
  ASSERT_EQ(slots.size(), marks.size());
  ASSERT_EQ(of_part.size(), 15u);
  for (std::size_t i = 0; i < of_part.size(); ++i) {
    EXPECT_EQ(of_part[i], slots[(10 + i / 5) * 64 + 20 + i % 5]);
  }
  std::size_t found = 0;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (slots[i] == kNoSlot) continue;
    ++found;
    EXPECT_LT(slots[i], 2000u);
    EXPECT_EQ(marks[i], kNumber);
  }
  EXPECT_GT(found, slots.size() / 2);
  rest(window, camera(0.1));  // what was being painted meanwhile
  EXPECT_EQ(window.pixels(), expected(window, camera(0.1)));
}

TEST_F(SoftwareRendererTest, PicksOfSeveralMapsAreFoundBeside) {
  constexpr std::uint32_t kNumber = 0x123456;
  const Window window(64, 48);
  Source other;
  const PaintedMapPtr other_map = addMap(other);
  other.add(2500);
  const auto both = [&] {
    PaintedPicture maps{{viewed(camera(), false), viewed(camera(), false, "other's view")}};
    maps.layers.back().map = other_map;
    maps.layers.back().state = other.map.state();
    return maps;
  };
  renderer_->draw(both(), Canvas::kWindow);
  const std::vector<float> colour = renderer_->readColor();
  source_.hold();
  draw(camera(0.1), true, "another view");
  source_.waitUntilReached();  // and the painter is busy
  window.clear();
  renderer_->drawPick(both(), Canvas::kWindow, kNumber);
  std::vector<Pick> picks = renderer_->pick();
  const auto pixels = window.pixels();
  ASSERT_EQ(picks.size(), 2u);
  EXPECT_FALSE(picks[0].found() || picks[1].found());
  source_.letGo();
  const Pick::Slots slots[2] = {picks[0].slots(), picks[1].slots()};
  std::size_t found[2] = {0, 0};
  for (std::size_t i = 0; i < 64 * 48; ++i) {
    const std::uint8_t* rgb = &pixels[4 * (64 * (47 - i / 64) + i % 64)];
    const bool marked = std::uint32_t(rgb[0] << 16 | rgb[1] << 8 | rgb[2]) == kNumber;
    ASSERT_EQ(marked, colour[4 * i + 3] >= kLeastPicked) << i;
    ASSERT_TRUE(slots[0][i] == kNoSlot || slots[1][i] == kNoSlot) << i;
    for (const int map : {0, 1}) found[map] += marked && slots[map][i] != kNoSlot;
  }
  EXPECT_GT(found[0], 200u);
  EXPECT_GT(found[1], 200u);
  EXPECT_TRUE(std::any_of(slots[1].begin(), slots[1].end(),
                          [](std::uint32_t slot) { return slot != kNoSlot && slot >= 2000; }));
}

TEST_F(SoftwareRendererTest, APickThatCantBeFoundSaysWhy) {
  SplatCamera wide = camera();
  wide.width = wide.height = 1 << 20;
  renderer_->drawPick({{viewed(wide, false)}}, Canvas::kNone, 0);
  EXPECT_THROW(renderer_->pick().front().slots(), PictureError);
  source_.hold();
  renderer_->drawPick({{viewed(camera(), false)}}, Canvas::kNone, 0);
  Pick left = std::move(renderer_->pick().front());
  source_.letGo();
  renderer_.reset();
  EXPECT_TRUE(left.found());
}

TEST_F(SoftwareRendererTest, EditsThatComeWhileItPaintsAreShown) {
  const Window window(64, 48);
  rest(window, camera());
  const auto before = window.pixels();
  source_.hold();
  draw(camera(0.1));
  source_.waitUntilReached();
  source_.add(3000);
  renderer_->painter().wake();
  source_.letGo();
  rest(window, camera());
  EXPECT_NE(window.pixels(), before);
  EXPECT_EQ(window.pixels(), expected(window, camera()));
  EXPECT_EQ(map_->state().splats, 5000u);
}

TEST_F(SoftwareRendererTest, AViewThatIsForgottenWhileItIsPaintedIsGone) {
  const Window window(64, 48);
  source_.hold();
  draw(camera(), true, "gone");
  source_.waitUntilReached();
  renderer_->forget("gone");
  draw(camera(), true, "here");
  source_.letGo();
  rest(window, camera(), "here");
  EXPECT_EQ(renderer_->painter().newest("gone"), nullptr);
}

TEST_F(SoftwareRendererTest, SeveralViewsOfAnySizeTakeTurns) {
  const Window large(300, 200), small(33, 17), pixel(1, 1);
  for (const double x : {0.0, 0.1}) {
    rest(large, camera(x, 300, 200), "large");
    const auto shown = large.pixels();
    rest(pixel, camera(x, 1, 1), "small");
    EXPECT_EQ(pixel.pixels(), expected(pixel, camera(x, 1, 1)));
    rest(small, camera(x, 33, 17), "small");  // resized
    EXPECT_EQ(small.pixels(), expected(small, camera(x, 33, 17)));
    EXPECT_EQ(shown, expected(large, camera(x, 300, 200)));
  }
}

// Where a map is a metre to the side in the frame of another.
SplatCamera aside(SplatCamera camera) {
  camera.translation[0] += 1;
  return camera;
}

TEST_F(SoftwareRendererTest, MapsOfAViewAreOnePictureWhoseverDisplayGoes) {
  const Window window(64, 48);
  Source other_source;
  other_source.add(500);
  const PaintedMapPtr other = addMap(other_source);
  const auto both = [&](const SplatCamera& camera) {
    Layer<PaintedMapPtr> first = viewed(camera), second = viewed(aside(camera), true, "other");
    second.map = other;
    second.state = other_source.map.state();
    return PaintedPicture{{first, second}};
  };
  const auto rest = [&](const PaintedPicture& maps) {
    PaintingPtr painting;
    do {
      std::this_thread::yield();
      window.clear();
      painting = renderer_->draw(maps, Canvas::kWindow);
    } while (!renderer_->exact());
    EXPECT_EQ(painting->maps.size(), maps.layers.size());
    return window.pixels();
  };
  const auto alone = rest({{both(camera()).layers[1]}});
  const auto together = rest(both(camera()));
  EXPECT_NE(together, alone);

  // The first display goes, and the painter is busy: what there is stays, as the other sees it.
  renderer_->forget("view");
  other_source.add(1);
  other_source.hold();
  renderer_->painter().wake();
  other_source.waitUntilReached();
  window.clear();
  EXPECT_NE(renderer_->draw({{both(camera()).layers[1]}}, Canvas::kWindow), nullptr);
  EXPECT_FALSE(renderer_->exact());
  const auto meanwhile = window.pixels();
  double difference = 0;
  for (std::size_t i = 0; i < together.size(); ++i) {
    difference += std::abs(meanwhile[i] - together[i]);
  }
  EXPECT_LT(difference / double(together.size()), 1);
  other_source.letGo();
  rest({{both(camera()).layers[1]}});
}

TEST_F(SoftwareRendererTest, WhatCantBePaintedSaysWhyAndTheMapStays) {
  const Window window(64, 48);
  SplatCamera wide = camera();
  wide.width = wide.height = 1 << 20;
  EXPECT_THROW(renderer_->draw({{viewed(wide, false)}}, Canvas::kNone), PictureError);
  rest(window, camera());
  EXPECT_EQ(window.pixels(), expected(window, camera()));
}

}  // namespace
