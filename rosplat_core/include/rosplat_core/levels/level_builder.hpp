#pragma once

#include <array>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/map/edit_queue.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/host_slots.hpp"

namespace rosplat {

// The level at which each slot of a page enters the lattice; kNoLevel if no node holds it yet.
using EntryLevels = std::array<std::uint8_t, SlotPage::kSlots>;
constexpr std::uint8_t kNoLevel = 0xff;

// The entry level of a slot that an edit has just written. source: its place in the edit's arrays.
// kNoLevel, for no node holds the slot yet; an invisible slot may have any level.
inline std::uint8_t levelOfNew(const GaussianEdit& edit, std::size_t source) {
  return edit.extents[source] >= 0 ? kNoLevel : 0;
}

// The levels of detail after some edits.
struct LevelsUpdate {
  std::uint64_t edits = 0;            // how many, as apply() numbers them
  std::vector<Levels::Nodes> groups;  // by index
  std::vector<LevelSamples> samples;  // the same
  // Entry levels of the pages where they have changed, by ascending first slots.
  std::vector<std::pair<std::uint32_t, EntryLevels>> entries;
};

// Builds and repairs the levels of detail of a map that something else draws: in a thread of its
// own, from a copy of the map in the processor's memory. Edits that come while it builds wait in a
// queue, which drops what later edits overwrite; the copy takes them over between two steps. Half
// of the time is for building, however many edits come.
class LevelBuilder {
 public:
  LevelBuilder();
  ~LevelBuilder();

  // Queues the next edit or run of the map. Returns its number: how many there were so far. now:
  // the clock of `change` in packed_slot.hpp.
  std::uint64_t apply(std::shared_ptr<const GaussianEdit> edit, double now);
  std::uint64_t apply(PackedRun run, double now);
  // Returns memory for the next run: that of a run that was taken over, if there is any.
  PackedRun spare();
  // Tells whether more of the map is to come. As long as more is, or runs wait, no nodes are built.
  void expectMore(bool more);
  // Returns what has changed since the last call; null if nothing has. wait: waits first until the
  // nodes hold all that was applied, or can't be built.
  std::unique_ptr<LevelsUpdate> update(bool wait);
  // Why no more updates come; empty if nothing is wrong.
  std::string error() const;
  std::size_t bytes() const;  // with the edits that wait

 private:
  struct Run {
    PackedRun run;
    double now;
    std::uint64_t number;
  };

  bool waits() const { return !edits_.empty() || !runs_.empty(); }
  void dropRuns();
  void run();
  void build();
  void takeWaiting();
  void insert(const GaussianEdit& edit, double now, std::uint64_t number);
  void insert(Run run);
  bool isInterrupted(bool had_time) const;
  void handOver(const std::vector<std::uint32_t>& changed);

  mutable std::mutex mutex_;  // guards all down to bytes_
  std::condition_variable wake_, rests_;
  bool stop_ = false, busy_ = false;
  bool more_ = false, complete_ = false;  // complete: all has come since the last build
  EditQueue edits_;                       // that wait; MapState::edits: their numbers
  std::deque<Run> runs_;                  // that wait
  std::size_t runs_bytes_ = 0;            // of runs_
  std::vector<PackedRun> spare_;          // kept while more of the map is to come
  std::uint64_t applied_ = 0;
  std::unique_ptr<LevelsUpdate> update_;
  std::string error_;
  std::size_t bytes_ = 0;  // of slots_ and levels_

  // For thread_ only.
  std::shared_ptr<ThreadTeam> team_;
  HostSlots slots_;
  Levels levels_;
  std::uint64_t taken_ = 0;  // number of the last edit
  std::thread thread_;
};

}  // namespace rosplat
