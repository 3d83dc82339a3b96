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
// ones are uploaded beside those that are shown, which they replace when all are there.
class NodeStore {
 public:
  // Pages of a level in the order of their cells: `place` is where they are held; and of all
  // levels.
  struct Level {
    std::vector<SlotPage> pages;
    std::vector<PageShelf> shelves;
  };
  using OfGroup = std::array<Level, kLevels>;

  // ring: to write with; stays.
  explicit NodeStore(gl::UploadRing& ring) : ring_(&ring), arenas_(ring) {}

  // Has these take the place of what is shown, as soon as they are uploaded.
  void replace(const std::vector<Levels::Nodes>& groups, int sh_degree);
  // Uploads of them what a number of bytes allows, which it makes less; whether all are there.
  // team: helps. Throws gl::Error when the driver has no memory left.
  bool upload(std::size_t& bytes, ThreadTeam* team = nullptr);
  // Shows them.
  void show();

  // That are shown, by group.
  const std::vector<OfGroup>& groups() const { return groups_; }
  SlotArenas::Place placeOf(std::uint32_t place) const { return arenas_.placeOf(place); }
  const std::vector<SlotArenas::Arena>& arenas() const { return arenas_.arenas(); }
  void addBands(int degree) { arenas_.addBands(degree); }
  // How many nodes there may be.
  std::size_t slots() const { return std::size_t{places_} * SlotPage::kSlots; }
  std::size_t bytes() const { return arenas_.bytes(); }

 private:
  struct New {
    std::shared_ptr<const NodePage> page;
    std::uint32_t place;
  };

  void replace(int level, const Levels::Pages& before, const Level& held,
               const Levels::Pages& pages, Level& next);
  void write(const New* pages, std::size_t count, ThreadTeam* team);

  gl::UploadRing* ring_;
  SlotArenas arenas_;
  std::vector<std::uint32_t> free_;  // places
  std::uint32_t places_ = 0;         // so far
  std::vector<Levels::Nodes> pages_, next_pages_;
  std::vector<OfGroup> groups_, next_groups_;
  std::vector<New> new_;                // to be uploaded
  std::size_t uploaded_ = 0;            // of these
  std::vector<std::uint32_t> leaving_;  // places of what is not among the next
  std::vector<std::uint32_t> staged_;
};

}  // namespace rosplat
