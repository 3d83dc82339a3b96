#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <random>
#include <thread>
#include <utility>

#include "failing_memory.hpp"
#include "owned_batch.hpp"
#include "rosplat_core/painter/painter.hpp"

namespace rosplat {
namespace {

// A painter, and the map that it is given.
struct Studio {
  Studio() {
    arrivals->handOver(taker, [] {});
    painter.add(copy);
  }

  // Splats on a wall 6 m away, in slots from the first on.
  void write(std::uint32_t count, std::uint8_t operation, std::uint32_t first_slot = 0) {
    std::mt19937 random(first_slot);
    std::uniform_real_distribution<float> unit(-1, 1);
    OwnedBatch batch(map.state().revision + 1, operation, first_slot);
    for (std::uint32_t i = 0; i < count; ++i) {
      batch.add({3 * unit(random), 3 * unit(random), 6}, {0.03f, 0.03f, 0.03f}, 0.9f);
    }
    BatchReport report;
    map.apply(batch.look(), report,
              [this](const auto& edit, const MapState& state) { arrivals->push(edit, state); });
  }
  // From a place beside the origin [m].
  std::shared_ptr<PaintRequest> request(const char* detail, bool interactive = false,
                                        double x = 0) const {
    auto request = std::make_shared<PaintRequest>();
    auto& layer = request->layers.emplace_back();
    layer.map = copy;
    layer.camera.translation[0] = -x;
    layer.camera.fx = layer.camera.fy = 100;
    layer.camera.cx = 60;
    layer.camera.cy = 40;
    layer.camera.width = 120;
    layer.camera.height = 80;
    layer.settings.detail = parseDetail(detail);
    layer.settings.interactive = interactive;
    return request;
  }

