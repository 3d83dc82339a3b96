#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "map/gaussian_batch.hpp"
#include "map/map_sample.hpp"
#include "map/packed_slot.hpp"
#include "map/slot_set.hpp"

namespace rosplat {

constexpr std::uint32_t kMaxSlots = 1u << 25;  // as GaussianArray.MAX_SLOTS

// A checked batch, laid out for the GPU and for sorting. Emptied slots have opacity 0 and extent
// -1.
struct GaussianEdit {
  bool clear = false;          // empty the map first
  std::uint64_t round = 0;     // as MapState::round
  std::uint64_t revision = 0;  // of the map afterwards
  std::uint32_t capacity = 0;  // one past the highest slot in use afterwards
  int sh_degree = -1;          // bands present, -1 where only slots are emptied
  // The arrays hold the runs one after the other; where only slots are emptied, they are empty, and
  // the runs go no farther than the map does.
  SlotRuns runs;
  std::vector<std::uint32_t> slots;                                // kSlotWords a slot
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;  // kBandWords[band] a slot
  std::vector<float> positions;  // 3 a slot [m], relative to the map's origin
  std::vector<float> extents;    // radius of the 1/255 ellipsoid along its longest axis [m], or -1
};

// An edit that writes neighbouring slots as they were packed once, to a map that lacks them.
GaussianEdit editOf(std::uint32_t first_slot, std::vector<std::uint32_t> slots,
                    std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands, int sh_degree);

// What became of a batch.
struct BatchReport {
  bool duplicate = false;     // a snapshot of what is here already, ignored
  std::uint64_t missed = 0;   // batches lost before this one
  std::uint64_t dropped = 0;  // splats with values that mean nothing; their slots are empty
};

// A batch that contradicts itself; the map is unchanged. what() names the field.
struct BatchError : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

// What is known of a map after a batch.
struct MapState {
  std::string id;
  // Grows where revisions begin again: with another map, or one that is played once more.
  std::uint64_t round = 0;
  std::uint64_t revision = 0;
  std::uint32_t splats = 0;
  std::uint32_t expected = 0;  // what the publisher announced, 0 where it didn't
  std::uint32_t capacity = 0;  // one past the highest slot in use
  int sh_degree = 0;
  bool antialiased = false;
  // As the first splats since the last clear had them; origin is added to every position. [m]
  std::array<double, 3> origin{};
  std::uint64_t missed = 0;   // batches, since the last clear
  std::uint64_t dropped = 0;  // splats, since the last clear

  // Whether all that its publisher announced is there.
  bool complete() const { return splats > 0 && splats + dropped >= expected; }
};

constexpr std::uint32_t kNoSlot = 0xffffffffu;

// One slot of a map, empty where its opacity is 0.
struct SplatValues {
  std::uint32_t slot = kNoSlot;
  std::array<double, 3> position{};    // [m]
  std::array<float, 4> orientation{};  // x y z w, of any length
  std::array<float, 3> scale{};        // standard deviations along the principal axes [m]
  float opacity = 0;
  std::vector<float> sh;  // 3 (degree + 1)^2, coefficient-major, RGB interleaved
};

// Keeps the books of a map: which slots are in use, which revision this is, what is still missing.
// Knows no GPU; holds no splats but a sample.
class GaussianMap {
 public:
  // Gets an edit, and the state after it, before the map knows of it.
  using Keep = std::function<void(const std::shared_ptr<const GaussianEdit>&, const MapState&)>;

  // Checks a batch and turns it into an edit; null for a duplicate. Throws BatchError, or what
  // `keep` throws, or std::bad_alloc: then the map is unchanged, and the next batch misses this
  // one.
  std::shared_ptr<const GaussianEdit> apply(const GaussianBatch& batch, BatchReport& report,
                                            const Keep& keep = nullptr);

  const MapState& state() const { return state_; }
  const MapSample& sample() const { return sample_; }
  bool inUse(std::uint32_t slot) const { return used_.has(slot); }

 private:
  MapState state_;
  MapSample sample_;
  SlotSet used_;
};

}  // namespace rosplat
