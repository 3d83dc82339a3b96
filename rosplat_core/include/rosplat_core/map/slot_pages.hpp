#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// Neighbouring slots, of which at least one was written since the map's last clear.
struct SlotPage {
  static constexpr std::uint32_t kSlots = kPageSlots;

  std::uint32_t first_slot = 0;
  std::uint32_t place = 0;  // pages are numbered as they come: 0, 1, 2, ...
  std::uint32_t group = 0;  // that all of it is of, by index
  // Around the centres of all that was ever in it, relative to the group's origin. [m]
  std::array<float, 3> least, most;
  float extent = -1;  // the largest of theirs [m], -1 where nothing could ever be seen
};

// Which pages a map's slots lie in, and where the groups are that these belong to. Authors number
// slots as they like (keyframe << 12 | i); what holds a map has memory for its pages alone, by
// place, and goes through them in order of slots.
class SlotPages {
 public:
  // Adds the pages that an edit writes to, and widens their bounds. Slots that are only emptied
  // need none. Throws std::bad_alloc: then all is as it was.
  void apply(const GaussianEdit& edit);
  // First slots of the pages that an edit touches, ascending.
  static std::vector<std::uint32_t> touched(const GaussianEdit& edit);
  // First slots of pages which that edit gave to another group: what was in them is gone.
  const std::vector<std::uint32_t>& emptied() const { return emptied_; }
  const std::vector<Group>& groups() const { return groups_.all(); }  // by index
  const Group& groupOf(const SlotPage& page) const { return groups_.all()[page.group]; }
  // What places the groups elsewhere.
  GaussianEdit moves() const { return editOf(groups_); }

  const std::vector<SlotPage>& pages() const { return pages_; }  // by ascending first_slot
  // The page of a slot; null where there is none.
  const SlotPage* find(std::uint32_t slot) const;
  // All slots below the capacity that have a page, ascending.
  std::vector<std::uint32_t> slots(std::uint32_t capacity) const;
  std::size_t bytes() const { return pages_.capacity() * sizeof(SlotPage); }

 private:
  SlotPage& page(std::uint32_t first_slot, std::uint32_t group);

  std::vector<SlotPage> pages_;
  std::vector<std::uint32_t> emptied_;
  Groups groups_;
};

}  // namespace rosplat
