#include "gpu/page_table.hpp"

#include <utility>

namespace rosplat {

void PageTable::keep(const SlotStore& store, const std::vector<SeenGroup>& groups) {
  first_slots_.clear();
  places_.clear();
  groups_.clear();
  std::vector<std::size_t> next(store.arenas().size());  // by arena: how many, then where it goes
  for (const SlotPage& page : store.pages().pages()) {
    if (!store.holds(page) || !groups[page.group].pages.mayShow(page)) continue;
    first_slots_.push_back(page.first_slot);
    places_.push_back(store.placeOf(page));
    groups_.push_back(page.group);
    ++next[places_.back().arena];
  }
  ranges_.clear();
  std::size_t first = 0;
  for (std::size_t arena = 0; arena < next.size(); ++arena) {
    const std::size_t count = std::exchange(next[arena], first);
    if (count > 0) ranges_.push_back({&store.arenas()[arena], first, count});
    first += count;
  }
  entries_.resize(places_.size());
  for (std::size_t number = 0; number < places_.size(); ++number) {
    const SlotStore::Place& place = places_[number];
    entries_[next[place.arena]++] = {static_cast<std::uint32_t>(number), place.page,
                                     groups_[number]};
  }
  if (entries_ == uploaded_ || entries_.empty()) return;
  table_.upload(entries_);
  uploaded_ = entries_;
}

std::vector<std::uint32_t> PageTable::numbers(std::uint32_t capacity) const {
  std::vector<std::uint32_t> numbers((capacity + SlotPage::kSlots - 1) / SlotPage::kSlots, kNoSlot);
  for (std::size_t number = 0; number < first_slots_.size(); ++number) {
    numbers[first_slots_[number] / SlotPage::kSlots] = static_cast<std::uint32_t>(number);
  }
  return numbers;
}

}  // namespace rosplat
