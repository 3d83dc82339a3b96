#include "gpu/page_table.hpp"

#include <utility>

#include "map/cut.hpp"

namespace rosplat {

namespace {

constexpr std::uint32_t kOfSlots = 0xffffffffu;  // in place of a level

// take(i): of those among the shelf's pages that are shown.
template <typename Shown, typename Take>
void forEach(const Shown& shown, const PageShelf& shelf, const Take& take) {
  for (std::size_t i = shelf.begin; i < shelf.end; ++i) {
    if (shown[i - shelf.begin]) take(i);
  }
}

}  // namespace

void PageTable::keep(const Frame& frame, const std::vector<SeenGroup>& groups) {
  const SlotStore& store = frame.store;
  const std::size_t slot_arenas = store.arenas().size();
  const auto arenaOf = [&](std::size_t arena) {
    return arena < slot_arenas ? &store.arenas()[arena]
                               : &frame.nodes->arenas()[arena - slot_arenas];
  };
  first_slots_.clear();
  kept_.clear();
  const auto keep = [this](const SlotPage& page, SlotArenas::Place place, std::uint32_t level) {
    first_slots_.push_back(page.first_slot);
    kept_.push_back({place, page.group, level});
  };
  std::vector<Cut> cuts;
  for (std::size_t group = 0; frame.cuts() && group < groups.size(); ++group) {
    cuts.push_back(frame.cut(groups[group].camera, store.pages().groups()[group].originOrZero()));
  }
  // own: of nodes' cells, 0 of slots. [m]
  const auto forEachShown = [&](const PageShelf& shelf, float own, const auto& take) {
    const PageView& view = groups[shelf.bounds.group].pages;
    if (!view.mayShow(shelf.bounds)) return;
    if (!frame.cuts()) return forEach(view.mayShow(shelf.pages), shelf, take);
    const Cut& cut = cuts[shelf.bounds.group];
    if (!cut.mayShow(shelf.bounds, own, shelf.widest_parent)) return;
    const auto in_cut = cut.mayShow(shelf.pages, own, shelf.parents);
    auto shown = view.mayShow(shelf.pages);
    for (std::size_t i = 0; i < shown.size(); ++i) shown[i] &= in_cut[i];
    forEach(shown, shelf, take);
  };
  for (const PageShelf& shelf : store.shelves()) {
    forEachShown(shelf, 0, [&](std::size_t i) {
      const SlotPage& page = store.pages().pages()[i];
      if (store.holds(page)) keep(page, store.placeOf(page), kOfSlots);
    });
  }
  for (int number = 0; frame.cuts() && number < kLevels; ++number) {
    for (const NodeStore::OfGroup& nodes : frame.nodes->groups()) {
      const NodeStore::Level& level = nodes[std::size_t(number)];
      for (const PageShelf& shelf : level.shelves) {
        forEachShown(shelf, cellSize(number), [&](std::size_t i) {
          SlotArenas::Place place = frame.nodes->placeOf(level.pages[i]);
          place.arena += static_cast<std::uint32_t>(slot_arenas);
          keep(level.pages[i], place, static_cast<std::uint32_t>(number));
        });
      }
    }
  }

  // By arena: how many, then where the next one goes.
  std::vector<std::size_t> next(slot_arenas + (frame.cuts() ? frame.nodes->arenas().size() : 0));
  for (const Kept& page : kept_) ++next[page.place.arena];
  ranges_.clear();
  std::size_t first = 0;
  for (std::size_t arena = 0; arena < next.size(); ++arena) {
    const std::size_t count = std::exchange(next[arena], first);
    if (count > 0) ranges_.push_back({arenaOf(arena), first, count});
    first += count;
  }
  entries_.resize(kept_.size());
  for (std::size_t number = 0; number < kept_.size(); ++number) {
    const Kept& page = kept_[number];
    entries_[next[page.place.arena]++] = {static_cast<std::uint32_t>(number), page.place.page,
                                          page.group, page.level};
  }
  if (entries_ == uploaded_ || entries_.empty()) return;
  table_.upload(entries_);
  uploaded_ = entries_;
}

std::vector<std::uint32_t> PageTable::numbers(std::uint32_t capacity) const {
  std::vector<std::uint32_t> numbers((capacity + SlotPage::kSlots - 1) / SlotPage::kSlots, kNoSlot);
  for (std::size_t number = 0; number < first_slots_.size(); ++number) {
    if (first_slots_[number] == kNoSlot) break;  // nodes
    numbers[first_slots_[number] / SlotPage::kSlots] = static_cast<std::uint32_t>(number);
  }
  return numbers;
}

}  // namespace rosplat
