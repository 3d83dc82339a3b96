#include "map/published_content.hpp"

#include <algorithm>
#include <stdexcept>

#include "rosplat_core/map/channels.hpp"
#include "rosplat_core/map/gaussian_map.hpp"
#include "rosplat_core/slots/packed_rows.hpp"

namespace rosplat {

namespace {

// Size of a batch without its arrays and channel names, and of a placed group. [bytes]
constexpr std::size_t kBatchBytes = 400, kPlacementBytes = 60;

// The highest band of harmonics that has a value other than zero.
int withoutEmptyBands(const SplatArrays<const float>& splats) {
  const std::size_t stride = splats.shStride();
  const auto empty = [&](int degree) {
    for (std::size_t i = 0; i < splats.count; ++i) {
      const float* const sh = splats.sh + stride * i;
      if (std::any_of(sh + harmonicsOf(degree - 1), sh + harmonicsOf(degree),
                      [](float value) { return value != 0; })) {
        return false;
      }
    }
    return true;
  };
  int degree = splats.sh_degree;
  while (degree > 0 && empty(degree)) --degree;
  return degree;
}

// A map's known channels and those of splats.
std::vector<std::string> channelsOf(std::vector<std::string> known, const SplatsView& splats) {
  for (const auto& [name, values] : splats.channels) {
    if (std::find(known.begin(), known.end(), name) == known.end()) known.push_back(name);
  }
  if (known.size() > kMostChannels) {
    throw std::invalid_argument("channel_names: " + std::to_string(known.size()) +
                                " in all, a map has at most " + std::to_string(kMostChannels));
  }
  return known;
}

}  // namespace

PublishedContent::PublishedContent(const SplatsView& splats,
                                   const std::shared_ptr<const void>& keeper)
    : channels_(channelsOf({}, splats)), sh_degree_(splats.arrays.sh_degree) {
  if (splats.arrays.count == 0) return;
  model_ = splats.model;
  groups_[0].origin = splats.origin;
  for (std::size_t first = 0; first < splats.arrays.count; first += kPageSlots) {
    Page& page = pages_[static_cast<std::uint32_t>(first / kPageSlots)];
    page.used = page.splats.refer(splats, first, keeper);
    used_ += page.used.count();
  }
}

std::size_t PublishedContent::splatBytes(int sh_degree, std::size_t channel_count, bool listed) {
  return packed_rows::size(1, sh_degree) + sizeof(float) * channel_count +
         (listed ? sizeof(std::uint32_t) : 0);
}

// --- Edits ---------------------------------------------------------------------------------------

PublishedContent::Slots PublishedContent::freeSlots(std::size_t count, std::uint32_t group) const {
  Slots slots;
  static const std::bitset<kPageSlots> kNone;
  const auto take = [&](std::uint32_t number, const std::bitset<kPageSlots>& used) {
    for (std::uint32_t i = 0; i < kPageSlots && slots.size() < count; ++i) {
      if (!used[i]) slots.push_back(number * kPageSlots + i);
    }
  };
  for (const auto& [number, page] : pages_) {
    if (page.group == group && page.used.any()) take(number, page.used);
  }
  for (std::uint32_t number = 0; number < kMaxSlots / kPageSlots && slots.size() < count;
       ++number) {
    const auto found = pages_.find(number);
    if (found == pages_.end() || found->second.used.none()) take(number, kNone);
  }
  if (slots.size() < count) {
    throw std::invalid_argument("splats: the map has no room for " + std::to_string(count) +
                                " more of group " + std::to_string(group));
  }
  std::sort(slots.begin(), slots.end());
  return slots;
}

PublishedContent::Plan PublishedContent::prepareWrite(const NamedSlots& slots,
                                                      const SplatsView& splats,
                                                      std::uint32_t group) {
  Plan plan;
  plan.sh_degree = splats.rows ? splats.arrays.sh_degree : withoutEmptyBands(splats.arrays);
  plan.channels = channelsOf(channels_, splats);
  for (const auto& [name, values] : splats.channels) {
    const auto place = std::find(plan.channels.begin(), plan.channels.end(), name);
    plan.places.push_back(static_cast<std::size_t>(place - plan.channels.begin()));
  }
  if (slots.empty()) return plan;
  if (model_.value_or(splats.model) != splats.model) {
    throw std::invalid_argument("model: can't mix " + nameOf(splats.model) + " splats with " +
                                nameOf(*model_) + " ones, they are drawn differently");
  }
  const auto touched = slots.touched();
  for (const auto& [number, count] : touched) {
    const auto found = pages_.find(number);
    if (found == pages_.end() || found->second.group == group || found->second.used.none()) {
      continue;
    }
    throw std::invalid_argument("slots " + std::to_string(number * kPageSlots) + " to " +
                                std::to_string(number * kPageSlots + kPageSlots - 1) +
                                " hold splats of group " + std::to_string(found->second.group) +
                                ", this batch is of group " + std::to_string(group) +
                                ": a block of " + std::to_string(kPageSlots) +
                                " slots holds one group; append() finds free slots");
  }
  groups_[group];
  for (const auto& [number, count] : touched) {
    const auto [found, is_new] = pages_.try_emplace(number);
    Page& page = found->second;
    if (is_new) page.group = group;
    page.splats.reserve(plan.sh_degree, plan.places);
    if (count < kPageSlots) page.changed.reserve();
  }
  return plan;
}

std::size_t PublishedContent::write(const NamedSlots& slots, const SplatsView& splats,
                                    const Plan& plan, std::uint32_t group, std::uint64_t revision) {
  if (slots.empty()) return 0;
  channels_ = plan.channels;
  sh_degree_ = std::max(sh_degree_, plan.sh_degree);
  model_ = splats.model;
  auto& origin = groups_[group].origin;
  if (!origin) origin = splats.origin;
  for (const auto& [number, count] : slots.touched()) {
    Page& page = pages_[number];
    if (page.group != group) page.regrouped = revision;
    page.group = group;
    page.written = revision;
    if (count == kPageSlots) page.changed.fill(revision);
  }
  std::array<double, 3> shift;
  for (std::size_t k = 0; k < 3; ++k) shift[k] = splats.origin[k] - (*origin)[k];
  std::size_t left_out = 0;
  std::uint32_t number = kMaxSlots;
  Page* page = nullptr;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (number != slots[i] / kPageSlots) page = &pages_[number = slots[i] / kPageSlots];
    const std::size_t at = slots[i] % kPageSlots;
    std::array<float, 3> position = splats.position(i);
    for (std::size_t k = 0; k < 3; ++k) {
      if (shift[k] != 0) position[k] = static_cast<float>(position[k] + shift[k]);
    }
    for (std::size_t k = 0; k < channels_.size(); ++k) {
      if (float* const values = page->splats.ownChannel(k)) values[at] = kNoValue;
    }
    for (std::size_t k = 0; k < plan.places.size(); ++k) {
      page->splats.ownChannel(plan.places[k])[at] = splats.channels[k].second[i];
    }
    const bool usable = page->splats.write(at, splats, i, position);
    left_out += !usable;
    used_ += usable;
    used_ -= page->used[at];
    page->used[at] = usable;
    if (page->changed[at] != revision) page->changed.set(at, revision);
  }
  return left_out;
}

