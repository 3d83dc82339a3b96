// Whatever finds no memory crashes nothing: it leaves what was there whole or says what it lacks,
// and succeeds once there is memory again. Each allocation fails in turn, alone and with all after
// it.

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <memory>
#include <new>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/raster/cpu_rasterizer.hpp"

namespace {

std::atomic<long> allocations{0};  // so far
std::atomic<long> failing{-1};     // which fails, none where it is below 0
std::atomic<bool> lasting{false};  // so do all after it
bool reached = false;              // that one, since this was asked last

void* allocate(std::size_t size, std::size_t alignment) {
  const long number = allocations++, fails = failing;
  if (fails >= 0 && (lasting ? number >= fails : number == fails)) throw std::bad_alloc();
  void* memory = nullptr;
  if (posix_memalign(&memory, std::max(alignment, sizeof(void*)), size) != 0)
    throw std::bad_alloc();
  return memory;
}

}  // namespace

void* operator new(std::size_t size) { return allocate(size, alignof(std::max_align_t)); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return allocate(size, std::size_t(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }

namespace rosplat {
namespace {

// What became of something that found no memory.
enum class Outcome { kDone, kThrown };

// Has something done while an allocation fails.
Outcome tried(long fails, bool lasts, const std::function<void()>& something) {
  lasting = lasts;
  allocations = 0;
  failing = fails;
  Outcome outcome = Outcome::kDone;
  try {
    something();
  } catch (const std::bad_alloc&) {
    outcome = Outcome::kThrown;
  } catch (const PictureError&) {
    outcome = Outcome::kThrown;
  }
  failing = -1;
  reached = reached || allocations > fails;
  return outcome;
}

// Calls attempt(which allocation fails, whether all after it do, too) until none does.
void failEach(const std::function<void(long, bool)>& attempt) {
  for (const bool lasts : {false, true}) {
    long fails = 0;
    do {
      SCOPED_TRACE("allocation " + std::to_string(fails) + (lasts ? " and all after it" : ""));
      reached = false;
      attempt(fails, lasts);
      if (testing::Test::HasFailure()) return;
      ++fails;
    } while (reached);
    EXPECT_GT(fails, 1);
  }
}

OwnedBatch batchOf(std::uint64_t revision, std::uint8_t operation, std::uint32_t first_slot,
                   std::uint32_t count, std::uint32_t group = 0) {
  OwnedBatch batch(revision, operation, first_slot);
  batch.group = group;
  if (operation == GaussianBatch::DELETE) batch.count = count;
  for (std::uint32_t i = 0; operation < GaussianBatch::DELETE && i < count; ++i) {
    const float x = float(first_slot + i + revision);
    batch.add({std::sin(x), std::sin(2 * x), 5 + std::sin(3 * x)}, {0.05f, 0.02f, 0.03f}, 0.8f,
              std::vector<float>(12, std::sin(x)));
    batch.sh_degree = 1;
  }
  return batch;
}

OwnedBatch moveOf(std::uint64_t revision, std::uint32_t group) {
  OwnedBatch move(revision, GaussianBatch::MOVE);
  move.group_list = {group};
  move.poses.push_back({{0.1, 0.2, 0.3}, {0, 0, 0, 1}});
  return move;
}

// A map of two groups, edit by edit.
std::vector<OwnedBatch> beginning() {
  return {batchOf(1, GaussianBatch::REPLACE, 0, 1500),
          batchOf(2, GaussianBatch::UPSERT, 5000, 60, 7), moveOf(3, 7)};
}

// Each of which may come next.
std::vector<OwnedBatch> nextOnes() {
  OwnedBatch channels = batchOf(4, GaussianBatch::UPSERT, 1000, 1500);
  channels.channel_names = {"label"};
  channels.values.assign(1500, 3);
  OwnedBatch bands(4, GaussianBatch::UPSERT, 10);
  bands.sh_degree = 2;
  bands.add({0, 0, 5}, {0.1f, 0.1f, 0.1f}, 1, std::vector<float>(27, 0.5f));
  return {channels,
          bands,
          batchOf(4, GaussianBatch::UPSERT, 9000, 3, 9),
          batchOf(4, GaussianBatch::DELETE, 0, 1400),
          batchOf(4, GaussianBatch::REPLACE, 2000, 2000),
          moveOf(4, 3)};
}

using Edit = std::shared_ptr<const GaussianEdit>;

Edit applied(GaussianMap& map, OwnedBatch batch) {
  BatchReport report;
  return map.apply(batch.look(), report);
}

std::vector<Edit> editsOf(const std::vector<OwnedBatch>& batches) {
  GaussianMap map;
  std::vector<Edit> edits;
  for (const OwnedBatch& batch : batches) edits.push_back(applied(map, batch));
  return edits;
}

// What there is of a map, as bits.
using Content = std::vector<std::uint64_t>;

template <typename T>
void add(Content& content, const T& value) {
  static_assert(sizeof(T) <= sizeof(std::uint64_t));
  content.push_back(0);
  std::memcpy(&content.back(), &value, sizeof(T));
}

Content contentOf(const HostSlots& slots) {
  Content content;
  for (const SlotPage& page : slots.pages()) {
    add(content, page.first_slot);
    const Group& group = slots.index().groupOf(page);
    add(content, group.number);
    for (const double x : group.pose.position) add(content, x);
    const HostSlots::Page& memory = slots.at(page);
    for (std::size_t i = 0; i < HostSlots::kSlots; ++i) {
      if (memory.extent[i] < 0) continue;
      add(content, i);
      add(content, memory.extent[i]);
      const PackedSlot packed = memory.packed(i, slots.shDegree());
      for (const std::uint32_t word : packed.words) add(content, word);
      for (const auto& band : packed.bands) {
        for (const std::uint32_t word : band) add(content, word);
      }
      for (const auto& channel : memory.channels) add(content, channel ? (*channel)[i] : kNoValue);
    }
  }
  return content;
}

Content contentOf(const std::vector<Edit>& edits) {
  HostSlots slots;
  for (const Edit& edit : edits) slots.apply(*edit, 0);
  return contentOf(slots);
}

std::string contentOf(const GaussianMap& map) {
  const MapState& state = map.state();
  std::string content = state.id;
  for (const std::uint64_t value :
       {state.round, state.revision, state.edits, std::uint64_t(state.splats),
        std::uint64_t(state.capacity), std::uint64_t(state.groups),
        std::uint64_t(state.channels.size()), std::uint64_t(state.sh_degree), state.missed}) {
    content += " " + std::to_string(value);
  }
  for (std::uint32_t slot = 0; slot < 10000; ++slot) content += map.inUse(slot) ? '1' : '0';
  for (const Group& group : map.groups().all()) {
    content += " " + std::to_string(group.number) + std::to_string(group.pose.position[0]);
  }
  return content;
}

TEST(OutOfMemory, AMapIsAsBeforeABatchThatItHasNoMemoryFor) {
  GaussianMap before;
  for (const OwnedBatch& batch : beginning()) applied(before, batch);
  for (OwnedBatch& next : nextOnes()) {
    next.look();
    GaussianMap expected = before;
    const Edit edit = applied(expected, next);
    failEach([&](long fails, bool lasts) {
      GaussianMap map = before;
      EditQueue queue;
      BatchReport report;
      const auto apply = [&] {
        map.apply(next, report, [&](const Edit& kept, const MapState& state) {
          queue.push(EditQueue::node(kept, state));
        });
      };
      if (tried(fails, lasts, apply) == Outcome::kThrown) {
        EXPECT_EQ(contentOf(map), contentOf(before));
        EXPECT_TRUE(queue.empty());
        apply();
      }
      EXPECT_EQ(contentOf(map), contentOf(expected));
      ASSERT_EQ(queue.size(), 1u);
      const EditQueue::Waiting waiting = queue.pop();
      EXPECT_EQ(waiting.edit->slots, edit->slots);
      EXPECT_EQ(waiting.edit->runs, edit->runs);
    });
  }
}

TEST(OutOfMemory, AQueueLosesNothingOfTheEditsInIt) {
  std::vector<OwnedBatch> batches = beginning();
  for (std::uint64_t revision = 4; revision < 10; ++revision) {
    batches.push_back(revision % 3 == 0 ? moveOf(revision, 7)
                                        : batchOf(revision, GaussianBatch::UPSERT,
                                                  std::uint32_t(100 * revision), 700));
  }
  const std::vector<Edit> edits = editsOf(batches);
  const Content expected = contentOf(edits);
  failEach([&](long fails, bool lasts) {
    EditQueue queue(0);
    std::vector<EditQueue::Node> nodes;
    for (const Edit& edit : edits) nodes.push_back(EditQueue::node(edit, {}));
    tried(fails, lasts, [&] {
      for (EditQueue::Node& node : nodes) queue.push(std::move(node));
    });
    std::vector<Edit> popped;
    while (!queue.empty()) popped.push_back(queue.pop().edit);
    EXPECT_TRUE(contentOf(popped) == expected);
    EXPECT_EQ(queue.bytes(), 0u);
  });
}

TEST(OutOfMemory, SlotsAreAsBeforeAnEditThatThereIsNoMemoryFor) {
  ThreadTeam two(2);
  two.run(2, [](unsigned, unsigned) {});  // its threads are there
  const std::vector<OwnedBatch> first = beginning();
  for (const OwnedBatch& next : nextOnes()) {
    std::vector<OwnedBatch> all = first;
    all.push_back(next);
    std::vector<Edit> edits = editsOf(all);
    const Content expected = contentOf(edits);
    const Edit last = edits.back();
    edits.pop_back();
    const Content before = last->clear ? Content() : contentOf(edits);
    for (ThreadTeam* team : {static_cast<ThreadTeam*>(nullptr), &two}) {
      failEach([&](long fails, bool lasts) {
        HostSlots slots;
        for (const Edit& edit : edits) slots.apply(*edit, 0);
        const auto apply = [&] { slots.apply(*last, 0, team); };
        if (tried(fails, lasts, apply) == Outcome::kThrown) {
          EXPECT_TRUE(contentOf(slots) == before);
          apply();
        }
        EXPECT_TRUE(contentOf(slots) == expected);
      });
    }
  }
}

bool never() { return false; }

Content nodesOf(const Levels& levels) {
  Content content;
  for (const Levels::Nodes& nodes : levels.groups()) {
    for (const Levels::Pages& pages : nodes) {
      for (const auto& page : pages) {
        for (std::size_t i = 0; i < page->cells.size(); ++i) {
          const Node node = page->node(i, 1);
          add(content, node.cell);
          for (const std::uint32_t word : node.packed.words) add(content, word);
          for (const std::uint32_t slot : node.members) add(content, slot);
        }
      }
    }
  }
  return content;
}

TEST(OutOfMemory, LevelsGoOnWhereMemoryEnded) {
  const std::vector<Edit> edits = editsOf({batchOf(1, GaussianBatch::REPLACE, 0, 40),
                                           batchOf(2, GaussianBatch::UPSERT, 2000, 5, 7),
                                           batchOf(3, GaussianBatch::UPSERT, 30, 20)});
  for (const unsigned threads : {1u, 2u}) {
    const auto team = std::make_shared<ThreadTeam>(threads);
    HostSlots whole;
    Levels at_once(team);
    for (const Edit& edit : edits) whole.apply(*edit, 0);
    ASSERT_TRUE(at_once.advance(whole, never));
    const Content expected = nodesOf(at_once);
    for (const std::size_t there : {edits.size(), edits.size() - 1}) {  // before there are levels
      failEach([&](long fails, bool lasts) {
        HostSlots slots;
        Levels levels(team);
        for (std::size_t i = 0; i < there; ++i) slots.apply(*edits[i], 0);
        if (there < edits.size()) {
          levels.advance(slots, never);
          slots.apply(*edits.back(), 0);
        }
        const auto advance = [&] {
          for (std::size_t i = there; i < edits.size(); ++i) levels.mark(slots, edits[i]->runs);
          levels.advance(slots, never);
        };
        if (tried(fails, lasts, advance) == Outcome::kThrown) advance();
        EXPECT_TRUE(nodesOf(levels) == expected);
      });
    }
  }
}

// A map that is drawn.
struct Drawn {
  explicit Drawn(bool with_levels) : levels(std::make_shared<ThreadTeam>(1)) {
    for (const OwnedBatch& batch : beginning()) slots.apply(*applied(map, batch), 0);
    levels.advance(slots, never);
    PictureLayer& layer = request.layers.emplace_back();
    layer.slots = &slots;
    layer.map = &map.state();
    layer.camera.fx = layer.camera.fy = 60;
    layer.camera.cx = 30;
    layer.camera.cy = 20;
    layer.camera.width = 60;
    layer.camera.height = 40;
    if (with_levels) layer.levels = &levels, layer.error = 3;
    depth.assign(60 * 40, 0.9f);
    request.scene_depth = request.translucent_depth = depth;
    request.depth = PictureDepth::kMean;
  }

  GaussianMap map;
  HostSlots slots;
  Levels levels;
  std::vector<float> depth;
  PictureRequest request;
};

TEST(OutOfMemory, APictureIsRefusedAndTheNextOneIsDrawn) {
  for (const bool with_levels : {false, true}) {
    const Drawn drawn(with_levels);
    for (const unsigned threads : {1u, 2u}) {
      SplatPicture expected;
      const auto team = std::make_shared<ThreadTeam>(threads);
      CpuRasterizer(team).draw(drawn.request, expected);
      const std::vector<PickedSplat> picks = CpuRasterizer(team).pick(drawn.request);
      failEach([&](long fails, bool lasts) {
        CpuRasterizer rasterizer(team);
        SplatPicture picture;
        const auto draw = [&] { rasterizer.draw(drawn.request, picture); };
        if (tried(fails, lasts, draw) == Outcome::kThrown) draw();
        EXPECT_EQ(picture.colour, expected.colour);
        EXPECT_EQ(picture.behind, expected.behind);
      });
      failEach([&](long fails, bool lasts) {
        CpuRasterizer rasterizer(team);
        std::vector<PickedSplat> picked;
        const auto pick = [&] { picked = rasterizer.pick(drawn.request); };
        if (tried(fails, lasts, pick) == Outcome::kThrown) pick();
        EXPECT_EQ(picked, picks);
      });
      if (with_levels) continue;  // contributions are of splats alone
      Contributions sums;
      CpuRasterizer(team).contribute(drawn.request, sums);
      failEach([&](long fails, bool lasts) {
        CpuRasterizer rasterizer(team);
        Contributions found;
        const auto contribute = [&] { rasterizer.contribute(drawn.request, found); };
        if (tried(fails, lasts, contribute) == Outcome::kThrown) {
          found = {};
          contribute();
        }
        EXPECT_EQ(found.weight, sums.weight);
      });
    }
  }
}

}  // namespace
}  // namespace rosplat
