#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/program.hpp"
#include "gpu/slot_arenas.hpp"
#include "rosplat_core/levels/level_builder.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"
#include "rosplat_core/views/page_shelf.hpp"

namespace rosplat {

// The slots of a map in the GPU's memory. Pages of slots that no edit has written cost no memory.
class SlotStore {
 public:
  using Arena = SlotArenas::Arena;
  using Place = SlotArenas::Place;

  // ring, scatter (slot_scatter.comp): write the slots; must outlive this.
  SlotStore(gl::UploadRing& ring, const gl::Program& scatter)
      : ring_(ring), scatter_(scatter), arenas_(ring) {}
  SlotStore(const SlotStore&) = delete;
  SlotStore& operator=(const SlotStore&) = delete;

  // Uploads what an edit changes. now: the clock of `change` in packed_slot.hpp. Throws gl::Error
  // when the driver has no memory left.
  void apply(const GaussianEdit& edit, double now);

  const SlotPages& pages() const { return pages_; }
  // Whether the card holds a page, by its place: false if there was no memory for it.
  bool holds(const SlotPage& page) const { return holds(page.place); }
  bool holds(std::uint32_t place) const { return place < held_.size() && held_[place]; }
  Place placeOf(const SlotPage& page) const { return arenas_.placeOf(page.place); }
  Place placeOf(std::uint32_t place) const { return arenas_.placeOf(place); }
  const std::vector<Arena>& arenas() const { return arenas_.arenas(); }

  // Sets the level at which each slot of a page enters the levels of detail. Slots that are written
  // later have levelOfNew() until the next call.
  void setLevels(std::uint32_t first_slot, const EntryLevels& levels);
  // Drops the levels of all slots.
  void dropLevels();
  // The width of the widest cell whose node stands for a slot of a page. [m]
  float widestParent(const SlotPage& page) const {
    return page.place < coarsest_.size() ? cellSize(coarsest_[page.place]) : kBoundless;
  }

  // All pages, as they are now, on shelves.
  const std::vector<PageShelf>& shelves() const;

  std::uint32_t capacity() const { return capacity_; }  // one past the highest slot in use
  // Upper bound of the number of slots in use.
  std::size_t slots() const {
    return std::min<std::size_t>(capacity_, pages_.pages().size() * SlotPage::kSlots);
  }
  int shDegree() const { return arenas_.shDegree(); }
  std::size_t channels() const { return arenas_.channels(); }  // number of channels with values
  // Changes with the content. No two stores ever have the same, except 0: never changed.
  std::uint64_t version() const { return version_; }
  std::size_t bytes() const { return arenas_.bytes(); }

 private:
  // Slots that lie next to each other in an edit and in an arena.
  struct Piece {
    Arena* arena;
    std::size_t first, source, count;
  };

  // A slot: its index in an edit, and its place in an arena.
  struct Spot {
    std::size_t source;
    std::uint32_t place;
  };

  void change();
  void empty(const SlotPage& page);
  std::vector<Piece> pieces(const GaussianEdit& edit);
  void write(const GaussianEdit& edit, const Piece& piece, std::uint32_t change);
  void scatter(const GaussianEdit& edit, const std::vector<Piece>& pieces, std::uint32_t change);
  void scatter(const GaussianEdit& edit, const Arena& arena, const std::vector<Spot>& spots,
               std::uint32_t change);

  gl::UploadRing& ring_;
  const gl::Program& scatter_;
  SlotPages pages_;
  SlotArenas arenas_;
  std::vector<bool> held_;              // by a page's place
  std::vector<std::uint8_t> coarsest_;  // the highest level of a page's slots; empty without levels
  std::uint32_t capacity_ = 0;
  std::uint64_t version_ = 0;
  mutable std::vector<PageShelf> shelves_;
  mutable std::uint64_t shelved_ = 0;  // version of `shelves_`
};

}  // namespace rosplat
