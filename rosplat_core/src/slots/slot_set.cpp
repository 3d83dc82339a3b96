#include "rosplat_core/slots/slot_set.hpp"

namespace rosplat {

void SlotSet::makeRoom(const SlotRuns& runs) {
  forEachPart(runs, [this](std::uint32_t slot, std::uint32_t, std::size_t) {
    const std::size_t page = slot / kPage;
    if (places_.size() <= page) places_.resize(page + 1, kNone);
    if (places_[page] != kNone) return;
    pages_.emplace_back();
    places_[page] = static_cast<std::uint32_t>(pages_.size() - 1);
  });
}

SlotRuns SlotSet::within(const SlotRuns& runs) const {
  SlotRuns found;
  forEachPart(runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t) {
    if (slot / kPage >= places_.size() || places_[slot / kPage] == kNone) return;
    if (!found.empty() && found.back().first + found.back().second == slot) {
      found.back().second += count;
    } else {
      found.emplace_back(slot, count);
    }
  });
  return found;
}

bool SlotSet::has(std::uint32_t slot) const {
  const std::size_t page = slot / kPage;
  return page < places_.size() && places_[page] != kNone && pages_[places_[page]][slot % kPage];
}

bool SlotSet::any(std::uint32_t page) const {
  return page < places_.size() && places_[page] != kNone && pages_[places_[page]].any();
}

bool SlotSet::set(std::uint32_t slot, bool in) noexcept {
  auto bit = pages_[places_[slot / kPage]][slot % kPage];
  const bool was_in = bit;
  bit = in;
  return was_in;
}

}  // namespace rosplat
