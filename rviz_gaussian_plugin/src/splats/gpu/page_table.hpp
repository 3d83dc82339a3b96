#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/gl_objects.hpp"
#include "gpu/frame.hpp"
#include "gpu/slot_arenas.hpp"
#include "rosplat_core/views/seen_group.hpp"

namespace rosplat {

// The pages of maps that a view may show, and those of the nodes of their levels of detail. They
// are numbered map by map in the order of their slots, nodes last, and so are these: number of the
// page
// * SlotPage::kSlots + slot in the page. Shaders go through them arena by arena.
class PageTable {
 public:
  // What is kept of an arena: neighbours in the table.
  struct Range {
    const SlotArenas::Arena* arena;
    std::size_t layer;  // of the frame
    std::size_t first, count;
  };

  // Keeps what a frame may show. Its stores must stay as they are while ranges() are used.
  // groups: of each layer, as the view sees them, by index.
  void keep(const Frame& frame, const std::vector<std::vector<SeenGroup>>& groups);

  std::size_t count() const { return first_slots_.size(); }
  const std::vector<Range>& ranges() const { return ranges_; }
  // The table, as splat_pages.glsl reads it.
  const gl::Buffer& table() const { return table_; }
  // Of the pages by number; kNoSlot of nodes.
  const std::vector<std::uint32_t>& firstSlots() const { return first_slots_; }
  // The number of each layer's first page, and one past the last.
  const std::vector<std::size_t>& layerBegins() const { return layer_begins_; }
  // Of a map that is alone, its pages of so many slots by first slot / SlotPage::kSlots: their
  // numbers, kNoSlot where they aren't kept.
  std::vector<std::uint32_t> numbers(std::uint32_t capacity) const;

  std::size_t bytes() const { return table_.bytes(); }

 private:
  struct Entry {  // as in splat_pages.glsl
    std::uint32_t number, page, group, level;
    bool operator==(const Entry& o) const {
      return number == o.number && page == o.page && group == o.group && level == o.level;
    }
  };
  // Where a page is: of which of all arenas, and where there.
  struct Kept {
    SlotArenas::Place place;
    std::uint32_t group, level;
  };

  // Its arenas and groups come after those of the layers before it.
  void keep(const FrameLayer& layer, const std::vector<SeenGroup>& groups, std::size_t first_arena,
            std::size_t first_group);

  std::vector<std::uint32_t> first_slots_;
  std::vector<std::size_t> layer_begins_;
  std::vector<Kept> kept_;  // by number
  std::vector<Range> ranges_;
  std::vector<Entry> entries_, uploaded_;
  gl::Buffer table_;
};

}  // namespace rosplat
