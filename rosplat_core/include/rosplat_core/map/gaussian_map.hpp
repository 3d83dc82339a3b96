#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/map/map_sample.hpp"
#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/slots/slot_set.hpp"

namespace rosplat {

class ThreadTeam;

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
  std::uint32_t group = 0;           // of the slots that are written
  std::array<double, 3> origin{};    // of that group, in its frame [m]
  std::vector<std::uint32_t> slots;  // kSlotWords a slot
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;  // kBandWords[band] a slot
  std::array<std::vector<float>, kMostChannels> channels;          // a value a slot, or none: empty
  std::vector<float> extents;    // radius of the 1/255 ellipsoid along its longest axis [m], or -1
  std::vector<GroupMove> moves;  // each group once

  // Of a slot, by its place in the arrays: relative to the origin [m].
  std::array<float, 3> position(std::size_t i) const {
    std::array<float, 3> position;
    std::memcpy(position.data(), &slots[kSlotWords * i], sizeof(position));
    return position;
  }
};

// Neighbouring slots of a group, as they were packed once.
struct PackedRun {
  Group group;
  std::uint32_t first_slot = 0;
  int sh_degree = 0;
  std::vector<std::uint32_t> slots;                                // as in GaussianEdit
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;  // the same
  std::array<std::vector<float>, kMostChannels> channels;          // the same
};

// An edit that writes them to a map that lacks them. team: helps.
GaussianEdit editOf(PackedRun run, ThreadTeam* team = nullptr);
// An edit that places groups where they are.
GaussianEdit editOf(const Groups& groups);

// What became of a batch.
struct BatchReport {
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
  // Grows with each batch. What is pulled comes in several of one revision.
  std::uint64_t edits = 0;
  std::uint32_t splats = 0;
  std::uint32_t expected = 0;  // what the publisher announced, 0 where it didn't
  std::uint32_t capacity = 0;  // one past the highest slot in use
  std::size_t groups = 0;      // that have had splats since the last clear
  int sh_degree = 0;
  std::vector<Channel> channels;  // that splats have come with since the last clear
  bool antialiased = false;       // as the first splats since the last clear
  bool pulled = false;            // in part: more is on its way
  std::uint64_t missed = 0;       // batches, since the last clear or pull
  std::uint64_t dropped = 0;      // splats, since the last clear
  // Of a map that is drawn: what comes next is in it in part, for memory was lacking.
  bool torn = false;

  // Whether all that its publisher announced is there.
  bool complete() const {
    return !torn && !pulled && missed == 0 && splats > 0 && splats + dropped >= expected;
  }
};

constexpr std::uint32_t kNoSlot = 0xffffffffu;

// One slot of a map, empty where its opacity is 0.
struct SplatValues {
  std::uint32_t slot = kNoSlot;
  std::uint32_t group = 0;
  std::array<double, 3> position{};    // in the map's frame [m]
  std::array<float, 4> orientation{};  // the same, x y z w, of any length
  std::array<float, 3> scale{};        // standard deviations along the principal axes [m]
  float opacity = 0;
  // 3 (degree + 1)^2, coefficient-major, RGB interleaved, in the group's frame.
  std::vector<float> sh;
  std::vector<float> channels;  // by MapState::channels, not finite where there is none
};

// Of a slot as packed_slot.hpp has it.
SplatValues valuesOf(std::uint32_t slot, const Group& group, const std::uint32_t* words,
                     int sh_degree,
                     const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands);

// Keeps the books of a map: which slots are in use, and of which groups, where these are, which
// revision this is, what is still missing. Knows no GPU; holds no splats but a sample. Any thread
// may apply batches, which are taken one after the other; who looks at the map doesn't wait for a
// batch to be checked and packed.
class GaussianMap {
 public:
  // Gets an edit, and the state after it, before the map knows of it, one after the other.
  using Keep = std::function<void(const std::shared_ptr<const GaussianEdit>&, const MapState&)>;

  // most_sh_degree: of what edits hold; higher bands are checked, and left out.
  explicit GaussianMap(int most_sh_degree = kMaxShDegree) : most_sh_degree_(most_sh_degree) {}

  // Checks a batch and turns it into an edit. Throws BatchError, or what `keep` throws, or
  // std::bad_alloc: then the map is unchanged, and the next batch misses this one.
  std::shared_ptr<const GaussianEdit> apply(const GaussianBatch& batch, BatchReport& report,
                                            const Keep& keep = nullptr);

  // Any thread: what look(state, sample, groups) makes of the map before or after a batch.
  template <typename Look>
  auto look(const Look& look) const {
    const std::lock_guard lock(locks_.exchanging);
    return look(state_, sample_, groups_);
  }
  // Any thread: where the splats of the sample are, in the map's frame. [m]
  std::vector<std::array<double, 3>> samplePositions() const;
  // Where no batch is applied meanwhile.
  const MapState& state() const { return state_; }
  const MapSample& sample() const { return sample_; }
  const Groups& groups() const { return groups_; }
  bool inUse(std::uint32_t slot) const { return used_.has(slot); }

 private:
  // First slots of the blocks that runs touch and that hold splats of another group.
  std::vector<std::uint32_t> blocksOfOthers(const SlotSet& used, const SlotRuns& runs,
                                            std::uint32_t group) const;

  // A copy of the map has its own.
  struct Locks {
    Locks() = default;
    Locks(const Locks&) {}
    Locks& operator=(const Locks&) { return *this; }

    std::mutex applying;    // held for a whole batch: only its holder writes anything
    std::mutex exchanging;  // of state_, sample_ and groups_, once the batch is packed
  };

  int most_sh_degree_;
  mutable Locks locks_;
  MapState state_;
  MapSample sample_;
  Groups groups_;
  SlotSet used_;
  std::vector<std::uint16_t> block_groups_;  // numbers, by SlotSet's block
};

}  // namespace rosplat
