#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

// Slots that a call names: consecutive ones, or a list that the caller owns.
class NamedSlots {
 public:
  static constexpr std::uint32_t kPageSlots = SlotPage::kSlots;

  struct Touched {
    std::uint32_t page, count;
  };

  // Throws std::invalid_argument for a slot that is out of range or named twice.
  static NamedSlots checked(const std::vector<std::uint32_t>& slots) {
    for (const std::uint32_t slot : slots) checkSlot("slots", slot);
    if (std::adjacent_find(slots.begin(), slots.end(), std::greater_equal<>()) != slots.end()) {
      std::vector<std::uint32_t> ascending = slots;
      std::sort(ascending.begin(), ascending.end());
      if (std::adjacent_find(ascending.begin(), ascending.end()) != ascending.end()) {
        throw std::invalid_argument("slots: each slot may be named once");
      }
    }
    return {slots.data(), slots.size()};
  }
  static NamedSlots checked(std::uint32_t first, std::size_t count) {
    if (count > 0) checkSlot("first_slot", first + std::uint64_t{count} - 1);
    return {count > 0 ? first : 0, count};  // receivers check first_slot even of an empty batch
  }
  NamedSlots() = default;
  NamedSlots(std::uint32_t first, std::size_t count) : first_(first), count_(count) {}
  NamedSlots(const std::uint32_t* slots, std::size_t count) : count_(count), list_(slots) {
    const auto gap =
        std::adjacent_find(slots, slots + count, [](auto a, auto b) { return a + 1 != b; });
    if (gap != slots + count) return;
    first_ = count > 0 ? *slots : 0;
    list_ = nullptr;
  }

  std::size_t size() const { return count_; }
  bool empty() const { return count_ == 0; }
  bool listed() const { return list_ != nullptr; }
  std::uint32_t first() const { return first_; }
  // Empty for consecutive slots.
  std::vector<std::uint32_t> list() const {
    if (!listed()) return {};
    return {list_, list_ + count_};
  }
  std::uint32_t operator[](std::size_t i) const {
    return listed() ? list_[i] : first_ + static_cast<std::uint32_t>(i);
  }

  // Splits the slots into parts of `most` at most; without slots, into one empty part.
  std::vector<NamedSlots> parts(std::size_t most) const {
    std::vector<NamedSlots> parts;
    for (std::size_t i = 0; i < std::max<std::size_t>(1, count_); i += most) {
      const std::size_t count = std::min(most, count_ - i);
      parts.push_back(listed() ? NamedSlots(list_ + i, count)
                               : NamedSlots(first_ + static_cast<std::uint32_t>(i), count));
    }
    return parts;
  }
  // The pages of the slots, ascending, and how many slots are in each.
  std::vector<Touched> touched() const {
    std::vector<Touched> pages;
    for (std::size_t i = 0; i < count_;) {
      const std::uint32_t slot = (*this)[i], page = slot / kPageSlots;
      const std::size_t rest = std::min<std::size_t>(kPageSlots - slot % kPageSlots, count_ - i);
      const auto count = static_cast<std::uint32_t>(listed() ? 1 : rest);
      if (pages.empty() || pages.back().page != page) pages.push_back({page, 0});
      pages.back().count += count;
      i += count;
    }
    if (!listed()) return pages;
    std::sort(pages.begin(), pages.end(), [](auto a, auto b) { return a.page < b.page; });
    std::size_t end = 0;
    for (const Touched& page : pages) {
      if (end > 0 && pages[end - 1].page == page.page) {
        pages[end - 1].count += page.count;
      } else {
        pages[end++] = page;
      }
    }
    pages.resize(end);
    return pages;
  }

 private:
  static void checkSlot(const char* name, std::uint64_t slot) {
    if (slot < kMaxSlots) return;
    throw std::invalid_argument(std::string(name) + ": a slot is a number from 0 to " +
                                std::to_string(kMaxSlots - 1) + ", got " + std::to_string(slot));
  }

  std::uint32_t first_ = 0;
  std::size_t count_ = 0;
  const std::uint32_t* list_ = nullptr;
};

}  // namespace rosplat