void PublishedContent::prepareErase(const NamedSlots& slots) {
  for (const auto& [number, count] : slots.touched()) {
    const auto found = pages_.find(number);
    if (found == pages_.end()) continue;
    if (slots.listed() || count < kPageSlots) found->second.changed.reserve();
  }
}

void PublishedContent::erase(const NamedSlots& slots, std::uint64_t revision) {
  for (std::size_t i = 0; i < slots.size();) {
    const std::uint32_t at = slots[i] % kPageSlots;
    const auto found = pages_.find(slots[i] / kPageSlots);
    const std::size_t neighbours =
        slots.listed() ? 1 : std::min<std::size_t>(kPageSlots - at, slots.size() - i);
    i += neighbours;
    if (found == pages_.end()) continue;
    Page& page = found->second;
    page.written = revision;
    if (neighbours == kPageSlots) page.changed.fill(revision);
    for (std::uint32_t k = at; k < at + neighbours; ++k) {
      used_ -= page.used[k];
      page.used[k] = false;
      if (page.changed[k] != revision) page.changed.set(k, revision);
    }
    if (page.used.none()) page.splats = {};
  }
}

void PublishedContent::preparePlace(const Poses& poses) {
  for (const auto& [group, pose] : poses) groups_[group];
}

void PublishedContent::place(const Poses& poses, std::uint64_t revision) {
  for (const auto& [group, pose] : poses) {
    groups_[group].pose = pose;
    groups_[group].placed = revision;
  }
}

