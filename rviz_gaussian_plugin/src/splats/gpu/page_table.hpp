#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/buffer.hpp"
#include "gpu/frame.hpp"
#include "gpu/slot_arenas.hpp"
#include "rosplat_core/views/seen_group.hpp"

namespace rosplat {

// The pages that a view may show: of the slots of maps, and of the nodes of their levels of detail.
// Pages are numbered map by map, in the order of their slots, nodes last. The number of a slot is:
// number of its page * SlotPage::kSlots + index in the page. Shaders go through pages arena by
// arena.
class PageTable {
 public:
  // The chosen pages of an arena: neighbours in the table.
  struct Range {
    const SlotArenas::Arena* arena;
    std::size_t layer;  // of the frame
    std::size_t first, count;
  };

  // Chooses the pages that a frame may show. The frame's stores must not change while ranges() are
  // used. groups: those of each layer, as the view sees them, by index.
  void choose(const Frame& frame, const std::vector<std::vector<SeenGroup>>& groups);

  std::size_t count() const { return first_slots_.size(); }
  std::size_t all() const { return all_; }  // pages that the maps have, in view or not
  const std::vector<Range>& ranges() const { return ranges_; }
  // The table, as splat_pages.glsl reads it.
  const gl::Buffer& table() const { return table_; }
  // The pages' first slots, by number; kNoSlot for pages of nodes.
  const std::vector<std::uint32_t>& firstSlots() const { return first_slots_; }
  // The number of each layer's first page, and one past the last.
  const std::vector<std::size_t>& layerBegins() const { return layer_begins_; }
  // Only for a single map of `capacity` slots: returns its pages' numbers by first slot /
  // SlotPage::kSlots, kNoSlot for pages that weren't chosen.
  std::vector<std::uint32_t> numbers(std::uint32_t capacity) const;

  std::size_t bytes() const { return table_.bytes(); }

 private:
  struct Entry {  // as in splat_pages.glsl
    std::uint32_t number, page, group, level;
  };
  // first_arena, first_group: those of the layer, among the arenas and groups of all layers.
  void choose(const FrameLayer& layer, const std::vector<SeenGroup>& groups,
              std::size_t first_arena, std::size_t first_group);

  std::size_t all_ = 0;
  std::vector<std::uint32_t> first_slots_;
  std::vector<std::size_t> layer_begins_;
  std::vector<Range> ranges_;
  std::vector<std::vector<Entry>> of_arenas_;  // of all layers
  std::vector<Entry> entries_, uploaded_;
  gl::Buffer table_;
};

}  // namespace rosplat
