#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "gpu/node_store.hpp"
#include "gpu/slot_reader.hpp"
#include "gpu/slot_store.hpp"
#include "rosplat_core/levels/level_builder.hpp"
#include "rosplat_core/threads/thread_team.hpp"

namespace rosplat {

// The levels of detail of the map in a SlotStore, while a view wants them. Edits go to a builder in
// a thread of its own, whose nodes are uploaded to the card.
class CardLevels {
 public:
  // ring: writes the nodes; must outlive this.
  explicit CardLevels(gl::UploadRing& ring) : ring_(ring), nodes_(ring) {}

  // Passes on an edit that the store has applied already. An edit that clears drops all nodes.
  void apply(const SlotStore& store, const std::shared_ptr<const GaussianEdit>& edit, double now);
  // Goes on building, uploading and showing nodes, which sets the store's levels: does some of it
  // or, with `all`, waits for all of it. Throws gl::Error when the driver has no memory left.
  void advance(SlotStore& store, double now, bool all);

  const NodeStore& nodes() const { return nodes_; }
  const std::vector<LevelSamples>& samples() const { return samples_; }  // of nodes(), by group
  // Why there are no levels; empty if nothing is wrong.
  std::string error() const { return builder_.error(); }
  std::size_t bytes() const {
    return nodes_.bytes() + builder_.bytes() + written_.size() * sizeof(Written);
  }
  std::size_t gpuBytes() const { return nodes_.bytes(); }

 private:
  // A page that was written by edits that the nodes may lack: the number of the last edit of each
  // slot, and the level at which the slot enters until the nodes hold it.
  struct Written {
    std::array<std::uint64_t, SlotPage::kSlots> numbers{};
    EntryLevels levels;
  };

  void markWritten(const GaussianEdit& edit, std::uint64_t number);
  void copy(const SlotStore& store, double now, std::size_t most_pages);
  void finish(SlotStore& store);

  gl::UploadRing& ring_;
  std::shared_ptr<ThreadTeam> team_ = ThreadTeam::ofViewers();
  LevelBuilder builder_;
  NodeStore nodes_;
  std::vector<LevelSamples> samples_;
  std::unique_ptr<LevelsUpdate> update_;                       // is being uploaded, or null
  std::map<std::uint32_t, std::unique_ptr<Written>> written_;  // by the page's first slot
  std::uint64_t cleared_ = 0;  // number of the last edit that emptied the map
  // The builder has been given the pages before this slot. kNoSlot: all; new ones come as edits.
  std::uint32_t copied_ = 0;
  PageReader reader_;  // of those pages
};

}  // namespace rosplat