// --- Reading -------------------------------------------------------------------------------------

std::vector<PublishedMap::Group> PublishedContent::groups() const {
  std::map<std::uint32_t, Slots> used;
  for (const auto& [number, page] : pages_) {
    if (page.used.none()) continue;
    Slots& slots = used[page.group];
    for (std::uint32_t i = 0; i < kPageSlots; ++i) {
      if (page.used[i]) slots.push_back(kPageSlots * number + i);
    }
  }
  if (used.empty()) used[0];
  std::vector<PublishedMap::Group> groups;
  for (auto& [number, slots] : used) {
    PublishedMap::Group& group = groups.emplace_back();
    group.number = number;
    if (const auto found = groups_.find(number); found != groups_.end()) {
      group.pose = found->second.pose;
    }
    const NamedSlots named(slots.data(), slots.size());
    group.splats.origin = originOf(number);
    group.splats.model = model();
    read(named, sh_degree_, group.splats);
    const std::vector<float> values = readChannels(named, channels_);
    auto first = values.begin();
    for (const std::string& name : channels_) {
      const auto end = first + static_cast<std::ptrdiff_t>(slots.size());
      group.splats.channels.emplace_back(name, std::vector<float>(first, end));
      first = end;
    }
    group.slots = std::move(slots);
  }
  return groups;
}

PublishedContent::Poses PublishedContent::placedAfter(std::uint64_t revision) const {
  Poses poses;
  for (const auto& [group, frame] : groups_) {
    if (frame.pose && frame.placed > revision) poses.emplace(group, *frame.pose);
  }
  return poses;
}

// Calls each(page, place in the page, i) for the i-th slot.
template <typename Each>
void PublishedContent::forEach(const NamedSlots& slots, const Each& each) const {
  std::uint32_t number = kMaxSlots;
  const Page* page = nullptr;
  for (std::size_t i = 0; i < slots.size(); ++i) {
    if (number != slots[i] / kPageSlots) page = &pages_.at(number = slots[i] / kPageSlots);
    each(*page, slots[i] % kPageSlots, i);
  }
}

void PublishedContent::read(const NamedSlots& slots, int sh_degree, Splats& splats) const {
  const SplatArrays<float> arrays = splats.resize(slots.size(), sh_degree);
  forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
    page.splats.read(at, i, arrays);
  });
}

std::vector<std::uint8_t> PublishedContent::readRows(const NamedSlots& slots, int sh_degree) const {
  const std::size_t bytes = packed_rows::size(1, sh_degree);
  std::vector<std::uint8_t> rows(bytes * slots.size());
  forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
    page.splats.readRow(at, sh_degree, rows.data() + bytes * i);
  });
  return rows;
}

std::vector<float> PublishedContent::readChannels(const NamedSlots& slots,
                                                  const std::vector<std::string>& channels) const {
  const std::size_t n = slots.size();
  std::vector<float> values(channels.size() * n, kNoValue);
  for (std::size_t k = 0; k < channels.size(); ++k) {
    const auto found = std::find(channels_.begin(), channels_.end(), channels[k]);
    const auto place = static_cast<std::size_t>(found - channels_.begin());
    forEach(slots, [&](const Page& page, std::size_t at, std::size_t i) {
      if (const float* const own = page.splats.channel(place)) values[n * k + i] = own[at];
    });
  }
  return values;
}

std::array<double, 3> PublishedContent::originOf(std::uint32_t group) const {
  const auto found = groups_.find(group);
  return found == groups_.end() ? std::array<double, 3>{}
                                : found->second.origin.value_or(std::array<double, 3>{});
}

// --- Changes -------------------------------------------------------------------------------------

