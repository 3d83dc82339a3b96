#include "gpu/page_table.hpp"

#include <algorithm>

#include "rosplat_core/levels/cut.hpp"

namespace rosplat {

namespace {

constexpr std::uint32_t kOfSlots = 0xffffffffu;  // level of a page of slots

// Calls take(i) for the i-th page of the shelf, if it is shown.
template <typename Shown, typename Take>
void forEach(const Shown& shown, const PageShelf& shelf, const Take& take) {
  for (std::size_t i = 0; i < shelf.end - shelf.begin; ++i) {
    if (shown[i]) take(i);
  }
}

}  // namespace

void PageTable::keep(const Frame& frame, const std::vector<std::vector<SeenGroup>>& groups) {
  first_slots_.clear();
  ranges_.clear();
  layer_begins_.clear();
  for (std::vector<Entry>& of_arena : of_arenas_) of_arena.clear();
  std::size_t first_group = 0;
  for (std::size_t layer = 0; layer < frame.layers.size(); ++layer) {
    layer_begins_.push_back(first_slots_.size());
    const std::size_t first_arena = ranges_.size();
    const auto add = [&](const std::vector<SlotArenas::Arena>& arenas) {
      for (const SlotArenas::Arena& arena : arenas) ranges_.push_back({&arena, layer, 0, 0});
    };
    add(frame.layers[layer].store.arenas());
    if (frame.layers[layer].cuts()) add(frame.layers[layer].nodes->arenas());
    of_arenas_.resize(std::max(of_arenas_.size(), ranges_.size()));
    keep(frame.layers[layer], groups[layer], first_arena, first_group);
    first_group += groups[layer].size();
  }
  layer_begins_.push_back(first_slots_.size());

  entries_.clear();
  for (std::size_t arena = 0; arena < ranges_.size(); ++arena) {
    const std::vector<Entry>& of_arena = of_arenas_[arena];
    ranges_[arena].first = entries_.size();
    ranges_[arena].count = of_arena.size();
    entries_.insert(entries_.end(), of_arena.begin(), of_arena.end());
  }
  ranges_.erase(std::remove_if(ranges_.begin(), ranges_.end(),
                               [](const Range& range) { return range.count == 0; }),
                ranges_.end());
  if (entries_ == uploaded_ || entries_.empty()) return;
  table_.upload(entries_);
  entries_.swap(uploaded_);
}

void PageTable::keep(const FrameLayer& layer, const std::vector<SeenGroup>& groups,
                     std::size_t first_arena, std::size_t first_group) {
  const SlotStore& store = layer.store;
  const auto keep = [&](const PageShelf& shelf, std::size_t i, SlotArenas::Place place,
                        std::size_t arenas, std::uint32_t level) {
    of_arenas_[arenas + place.arena].push_back(
        {static_cast<std::uint32_t>(first_slots_.size()), place.page,
         static_cast<std::uint32_t>(first_group + shelf.bounds.group), level});
    first_slots_.push_back(shelf.first_slots[i]);
  };
  std::vector<Cut> cuts;
  for (std::size_t group = 0; layer.cuts() && group < groups.size(); ++group) {
    cuts.push_back(layer.cut(groups[group].camera, store.pages().groups()[group].originOrZero()));
  }
  // own: width of the nodes' own cells, 0 for slots [m]
  const auto forEachShown = [&](const PageShelf& shelf, float own, const auto& take) {
    const PageView& view = groups[shelf.bounds.group].pages;
    if (!view.mayShow(shelf.bounds)) return;
    const std::uint32_t sides = view.sidesAcross(shelf.bounds);
    if (!layer.cuts()) return forEach(view.mayShow(shelf.pages, sides), shelf, take);
    const Cut& cut = cuts[shelf.bounds.group];
    if (!cut.mayShow(shelf.bounds, own, shelf.widest_parent)) return;
    const auto in_cut = cut.mayShow(shelf.pages, own, shelf.parents);
    auto shown = view.mayShow(shelf.pages, sides);
    for (std::size_t i = 0; i < shown.size(); ++i) shown[i] &= in_cut[i];
    forEach(shown, shelf, take);
  };
  for (const PageShelf& shelf : store.shelves()) {
    forEachShown(shelf, 0, [&](std::size_t i) {
      const std::uint32_t place = shelf.places[i];
      if (store.holds(place)) keep(shelf, i, store.placeOf(place), first_arena, kOfSlots);
    });
  }
  const std::size_t first_of_nodes = first_arena + store.arenas().size();
  for (int number = 0; layer.cuts() && number < kLevels; ++number) {
    for (const NodeStore::OfGroup& nodes : layer.nodes->groups()) {
      const NodeStore::Level& level = nodes[std::size_t(number)];
      for (const PageShelf& shelf : level.shelves) {
        forEachShown(shelf, cellSize(number), [&](std::size_t i) {
          keep(shelf, i, layer.nodes->placeOf(shelf.places[i]), first_of_nodes,
               static_cast<std::uint32_t>(number));
        });
      }
    }
  }
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
