#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <utility>
#include <vector>

#include "random_batches.hpp"
#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/map/slot_pages.hpp"

using namespace rosplat;

namespace {

constexpr std::uint32_t kSlots = 3000;

// What a receiver holds, slot by slot: all words, those of absent bands zero, and extent.
class Receiver {
 public:
  void apply(const GaussianEdit& edit) {
    if (edit.clear) slots_.clear(), poses_.clear();
    for (const GroupMove& move : edit.moves) poses_[move.group] = move.pose.position;
    std::size_t i = 0;
    forEachSlot(edit.runs, [&](std::uint32_t slot) {
      if (edit.sh_degree < 0) {
        slots_.erase(slot);
      } else {
        std::uint32_t& group = blocks_[slot / SlotPage::kSlots];
        if (group != edit.group) {
          const std::uint32_t first = slot - slot % SlotPage::kSlots;
          slots_.erase(slots_.lower_bound(first), slots_.lower_bound(first + SlotPage::kSlots));
          group = edit.group;
        }
        Slot& held = slots_[slot] = {};
        held.group = edit.group;
        held.origin = edit.origin;
        const auto keep = [&](const std::vector<std::uint32_t>& words, std::size_t width) {
          for (std::size_t k = 0; k < width; ++k) {
            held.words.push_back(words.empty() ? 0 : words[width * i + k]);
          }
        };
        keep(edit.slots, kSlotWords);
        for (int band = 1; band <= kMaxShDegree; ++band) keep(edit.bands[band], kBandWords[band]);
        held.extent = edit.extents[i];
        for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
          const std::vector<float>& values = edit.channels[channel];
          held.channels[channel] = values.empty() ? -1 : values[i];
        }
      }
      ++i;
    });
  }
  bool operator==(const Receiver& o) const { return slots_ == o.slots_ && poses_ == o.poses_; }

  using Poses = std::map<std::uint32_t, std::array<double, 3>>;  // positions, by group
  const Poses& poses() const { return poses_; }

 private:
  struct Slot {
    std::vector<std::uint32_t> words;
    float extent = -1;
    std::array<float, kMostChannels> channels{};  // -1: none
    std::uint32_t group = 0;
    std::array<double, 3> origin{};
    bool operator==(const Slot& o) const {
      return words == o.words && extent == o.extent && channels == o.channels && group == o.group &&
             origin == o.origin;
    }
  };
  std::map<std::uint32_t, Slot> slots_;
  std::map<std::uint32_t, std::uint32_t> blocks_;  // groups
  Poses poses_;
};

// What 300 edits, coalesced or not, may be made of.
OwnedBatch randomBatch(std::uint64_t revision, std::mt19937& random) {
  const auto chance = [&](int in) { return std::uniform_int_distribution<>(1, in)(random) == 1; };
  OwnedBatch batch(revision);
  batch.operation = chance(60)  ? GaussianBatch::REPLACE
                    : chance(4) ? GaussianBatch::DELETE
                                : GaussianBatch::UPSERT;
  batch.sh_degree = static_cast<std::uint8_t>(std::uniform_int_distribution<>(0, 3)(random));
  chooseSlots(batch, kSlots, chance(10) ? kSlots : 40, random);
  batch.group = std::uniform_int_distribution<std::uint32_t>(0, 2)(random);
  batch.origin[0] = std::uniform_int_distribution<>(0, 9)(random);
  if (batch.operation == GaussianBatch::DELETE && chance(3)) {  // a block, for another group
    batch.slot_list.clear();
    batch.first_slot = batch.group * SlotPage::kSlots;
    batch.count = SlotPage::kSlots;
  }
  if (batch.operation == GaussianBatch::UPSERT && chance(3)) chooseMoves(batch, 3, random);
  for (const char* name : {"label", "seen", "age"}) {
    if (chance(3)) batch.channel_names.push_back(name);
  }
  fill(batch, random);
  if (chance(3) && !batch.opacity.empty()) batch.opacity.front() = NAN;  // its slot becomes empty
  return batch;
}

std::shared_ptr<const GaussianEdit> apply(GaussianMap& map, const GaussianBatch& batch) {
  BatchReport report;
  return map.apply(batch, report);
}

}  // namespace