  // What a request that isn't waited for comes to; null where it never does.
  PaintingPtr painted(const PaintRequestPtr& request) {
    painter.ask("view", request);
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
    while (std::chrono::steady_clock::now() < deadline) {
      const PaintingPtr newest = painter.newest("view");
      if (newest && newest->request == request) return newest;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return nullptr;
  }

  GaussianMap map;
  std::shared_ptr<Arrivals> arrivals = std::make_shared<Arrivals>();
  Arrivals::Taker taker = arrivals->makeTaker();
  PaintedMapPtr copy = std::make_shared<PaintedMap>(
      [taker = taker](const Arrivals::Apply& apply) { return taker.applyNext(apply); });
  Painter painter;
};

TEST(Painter, PaintsADetailThatIsWaitedForAtOnceAndOfTheWholeMap) {
  Studio studio;
  studio.write(20000, GaussianBatch::REPLACE);
  const PaintingPtr full = studio.painter.paintNow("view", studio.request("full"));
  EXPECT_EQ(full->maps[0].error, 0);
  EXPECT_EQ(studio.copy->levelsBytes(), 0u);  // nobody asked for any
  const PaintingPtr few = studio.painter.paintNow("view", studio.request("2000"));
  EXPECT_LE(few->maps[0].drawn, 2000u);
  EXPECT_LT(few->maps[0].drawn, full->maps[0].drawn / 4);
  EXPECT_GT(few->maps[0].error, 0);
  EXPECT_TRUE(few->settled);
  EXPECT_GT(studio.copy->levelsBytes(), 0u);

  studio.write(20000, GaussianBatch::UPSERT, 20000);
  const PaintingPtr more = studio.painter.paintNow("view", studio.request("2000"));
  EXPECT_EQ(more->maps[0].map.splats, 40000u);
  EXPECT_LE(more->maps[0].drawn, 2000u);
  studio.write(10, GaussianBatch::REPLACE);
  EXPECT_EQ(more->maps[0].detail_error, "");
  const PaintingPtr one = studio.painter.paintNow("view", studio.request("1"));
  EXPECT_EQ(one->maps[0].detail_error,
            "no fewer than " + std::to_string(one->maps[0].drawn) + " splats can be drawn");
  const PaintingPtr other = studio.painter.paintNow("view", studio.request("2000"));
  EXPECT_EQ(other->maps[0].map.splats, 10u);
  EXPECT_EQ(other->maps[0].error, 0);  // of so few, all are drawn

  studio.painter.paintNow("other view", studio.request("full"));
  EXPECT_GT(studio.copy->levelsBytes(), 0u);
  studio.painter.paintNow("view", studio.request("full"));
  EXPECT_EQ(studio.copy->levelsBytes(), 0u);  // nobody wants any, any more
  studio.write(20000, GaussianBatch::REPLACE);
  EXPECT_LE(studio.painter.paintNow("view", studio.request("2000"))->maps[0].drawn, 2000u);
}

TEST(Painter, PaintsAGivenOrderInFull) {
  Studio studio;
  studio.write(20000, GaussianBatch::REPLACE);
  auto request = std::make_shared<PaintRequest>(*studio.request("8px"));
  request->layers[0].settings.order = OrderSource::kOff;
  studio.painter.paintNow("view", studio.request("8px"));
  const PaintingPtr painting = studio.painter.paintNow("view", request);
  EXPECT_EQ(painting->maps[0].error, 0);
  EXPECT_EQ(painting->maps[0].detail_error, "a given order has no levels of detail");
  EXPECT_EQ(studio.copy->levelsBytes(), 0u);
}

TEST(Painter, PaintsAMapThatWentOnByDepthAndNotInAnOrderOfBefore) {
  Studio studio;
  studio.write(1000, GaussianBatch::REPLACE);
  auto order = std::make_shared<Order>();
  order->map_id = studio.map.state().id;
  order->revision = studio.map.state().revision;
  for (std::uint32_t slot = 0; slot < 500; ++slot) order->slots.push_back(slot);
  order->bound = 500;
  auto request = std::make_shared<PaintRequest>(*studio.request("full"));
  request->layers[0].order.order = order;
  const PaintingPtr given = studio.painter.paintNow("view", request);
  EXPECT_EQ(given->maps[0].order, order);
  EXPECT_LE(given->maps[0].drawn, 500u);
  EXPECT_EQ(given->maps[0].detail_error, "");

  studio.write(1000, GaussianBatch::UPSERT, 1000);
  const PaintingPtr by_depth = studio.painter.paintNow("view", request);
  EXPECT_EQ(by_depth->maps[0].map.splats, 2000u);
  EXPECT_FALSE(by_depth->maps[0].order);
  EXPECT_EQ(by_depth->picture.colour,
            studio.painter.paintNow("view", studio.request("full"))->picture.colour);
}

TEST(Painter, LeadsAViewThatMovesToItsDetailWhileTheMapChanges) {
  Studio studio;
  studio.write(100000, GaussianBatch::REPLACE);
  const PaintRequestPtr request = studio.request("3000", true);
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  PaintingPtr painting;
  for (std::uint32_t frame = 0; std::chrono::steady_clock::now() < deadline; ++frame) {
    if (frame < 40) {
      studio.write(500, GaussianBatch::UPSERT, frame * 700);
      studio.painter.wake();
    }
    studio.painter.ask("view", request);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    painting = studio.painter.newest("view");
    const bool whole = painting && painting->maps[0].map.revision == studio.map.state().revision;
    const auto near = [](std::size_t drawn) { return drawn > 1000 && drawn < 6000; };
    if (frame >= 40 && whole && painting->settled && near(painting->maps[0].drawn)) break;
  }
  ASSERT_TRUE(painting);
  EXPECT_TRUE(painting->settled);
  EXPECT_EQ(painting->maps[0].map.revision, studio.map.state().revision);
  EXPECT_LT(painting->maps[0].drawn, 6000u);
  EXPECT_GT(painting->maps[0].drawn, 1000u);
}

TEST(Painter, PaintsWhatACameraThatMovesIsThoughtToSee) {
  Studio studio;
  studio.write(20000, GaussianBatch::REPLACE);
  const PaintingPtr before = studio.painted(studio.request("full", true));
  ASSERT_TRUE(before);
  EXPECT_EQ(before->due, before->asked);
  const auto moving = std::make_shared<PaintRequest>(*studio.request("full", true, 1));
  moving->motion.shift = {-0.5, 0, 0};
  studio.painter.ask("view", moving);
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  PaintingPtr ahead = before;
  while (ahead == before && std::chrono::steady_clock::now() < deadline) {
    ahead = studio.painter.newest("view");
  }
  EXPECT_GT(ahead->due, ahead->asked + before->took);
  const double x = -ahead->request->camera().translation[0];
  EXPECT_NEAR(x, 1 + 0.5 * (ahead->due - ahead->asked), 1e-9);
  EXPECT_TRUE(ahead->request->motion.none());
  const auto resting = studio.request("full", true, 1);
  EXPECT_TRUE(studio.painted(resting));
}

// At each allocation in turn: once, and from there on.
void runOutOfMemory(const char* detail, int failures) {
  namespace memory = failing_memory;
  memory::spared = true;
  constexpr std::uint32_t kSplats = 3000, kMore = 1500;
  Studio whole;
  whole.write(kSplats, GaussianBatch::REPLACE);
  whole.write(kMore, GaussianBatch::UPSERT, kSplats - 500);
  const auto expected = whole.painter.paintNow("view", whole.request(detail))->picture.colour;
  bool ran_out = true;
  int allocations = 0, failed = 0;
  for (; ran_out; allocations += 1 + allocations / 50) {
    Studio studio;
    studio.write(kSplats, GaussianBatch::REPLACE);
    studio.painter.paintNow("view", studio.request(detail));
    studio.write(kMore, GaussianBatch::UPSERT, kSplats - 500);
    memory::left = allocations;
    memory::failures = failures;
    try {
      const PaintingPtr painting = studio.painter.paintNow("view", studio.request(detail));
      if (painting->maps[0].map.revision == 2) {
        EXPECT_EQ(studio.arrivals->error(), "");
        if (painting->maps[0].detail_error.empty()) EXPECT_EQ(painting->picture.colour, expected);
      } else {
        EXPECT_FALSE(painting->maps[0].map.complete());
        EXPECT_EQ(studio.arrivals->error(), "a part of the map isn't drawn: memory is lacking");
      }
    } catch (const PictureError& error) {
      ++failed;
      EXPECT_NE(std::string(error.what()), "");
    }
    ran_out = memory::failures.exchange(0) < failures;
    studio.arrivals->handOver(studio.taker, [] {});  // so that it is tried at once
    const PaintingPtr painting = studio.painter.paintNow("view", studio.request(detail));
    EXPECT_EQ(painting->maps[0].map.revision, 2u);
    EXPECT_TRUE(painting->maps[0].map.complete());
    ASSERT_EQ(painting->picture.colour, expected) << "after " << allocations << " allocations";
  }
  EXPECT_GT(allocations, 20);
  EXPECT_GT(failed, 0);
}

TEST(Painter, OutOfMemoryItSaysSoAndPaintsTheNext) {
  constexpr int kAll = 1 << 30;
  for (const int failures : {1, kAll}) {
    runOutOfMemory("full", failures);
    runOutOfMemory("20px", failures);
  }
}

}  // namespace
}  // namespace rosplat
