#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <future>
#include <limits>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "owned_batch.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/slots/payload.hpp"

using namespace rosplat;

namespace {

int allocations_left = -1;  // until memory runs out, once; never where negative
thread_local void (*at_allocation)() = nullptr;  // called before each of this thread

}  // namespace

void* operator new(std::size_t size) {
  if (at_allocation) std::exchange(at_allocation, nullptr)();
  if (allocations_left == 0) {
    allocations_left = -1;
    throw std::bad_alloc();
  }
  if (allocations_left > 0) --allocations_left;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace {

// Splat i sits at (i, 0, 0).
struct Batch : OwnedBatch {
  Batch(std::uint64_t revision, Operation what, std::uint32_t first, std::uint32_t n,
        std::uint8_t degree = 0)
      : OwnedBatch(revision, what, first) {
    count = n;
    sh_degree = degree;
    if (what == REPLACE || what == UPSERT) {
      position.resize(3 * n, 0.0f);
      orientation.resize(4 * n, 0.5f);
      scale.resize(3 * n, 0.1f);
      opacity.resize(n, 1.0f);
      harmonics.resize(3u * (degree + 1u) * (degree + 1u) * n, 0.25f);
      for (std::uint32_t i = 0; i < n; ++i) position[3 * i] = float(i);
    }
    look();
  }
};

Batch inGroup(std::uint32_t group, Batch batch) {
  batch.group = group;
  return batch;
}

Batch moveOf(std::uint64_t revision, std::vector<std::uint32_t> groups) {
  Batch batch(revision, GaussianBatch::MOVE, 0, 0);
  batch.group_list = std::move(groups);
  batch.poses.assign(batch.group_list.size(), {{1, 2, 3}, {0, 0, 2e-200, 2e-200}});
  batch.look();
  return batch;
}

class GaussianMapTest : public testing::Test {
 protected:
  std::shared_ptr<const GaussianEdit> apply(const GaussianBatch& batch) {
    report = {};
    return map.apply(batch, report);
  }

  GaussianMap map;
  BatchReport report;
};

}  // namespace

TEST_F(GaussianMapTest, KeepsTheBooksOfReplaceUpsertDelete) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 10));
  EXPECT_EQ(map.state().splats, 10u);
  apply(Batch(2, GaussianBatch::UPSERT, 8, 4));  // two rewritten, two new
  EXPECT_EQ(map.state().splats, 12u);
  EXPECT_EQ(map.state().capacity, 12u);
  const auto deleted = apply(Batch(3, GaussianBatch::DELETE, 0, 5));
  EXPECT_EQ(map.state().splats, 7u);
  EXPECT_EQ(deleted->runs, (SlotRuns{{0, 5}}));
  EXPECT_FALSE(map.inUse(4));
  EXPECT_TRUE(map.inUse(5));
  EXPECT_TRUE(apply(Batch(4, GaussianBatch::REPLACE, 0, 1))->clear);
  EXPECT_EQ(map.state().splats, 1u);
  EXPECT_EQ(map.state().capacity, 1u);
}

TEST_F(GaussianMapTest, DeletingUnknownSlotsChangesNothing) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 3));
  apply(Batch(2, GaussianBatch::DELETE, 2, 1000));
  EXPECT_EQ(map.state().splats, 2u);
  EXPECT_EQ(map.state().capacity, 3u);
}

TEST_F(GaussianMapTest, ADeleteCostsNoMoreThanTheMapHas) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 1000));
  apply(Batch(2, GaussianBatch::UPSERT, kMaxSlots - 1, 1));
  Batch everything(3, GaussianBatch::DELETE, 0, kMaxSlots);
  const auto edit = apply(everything);
  EXPECT_EQ(map.state().splats, 0u);
  EXPECT_EQ(countSlots(edit->runs), 2u * SlotPage::kSlots);
  EXPECT_TRUE(edit->slots.empty() && edit->extents.empty());
}

TEST_F(GaussianMapTest, ListedSlotsBecomeRuns) {
  Batch batch(1, GaussianBatch::REPLACE, 0, 5);
  batch.slot_list = {4, 5, 6, 1, 9};
  batch.look();
  const auto edit = apply(batch);
  const std::vector<std::pair<std::uint32_t, std::uint32_t>> runs{{4, 3}, {1, 1}, {9, 1}};
  EXPECT_EQ(edit->runs, runs);
  EXPECT_EQ(map.state().capacity, 10u);
}