TEST(EditQueue, WhatIsCoalescedLeavesWhatOneByOneDoes) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    std::mt19937 random(seed);
    GaussianMap map;
    EditQueue queue(20000);  // bytes, so that most edits are coalesced
    Receiver one_by_one, drawn;
    MapState state;
    std::vector<Receiver::Poses> poses{{}};  // by revision
    const auto take = [&] {
      const EditQueue::Waiting waiting = queue.pop();
      EXPECT_GE(waiting.state.revision, state.revision);
      EXPECT_EQ(waiting.edit->revision, waiting.state.revision);
      drawn.apply(*waiting.edit);
      state = waiting.state;
      // Groups have never been where they were not, all at a time; and what is written is where it
      // was when it was written.
      EXPECT_NE(std::find(poses.begin(), poses.end(), drawn.poses()), poses.end());
      const GaussianEdit& edit = *waiting.edit;
      if (edit.sh_degree >= 0 && !edit.runs.empty()) {
        const auto placeIn = [&edit](const Receiver::Poses& all) {
          const auto found = all.find(edit.group);
          return found == all.end() ? std::array<double, 3>{} : found->second;
        };
        EXPECT_EQ(placeIn(drawn.poses()), placeIn(poses[edit.revision]));
      }
    };
    std::size_t most = 0;
    for (std::uint64_t revision = 1; revision <= 300; ++revision) {
      OwnedBatch batch = randomBatch(revision, random);
      std::shared_ptr<const GaussianEdit> edit;
      try {
        edit = apply(map, batch);
      } catch (const BatchError&) {  // another group's block
        edit = apply(map, OwnedBatch(revision, GaussianBatch::DELETE));
      }
      one_by_one.apply(*edit);
      poses.push_back(one_by_one.poses());
      queue.push(EditQueue::node(edit, map.state()));
      most = std::max(most, queue.size());
      for (int i = std::uniform_int_distribution<>(-20, 2)(random); i > 0 && !queue.empty(); --i) {
        take();
      }
    }
    EXPECT_LT(most, 250u);  // some were left out
    while (!queue.empty()) take();
    EXPECT_EQ(queue.bytes(), 0u);
    EXPECT_TRUE(drawn == one_by_one) << "seed " << seed;
    EXPECT_EQ(state.revision, 300u);
    EXPECT_EQ(state.splats, map.state().splats);
  }
}

TEST(EditQueue, TakesNoMoreMemoryThanTheSlotsThatItWrites) {
  std::mt19937 random(1);
  GaussianMap map;
  EditQueue queue;
  OwnedBatch batch(1, GaussianBatch::UPSERT);
  batch.sh_degree = 3;
  batch.count = 1000;
  fill(batch, random);
  std::size_t most = 0;
  for (; batch.revision <= 3000; ++batch.revision) {
    queue.push(EditQueue::node(apply(map, batch), map.state()));
    most = std::max(most, queue.bytes());
  }
  EXPECT_LT(most, 17u << 20);  // of 350 MB
  for (std::uint64_t revision = 3001; revision <= 103000; ++revision) {
    const OwnedBatch nothing(revision, GaussianBatch::UPSERT);
    queue.push(EditQueue::node(apply(map, nothing), map.state()));
  }
  EXPECT_LT(queue.bytes(), 17u << 20);
}

TEST(EditQueue, AClearDropsWhatWaits) {
  std::mt19937 random(1);
  GaussianMap map;
  EditQueue queue;
  OwnedBatch batch;
  batch.count = 10;
  for (batch.revision = 1; batch.revision <= 3; ++batch.revision) {
    batch.operation = batch.revision == 2 ? GaussianBatch::UPSERT : GaussianBatch::REPLACE;
    fill(batch, random);
    queue.push(EditQueue::node(apply(map, batch), map.state()));
  }
  EXPECT_EQ(queue.size(), 1u);
  EXPECT_EQ(queue.pop().state.revision, 3u);
}

// Parts of all sizes are, in turn, the edits that they are of; and what is overwritten meanwhile is
// left out of what is left.
TEST(EditQueue, PartsAddUpToTheirEdit) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    std::mt19937 random(seed);
    const auto chance = [&](int in) { return std::uniform_int_distribution<>(1, in)(random) == 1; };
    GaussianMap map;
    EditQueue queue(20000);
    Receiver one_by_one, drawn;
    bool more = false;
    std::size_t parts = 0;
    const auto take = [&] {
      const std::size_t most = std::uniform_int_distribution<std::size_t>(1, 5000)(random);
      const EditQueue::Waiting taken = queue.pop(most).front();
      EXPECT_LE(uploadBytes(*taken.edit), std::max<std::size_t>(most, 4 * 40));
      EXPECT_TRUE(taken.state.pulled || !taken.more);
      drawn.apply(*taken.edit);
      more = taken.more;
      parts += more;
    };
    for (std::uint64_t revision = 1; revision <= 100; ++revision) {
      OwnedBatch batch = randomBatch(revision, random);
      std::shared_ptr<const GaussianEdit> edit;
      try {
        edit = apply(map, batch);
      } catch (const BatchError&) {  // another group's block
        edit = apply(map, OwnedBatch(revision, GaussianBatch::DELETE));
      }
      one_by_one.apply(*edit);
      queue.push(EditQueue::node(edit, map.state()));
      while (!queue.empty() && !chance(5)) take();
    }
    while (!queue.empty()) take();
    EXPECT_FALSE(more);
    EXPECT_GT(parts, 20u);
    EXPECT_EQ(queue.bytes(), 0u);
    EXPECT_TRUE(drawn == one_by_one) << "seed " << seed;
  }
}
