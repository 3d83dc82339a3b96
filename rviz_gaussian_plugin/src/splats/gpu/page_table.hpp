#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/gl_objects.hpp"
#include "gpu/slot_store.hpp"
#include "map/seen_group.hpp"

namespace rosplat {

// The pages of a map that a view may show. They are numbered in the order of their slots, and so
// are these: number of the page * SlotPage::kSlots + slot in the page. Shaders go through them
// arena by arena.
class PageTable {
 public:
  // What is kept of an arena: neighbours in the table.
  struct Range {
    const SlotStore::Arena* arena;
    std::size_t first, count;
  };

  // Keeps what a view may show. The store must stay as it is while ranges() are used.
  // groups: of the store, as the view sees them, by index.
  void keep(const SlotStore& store, const std::vector<SeenGroup>& groups);

  std::size_t count() const { return first_slots_.size(); }
  const std::vector<Range>& ranges() const { return ranges_; }
  // The table, as splat_pages.glsl reads it.
  const gl::Buffer& table() const { return table_; }
  // Of the pages by number.
  const std::vector<std::uint32_t>& firstSlots() const { return first_slots_; }
  // Of a map's pages of so many slots, by first slot / SlotPage::kSlots: their numbers, kNoSlot
  // where they aren't kept.
  std::vector<std::uint32_t> numbers(std::uint32_t capacity) const;

  std::size_t bytes() const { return table_.bytes(); }

 private:
  struct Entry {  // as in splat_pages.glsl
    std::uint32_t number, page, group;
    bool operator==(const Entry& o) const {
      return number == o.number && page == o.page && group == o.group;
    }
  };

  std::vector<std::uint32_t> first_slots_;
  std::vector<SlotStore::Place> places_;  // by number
  std::vector<std::uint32_t> groups_;     // the same
  std::vector<Range> ranges_;
  std::vector<Entry> entries_, uploaded_;
  gl::Buffer table_;
};

}  // namespace rosplat