// The first block, from `first` on, that has slots or the number of a group.
std::optional<std::uint32_t> PublishedContent::blockFrom(std::uint32_t first) const {
  const auto page = pages_.lower_bound(first);
  const auto group = groups_.lower_bound(first);
  if (page == pages_.end() && group == groups_.end()) return std::nullopt;
  if (group == groups_.end()) return page->first;
  return page == pages_.end() ? group->first : std::min(page->first, group->first);
}

// The splats of a block that changed, the pose of their group, and the pose of the group that has
// the block's number: so all poses come, and none after its splats. known: poses to leave out.
PublishedContent::BlockChanges PublishedContent::changesOf(std::uint32_t block, std::uint64_t after,
                                                           const Poses& known) const {
  BlockChanges changes;
  const auto place = [&](std::uint32_t group) {
    const auto found = groups_.find(group);
    if (found == groups_.end() || !found->second.pose || known.count(group) > 0) return;
    if (found->second.placed > after) changes.placed.emplace(group, *found->second.pose);
  };
  place(block);
  const auto found = pages_.find(block);
  if (found == pages_.end() || (after > 0 && found->second.written <= after)) return changes;
  const Page& page = found->second;
  changes.group = page.group;
  place(page.group);
  for (std::uint32_t i = 0; i < kPageSlots; ++i) {
    const bool changed = after == 0 || page.changed[i] > after;
    const std::uint32_t slot = kPageSlots * block + i;
    if (changed && page.used[i]) changes.written.push_back(slot);
    if (after > 0 && (page.regrouped > after || (changed && !page.used[i]))) {
      changes.emptied.push_back(slot);
    }
  }
  return changes;
}

PublishedContent::Changes PublishedContent::changes(std::uint64_t after, std::uint32_t first_block,
                                                    const Limits& limits) const {
  Changes changes;
  std::size_t names = 0;
  for (const std::string& name : channels_) names += name.size() + 8;
  std::size_t bytes = 3 * kBatchBytes;
  bool begun = false;
  for (auto block = blockFrom(first_block); block; block = blockFrom(*block + 1)) {
    BlockChanges of_block = changesOf(*block, after, changes.poses);
    const std::size_t splat_bytes = splatBytes(limits.sh_degree, channels_.size(), true);
    std::size_t more = kPlacementBytes * of_block.placed.size() +
                       sizeof(std::uint32_t) * of_block.emptied.size() +
                       splat_bytes * of_block.written.size();
    if (more == 0) continue;
    if (!of_block.written.empty() && changes.written.count(of_block.group) == 0)
      more += kBatchBytes + names;
    if (begun && bytes + more > limits.bytes) {
      changes.next_block = *block;
      break;
    }
    begun = true;
    bytes += more;
    changes.poses.merge(of_block.placed);
    const auto append = [](const Slots& from, Slots& to) {
      to.insert(to.end(), from.begin(), from.end());
    };
    append(of_block.emptied, changes.emptied);
    if (!of_block.written.empty()) append(of_block.written, changes.written[of_block.group]);
  }
  return changes;
}

// --- Sending all ---------------------------------------------------------------------------------

std::map<std::uint32_t, std::vector<std::uint32_t>> PublishedContent::beginSending() {
  std::map<std::uint32_t, std::vector<std::uint32_t>> blocks;
  for (auto& [number, page] : pages_) {
    if (page.used.any()) blocks[page.group].push_back(number);
    page.regrouped = 0;
  }
  return blocks;
}

bool PublishedContent::holds(std::uint32_t slot, std::uint32_t group) const {
  const auto page = pages_.find(slot / kPageSlots);
  return page != pages_.end() && page->second.used[slot % kPageSlots] &&
         page->second.group == group;
}

void PublishedContent::touch(const NamedSlots& slots, std::uint64_t revision) {
  for (const auto& [number, count] : slots.touched()) {
    Page& page = pages_.at(number);
    page.written = revision;
    if (count == kPageSlots) page.changed.fill(revision);
  }
  for (std::size_t i = 0; i < slots.size(); ++i) {
    SlotRevisions& changed = pages_.at(slots[i] / kPageSlots).changed;
    if (changed[slots[i] % kPageSlots] != revision) changed.set(slots[i] % kPageSlots, revision);
  }
}

}  // namespace rosplat
