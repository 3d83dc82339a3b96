#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/gl_objects.hpp"
#include "map/gaussian_map.hpp"
#include "map/slot_pages.hpp"

namespace rosplat {

// The slots of a map in the GPU's memory: its pages by place, in arenas that are each as large as a
// shader's buffer may be. A range of slots that nobody uses costs nothing, and a map that grows is
// not copied, but for the last arena, until that is full.
class SlotStore {
 public:
  struct Arena {
    gl::Buffer slots;                                // kSlotWords a slot
    std::array<gl::Buffer, kMaxShDegree + 1> bands;  // kBandWords a slot, from band 1 on
    std::uint32_t pages = 0;                         // room for so many
  };
  // Where a page is.
  struct Place {
    std::uint32_t arena, page;
  };

  SlotStore();

  // Uploads what an edit changes. now: the clock of `change` in packed_slot.hpp. Throws gl::Error
  // when the driver has no memory left.
  void apply(const GaussianEdit& edit, double now);

  const SlotPages& pages() const { return pages_; }
  // Whether there was memory for a page.
  bool holds(const SlotPage& page) const { return page.place < held_.size() && held_[page.place]; }
  Place placeOf(const SlotPage& page) const {
    return {page.place / arena_pages_, page.place % arena_pages_};
  }
  const std::vector<Arena>& arenas() const { return arenas_; }
  // What writes a page elsewhere. Waits for the graphics card.
  GaussianEdit edit(const SlotPage& page) const;

  std::uint32_t capacity() const { return capacity_; }  // one past the highest slot in use
  // How many may be in use.
  std::size_t slots() const {
    return std::min<std::size_t>(capacity_, pages_.pages().size() * SlotPage::kSlots);
  }
  int shDegree() const { return sh_degree_; }
  std::uint64_t edits() const { return edits_; }  // so far
  std::size_t bytes() const;

 private:
  // Slots that lie next to each other in an edit and in an arena.
  struct Piece {
    Arena* arena;
    std::size_t first, source, count;
  };

  void addBands(int degree);
  void makeRoom(std::uint32_t pages);
  void empty(const SlotPage& page);
  std::vector<Piece> pieces(const GaussianEdit& edit);
  void write(const GaussianEdit& edit, const Piece& piece, std::uint32_t change);

  SlotPages pages_;
  std::uint32_t arena_pages_;
  std::vector<Arena> arenas_;
  std::vector<bool> held_;  // by a page's place
  std::uint32_t capacity_ = 0;
  int sh_degree_ = 0;
  std::uint64_t edits_ = 0;
  std::vector<std::uint32_t> staged_;
};

}  // namespace rosplat
