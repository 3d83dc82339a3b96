#include "gpu/page_table.hpp"

#include <algorithm>
#include <cstring>
#include <optional>

#include "rosplat_core/levels/cut.hpp"

namespace rosplat {

namespace {

constexpr std::uint32_t kOfSlots = 0xffffffffu;  // level of a page of slots

}  // namespace

void PageTable::choose(const Frame& frame, const std::vector<std::vector<SeenGroup>>& groups) {
  all_ = 0;
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
    choose(frame.layers[layer], groups[layer], first_arena, first_group);
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
  if (entries_.empty()) return;
  const std::size_t bytes = entries_.size() * sizeof(Entry);
  const bool same = entries_.size() == uploaded_.size() &&
                    std::memcmp(entries_.data(), uploaded_.data(), bytes) == 0;
  if (same) return;
  table_.upload(entries_);
  entries_.swap(uploaded_);
}

void PageTable::choose(const FrameLayer& layer, const std::vector<SeenGroup>& groups,
                       std::size_t first_arena, std::size_t first_group) {
  const SlotStore& store = layer.store;
  std::vector<Cut> cuts;
  for (std::size_t group = 0; layer.cuts() && group < groups.size(); ++group) {
    cuts.push_back(layer.cut(groups[group].camera, store.pages().groups()[group].originOrZero()));
  }
  // own: width of the nodes' own cells, 0 for slots [m]. placeOf(place): where an arena has a page,
  // if one has it.
  const auto chooseShown = [&](const PageShelf& shelf, float own, std::size_t arenas,
                               std::uint32_t level, const auto& placeOf) {
    all_ += shelf.end - shelf.begin;
    const std::uint32_t group = shelf.bounds.group;
    const PageView& view = groups[group].pages;
    if (!view.mayShow(shelf.bounds)) return;
    if (layer.cuts() && !cuts[group].mayShow(shelf.bounds, own, shelf.widest_parent)) return;
    auto shown = view.mayShow(shelf.pages, view.sidesAcross(shelf.bounds));
    if (layer.cuts()) {
      const auto in_cut = cuts[group].mayShow(shelf.pages, own, shelf.parents);
      for (std::size_t i = 0; i < shown.size(); ++i) shown[i] &= in_cut[i];
    }
    for (std::size_t i = 0; i < shelf.end - shelf.begin; ++i) {
      if (!shown[i]) continue;
      const std::optional<SlotArenas::Place> at = placeOf(shelf.places[i]);
      if (!at) continue;
      // Word by word: a value to push is put together elsewhere first, which takes twice as long.
      Entry& entry = of_arenas_[arenas + at->arena].emplace_back();
      entry.number = static_cast<std::uint32_t>(first_slots_.size());
      entry.page = at->page;
      entry.group = static_cast<std::uint32_t>(first_group) + group;
      entry.level = level;
      first_slots_.push_back(shelf.first_slots[i]);
    }
  };
  for (const PageShelf& shelf : store.shelves()) {
    chooseShown(shelf, 0, first_arena, kOfSlots, [&](std::uint32_t place) {
      return store.holds(place) ? std::optional(store.placeOf(place)) : std::nullopt;
    });
  }
  const std::size_t first_of_nodes = first_arena + store.arenas().size();
  for (int number = 0; layer.cuts() && number < kLevels; ++number) {
    for (const NodeStore::OfGroup& nodes : layer.nodes->groups()) {
      for (const PageShelf& shelf : nodes[std::size_t(number)].shelves) {
        const int around = shelf.widest_parent < kBoundless ? number + 1 : kLevels;
        chooseShown(shelf, cellSize(number), first_of_nodes,
                    static_cast<std::uint32_t>(number | around << 8), [&](std::uint32_t place) {
                      return std::optional(layer.nodes->placeOf(place));
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