TEST_F(GaussianMapTest, SortsSphericalHarmonicsIntoBands) {
  Batch batch(1, GaussianBatch::REPLACE, 0, 2, 1);
  for (std::size_t i = 0; i < batch.harmonics.size(); ++i) batch.harmonics[i] = float(i);
  const auto edit = apply(batch);
  EXPECT_EQ(unpackSlot(&edit->slots[0]).color, (std::array<float, 3>{0, 1, 2}));
  EXPECT_EQ(unpackSlot(&edit->slots[kSlotWords]).color, (std::array<float, 3>{12, 13, 14}));
  EXPECT_EQ(edit->bands[1].size(), 6u);
  // The first splat's largest coefficient is 11, the second's 23; red has 1023 steps.
  EXPECT_EQ(edit->bands[1][0] & 0x7ffu, 279u);  // 3 / 11
  EXPECT_EQ(edit->bands[1][3] & 0x7ffu, 667u);  // 15 / 23
  EXPECT_TRUE(edit->bands[2].empty());
}

TEST_F(GaussianMapTest, CountsLosses) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 1));
  apply(Batch(5, GaussianBatch::UPSERT, 1, 1));
  EXPECT_EQ(report.missed, 3u);
  apply(Batch(9, GaussianBatch::REPLACE, 0, 1));
  EXPECT_EQ(map.state().missed, 0u);  // a REPLACE needs nothing before it
}

TEST_F(GaussianMapTest, IsCompleteOnceTheLastOfWhatIsPulledIsThere) {
  const auto pulled = [&](Batch batch, Arrival arrival) {
    batch.arrival = arrival;
    return apply(batch);
  };
  apply(Batch(7, GaussianBatch::UPSERT, 0, 1));
  const MapState before = map.state();
  EXPECT_EQ(before.missed, 6u);
  EXPECT_FALSE(before.complete());
  pulled(Batch(7, GaussianBatch::UPSERT, 1, 1), Arrival::kPulled);
  EXPECT_FALSE(map.state().complete());
  pulled(Batch(7, GaussianBatch::UPSERT, 2, 1), Arrival::kLast);
  EXPECT_TRUE(map.state().complete());
  EXPECT_EQ(map.state().missed, 0u);
  EXPECT_EQ(map.state().round, before.round);
  EXPECT_EQ(map.state().edits, before.edits + 2);  // of one revision, but another map
}

TEST_F(GaussianMapTest, IsNotCompleteWhereAPulledBatchFailed) {
  const auto pulled = [&](std::uint32_t slot, Arrival arrival, const GaussianMap::OnEdit& on_edit) {
    Batch batch(7, GaussianBatch::UPSERT, slot, 1);
    batch.arrival = arrival;
    BatchReport fresh;
    map.apply(batch.look(), fresh, on_edit);
  };
  apply(Batch(7, GaussianBatch::UPSERT, 0, 1));
  const auto fails = [](const auto&, const MapState&) { throw std::bad_alloc(); };
  EXPECT_THROW(pulled(1, Arrival::kPulled, fails), std::bad_alloc);
  pulled(2, Arrival::kLast, nullptr);
  EXPECT_EQ(map.state().missed, 1u);
  EXPECT_FALSE(map.state().complete());
  for (const std::uint32_t slot : {1, 2}) {
    pulled(slot, slot == 1 ? Arrival::kPulled : Arrival::kLast, nullptr);
  }
  EXPECT_TRUE(map.state().complete());
}

TEST_F(GaussianMapTest, IsPlayedOnceMore) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 5));
  apply(Batch(2, GaussianBatch::UPSERT, 5, 5));
  apply(Batch(3, GaussianBatch::UPSERT, 10, 5));
  EXPECT_FALSE(apply(Batch(2, GaussianBatch::UPSERT, 5, 5))->clear);  // not from its beginning
  EXPECT_EQ(map.state().revision, 2u);
  EXPECT_EQ(map.state().splats, 15u);
  EXPECT_EQ(map.state().missed, 1u);
  EXPECT_TRUE(apply(Batch(1, GaussianBatch::REPLACE, 0, 5))->clear);
  EXPECT_EQ(map.state().splats, 5u);
  EXPECT_EQ(map.state().missed, 0u);
}

