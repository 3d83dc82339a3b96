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

// At which level each slot of a page enters the lattice; kNoLevel where no node holds what it is.
using EntryLevels = std::array<std::uint8_t, SlotPage::kSlots>;
constexpr std::uint8_t kNoLevel = 0xff;

// That of a slot as an edit has just written it, by its place in the edit; what can't be seen may
// as well have one.
inline std::uint8_t levelOfNew(const GaussianEdit& edit, std::size_t source) {
  return edit.extents[source] >= 0 ? kNoLevel : 0;
}

// Levels of detail as they are after so many edits.
struct LevelsUpdate {
  std::uint64_t edits = 0;
  std::vector<Levels::Nodes> groups;  // by index
  std::vector<LevelSamples> samples;  // of these
  // Of pages where they have changed, which ascend, by the first slot.
  std::vector<std::pair<std::uint32_t, EntryLevels>> entries;
};

// Builds and repairs the levels of detail of a map that something else draws: in a thread of its
// own, from a copy of the map in the processor's memory. What comes while it builds waits, without
// what later edits overwrite, and goes into the copy between two steps; but half of the time is for
// building, however much comes.
class LevelBuilder {
 public:
  LevelBuilder();
  ~LevelBuilder();

  // What comes next of the map; returns how many edits there were so far. now: the clock of
  // `change` in packed_slot.hpp.
  std::uint64_t apply(std::shared_ptr<const GaussianEdit> edit, double now);
  std::uint64_t apply(PackedRun run, double now);
  // Memory for the next run: that of one that was taken, if there is any.
  PackedRun spare();
  // Whether more of the map is to come, before which nodes aren't worth the work.
  void expectMore(bool more);
  // What has changed since it was asked last; null where nothing has. wait: until the nodes hold
  // all that was applied.
  std::unique_ptr<LevelsUpdate> take(bool wait);
  // Why there are no more; empty where nothing is wrong.
  std::string error() const;
  std::size_t bytes() const;  // with what waits

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
  void take(const GaussianEdit& edit, double now, std::uint64_t number);
  void take(Run run);
  bool isInterrupted(bool had_time) const;
  void handOver(const std::vector<std::uint32_t>& changed);

  mutable std::mutex mutex_;  // what follows
  std::condition_variable wake_, rests_;
  bool stop_ = false, busy_ = false;
  bool more_ = false, complete_ = false;  // complete: since nodes were made last
  EditQueue edits_;                       // that wait; MapState::edits is their number
  std::deque<Run> runs_;                  // the same
  std::size_t runs_bytes_ = 0;            // of these
  std::vector<PackedRun> spare_;          // while more of the map is to come
  std::uint64_t applied_ = 0;
  std::unique_ptr<LevelsUpdate> update_;
  std::string error_;
  std::size_t bytes_ = 0;  // of slots_ and levels_

  // The thread's own.
  std::shared_ptr<ThreadTeam> team_;
  HostSlots slots_;
  Levels levels_;
  std::uint64_t taken_ = 0;  // number of the last edit
  std::thread thread_;
};

}  // namespace rosplat
