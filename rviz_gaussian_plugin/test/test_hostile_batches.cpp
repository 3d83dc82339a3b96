// Batches and orders that no honest peer sends, at random: nothing ends the process, the books stay
// right, and memory stays in proportion to what the map needs.

#include <gtest/gtest.h>
#include <malloc.h>

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <limits>
#include <new>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "map/slot_pages.hpp"
#include "random_batches.hpp"
#include "rosplat_sorter/order_slots.hpp"
#include "splat_scene.hpp"

namespace {

// What this process holds now, and held at most since it was asked. [bytes]
std::atomic<std::size_t> held{0}, most_held{0};

void* take(std::size_t size) {
  void* memory = std::malloc(size);
  if (!memory) throw std::bad_alloc();
  const std::size_t now = held += malloc_usable_size(memory);
  std::size_t most = most_held;
  while (now > most && !most_held.compare_exchange_weak(most, now)) {
  }
  return memory;
}

void give(void* memory) noexcept {
  held -= malloc_usable_size(memory);
  std::free(memory);
}

}  // namespace

void* operator new(std::size_t size) { return take(size); }
void operator delete(void* memory) noexcept { give(memory); }
void operator delete(void* memory, std::size_t) noexcept { give(memory); }

using namespace rosplat;

namespace {

std::size_t cases() {
  const char* count = std::getenv("ROSPLAT_FUZZ_CASES");
  return count ? std::strtoul(count, nullptr, 10) : 2000;
}

class Random {
 public:
  explicit Random(unsigned seed) : random_(seed) {}
  bool chance(unsigned in) { return upTo(in - 1) == 0; }
  std::uint32_t upTo(std::uint32_t end) {
    return std::uniform_int_distribution<std::uint32_t>(0, end)(random_);
  }
  template <typename T>
  T of(std::initializer_list<T> values) {
    return *(values.begin() + upTo(static_cast<std::uint32_t>(values.size()) - 1));
  }
  std::mt19937& engine() { return random_; }

 private:
  std::mt19937 random_;
};

// A batch that is good but for one thing or two, as often as not.
OwnedBatch batchOf(const MapState& map, Random& random) {
  OwnedBatch batch;
  batch.map_id = random.chance(200) ? "other" : map.id;
  batch.revision =
      random.chance(50) ? random.of<std::uint64_t>({0, 1, 2, ~0ull - 1}) : map.revision + 1;
  batch.snapshot = random.chance(20);
  batch.operation = random.of<std::uint8_t>({1, 1, 1, 1, 1, 2, 2});
  if (random.chance(100)) batch.operation = GaussianBatch::REPLACE;
  if (random.chance(200)) batch.operation = 77;
  batch.sh_degree = static_cast<std::uint8_t>(random.upTo(random.chance(100) ? 255 : 3));
  batch.antialiased = random.chance(2);
  if (random.chance(10)) batch.origin = {4.5e6, random.of({0.0, 1e300, -1e9}), 0};
  batch.expected_slots = random.chance(10) ? 0xffffffffu : 0;
  const std::uint32_t below = random.of<std::uint32_t>({100, 100000, 100000, kMaxSlots});
  chooseSlots(batch, below, random.chance(20) ? 3000 : 30, random.engine());
  if (batch.sh_degree <= 3) batch.fill(random.engine());

  const auto break_one = [&](std::vector<float>& values) {
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    if (values.empty()) return;
    values[random.upTo(static_cast<std::uint32_t>(values.size()) - 1)] =
        random.of({NAN, kInfinity, -kInfinity, 3e38f, -1.0f, 0.0f, 1e-45f});
  };
  for (auto* values :
       {&batch.position, &batch.orientation, &batch.scale, &batch.opacity, &batch.harmonics}) {
    if (random.chance(8)) break_one(*values);
    if (random.chance(60)) values->resize(random.upTo(100));
  }
  if (random.chance(40)) batch.count = random.of({0u, 1u, kMaxSlots, kMaxSlots + 1, 0xffffffffu});
  if (random.chance(40)) batch.first_slot = random.of({0u, kMaxSlots - 1, kMaxSlots, 0xffffffffu});
  if (random.chance(60) && !batch.slot_list.empty()) batch.slot_list.front() = kMaxSlots;
  if (random.chance(30)) {  // all slots at once, for next to nothing
    batch = OwnedBatch();
    batch.map_id = map.id;
    batch.revision = map.revision + 1;
    batch.operation = GaussianBatch::DELETE;
    batch.count = kMaxSlots;
  }
  batch.look();
  return batch;
}

// Which slots the map has, by a plain twin.
class Twin {
 public:
  void apply(const OwnedBatch& batch, bool clear) {
    if (clear) slots_.clear(), pages_.clear();
    const bool values = batch.operation != GaussianBatch::DELETE;
    if (!values && batch.slot_list.empty()) {
      slots_.erase(slots_.lower_bound(batch.first_slot),
                   slots_.lower_bound(batch.first_slot + batch.count));
      return;
    }
    for (std::uint32_t i = 0; i < batch.count; ++i) {
      const std::uint32_t slot =
          batch.slot_list.empty() ? batch.first_slot + i : batch.slot_list[i];
      if (values) pages_.insert(slot / SlotPage::kSlots);
      if (values && means(batch, i)) {
        slots_.insert(slot);
      } else {
        slots_.erase(slot);
      }
    }
  }
  const std::set<std::uint32_t>& slots() const { return slots_; }
  std::size_t pages() const { return pages_.size(); }