TEST_F(GaussianMapTest, AnotherMapIdStartsAnew) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 10));
  Batch other(1, GaussianBatch::UPSERT, 0, 2);
  other.map_id = "another";
  EXPECT_TRUE(apply(other)->clear);
  EXPECT_EQ(map.state().splats, 2u);
}

TEST_F(GaussianMapTest, DropsSplatsThatMeanNothing) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  Batch batch(1, GaussianBatch::REPLACE, 0, 8);
  batch.position[0] = nan;
  batch.position[3 + 1] = infinity;
  for (int k = 0; k < 4; ++k) batch.orientation[4 * 2 + k] = 0.0f;
  batch.scale[3 * 3] = -1.0f;
  batch.opacity[4] = nan;
  batch.harmonics[3 * 5] = nan;
  batch.opacity[6] = 7.0f;  // more than opaque: opaque
  const auto edit = apply(batch);
  EXPECT_EQ(report.dropped, 6u);
  EXPECT_EQ(map.state().splats, 2u);
  for (int i = 0; i < 6; ++i) EXPECT_EQ(unpackSlot(&edit->slots[kSlotWords * i]).opacity, 0.0f);
  EXPECT_EQ(edit->extents[0], -1.0f);
  EXPECT_EQ(unpackSlot(&edit->slots[kSlotWords * 6]).opacity, 1.0f);
}

TEST_F(GaussianMapTest, RebasesToTheOriginOfTheFirstBatch) {
  Batch first(1, GaussianBatch::REPLACE, 0, 1);
  first.origin = {4.5e6, 0, 0};
  apply(first);
  Batch second(2, GaussianBatch::UPSERT, 1, 1);
  second.origin = {4.5e6 + 0.125, 0, 0};
  EXPECT_EQ(apply(second)->position(0)[0], 0.125f);
}

TEST_F(GaussianMapTest, ExtentIsTheEllipsoidOfOneGreyLevel) {
  Batch batch(1, GaussianBatch::REPLACE, 0, 3);
  batch.scale[0] = 2.0f;
  batch.opacity = {1.0f, 0.5f, 0.003f};
  batch.look();
  const auto edit = apply(batch);
  // alpha = opacity exp(-r^2 / 2 sigma^2) = 1/255
  EXPECT_NEAR(edit->extents[0], 2.0 * std::sqrt(2.0 * std::log(255.0)), 1e-2);
  EXPECT_NEAR(0.5 * std::exp(-0.5 * std::pow(edit->extents[1] / 0.1, 2)), 1.0 / 255.0, 1e-6);
  EXPECT_EQ(edit->extents[2], -1.0f);
}

TEST_F(GaussianMapTest, RefusesBatchesThatContradictThemselves) {
  const auto refuses = [this](Batch batch, const std::string& field) {
    try {
      apply(batch);
      ADD_FAILURE() << "accepted a batch with a wrong " << field;
    } catch (const BatchError& error) {
      EXPECT_NE(std::string(error.what()).find(field), std::string::npos) << error.what();
    }
  };
  const Batch good(7, GaussianBatch::REPLACE, 0, 2);
  Batch bad = good;
  bad.look(), bad.positions.size = 5, refuses(bad, "positions");
  bad.look(), bad.orientations.size = 7, refuses(bad, "orientations");
  bad.look(), bad.scales.size = 0, refuses(bad, "scales");
  bad.look(), bad.opacities.size = 3, refuses(bad, "opacities");
  bad.look(), bad.sh_degree = 1, refuses(bad, "sh");
  bad = good, bad.look(), bad.sh_degree = 7, refuses(bad, "sh_degree");
  bad = good, bad.look(), bad.operation = 4, refuses(bad, "operation");
  bad = good, bad.look(), bad.revision = 0, refuses(bad, "revision");
  bad = good, bad.look(), bad.format = "x", refuses(bad, "format");
  bad = good, bad.look(), bad.first_slot = kMaxSlots, refuses(bad, "first_slot");
  bad = good, bad.slot_list = {1, kMaxSlots}, bad.look(), refuses(bad, "slots");
  bad = good, bad.slot_list = {1}, bad.look(), refuses(bad, "slots");
  bad = good, bad.look(), bad.origin[1] = NAN, refuses(bad, "origin");
  bad = good, bad.look(), bad.group = kMostGroups, refuses(bad, "group");
  bad = good, bad.group_list = {1}, bad.look(), refuses(bad, "groups");
  bad = good, bad.look(), bad.poses.resize(1), refuses(bad, "poses");
  const Batch move = moveOf(7, {3, 9});
  bad = move, bad.group_list = {3, 3}, bad.look(), refuses(bad, "groups");
  bad = move, bad.group_list = {3, kMostGroups}, bad.look(), refuses(bad, "groups");
  bad = move, bad.look(), bad.poses.pop_back(), refuses(bad, "poses");
  bad = move, bad.look(), bad.poses[1].position[2] = NAN, refuses(bad, "poses");
  bad = move, bad.look(), bad.poses[1].orientation[0] = INFINITY, refuses(bad, "poses");
  bad = move, bad.look(), bad.poses[0].orientation = {}, refuses(bad, "poses");
  bad = move, bad.look(), bad.count = 1, refuses(bad, "count");
  bad = move, bad.slot_list = {1}, bad.look(), refuses(bad, "slots");
  bad = move, bad.opacity = {1}, bad.look(), refuses(bad, "opacities");
  bad = Batch(7, GaussianBatch::DELETE, 0, 2);
  bad.position.resize(6), bad.look(), refuses(bad, "positions");
  EXPECT_EQ(map.state().revision, 0u);  // none of them left a trace
}

