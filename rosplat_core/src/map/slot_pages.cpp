#include "rosplat_core/map/slot_pages.hpp"

#include <algorithm>
#include <utility>

namespace rosplat {

namespace {

template <typename Pages>
auto firstFrom(Pages& pages, std::uint32_t first_slot) {
  return std::lower_bound(
      pages.begin(), pages.end(), first_slot,
      [](const SlotPage& page, std::uint32_t slot) { return page.first_slot < slot; });
}

std::uint32_t firstSlotOfPage(std::uint32_t slot) { return slot - slot % SlotPage::kSlots; }

}  // namespace

std::vector<std::uint32_t> SlotPages::touched(const GaussianEdit& edit) {
  std::vector<std::uint32_t> pages;
  forEachPart(edit.runs, [&pages](std::uint32_t slot, std::uint32_t, std::size_t) {
    const std::uint32_t page = firstSlotOfPage(slot);
    if (pages.empty() || pages.back() != page) pages.push_back(page);
  });
  std::sort(pages.begin(), pages.end());
  pages.erase(std::unique(pages.begin(), pages.end()), pages.end());
  return pages;
}

void SlotPages::apply(const GaussianEdit& edit) {
  const bool writes = edit.sh_degree >= 0 && !edit.runs.empty();
  // Memory is allocated before anything changes.
  if (writes) {
    const std::size_t more = touched(edit).size(), known = edit.clear ? 0 : pages_.size();
    if (known + more > pages_.capacity()) pages_.reserve(known + more + known / 4);
    emptied_.reserve(more);
  }
  Groups fresh;
  (edit.clear ? fresh : groups_).makeRoom(edit.moves.size() + (writes ? 1 : 0));
  if (edit.clear) groups_ = std::move(fresh);
  for (const GroupMove& move : edit.moves) groups_.move(move);
  const std::uint32_t group = writes ? groups_.write(edit.group, edit.origin) : 0;
  emptied_.clear();
  if (edit.clear) pages_.clear();
  if (!writes) return;
  forEachPart(edit.runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t source) {
    SlotPage& of = page(firstSlotOfPage(slot), group);
    for (std::size_t i = source; i < source + count; ++i) {
      if (edit.extents[i] >= 0) of.widen(edit.position(i), edit.extents[i]);
    }
  });
}

const SlotPage* SlotPages::find(std::uint32_t slot) const {
  const auto found = firstFrom(pages_, firstSlotOfPage(slot));
  return found != pages_.end() && found->first_slot == firstSlotOfPage(slot) ? &*found : nullptr;
}

std::vector<std::uint32_t> SlotPages::slots(std::uint32_t capacity) const {
  std::vector<std::uint32_t> slots;
  slots.reserve(pages_.size() * SlotPage::kSlots);
  for (const SlotPage& page : pages_) {
    const std::uint32_t end = std::min(page.first_slot + SlotPage::kSlots, capacity);
    for (std::uint32_t slot = page.first_slot; slot < end; ++slot) slots.push_back(slot);
  }
  return slots;
}

SlotPage& SlotPages::page(std::uint32_t first_slot, std::uint32_t group) {
  const auto at = firstFrom(pages_, first_slot);
  const bool known = at != pages_.end() && at->first_slot == first_slot;
  if (known && at->group == group) return *at;
  SlotPage fresh;
  fresh.first_slot = first_slot;
  fresh.place = known ? at->place : static_cast<std::uint32_t>(pages_.size());
  fresh.group = group;
  if (!known) return *pages_.insert(at, fresh);
  emptied_.push_back(first_slot);
  return *at = fresh;
}

}  // namespace rosplat
