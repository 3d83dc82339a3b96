#include "cpu/host_slots.hpp"

#include <algorithm>
#include <cstring>

namespace rosplat {

namespace {

std::size_t bandWords(int band) { return HostSlots::kSlots * kBandWords[band]; }

}  // namespace

void HostSlots::apply(const GaussianEdit& edit, double now) {
  if (edit.clear) {
    memory_.clear();
    pages_ = {};
    sh_degree_ = 0;
    band_bytes_ = 0;
  }
  sh_degree_ = std::max(sh_degree_, edit.sh_degree);
  pages_.apply(edit);
  memory_.reserve(pages_.pages().size());
  while (memory_.size() < pages_.pages().size()) {
    memory_.push_back(std::make_unique<Page>());
    memory_.back()->extent.fill(-1);
  }
  const auto change = static_cast<std::uint32_t>(now) << 16;
  std::size_t source = 0;
  for (const auto& [first, count] : edit.runs) {
    for (std::uint32_t done = 0; done < count;) {
      const std::uint32_t slot = first + done;
      const auto in_page =
          std::min(count - done, static_cast<std::uint32_t>(kSlots - slot % kSlots));
      write(edit, source + done, slot, in_page, change);
      done += in_page;
    }
    source += count;
  }
}

// Slots of one page.
void HostSlots::write(const GaussianEdit& edit, std::size_t source, std::uint32_t first,
                      std::uint32_t count, std::uint32_t change) {
  const SlotPage* const found = pages_.find(first);
  if (!found) return;  // slots that were never used are empty already
  Page& page = *memory_[found->place];
  const std::size_t target = first % kSlots;
  if (edit.sh_degree < 0) {
    for (auto& words : page.words) std::fill_n(&words[target], count, 0u);
    std::fill_n(&page.extent[target], count, -1.0f);
    return;
  }
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t* const words = &edit.slots[kSlotWords * (source + i)];
    float position[3];
    std::memcpy(position, words, sizeof(position));
    for (std::size_t axis = 0; axis < 3; ++axis) page.position[axis][target + i] = position[axis];
    page.extent[target + i] = edit.extents[source + i];
    for (std::size_t k = 0; k < page.words.size(); ++k) {
      page.words[k][target + i] = words[3 + k] | (3 + k == kChangeWord ? change : 0);
    }
  }
  for (int band = 1; band <= sh_degree_; ++band) {
    const auto coefficients = static_cast<std::size_t>(kBandWords[band]);
    std::uint32_t* memory = page.bands[band].get();
    if (!memory) {
      if (band > edit.sh_degree) continue;
      page.bands[band].reset(new std::uint32_t[bandWords(band)]{});
      memory = page.bands[band].get();
      band_bytes_ += bandWords(band) * sizeof(std::uint32_t);
    }
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t k = 0; k < coefficients; ++k) {
        memory[k * kSlots + target + i] =
            band <= edit.sh_degree ? edit.bands[band][coefficients * (source + i) + k] : 0;
      }
    }
  }
}

std::size_t HostSlots::bytes() const {
  return memory_.size() * sizeof(Page) + band_bytes_ + pages_.bytes() +
         memory_.capacity() * sizeof(memory_[0]);
}

std::vector<SplatValues> HostSlots::read(const std::vector<std::uint32_t>& slots) const {
  std::vector<SplatValues> splats;
  for (const std::uint32_t slot : slots) {
    SplatValues& values = splats.emplace_back();
    values.slot = slot;
    const SlotPage* const found = pages_.find(slot);
    if (!found) continue;
    const Page& page = *memory_[found->place];
    const std::size_t i = slot % kSlots;
    std::array<std::uint32_t, kSlotWords> words;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      std::memcpy(&words[axis], &page.position[axis][i], sizeof(float));
    }
    for (std::size_t k = 0; k < page.words.size(); ++k) words[3 + k] = page.words[k][i];
    const Splat splat = unpackSlot(words.data());
    std::copy(splat.position.begin(), splat.position.end(), values.position.begin());
    values.orientation = splat.orientation;
    values.scale = splat.scale;
    values.opacity = splat.opacity;

    std::array<std::array<std::uint32_t, 7>, kMaxShDegree + 1> bands{};
    std::array<const std::uint32_t*, kMaxShDegree + 1> bands_of{};
    for (int band = 1; band <= sh_degree_; ++band) {
      for (int k = 0; k < kBandWords[band] && page.bands[band]; ++k) {
        bands[band][k] = page.bands[band][std::size_t(k) * kSlots + i];
      }
      bands_of[band] = bands[band].data();
    }
    values.sh.assign(splat.color.begin(), splat.color.end());
    const std::vector<float> rest = unpackHarmonics(words.data(), sh_degree_, bands_of);
    values.sh.insert(values.sh.end(), rest.begin(), rest.end());
  }
  return splats;
}

GaussianEdit HostSlots::edit(const SlotPage& of) const {
  const Page& page = at(of);
  std::vector<std::uint32_t> slots(kSlots * kSlotWords);
  for (std::size_t i = 0; i < kSlots; ++i) {
    std::uint32_t* const words = &slots[kSlotWords * i];
    for (std::size_t axis = 0; axis < 3; ++axis) {
      std::memcpy(&words[axis], &page.position[axis][i], sizeof(float));
    }
    for (std::size_t k = 0; k < page.words.size(); ++k) words[3 + k] = page.words[k][i];
  }
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;
  for (int band = 1; band <= sh_degree_; ++band) {
    const auto coefficients = static_cast<std::size_t>(kBandWords[band]);
    bands[band].resize(kSlots * coefficients);
    for (std::size_t k = 0; page.bands[band] && k < coefficients; ++k) {
      for (std::size_t i = 0; i < kSlots; ++i) {
        bands[band][coefficients * i + k] = page.bands[band][k * kSlots + i];
      }
    }
  }
  return editOf(of.first_slot, std::move(slots), std::move(bands), sh_degree_);
}

}  // namespace rosplat
