#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "gpu/node_store.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/levels/level_builder.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// Levels of detail of the map in a SlotStore, for as long as they are wanted: what is edited goes
// to a builder beside the render thread, and its nodes come back to the card.
class CardLevels {
 public:
  // ring: to write with; stays.
  explicit CardLevels(gl::UploadRing& ring) : ring_(ring), nodes_(ring) {}

  // The store, which has this edit by now; nodes of another map are gone.
  void apply(const SlotStore& store, const std::shared_ptr<const GaussianEdit>& edit, double now);
  // Goes on with what there is to do, in the store too; some of it, or all, which it waits for.
  // Throws gl::Error when the driver has no memory left.
  void advance(SlotStore& store, double now, bool all);

  const NodeStore& nodes() const { return nodes_; }
  const std::vector<LevelSamples>& samples() const { return samples_; }  // of these, by group
  // Why there are none; empty where nothing is wrong.
  std::string error() const { return builder_.error(); }
  std::size_t bytes() const {
    return nodes_.bytes() + builder_.bytes() + written_.size() * sizeof(Written);
  }
  std::size_t gpuBytes() const { return nodes_.bytes(); }

 private:
  // A page that edits have written to which the nodes may lack: which edit wrote each slot last,
  // and at which level the slot enters until they have it.
  struct Written {
    std::array<std::uint64_t, SlotPage::kSlots> numbers{};
    EntryLevels levels;
  };

  void note(const GaussianEdit& edit, std::uint64_t number);
  void copy(const SlotStore& store, double now, std::size_t most_pages);
  void finish(SlotStore& store);

  gl::UploadRing& ring_;
  std::shared_ptr<ThreadTeam> team_ = ThreadTeam::ofViewers();
  LevelBuilder builder_;
  NodeStore nodes_;
  std::vector<LevelSamples> samples_;
  std::unique_ptr<LevelsUpdate> update_;                       // that is being uploaded
  std::map<std::uint32_t, std::unique_ptr<Written>> written_;  // by the page's first slot
  std::uint64_t cleared_ = 0;  // number of the last edit that emptied the map
  // Pages of the map before these slots were given to the builder, or come as edits.
  std::uint32_t copied_ = 0;
};

}  // namespace rosplat
