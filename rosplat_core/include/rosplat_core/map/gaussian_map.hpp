#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/map/gaussian_batch.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/map/map_sample.hpp"
#include "rosplat_core/slots/model.hpp"
#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/slots/slot_set.hpp"

namespace rosplat {

class ThreadTeam;

constexpr std::uint32_t kMaxSlots = 1u << 25;  // as GaussianArray.MAX_SLOTS

// Slots as packed_slot.hpp has them.
struct SlotArrays {
  std::vector<std::uint32_t> slots;                                // kSlotWords a slot
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;  // kBandWords[band] a slot
  std::array<std::vector<float>, kMostChannels> channels;          // a value a slot, or empty

  std::size_t bytes() const;
};

// Calls each(values a slot, array of the first, array of the next, ...) for all arrays of
// SlotArrays, or of what has arrays of the same names.
template <typename Each, typename... Of>
void forEachArray(const Each& each, Of&... of) {
  each(std::size_t(kSlotWords), of.slots...);
  for (std::size_t band = 1; band < kBandWords.size(); ++band) {
    each(std::size_t(kBandWords[band]), of.bands[band]...);
  }
  for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
    each(std::size_t(1), of.channels[channel]...);
  }
}

// A checked batch, laid out for the GPU and for sorting. Emptied slots have opacity 0 and extent
// -1.
struct GaussianEdit : SlotArrays {
  bool clear = false;          // empty the map first
  std::uint64_t round = 0;     // as MapState::round
  std::uint64_t revision = 0;  // of the map afterwards
  std::uint32_t capacity = 0;  // one past the highest slot in use afterwards
  int sh_degree = -1;          // highest band, -1 if no splats are written
  // The arrays hold the slots of the runs in turn. If slots are only emptied, the arrays are empty,
  // and the runs are cut to the pages that the map has.
  SlotRuns runs;
  std::uint32_t group = 0;         // of all splats written
  std::array<double, 3> origin{};  // of that group, in its frame [m]
  std::vector<float> extents;    // radius of the 1/255 ellipsoid along its longest axis [m], or -1
  std::vector<GroupMove> moves;  // each group once

  // Position of the i-th slot of the arrays, relative to the origin [m].
  std::array<float, 3> position(std::size_t i) const {
    std::array<float, 3> position;
    std::memcpy(position.data(), &slots[kSlotWords * i], sizeof(position));
    return position;
  }
};

// Consecutive slots of a group, packed already.
struct PackedRun : SlotArrays {
  Group group;
  std::uint32_t first_slot = 0;
  int sh_degree = 0;
};

// An edit that writes a run to a map that lacks these slots. team: threads that help.
GaussianEdit editOf(PackedRun run, ThreadTeam* team = nullptr);
// An edit that places groups at their poses.
GaussianEdit editOf(const Groups& groups);

// What became of a batch.
struct BatchReport {
  std::uint64_t missed = 0;   // batches lost before this one
  std::uint64_t dropped = 0;  // splats that aren't usable (isUsable()); their slots are empty
};

// A batch that contradicts itself; the map is unchanged. what() names the field.
struct BatchError : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

// What is known of a map after a batch.
struct MapState {
  std::string id;
  // Grows when revisions begin again: with another map, or with one that is played again.
  std::uint64_t round = 0;
  std::uint64_t revision = 0;
  std::uint64_t begun = 0;  // grows with each clear: slots may be other splats then
  // Grows with each batch, unlike revision: several pulled batches have the same one.
  std::uint64_t edits = 0;
  std::uint32_t splats = 0;
  std::uint32_t expected = 0;  // what the publisher announced, 0 where it didn't
  std::uint32_t capacity = 0;  // one past the highest slot in use
  std::size_t groups = 0;      // that have had splats since the last clear
  int sh_degree = 0;
  std::vector<Channel> channels;  // that splats have come with since the last clear
  Model model = Model::kEwa;      // as the first splats since the last clear
  bool pulled = false;            // only a part is there, more is on its way
  std::uint64_t missed = 0;       // batches, since the last clear or pull
  std::uint64_t dropped = 0;      // splats, since the last clear
  // Of a drawn map: it holds only a part of the next edit, because memory ran out, say.
  bool torn = false;

