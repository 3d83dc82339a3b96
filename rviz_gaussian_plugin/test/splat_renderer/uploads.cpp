// How edits reach the graphics card.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include "drawn_scenes.hpp"
#include "driver_doubles.hpp"
#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/upload_ring.hpp"
#include "gpu/slot_store.hpp"
#include "owned_batch.hpp"
#include "splat_scene.hpp"

using namespace rosplat;

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
