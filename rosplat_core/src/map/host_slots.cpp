#include "rosplat_core/map/host_slots.hpp"

#include <algorithm>
#include <cstring>
#include <iterator>
#include <memory>

#include "rosplat_core/threads/in_parts.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kAppearancePadding = 3;  // words: readers take four words at a time

}  // namespace

void HostSlots::apply(const GaussianEdit& edit, double now, ThreadTeam* team) {
  if (edit.clear) *this = HostSlots();
  // Memory is allocated before anything changes; present pages may gain empty bands and channels.
  std::vector<std::uint32_t> touched;
  if (edit.sh_degree >= 0) touched = SlotPages::touched(edit);
  std::vector<std::unique_ptr<Page>> fresh(touched.size());
  inParts(team, touched.size(), [&](std::size_t number) {
    const SlotPage* const known = pages_.find(touched[number]);
    if (!known) {
      fresh[number] = std::make_unique<Page>();
      fresh[number]->extent.fill(-1);
    }
    makeRoom(edit, known ? at(*known) : *fresh[number]);
  });
  fresh.erase(std::remove(fresh.begin(), fresh.end(), nullptr), fresh.end());
  const std::size_t pages = memory_.size() + fresh.size();
  if (pages > memory_.capacity()) memory_.reserve(pages + memory_.size() / 4);
  std::vector<PageWrite> parts;  // of one run: each of another page
  std::uint32_t longest = 0;
  for (const auto& [first, count] : edit.runs) longest = std::max(longest, count);
  parts.reserve(longest / kSlots + 2);
  pages_.apply(edit);

  std::move(fresh.begin(), fresh.end(), std::back_inserter(memory_));
  sh_degree_ = std::max(sh_degree_, edit.sh_degree);
  for (std::size_t channel = channels_; channel < kMostChannels; ++channel) {
    if (!edit.channels[channel].empty()) channels_ = channel + 1;
  }
  for (const std::uint32_t first_slot : pages_.emptied()) at(*pages_.find(first_slot)).empty();
  const auto change = static_cast<std::uint32_t>(now) << 16;
  std::size_t source = 0;
  for (const auto& [first, count] : edit.runs) {
    parts.clear();
    for (std::uint32_t done = 0, in_page; done < count; done += in_page) {
      const std::uint32_t slot = first + done;
      in_page = std::min(count - done, static_cast<std::uint32_t>(kSlots - slot % kSlots));
      parts.push_back({slot, in_page, source + done});
    }
    inParts(team, parts.size(), [&](std::size_t number) { write(edit, parts[number], change); });
    source += count;
  }
}

// Makes room for the bands and channels that an edit has.
void HostSlots::makeRoom(const GaussianEdit& edit, Page& page) const {
  page.reserve(edit.sh_degree);
  for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
    auto& memory = page.channels[channel];
    if (edit.channels[channel].empty() || memory) continue;
    memory = std::make_unique<PerSlot<float>>();
    memory->fill(kNoValue);
  }
}

void HostSlots::write(const GaussianEdit& edit, const PageWrite& part, std::uint32_t change) {
  const auto& [first, count, source] = part;
  const SlotPage* const found = pages_.find(first);
  if (!found) return;  // slots that were never used are empty already
  Page& page = *memory_[found->place];
  const std::size_t target = first % kSlots;
  if (page.parents) {
    for (std::size_t i = 0; i < count; ++i) {
      const bool shows = edit.sh_degree >= 0 && edit.extents[source + i] >= 0;
      (*page.parents)[target + i] = shows ? kBoundless : 0;
    }
    page.widest_parent = kBoundless;
  }
  if (edit.sh_degree < 0) {
    std::fill(page.appearance(target), page.appearance(target + count), 0u);
    std::fill_n(&page.extent[target], count, -1.0f);
    return;
  }
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t* const words = &edit.slots[kSlotWords * (source + i)];
    float position[3];
    std::memcpy(position, words, sizeof(position));
    for (std::size_t axis = 0; axis < 3; ++axis) page.position[axis][target + i] = position[axis];
    page.extent[target + i] = edit.extents[source + i];
    std::uint32_t* to =
        std::copy(words + kFirstAppearanceWord, words + kSlotWords, page.appearance(target + i));
    to[-1] |= change;
    for (int band = 1; band <= page.sh_degree; ++band) {
      const auto coefficients = static_cast<std::size_t>(kBandWords[band]);
      to = band <= edit.sh_degree
               ? std::copy_n(&edit.bands[band][coefficients * (source + i)], coefficients, to)
               : std::fill_n(to, coefficients, 0u);
    }
  }
  writeChannels(edit, source, page, target, count);
}

void HostSlots::writeChannels(const GaussianEdit& edit, std::size_t source, Page& page,
                              std::size_t target, std::size_t count) {
  for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
    const std::vector<float>& values = edit.channels[channel];
    const auto& memory = page.channels[channel];
    if (!memory) continue;
    for (std::size_t i = 0; i < count; ++i) {
      (*memory)[target + i] = values.empty() ? kNoValue : values[source + i];
    }
  }
}

