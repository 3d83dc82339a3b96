#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/groups.hpp"
#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

// Consecutive slots, at least one of which was written since the map's last clear.
struct SlotPage {
  static constexpr std::uint32_t kSlots = kPageSlots;

  std::uint32_t first_slot = 0;
  std::uint32_t place = 0;  // 0, 1, 2, ... in the order in which pages came
  std::uint32_t group = 0;  // index of the group that all its slots are of
  // Bounds of the centres of all visible splats it ever had, relative to the group's origin. [m]
  std::array<float, 3> least{kInfinity, kInfinity, kInfinity};
  std::array<float, 3> most{-kInfinity, -kInfinity, -kInfinity};
  float extent = -1;  // the largest of these splats [m], -1 if none could ever be seen

  void widen(const std::array<float, 3>& position, float by) {
    extent = std::max(extent, by);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      least[axis] = std::min(least[axis], position[axis]);
      most[axis] = std::max(most[axis], position[axis]);
    }
  }

 private:
  static constexpr float kInfinity = std::numeric_limits<float>::infinity();
};

// The pages of a map's slots, and the groups that the pages belong to. Authors number slots as they
// like (keyframe << 12 | i); holders of a map have memory for these pages alone, by place, and go
// through them in the order of slots.
class SlotPages {
 public:
  // Adds the pages that an edit writes to, and widens their bounds. Slots that are only emptied
  // need none. Throws std::bad_alloc: then nothing has changed.
  void apply(const GaussianEdit& edit);
  // First slots of the pages that an edit touches, ascending.
  static std::vector<std::uint32_t> touched(const GaussianEdit& edit);
  // First slots of the pages that the last edit gave to another group: their old splats are gone.
  const std::vector<std::uint32_t>& emptied() const { return emptied_; }
  const std::vector<Group>& groups() const { return groups_.all(); }  // by index
  const Group& groupOf(const SlotPage& page) const { return groups_.all()[page.group]; }
  // An edit that places the groups in another copy of the map.
  GaussianEdit moves() const { return editOf(groups_); }

  const std::vector<SlotPage>& pages() const { return pages_; }  // by ascending first_slot
  // The page of a slot; null without one.
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
