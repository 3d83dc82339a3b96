#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "gpu/slot_arenas.hpp"
#include "rosplat_core/levels/levels.hpp"
#include "rosplat_core/threads/thread_team.hpp"
#include "rosplat_core/views/page_shelf.hpp"

namespace rosplat {

// The nodes of levels of detail in the GPU's memory: pages of one level each, packed as slots. New
// pages are uploaded beside the pages that are shown, and replace these once all are uploaded.
class NodeStore {
 public:
  // The pages of a level in the order of their cells, `place` being that in the arenas.
  struct Level {
    std::vector<SlotPage> pages;
    std::vector<PageShelf> shelves;
  };
  using OfGroup = std::array<Level, kLevels>;

  // ring: writes the nodes; must outlive this.
  explicit NodeStore(gl::UploadRing& ring) : ring_(&ring), arenas_(ring) {}

  // Begins to replace the shown nodes by these: upload() and show() follow.
  void replace(const std::vector<Levels::Nodes>& groups, int sh_degree);
  // Uploads new pages of about `bytes` at most, and subtracts their size. Returns whether all are
  // uploaded. team: helps if not null. Throws gl::Error when the driver has no memory left.
  bool upload(std::size_t& bytes, ThreadTeam* team = nullptr);
  // Shows the new nodes, once all are uploaded.
  void show();

  // The shown nodes, by group.
  const std::vector<OfGroup>& groups() const { return groups_; }
  SlotArenas::Place placeOf(std::uint32_t place) const { return arenas_.placeOf(place); }
  const std::vector<SlotArenas::Arena>& arenas() const { return arenas_.arenas(); }
  void addBands(int degree) { arenas_.addBands(degree); }
  // Upper bound of the number of nodes.
  std::size_t slots() const { return std::size_t{places_} * SlotPage::kSlots; }
  std::size_t bytes() const { return arenas_.bytes(); }

 private:
  struct New {
    std::shared_ptr<const NodePage> page;
    std::uint32_t place;
  };

  void replace(float parent, const Levels::Pages& before, const Level& held,
               const Levels::Pages& pages, Level& next);
  void write(const New* pages, std::size_t count, ThreadTeam* team);

  gl::UploadRing* ring_;
  SlotArenas arenas_;
  std::vector<std::uint32_t> free_;  // places that hold nothing
  std::uint32_t places_ = 0;         // number of places so far
  std::vector<Levels::Nodes> pages_, next_pages_;
  std::vector<OfGroup> groups_, next_groups_;
  std::vector<New> new_;                // pages to upload
  std::size_t uploaded_ = 0;            // of `new_`
  std::vector<std::uint32_t> leaving_;  // places of shown pages that show() drops
  std::vector<std::uint32_t> staged_;
};

}  // namespace rosplat
