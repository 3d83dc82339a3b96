#include "rosplat_core/slots/slot_set.hpp"

#include <algorithm>

namespace rosplat {

void SlotSet::makeRoom(const SlotRuns& runs) {
  for (const auto& [first, count] : runs) {
    if (count == 0) continue;
    const std::size_t last = (first + count - 1) / kPage;
    if (places_.size() <= last) places_.resize(last + 1, kNone);
    for (std::size_t page = first / kPage; page <= last; ++page) {
      if (places_[page] != kNone) continue;
      pages_.emplace_back();
      places_[page] = static_cast<std::uint32_t>(pages_.size() - 1);
    }
  }
}

SlotRuns SlotSet::within(const SlotRuns& runs) const {
  SlotRuns found;
  const auto end_of_all = static_cast<std::uint32_t>(places_.size()) * kPage;
  for (const auto& [run_first, count] : runs) {
    const std::uint32_t end = std::min(run_first + count, end_of_all);
    for (std::uint32_t first = run_first, next; first < end; first = next) {
      next = std::min(end, first - first % kPage + kPage);
      if (places_[first / kPage] == kNone) continue;
      const bool goes_on =
          first > run_first && !found.empty() && found.back().first + found.back().second == first;
      if (goes_on) {
        found.back().second += next - first;
      } else {
        found.emplace_back(first, next - first);
      }
    }
  }
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