TEST_F(GaussianMapTest, ABlockIsOfOneGroupUntilItIsEmpty) {
  apply(inGroup(1, Batch(1, GaussianBatch::REPLACE, 2040, 20)));  // of two blocks
  apply(inGroup(2, Batch(2, GaussianBatch::UPSERT, 3072, 5)));
  EXPECT_EQ(map.state().groups, 2u);
  Batch both = inGroup(2, Batch(3, GaussianBatch::UPSERT, 0, 2));
  both.slot_list = {3080, 2060};  // the latter isn't in use, but its block is
  both.look();
  try {
    apply(both);
    ADD_FAILURE();
  } catch (const BatchError& error) {
    EXPECT_STREQ(error.what(),
                 "group is 2, but slots 2048 to 3071 hold splats of group 1: delete them first");
  }
  EXPECT_EQ(map.state().splats, 25u);
  EXPECT_FALSE(map.inUse(3080));
  apply(Batch(3, GaussianBatch::DELETE, 2048, 1000));
  EXPECT_EQ(apply(both)->group, 2u);
  EXPECT_THROW(apply(inGroup(2, Batch(4, GaussianBatch::UPSERT, 0, 2000))), BatchError);
  apply(inGroup(2, Batch(4, GaussianBatch::REPLACE, 0, 2048)));  // which forgets all
  EXPECT_EQ(map.state().groups, 1u);
}

TEST_F(GaussianMapTest, AGroupHasItsOwnOrigin) {
  Batch first = inGroup(5, Batch(1, GaussianBatch::REPLACE, 0, 1));
  first.origin = {4.5e6, 0, 0};
  apply(first);
  Batch other = inGroup(6, Batch(2, GaussianBatch::UPSERT, 1024, 1));
  other.origin = {-7e6, 0, 0};
  EXPECT_EQ(apply(other)->origin, other.origin);
  Batch again = inGroup(5, Batch(3, GaussianBatch::UPSERT, 1, 1));
  again.origin = {4.5e6 + 0.125, 0, 0};
  const auto edit = apply(again);
  EXPECT_EQ(edit->origin, first.origin);
  EXPECT_EQ(edit->position(0)[0], 0.125f);
}

TEST_F(GaussianMapTest, PosesStayUntilTheMapBeginsAnew) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 5));
  const auto edit = apply(moveOf(2, {32767, 0}));
  ASSERT_EQ(edit->moves.size(), 2u);
  EXPECT_TRUE(edit->runs.empty());
  EXPECT_EQ(edit->revision, 2u);
  EXPECT_EQ(edit->moves[0].group, 32767u);
  EXPECT_DOUBLE_EQ(edit->moves[0].pose.orientation[3], std::sqrt(0.5));
  apply(Batch(3, GaussianBatch::DELETE, 0, 5));
  // A quarter turn about z.
  ASSERT_TRUE(map.groups().find(0));
  const auto there = map.groups().find(0)->inMap(std::array<double, 3>{10, 20, 30});
  EXPECT_NEAR(there[0], 1 - 20, 1e-12);
  EXPECT_NEAR(there[1], 2 + 10, 1e-12);
  EXPECT_NEAR(there[2], 3 + 30, 1e-12);
  apply(Batch(4, GaussianBatch::REPLACE, 0, 0));
  EXPECT_FALSE(map.groups().find(0));
}

