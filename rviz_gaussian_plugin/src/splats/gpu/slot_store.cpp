#include "gpu/slot_store.hpp"

#include <algorithm>
#include <cstring>

namespace rosplat {

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);

}  // namespace

void SlotStore::apply(const GaussianEdit& edit, double now) {
  ++edits_;
  if (edit.clear) {
    arenas_.clear();
    held_.clear();
    coarsest_.clear();
    capacity_ = 0;
  }
  capacity_ = std::max(capacity_, edit.capacity);
  pages_.apply(edit);
  arenas_.addBands(edit.sh_degree);
  for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
    if (!edit.channels[channel].empty()) arenas_.addChannels(channel + 1);
  }
  arenas_.makeRoom(static_cast<std::uint32_t>(pages_.pages().size()));
  for (const std::uint32_t first_slot : pages_.emptied()) empty(*pages_.find(first_slot));
  for (const Piece& piece : pieces(edit)) {
    write(edit, piece, static_cast<std::uint32_t>(now) << 16);
  }
}

void SlotStore::empty(const SlotPage& page) {
  constexpr std::size_t kPageBytes = SlotPage::kSlots * kSlotBytes;
  const Place place = placeOf(page);
  writeZeros(arenas_[place.arena].slots, place.page * kPageBytes, kPageBytes);
}

std::vector<SlotStore::Piece> SlotStore::pieces(const GaussianEdit& edit) {
  held_.resize(pages_.pages().size());
  std::vector<Piece> pieces;
  std::size_t source = 0;
  for (const auto& [run_first, run_count] : edit.runs) {
    std::uint32_t slot = run_first, left = run_count;
    while (left > 0) {
      const std::uint32_t in_page = slot % SlotPage::kSlots;
      const std::uint32_t count = std::min(left, SlotPage::kSlots - in_page);
      const SlotPage* const page = pages_.find(slot);
      if (page && (edit.sh_degree >= 0 || holds(*page))) {
        const Place place = placeOf(*page);
        Arena& arena = arenas_[place.arena];
        if (edit.sh_degree >= 0 && page->place < coarsest_.size()) {
          coarsest_[page->place] = kNoLevel;
        }
        if (!holds(*page)) {
          if (count < SlotPage::kSlots) empty(*page);
          held_[page->place] = true;
        }
        const std::size_t first = std::size_t{place.page} * SlotPage::kSlots + in_page;
        Piece* const last = pieces.empty() ? nullptr : &pieces.back();
        if (last && last->arena == &arena && last->first + last->count == first &&
            last->source + last->count == source) {
          last->count += count;
        } else {
          pieces.push_back({&arena, first, source, count});
        }
      }
      slot += count;
      left -= count;
      source += count;
    }
  }
  return pieces;
}

void SlotStore::write(const GaussianEdit& edit, const Piece& piece, std::uint32_t change) {
  if (edit.sh_degree < 0) {
    return writeZeros(piece.arena->slots, piece.first * kSlotBytes, piece.count * kSlotBytes);
  }
  const auto begin = edit.slots.begin() + std::ptrdiff_t(kSlotWords * piece.source);
  staged_.assign(begin, begin + std::ptrdiff_t(kSlotWords * piece.count));
  for (std::size_t i = kChangeWord; i < staged_.size(); i += kSlotWords) staged_[i] |= change;
  piece.arena->slots.write(piece.first * kSlotBytes, staged_.data(), piece.count * kSlotBytes);
  if (piece.arena->levels.id()) {
    std::vector<std::uint8_t> levels(piece.count);
    for (std::size_t i = 0; i < piece.count; ++i) {
      levels[i] = levelOfNew(edit, piece.source + i);
    }
    piece.arena->levels.write(piece.first, levels.data(), piece.count);
  }
  for (int band = 1; band <= shDegree(); ++band) {
    gl::Buffer& target = piece.arena->bands[band];
    const std::size_t offset = piece.first * bandBytes(band);
    const std::size_t bytes = piece.count * bandBytes(band);
    if (band <= edit.sh_degree) {
      target.write(offset, &edit.bands[band][kBandWords[band] * piece.source], bytes);
    } else {
      writeZeros(target, offset, bytes);
    }
  }
  const std::vector<float> none(channels() > 0 ? piece.count : 0, kNoValue);
  for (std::size_t channel = 0; channel < channels(); ++channel) {
    const std::vector<float>& values = edit.channels[channel];
    piece.arena->channels[channel].write(piece.first * sizeof(float),
                                         values.empty() ? none.data() : &values[piece.source],
                                         piece.count * sizeof(float));
  }
}

GaussianEdit SlotStore::edit(const SlotPage& page) const {
  const Place place = placeOf(page);
  const Arena& arena = arenas_.arenas()[place.arena];
  const auto read = [&](const gl::Buffer& from, std::size_t words) {
    std::vector<std::uint32_t> values(SlotPage::kSlots * words);
    from.read(place.page * values.size() * kWord, values.data(), values.size() * kWord);
    return values;
  };
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;
  for (int band = 1; band <= shDegree(); ++band) {
    bands[band] = read(arena.bands[band], static_cast<std::size_t>(kBandWords[band]));
  }
  GaussianEdit edit = editOf(pages_.groupOf(page), page.first_slot, read(arena.slots, kSlotWords),
                             std::move(bands), shDegree());
  for (std::size_t channel = 0; channel < channels(); ++channel) {
    const std::vector<std::uint32_t> words = read(arena.channels[channel], 1);
    edit.channels[channel].resize(words.size());
    std::memcpy(edit.channels[channel].data(), words.data(), words.size() * kWord);
  }
  return edit;
}

void SlotStore::setLevels(std::uint32_t first_slot, const EntryLevels& levels) {
  const SlotPage* const page = pages_.find(first_slot);
  if (!page || !holds(*page)) return;
  ++edits_;
  arenas_.addLevels();
  coarsest_.resize(pages_.pages().size(), kNoLevel);
  coarsest_[page->place] = *std::max_element(levels.begin(), levels.end());
  const Place place = placeOf(*page);
  arenas_[place.arena].levels.write(std::size_t{place.page} * SlotPage::kSlots, levels.data(),
                                    levels.size());
}

void SlotStore::dropLevels() {
  ++edits_;
  arenas_.dropLevels();
  coarsest_.clear();
}

}  // namespace rosplat