void HostSlots::makeParents(const SlotPage& of) {
  Page& page = at(of);
  if (page.parents) return;
  page.parents = std::make_unique<PerSlot<float>>();
  for (std::size_t i = 0; i < kSlots; ++i) {
    (*page.parents)[i] = page.extent[i] >= 0 ? kBoundless : 0;
  }
}

void HostSlots::setParents(const SlotPage& of, const PerSlot<float>& sizes) {
  Page& page = at(of);
  makeParents(of);
  for (std::size_t i = 0; i < kSlots; ++i) {
    if (sizes[i] >= 0) (*page.parents)[i] = sizes[i];
  }
  page.widest_parent = *std::max_element(page.parents->begin(), page.parents->end());
}

void HostSlots::dropParents() {
  for (const auto& page : memory_) {
    page->parents.reset();
    page->widest_parent = kBoundless;
  }
}

std::size_t HostSlots::bytes() const {
  std::size_t bytes = pages_.bytes() + memory_.capacity() * sizeof(memory_[0]);
  for (const auto& page : memory_) {
    bytes += sizeof(Page) + page->appearanceBytes();
    for (const auto& channel : page->channels) bytes += channel ? sizeof(*channel) : 0;
    bytes += page->parents ? sizeof(*page->parents) : 0;
  }
  return bytes;
}

void HostSlots::Page::reserve(int degree) {
  if (degree <= sh_degree) return;
  const auto to = static_cast<std::size_t>(appearanceWords(degree));
  std::unique_ptr<std::uint32_t[]> larger(new std::uint32_t[kSlots * to + kAppearancePadding]{});
  for (std::size_t i = 0; appearances && i < kSlots; ++i) {
    std::copy_n(appearance(i), appearanceWords(sh_degree), &larger[to * i]);
  }
  appearances = std::move(larger);
  sh_degree = degree;
}

std::size_t HostSlots::Page::appearanceBytes() const {
  return appearances ? (kSlots * std::size_t(appearanceWords(sh_degree)) + kAppearancePadding) *
                           sizeof(std::uint32_t)
                     : 0;
}

void HostSlots::Page::empty() {
  std::fill(appearance(0), appearance(kSlots), 0u);
  extent.fill(-1);
  if (parents) parents->fill(0);
}

void HostSlots::Page::interleave(int band, std::uint32_t* to) const {
  for (std::size_t i = 0; i < kSlots; ++i) {
    if (band == 0) {
      for (const PerSlot<float>& axis : position) std::memcpy(to++, &axis[i], sizeof(float));
      to = std::copy_n(appearance(i), appearanceWords(0), to);
    } else {
      to = band <= sh_degree
               ? std::copy_n(appearance(i) + appearanceBand(band), kBandWords[band], to)
               : std::fill_n(to, kBandWords[band], 0u);
    }
  }
}

PackedSlot HostSlots::Page::packed(std::size_t i, int degree) const {
  PackedSlot slot;
  for (std::size_t k = 0; k < slot.words.size(); ++k) slot.words[k] = word(k, i);
  for (int band = 1; band <= std::min(degree, sh_degree); ++band) {
    std::copy_n(appearance(i) + appearanceBand(band), kBandWords[band], slot.bands[band].begin());
  }
  return slot;
}

void HostSlots::Page::put(std::size_t i, const PackedSlot& slot, int degree) {
  reserve(degree);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    std::memcpy(&position[axis][i], &slot.words[axis], sizeof(float));
  }
  std::uint32_t* to =
      std::copy(slot.words.begin() + kFirstAppearanceWord, slot.words.end(), appearance(i));
  for (int band = 1; band <= sh_degree; ++band) {
    to = std::copy_n(slot.bands[band].begin(), kBandWords[band], to);
  }
}

std::vector<SplatValues> HostSlots::read(const std::vector<std::uint32_t>& slots) const {
  std::vector<SplatValues> splats;
  for (const std::uint32_t slot : slots) {
    SplatValues& values = splats.emplace_back();
    values.slot = slot;
    const SlotPage* const found = pages_.find(slot);
    if (!found) continue;
    const PackedSlot packed = at(*found).packed(slot % kSlots, sh_degree_);
    values =
        valuesOf(slot, pages_.groupOf(*found), packed.words.data(), sh_degree_, packed.bandWords());
    for (std::size_t channel = 0; channel < channels_; ++channel) {
      const auto& memory = at(*found).channels[channel];
      values.channels.push_back(memory ? (*memory)[slot % kSlots] : kNoValue);
    }
  }
  return splats;
}

GaussianEdit HostSlots::edit(const SlotPage& of) const {
  PackedRun run{{}, pages_.groupOf(of), of.first_slot, sh_degree_};
  run.slots.resize(kSlots * kSlotWords);
  at(of).interleave(0, run.slots.data());
  for (int band = 1; band <= sh_degree_; ++band) {
    run.bands[band].resize(kSlots * std::size_t(kBandWords[band]));
    at(of).interleave(band, run.bands[band].data());
  }
  for (std::size_t channel = 0; channel < channels_; ++channel) {
    const auto& memory = at(of).channels[channel];
    if (memory) run.channels[channel].assign(memory->begin(), memory->end());
  }
  return editOf(std::move(run));
}

}  // namespace rosplat