 private:
  static bool means(const OwnedBatch& b, std::size_t i) {
    const auto finite = [i](const std::vector<float>& values, std::size_t width) {
      return std::all_of(values.begin() + std::ptrdiff_t(width * i),
                         values.begin() + std::ptrdiff_t(width * (i + 1)),
                         [](float v) { return std::isfinite(v); });
    };
    const auto* q = &b.orientation[4 * i];
    const auto* s = &b.scale[3 * i];
    return finite(b.position, 3) && finite(b.orientation, 4) && finite(b.scale, 3) &&
           finite(b.opacity, 1) &&
           finite(b.harmonics, 3u * (b.sh_degree + 1u) * (b.sh_degree + 1u)) &&
           (q[0] != 0 || q[1] != 0 || q[2] != 0 || q[3] != 0) && s[0] >= 0 && s[1] >= 0 &&
           s[2] >= 0;
  }

  std::set<std::uint32_t> slots_, pages_;
};

}  // namespace

// The scene is never drawn: all that arrives waits.
TEST(HostileBatches, CostWhatTheMapNeeds) {
  Random random(1);
  SplatScene scene([](const std::string&) { return std::string(); });
  Twin twin;
  std::size_t accepted = 0, refused = 0, needed = 0;
  const std::size_t before = held;
  most_held = before;
  for (std::size_t i = 0; i < cases(); ++i) {
    const MapState map = scene.state();
    const OwnedBatch batch = batchOf(map, random);
    try {
      const BatchReport report = scene.apply(batch);
      if (report.duplicate) continue;
      ++accepted;
      const bool clear = batch.map_id != map.id || batch.operation == GaussianBatch::REPLACE;
      // Where the origins differ by more than floats have, all splats are left out.
      const double shift = std::fabs(batch.origin[1] - scene.state().origin[1]);
      if (shift < 1e38) {
        twin.apply(batch, clear);
      } else {
        OwnedBatch none = batch;
        std::fill(none.opacity.begin(), none.opacity.end(), NAN);
        twin.apply(none, clear);
      }
    } catch (const BatchError&) {
      ++refused;
      ASSERT_EQ(scene.state().revision, map.revision);
    }
    ASSERT_EQ(scene.state().splats, twin.slots().size()) << "case " << i;
    // A page of slots with all their harmonics, in the queue; in the sorter; in two sets of bits.
    constexpr std::size_t kPage = SlotPage::kSlots * (4 * (11 + 3 * 15) + 24) + 2000;
    needed = std::max(needed, kPage * twin.pages());
  }
  EXPECT_GT(accepted, cases() / 4);
  EXPECT_GT(refused, cases() / 50);
  EXPECT_LT(most_held - before, needed * 3 / 2 + (64u << 20));
  EXPECT_LT(scene.backlog().bytes, needed * 3 / 2 + (17u << 20));
}

// Of any bits, in no more memory than 16 times their own.
TEST(HostileOrders, CostWhatTheyCarry) {
  Random random(2);
  rosplat_sorter::OrderReader reader;
  for (std::size_t i = 0; i < cases(); ++i) {
    std::vector<std::uint8_t> packed(random.upTo(random.chance(20) ? 100000 : 100));
    for (auto& byte : packed) byte = static_cast<std::uint8_t>(random.upTo(255));
    const unsigned bits = random.chance(10) ? random.upTo(300) : random.upTo(32);
    const std::size_t fitting = bits > 0 ? packed.size() * 8 / bits : 0;
    const std::size_t count = random.chance(4)
                                  ? random.of<std::size_t>({0, 1, kMaxSlots, ~std::size_t{0} / 32})
                                  : fitting;
    const std::size_t most = random.of<std::size_t>({3, 1000, kMaxSlots});
    std::vector<std::uint32_t> slots;
    try {
      const std::size_t bound = reader.read(
          static_cast<std::uint8_t>(random.upTo(3)), packed.data(), packed.size(), count, bits,
          random.of<std::string>({"", "rosplat_order_0", "../../etc/passwd"}), random.upTo(4),
          slots, most);
      EXPECT_EQ(bound, rosplat_sorter::boundOf(slots.data(), slots.size()));
      EXPECT_LE(slots.size(), most);
    } catch (const rosplat_sorter::OrderError&) {
    }
    EXPECT_LE(slots.capacity() * 4, 32 * (packed.size() + 1));
  }
}
