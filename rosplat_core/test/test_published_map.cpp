#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <future>
#include <map>
#include <new>
#include <numeric>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/published_map.hpp"
#include "rosplat_core/map/slot_revisions.hpp"
#include "rosplat_core/slots/packed_rows.hpp"

namespace {

constexpr std::size_t kNever = ~std::size_t{0};
std::size_t allocations_left = kNever;

}  // namespace

// Memory that runs out when a test says so.
void* operator new(std::size_t size) {
  if (allocations_left != kNever && allocations_left-- == 0) {
    allocations_left = kNever;
    throw std::bad_alloc();
  }
  if (void* const memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace rosplat {
namespace {

using Batch = PublishedMap::Batch;
using Slots = PublishedMap::Slots;

constexpr std::uint32_t kBlock = 1024;

Splats splatsOf(std::size_t count, float x = 1, int sh_degree = 0) {
  Splats splats;
  splats.positions.assign(3 * count, x);
  splats.orientations.assign(4 * count, 0.5f);
  splats.scales.assign(3 * count, 0.1f);
  splats.opacities.assign(count, 0.5f);
  splats.sh.assign(3u * (sh_degree + 1u) * (sh_degree + 1u) * count, 0.25f);
  return splats;
}

// Packed splats, at another x each.
std::vector<std::uint32_t> rowsOf(std::size_t count, int sh_degree) {
  const auto words = static_cast<std::size_t>(rowWords(sh_degree));
  const std::vector<float> sh(45, 0.25f);
  std::vector<std::uint32_t> rows(words * count);
  for (std::size_t i = 0; i < count; ++i) {
    Splat splat;
    splat.position[0] = static_cast<float>(i);
    splat.orientation[3] = 1;
    splat.scale.fill(0.1f);
    splat.opacity = 0.5f;
    std::uint32_t* const row = rows.data() + words * i;
    packSlot(splat, sh.data(), sh_degree, row, bandsOf(row));
  }
  return rows;
}

// The x of a batch's i-th splat.
float xOf(const Batch& batch, std::size_t i) {
  float x;
  std::memcpy(&x, batch.payload.data() + packed_rows::size(i, batch.sh_degree), sizeof(x));
  return x;
}

// What a batch takes in a message, but for its header and names.
std::size_t bytesOf(const Batch& batch) {
  return 4 * (batch.slots.size() + batch.channels.size()) + batch.payload.size() +
         60 * batch.poses.size();
}

std::size_t bytesOf(const PublishedMap::Answer& answer) {
  std::size_t bytes = 0;
  for (const Batch& batch : answer.batches) bytes += bytesOf(batch) + 200;
  return bytes;
}

// What batches add up to: a group and x by slot, and where groups are. Pulls what it lacks.
struct Receiver {
  std::map<std::uint32_t, std::pair<std::uint32_t, float>> splats;
  std::map<std::uint32_t, double> places;
  std::uint64_t revision = 0;
  std::size_t largest_answer = 0, answers = 0;

  void apply(const Batch& batch) {
    if (batch.operation == GaussianBatch::REPLACE) {
      splats.clear();
      places.clear();
    }
    for (const auto& [group, pose] : batch.poses) places[group] = pose.position[0];
    for (std::uint32_t i = 0; i < batch.count; ++i) {
      const std::uint32_t slot = batch.slots.empty() ? batch.first_slot + i : batch.slots[i];
      if (batch.operation == GaussianBatch::DELETE) {
        splats.erase(slot);
      } else {
        splats[slot] = {batch.group, xOf(batch, i)};
      }
    }
    revision = batch.revision;
  }
  void pull(const PublishedMap& map) {
    std::uint64_t after = revision;
    std::uint32_t block = 0;
    do {
      const auto answer = map.pull(map.mapId(), after, block, 3);
      ASSERT_FALSE(answer.batches.empty());
      ASSERT_TRUE(answer.next_block == 0 || answer.next_block > block);
      if (answer.batches.front().operation == GaussianBatch::REPLACE) after = 0;
      for (const Batch& batch : answer.batches) apply(batch);
      largest_answer = std::max(largest_answer, bytesOf(answer));
      ++answers;
      block = answer.next_block;
    } while (block != 0);
  }
};

void expectHolds(const Receiver& receiver, const PublishedMap& map) {
  Receiver expected;
  for (const auto& group : map.groups()) {
    for (std::size_t i = 0; i < group.slots.size(); ++i) {
      expected.splats[group.slots[i]] = {group.number, group.splats.positions[3 * i]};
    }
  }
  for (const auto& [group, pose] : map.poses()) expected.places[group] = pose.position[0];
  EXPECT_EQ(receiver.splats, expected.splats);
  EXPECT_EQ(receiver.places, expected.places);
}

PublishedMap::Wire wireTo(std::vector<Batch>& sent) {
  PublishedMap::Wire wire;
  wire.send = [&sent](Batch&& batch) { sent.push_back(std::move(batch)); };
  wire.warn = [](const std::string&) {};
  wire.settle = [] {};
  return wire;
}

TEST(SlotRevisions, AreThoseThatWereSet) {
  std::mt19937_64 random(1);
  SlotRevisions revisions(8);
  std::vector<std::uint64_t> expected(8);
  std::uint64_t revision = 0;
  for (int i = 0; i < 1000; ++i) {
    revision += random() % 3;
    if (random() % 10 == 0) {
      revisions.fill(revision);
      expected.assign(8, revision);
    } else {
      const std::size_t slot = random() % 8;
      revisions.set(slot, revision);
      expected[slot] = revision;
    }
    for (std::size_t slot = 0; slot < 8; ++slot) ASSERT_EQ(revisions[slot], expected[slot]);
  }
  revisions.set(3, revision + (std::uint64_t{1} << 32));
  EXPECT_EQ(revisions[3], revision + (std::uint64_t{1} << 32));
  for (const std::size_t slot : {0u, 7u}) EXPECT_GE(revisions[slot], expected[slot]);
  EXPECT_LT(revisions[0], revisions[3]);
}

// Of an edit that ends for lack of memory, wherever: either it is no part of the map, or who hears
// the next batch pulls it.
TEST(PublishedMap, AnEditWithoutMemoryIsPulledOrNeverWas) {
  const Splats some = splatsOf(700, 2), label = [] {
    Splats splats = splatsOf(3, 3, 1);
    splats.channels.emplace_back("label", std::vector<float>(3, 7.0f));
    return splats;
  }();
  const Slots scattered = {5, 2000, 9000};
  Slots blocks_and_one(2 * kBlock);
  std::iota(blocks_and_one.begin(), blocks_and_one.end(), 0u);
  blocks_and_one.push_back(2900);
  const PublishedMap::Poses poses = {{0, {{1, 0, 0}, {0, 0, 0, 1}}}, {7, {}}};
  const std::vector<std::function<void(PublishedMap&)>> edits = {
      [&](PublishedMap& map) { map.upsert(900, some); },
      [&](PublishedMap& map) { map.upsert(scattered, label); },
      [&](PublishedMap& map) { map.upsert(8 * kBlock, label, 3); },
      [&](PublishedMap& map) { map.erase({3, 1030}); },
      [&](PublishedMap& map) { map.erase(0, 2 * kBlock); },
      [&](PublishedMap& map) { map.erase(blocks_and_one); },
      [&](PublishedMap& map) { map.move(poses); },
      [&](PublishedMap& map) { map.replace(some); },
      [&](PublishedMap& map) { map.repeat(); },
  };
  std::size_t failures = 0;
  const auto tried = [&](const std::function<void(PublishedMap&)>& edit, std::size_t chunk_bytes) {
    for (std::size_t allowed = 0;; ++allowed) {
      std::vector<Batch> sent;
      sent.reserve(100);
      PublishedMap map(chunk_bytes, "none", wireTo(sent));
      map.replace(splatsOf(3000));
      map.move({{0, {{4, 0, 0}, {0, 0, 0, 1}}}});
      map.erase({17});
      Receiver receiver;
      for (const Batch& batch : sent) receiver.apply(batch);
      sent.clear();
      bool failed = false;
      allocations_left = allowed;
      try {
        edit(map);
      } catch (const std::bad_alloc&) {
        failed = true;
      }
      allocations_left = kNever;
      failures += failed;
      map.erase(Slots{});
      std::uint64_t heard = receiver.revision;
      for (const Batch& batch : sent) {
        if (batch.revision == heard + 1) {
          receiver.apply(batch);
          ++heard;
        }
      }
      if (sent.back().revision != heard) receiver.pull(map);
      ASSERT_EQ(receiver.revision, map.revision());
      expectHolds(receiver, map);
      if (!failed) break;
      ASSERT_LT(allowed, 10'000u);
    }
  };
  // Blocks that are written in one batch have no revisions of single slots yet.
  for (const std::size_t chunk_bytes : {20'000u, 1'000'000u}) {
    for (const auto& edit : edits) tried(edit, chunk_bytes);
  }
  EXPECT_GT(failures, 100u);
}

TEST(PublishedMap, ExpectsNoSplatThatIsLeftOut) {
  std::vector<Batch> sent;
  PublishedMap map(20'000, "none", wireTo(sent));
  Splats splats = splatsOf(3);
  splats.positions[0] = std::nanf("");
  map.replace(splats);
  EXPECT_EQ(sent.at(0).expected_slots, 2u);
}

TEST(PublishedMap, ExpectsWhatItDidIfAReplacementCannotBeSent) {
  std::vector<Batch> sent;
  auto wire = wireTo(sent);
  bool fails = false;
  wire.send = [&, send = wire.send](Batch&& batch) {
    if (std::exchange(fails, false)) throw std::runtime_error("no");
    send(std::move(batch));
  };
  PublishedMap map(20'000, "none", wire);
  map.replace(splatsOf(3), 5);
  fails = true;
  EXPECT_THROW(map.replace(splatsOf(2), 7), std::runtime_error);
  map.upsert(3, splatsOf(1));
  EXPECT_EQ(sent.back().expected_slots, 5u);
}

TEST(PublishedMap, LeavesOutRowsThatReceiversDrop) {
  std::vector<Batch> sent;
  PublishedMap map(20'000, "none", wireTo(sent));
  auto rows = std::make_shared<std::vector<std::uint32_t>>(rowsOf(10, 0));
  (*rows)[rowWords(0) * 3 + kSlotWords - 1] = 0x7c00u;  // blue is infinite
  SplatsView view;
  view.arrays.count = 10;
  view.rows = rows->data();
  map.replace(view, rows, std::nullopt, std::nullopt);
  EXPECT_EQ(map.size(), 9u);
  map.upsert(0, view, 0, std::nullopt);
  EXPECT_EQ(map.size(), 9u);
  map.upsert(2000, view, 0, std::nullopt);
  EXPECT_EQ(map.size(), 18u);
}

TEST(PublishedMap, BatchesAndAnswersKeepToTheirSizes) {
  constexpr std::size_t kChunk = 100'000;
  constexpr std::uint32_t kBlocks = 12'000;
  std::vector<Batch> sent;
  PublishedMap map(kChunk, "none", wireTo(sent));
  Slots one_of_each(kBlocks);
  for (std::uint32_t i = 0; i < kBlocks; ++i) one_of_each[i] = kBlock * i + 5;
  map.upsert(one_of_each, splatsOf(kBlocks));
  Receiver late, behind;
  late.pull(map);
  behind = late;
  expectHolds(late, map);

  map.erase(one_of_each);
  for (std::uint32_t i = 0; i < kBlocks; ++i) map.upsert(one_of_each[i], splatsOf(1), i);
  PublishedMap::Poses poses;
  for (std::uint32_t i = 0; i < kMostGroups; ++i) poses[i] = {{1.0 * i, 0, 0}, {0, 0, 0, 1}};
  const std::size_t before = sent.size();
  map.move(poses);
  EXPECT_EQ(sent.size(), before + 1);  // all at once
  for (const Batch& batch : sent) {
    if (batch.operation != GaussianBatch::MOVE) EXPECT_LE(bytesOf(batch), kChunk);
  }

  PublishedMap generous(10'000'000, "none", wireTo(sent));
  generous.upsert(one_of_each, splatsOf(kBlocks));
  Receiver other;
  other.pull(generous);
  generous.erase(one_of_each);
  for (std::uint32_t i = 0; i < kBlocks; ++i) generous.upsert(one_of_each[i], splatsOf(1), i);
  generous.move(poses);
  for (auto& [receiver, from] : {std::pair<Receiver&, PublishedMap&>(behind, map),
                                 std::pair<Receiver&, PublishedMap&>(other, generous)}) {
    receiver.pull(from);
    expectHolds(receiver, from);
    EXPECT_LE(receiver.largest_answer, 2'000'000u);
  }
  EXPECT_LE(behind.largest_answer, kChunk);
  EXPECT_LT(other.answers, 40u);  // and are not small
}

// 96 bytes a splat of degree 3, and 4 for its slot.
TEST(PublishedMap, AnswersAreCutByWhatTheyTake) {
  constexpr std::size_t kCount = 60 * kBlock, kAnswer = 2'000'000;
  std::vector<Batch> sent;
  PublishedMap map(8'000'000, "none", wireTo(sent));
  map.replace(splatsOf(kCount, -5, 3));
  Receiver late;
  late.pull(map);
  expectHolds(late, map);
  EXPECT_LE(late.largest_answer, kAnswer);
  EXPECT_LE(late.answers, 1 + 100 * kCount / (kAnswer - 100 * kBlock));
}

// No splat is pulled before the pose of its group.
TEST(PublishedMap, SplatsArePulledWithTheirPose) {
  std::vector<Batch> sent;
  PublishedMap map(1000, "none", wireTo(sent));
  for (std::uint32_t i = 0; i < 100; ++i) map.upsert(kBlock * i, splatsOf(20), 32'767 - i);
  for (std::uint32_t i = 0; i < 100; ++i) map.move({{32'767 - i, {{1, 0, 0}, {0, 0, 0, 1}}}});
  Receiver late;
  std::uint32_t block = 0;
  do {
    const auto answer = map.pull(map.mapId(), 0, block, 3);
    for (const Batch& batch : answer.batches) {
      if (batch.count > 0) EXPECT_EQ(late.places.count(batch.group), 1u);
      late.apply(batch);
    }
    block = answer.next_block;
  } while (block != 0);
  expectHolds(late, map);
}

TEST(PublishedMap, GoesOnInTheAuthorsMemory) {
  std::vector<Batch> sent;
  PublishedMap map(8'000'000, "none", wireTo(sent));
  const auto author = std::make_shared<const std::vector<std::uint32_t>>(rowsOf(3000, 3));
  const std::vector<float> labels(3000, 4.0f);
  SplatsView view;
  view.arrays.count = 3000;
  view.arrays.sh_degree = 3;
  view.rows = author->data();
  view.channels.emplace_back("label", labels.data());
  map.replace(view, author, std::nullopt, std::nullopt);
  EXPECT_GT(author.use_count(), 1);
  map.upsert({1500, 4000}, splatsOf(2, 5, 1));
  EXPECT_EQ(*author, rowsOf(3000, 3));  // who edits has a page of their own
  const auto group = map.groups().front();
  ASSERT_EQ(group.slots.size(), 3001u);
  EXPECT_EQ(group.splats.positions[3 * 1500], 5);
  EXPECT_EQ(group.splats.positions[3 * 1501], 1501);
  EXPECT_EQ(group.splats.sh[48 * 1501 + 47], 0.25f);
  EXPECT_EQ(group.splats.sh[48 * 1500 + 47], 0);
  EXPECT_EQ(group.splats.channels[0].second[1499], 4);
  EXPECT_TRUE(std::isnan(group.splats.channels[0].second[1500]));
  map.replace(splatsOf(1));
  EXPECT_EQ(author.use_count(), 1);
}

TEST(PublishedMap, AnOriginThatIsNotFiniteIsRefused) {
  std::vector<Batch> sent;
  PublishedMap map(8'000'000, "none", wireTo(sent));
  Splats splats = splatsOf(3);
  splats.origin[1] = std::nan("");
  EXPECT_THROW(map.replace(splats), std::invalid_argument);
  EXPECT_THROW(map.upsert(0, splats), std::invalid_argument);
  EXPECT_TRUE(sent.empty());
}

TEST(PublishedMap, AnEditOfNoSlotsNamesNoneThatCannotBe) {
  std::vector<Batch> sent;
  PublishedMap map(8'000'000, "none", wireTo(sent));
  map.erase(1u << 31, 0);
  ASSERT_FALSE(sent.empty());
  for (const Batch& batch : sent) EXPECT_EQ(batch.first_slot, 0u);
}

// While a repeat waits for those who listen, the map is edited, and ends the same for all.
TEST(PublishedMap, IsEditedWhileItIsRepeated) {
  std::vector<Batch> sent;
  auto wire = wireTo(sent);
  PublishedMap* edited = nullptr;
  int waits = 0;
  wire.settle = [&] {
    if (++waits == 2) {
      edited->upsert(1, splatsOf(1, 9));
      edited->upsert(2500, splatsOf(10, 9));
      edited->erase(kBlock, kBlock);
      edited->upsert(kBlock + 4, splatsOf(3, 8), 5);
      edited->move({{5, {{1, 0, 0}, {0, 0, 0, 1}}}});
    }
  };
  PublishedMap map(10'000, "none", wire);
  edited = &map;
  map.replace(splatsOf(3000));
  sent.clear();
  map.repeat();
  EXPECT_GT(waits, 5);
  Receiver receiver;
  for (const Batch& batch : sent) {
    if (receiver.revision > 0) EXPECT_EQ(batch.revision, receiver.revision + 1);
    receiver.apply(batch);
  }
  expectHolds(receiver, map);
  wire.settle = nullptr;
}

TEST(PublishedMap, IsPulledWhileAnEditIsSent) {
  std::vector<Batch> sent;
  auto wire = wireTo(sent);
  const PublishedMap* pulled = nullptr;
  Receiver receiver;
  wire.send = [&](Batch&&) {
    std::async(std::launch::async, [&] { receiver.pull(*pulled); }).get();
  };
  PublishedMap map(20'000, "none", wire);
  pulled = &map;
  map.replace(splatsOf(3000));
  map.upsert(1500, splatsOf(3000, 9));
  map.erase(0, kBlock);
  map.move({{5, {{1, 0, 0}, {0, 0, 0, 1}}}});
  expectHolds(receiver, map);
}

TEST(PublishedMap, AMapThatIsReplacedWhileItIsRepeatedEndsAsTheOther) {
  std::vector<Batch> sent;
  auto wire = wireTo(sent);
  PublishedMap* edited = nullptr;
  int waits = 0;
  wire.settle = [&] {
    if (++waits == 2) edited->replace(splatsOf(5, 6));
  };
  PublishedMap map(20'000, "none", wire);
  edited = &map;
  map.replace(splatsOf(3000));
  map.repeat();
  Receiver receiver;
  for (const Batch& batch : sent) receiver.apply(batch);
  expectHolds(receiver, map);
  EXPECT_EQ(map.size(), 5u);
}

// A submap grows beyond its block into the next one, which another submap holds.
TEST(PublishedMap, AppendsToFreeSlotsOfAGroupsBlocks) {
  std::vector<Batch> sent;
  PublishedMap map(
      1 << 20, "none",
      {[&](Batch&& batch) { sent.push_back(std::move(batch)); }, [](const std::string&) {}, [] {}});
  Slots expected(1000);
  std::iota(expected.begin(), expected.end(), 0);
  EXPECT_EQ(map.append(splatsOf(1000)), expected);
  EXPECT_EQ(map.append(splatsOf(10), 1),
            Slots({1024, 1025, 1026, 1027, 1028, 1029, 1030, 1031, 1032, 1033}));
  const Slots grown = map.append(splatsOf(100));  // 24 in its block, the rest in a new one
  EXPECT_EQ(grown.front(), 1000u);
  EXPECT_EQ(grown[23], 1023u);
  EXPECT_EQ(grown[24], 2048u);
  map.erase({5, 6, 1025});
  EXPECT_EQ(map.append(splatsOf(2), 1), Slots({1025, 1034}));
  EXPECT_EQ(map.append(splatsOf(2)), Slots({5, 6}));
  EXPECT_EQ(map.append(splatsOf(0)), Slots());
  map.erase(0, 2048);
  EXPECT_EQ(map.append(splatsOf(1), 2), Slots({0}));  // a block that no splat uses is anybody's
  EXPECT_EQ(sent.back().group, 2u);
  EXPECT_THROW(map.append(splatsOf(1), 1u << 20), std::invalid_argument);
}

TEST(PublishedMap, CopiesWhatAGroupHasInSlots) {
  std::vector<Batch> sent;
  PublishedMap map(1'000'000, "none", wireTo(sent));
  map.upsert(0, splatsOf(5, 2), 0);
  map.upsert(kBlock, splatsOf(5, 3), 1);
  map.erase({2});
  const Batch batch = map.copy({0, 2, 4, kBlock, 7 * kBlock}, 0);
  EXPECT_EQ(batch.slots, (Slots{0, 4}));
  EXPECT_EQ(batch.count, 2u);
  EXPECT_EQ(xOf(batch, 1), 2);
  EXPECT_EQ(map.copy({2}, 0).count, 0u);
}

}  // namespace
}  // namespace rosplat