  // Whether all splats that the publisher announced are there.
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
  std::array<float, 4> orientation{};  // in the map's frame, x y z w, of any length
  std::array<float, 3> scale{};        // standard deviations along the principal axes [m]
  float opacity = 0;
  // 3 (degree + 1)^2, coefficient-major, RGB interleaved, in the group's frame.
  std::vector<float> sh;
  std::vector<float> channels;  // in the order of MapState::channels; not finite: no value
};

// Unpacks a slot (packed_slot.hpp) of a group. Channels stay empty.
SplatValues valuesOf(std::uint32_t slot, const Group& group, const std::uint32_t* words,
                     int sh_degree,
                     const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands);

// Keeps the books of a map: its slots in use, their groups, the poses of groups, the revision, and
// what is missing. Knows no GPU, and holds only a sample of the splats. Any thread may apply
// batches, which are applied one after the other. inspect() doesn't wait for a batch to be checked
// and packed.
class GaussianMap {
 public:
  // Takes an edit and the state after it, before the map changes. Calls come one after the other.
  using OnEdit = std::function<void(const std::shared_ptr<const GaussianEdit>&, const MapState&)>;

  // most_sh_degree: the highest band in edits; higher ones are checked and left out.
  explicit GaussianMap(int most_sh_degree = kMaxShDegree) : most_sh_degree_(most_sh_degree) {}

  // Checks a batch and turns it into an edit. Throws BatchError, or what `on_edit` throws, or
  // std::bad_alloc: then the map is unchanged, and the next batch misses this one.
  std::shared_ptr<const GaussianEdit> apply(const GaussianBatch& batch, BatchReport& report,
                                            const OnEdit& on_edit = nullptr);

  // Any thread: returns inspect(state, sample, groups) of the map between two batches.
  template <typename Inspect>
  auto inspect(const Inspect& inspect) const {
    const std::lock_guard lock(locks_.exchanging);
    return inspect(state_, sample_, groups_);
  }
  // Any thread: positions of the sample's splats in the map's frame. [m]
  std::vector<std::array<double, 3>> samplePositions() const;
  // Only while no batch is being applied.
  const MapState& state() const { return state_; }
  const MapSample& sample() const { return sample_; }
  const Groups& groups() const { return groups_; }
  bool inUse(std::uint32_t slot) const { return used_.has(slot); }

 private:
  // Whether a batch begins the map anew.
  bool begins(const GaussianBatch& batch) const;
  // The state after a batch, but for its splats.
  MapState stateAfter(const GaussianBatch& batch, BatchReport& report) const;
  // First slots of those blocks touched by runs that hold splats of another group than the batch's.
  // Throws BatchError for such a block, unless the batch was pulled: the block may then be newer
  // than the batches after it. It is emptied, and a later one of these writes its splats again.
  std::vector<std::uint32_t> blocksOfOthers(const SlotSet& used, const SlotRuns& runs,
                                            const GaussianBatch& batch) const;
  // Lays out the splats of a batch in an edit that has its runs and origin, and takes them into a
  // state. Returns which are valid.
  std::vector<bool> layOutSplats(const GaussianBatch& batch, MapState& next,
                                 GaussianEdit& edit) const;

  // Each copy of a map has its own locks.
  struct Locks {
    Locks() = default;
    Locks(const Locks&) {}
    Locks& operator=(const Locks&) { return *this; }

    std::mutex applying;    // held for a whole batch: only its holder writes anything
    std::mutex exchanging;  // guards state_, sample_, groups_; writers lock it after packing
  };

  int most_sh_degree_;
  mutable Locks locks_;
  std::uint64_t lost_ = 0;  // pulled batches that failed, of the pull in progress
  MapState state_;
  MapSample sample_;
  Groups groups_;
  SlotSet used_;
  std::vector<std::uint16_t> block_groups_;  // group numbers, by SlotSet's page
};

}  // namespace rosplat