// Wherever memory runs out, a batch leaves no trace, and the next one says that it is missing.
TEST_F(GaussianMapTest, IsUnchangedByABatchThatMemoryIsLackingFor) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 10));
  std::vector<Batch> batches{Batch(2, GaussianBatch::REPLACE, 5, 300, 3),
                             Batch(2, GaussianBatch::UPSERT, 5, 300, 3)};
  batches.push_back(batches.back());
  batches.back().slot_list.resize(300);
  for (std::uint32_t i = 0; i < 300; ++i) batches.back().slot_list[i] = 2 * i;
  batches.push_back(inGroup(9, Batch(2, GaussianBatch::UPSERT, 5000, 300)));
  batches.push_back(moveOf(2, {1, 2, 3}));
  const Batch later(3, GaussianBatch::UPSERT, 0, 1);
  for (Batch& batch : batches) {
    batch.look();
    int failures = 0;
    for (bool done = false; !done; ++failures) {
      GaussianMap trial = map;
      BatchReport missed;
      report = {};
      allocations_left = failures;
      try {
        trial.apply(batch, report, [](const auto&, const MapState&) { std::string(100, 'x'); });
        done = true;
      } catch (const std::bad_alloc&) {
        EXPECT_EQ(trial.state().revision, 1u);
        EXPECT_EQ(trial.state().splats, 10u);
        EXPECT_EQ(trial.state().capacity, 10u);
        EXPECT_EQ(trial.state().sh_degree, 0);
        EXPECT_EQ(trial.groups().all().size(), 1u);
        EXPECT_FALSE(trial.apply(later, missed)->clear);
        EXPECT_EQ(missed.missed, 1u);
        EXPECT_EQ(trial.state().splats, 10u);
      }
      allocations_left = -1;
    }
    EXPECT_GT(failures, 8);  // the edit's arrays and what the map keeps
  }
}

namespace {

// Has another thread look at a map, and waits for it, wherever apply() needs memory: of all that it
// does, what is checked, decoded and packed needs most.
struct Onlooker {
  static inline const GaussianMap* map = nullptr;
  static inline int looks = 0, late = 0;
  static inline std::vector<std::uint64_t> revisions;

  static void look() {
    auto seen = std::async(std::launch::async, [] {
      return map->inspect([](const MapState& state, const auto&...) { return state.revision; });
    });
    ++looks;
    if (seen.wait_for(std::chrono::seconds(late ? 0 : 30)) != std::future_status::ready) {
      ++late;
      static std::vector<std::future<std::uint64_t>> left;  // as their end waits
      left.push_back(std::move(seen));
    } else {
      revisions.push_back(seen.get());
    }
    at_allocation = look;
  }
};

}  // namespace

TEST_F(GaussianMapTest, WhoLooksAtItWaitsForNoBatch) {
  apply(Batch(1, GaussianBatch::REPLACE, 0, 10));
  Batch batch(2, GaussianBatch::UPSERT, 5, 2000, 3);
  std::vector<std::uint8_t> bytes(payload::size(2000, 3));
  SplatArrays<const float> splats{2000,
                                  3,
                                  batch.position.data(),
                                  batch.orientation.data(),
                                  batch.scale.data(),
                                  batch.opacity.data(),
                                  batch.harmonics.data()};
  payload::encode(splats, std::vector<bool>(2000, true), bytes.data());
  OwnedBatch packed(2, GaussianBatch::UPSERT, 5);
  packed.count = 2000;
  packed.sh_degree = 3;
  packed.format = payload::kFormat;
  packed.payload = bytes;
  Onlooker::map = &map;
  at_allocation = Onlooker::look;
  apply(packed);
  at_allocation = nullptr;
  EXPECT_EQ(Onlooker::late, 0);
  EXPECT_GT(Onlooker::looks, 10);
  EXPECT_EQ(Onlooker::revisions, std::vector<std::uint64_t>(Onlooker::revisions.size(), 1));
  EXPECT_EQ(map.state().revision, 2u);
}
