#include "gpu/slot_store.hpp"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <utility>

#include "gl/buffer.hpp"
#include "gl/scopes.hpp"

namespace rosplat {

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);
// A shader writes edits of kFewScattered pieces or more, of fewer than kLongRun slots on average.
// On an H200, a copy takes 2.6 us a buffer, whatever its size; the shader 50 us and 0.03 us a slot.
constexpr std::size_t kFewScattered = 16, kLongRun = 128;

// Writes a slot's words with the time of their change. Returns where the next slot's words go.
std::uint32_t* put(const GaussianEdit& edit, std::size_t source, std::uint32_t change,
                   std::uint32_t* words) {
  const std::uint32_t* const slot = &edit.slots[kSlotWords * source];
  words = std::copy_n(slot, kChangeWord, words);
  *words++ = slot[kChangeWord] | change;
  return words;
}

}  // namespace

void SlotStore::change() {
  static std::atomic<std::uint64_t> versions{0};
  version_ = ++versions;
}

void SlotStore::apply(const GaussianEdit& edit, double now) {
  change();
  if (edit.clear) {
    arenas_.clear();
    held_.clear();
    coarsest_.clear();
    capacity_ = 0;
  }
  capacity_ = std::max(capacity_, edit.capacity);
  pages_.apply(edit);
  // Before anything may fail: the edit is applied again then, and finds these pages regrouped.
  for (const std::uint32_t first_slot : pages_.emptied()) {
    if (const SlotPage& page = *pages_.find(first_slot); holds(page)) empty(page);
  }
  arenas_.addBands(edit.sh_degree);
  for (std::size_t channel = 0; channel < kMostChannels; ++channel) {
    if (!edit.channels[channel].empty()) arenas_.addChannels(channel + 1);
  }
  arenas_.makeRoom(static_cast<std::uint32_t>(pages_.pages().size()));
  const std::vector<Piece> all = pieces(edit);
  const std::uint32_t change = static_cast<std::uint32_t>(now) << 16;
  if (all.size() >= kFewScattered && countSlots(edit.runs) / all.size() < kLongRun) {
    return scatter(edit, all, change);
  }
  for (const Piece& piece : all) write(edit, piece, change);
}

void SlotStore::empty(const SlotPage& page) {
  constexpr std::size_t kPageBytes = SlotPage::kSlots * kSlotBytes;
  const Place place = placeOf(page);
  arenas_[place.arena].slots.zero(place.page * kPageBytes, kPageBytes);
}

std::vector<SlotStore::Piece> SlotStore::pieces(const GaussianEdit& edit) {
  held_.resize(pages_.pages().size());
  std::vector<Piece> pieces;
  forEachPart(edit.runs, [&](std::uint32_t slot, std::uint32_t count, std::size_t source) {
    const SlotPage* const page = pages_.find(slot);
    if (!page || (edit.sh_degree < 0 && !holds(*page))) return;
    const Place place = placeOf(*page);
    Arena& arena = arenas_[place.arena];
    if (edit.sh_degree >= 0 && page->place < coarsest_.size()) coarsest_[page->place] = kNoLevel;
    if (!holds(*page)) {
      if (count < SlotPage::kSlots) empty(*page);
      held_[page->place] = true;
    }
    const std::size_t first = std::size_t{place.page} * SlotPage::kSlots + slot % SlotPage::kSlots;
    Piece* const last = pieces.empty() ? nullptr : &pieces.back();
    if (last && last->arena == &arena && last->first + last->count == first &&
        last->source + last->count == source) {
      last->count += count;
    } else {
      pieces.push_back({&arena, first, source, count});
    }
  });
  return pieces;
}

void SlotStore::write(const GaussianEdit& edit, const Piece& piece, std::uint32_t change) {
  const auto& [arena, first, source, count] = piece;
  if (edit.sh_degree < 0) return arena->slots.zero(first * kSlotBytes, count * kSlotBytes);
  ring_.write<std::uint32_t>(arena->slots, first, count, kSlotWords,
                             [&](std::uint32_t* words, std::size_t from, std::size_t n) {
                               for (std::size_t i = from; i < from + n; ++i) {
                                 words = put(edit, source + i, change, words);
                               }
                             });
  if (arena->levels.id()) {
    ring_.write<std::uint8_t>(arena->levels, first, count, 1,
                              [&](std::uint8_t* levels, std::size_t from, std::size_t n) {
                                for (std::size_t i = from; i < from + n; ++i) {
                                  *levels++ = levelOfNew(edit, source + i);
                                }
                              });
  }
  for (std::size_t band = 1; band <= std::size_t(shDegree()); ++band) {
    const auto words = static_cast<std::size_t>(kBandWords[band]);
    if (int(band) <= edit.sh_degree) {
      ring_.write(arena->bands[band], first, count, words, &edit.bands[band][words * source]);
    } else {
      arena->bands[band].zero(first * words * kWord, count * words * kWord);
    }
  }
  for (std::size_t channel = 0; channel < channels(); ++channel) {
    const std::vector<float>& values = edit.channels[channel];
    ring_.write<float>(arena->channels[channel], first, count, 1,
                       [&](float* to, std::size_t from, std::size_t n) {
                         if (values.empty()) {
                           std::fill_n(to, n, kNoValue);
                         } else {
                           std::copy_n(&values[source + from], n, to);
                         }
                       });
  }
}

// Writes by a shader, in no order: if an edit has a slot twice, only the last one is passed on.
void SlotStore::scatter(const GaussianEdit& edit, const std::vector<Piece>& pieces,
                        std::uint32_t change) {
  const gl::ComputeScope scope;
  for (const Arena& arena : arenas_.arenas()) {
    SlotRuns places;
    for (const Piece& piece : pieces) {
      if (piece.arena == &arena) places.emplace_back(piece.first, piece.count);
    }
    SlotSet listed;
    listed.makeRoom(places);
    std::vector<Spot> spots;
    spots.reserve(countSlots(places));
    for (auto piece = pieces.rbegin(); piece != pieces.rend(); ++piece) {
      for (std::size_t i = piece->arena == &arena ? piece->count : 0; i-- > 0;) {
        const auto place = static_cast<std::uint32_t>(piece->first + i);
        if (!listed.set(place, true)) spots.push_back({piece->source + i, place});
      }
    }
    scatter(edit, arena, spots, change);
  }
  gl::storageBarrier();
}

void SlotStore::scatter(const GaussianEdit& edit, const Arena& arena,
                        const std::vector<Spot>& spots, std::uint32_t change) {
  // The shader gets a slot's place, then the slot's words for each of these buffers.
  std::vector<std::pair<const gl::Buffer*, std::size_t>> held;
  const auto add = [&held](std::size_t words, const gl::Buffer& buffer) {
    if (buffer.id()) held.emplace_back(&buffer, words * kWord);
  };
  forEachArray(add, arena);
  if (arena.levels.id()) held.emplace_back(&arena.levels, 1);
  if (edit.sh_degree < 0) held.resize(1);  // slots that are emptied
  const auto wordsOf = [](std::size_t bytes) { return std::max<std::size_t>(bytes / kWord, 1); };
  std::size_t stride = 1;
  for (const auto& [buffer, bytes] : held) stride += wordsOf(bytes);

  const auto fill = [&](std::uint32_t* words, std::size_t from, std::size_t n) {
    for (std::size_t i = from; i < from + n; ++i) {
      const auto [source, place] = spots[i];
      *words++ = place;
      if (edit.sh_degree < 0) {
        words = std::fill_n(words, kSlotWords, 0u);
        continue;
      }
      words = put(edit, source, change, words);
      for (int band = 1; band <= shDegree(); ++band) {
        const auto of_band = static_cast<std::size_t>(kBandWords[band]);
        words = band <= edit.sh_degree
                    ? std::copy_n(&edit.bands[band][of_band * source], of_band, words)
                    : std::fill_n(words, of_band, 0u);
      }
      for (std::size_t channel = 0; channel < channels(); ++channel) {
        const std::vector<float>& values = edit.channels[channel];
        std::memcpy(words++, values.empty() ? &kNoValue : &values[source], kWord);
      }
      if (arena.levels.id()) *words++ = levelOfNew(edit, source);
    }
  };
  scatter_.use();
  scatter_.set("stride", static_cast<GLuint>(stride));
  const auto read = [&](const gl::Slice& from, std::size_t first, std::size_t count) {
    scatter_.bind("Written", from);
    scatter_.set("first", static_cast<GLuint>(first));
    scatter_.set("count", static_cast<GLuint>(count));
    std::size_t offset = 1;
    for (const auto& [buffer, bytes] : held) {
      const std::size_t words = wordsOf(bytes);
      scatter_.bind("Held", *buffer);
      scatter_.set("words", static_cast<GLuint>(words));
      scatter_.set("offset", static_cast<GLuint>(offset));
      scatter_.set("in_bytes", int(bytes < kWord));
      gl::dispatchInvocations(count * words);
      offset += words;
    }
  };
  ring_.readByShader<std::uint32_t>(spots.size(), stride, fill, read);
}

const std::vector<PageShelf>& SlotStore::shelves() const {
  if (shelved_ != version_) {
    shelves_ = shelve(pages_.pages(), [this](const SlotPage& page) { return widestParent(page); });
    shelved_ = version_;
  }
  return shelves_;
}

void SlotStore::setLevels(std::uint32_t first_slot, const EntryLevels& levels) {
  const SlotPage* const page = pages_.find(first_slot);
  if (!page || !holds(*page)) return;
  change();
  arenas_.addLevels();
  coarsest_.resize(pages_.pages().size(), kNoLevel);
  coarsest_[page->place] = *std::max_element(levels.begin(), levels.end());
  const Place place = placeOf(*page);
  ring_.write(arenas_[place.arena].levels, std::size_t{place.page} * SlotPage::kSlots,
              levels.size(), 1, levels.data());
}

void SlotStore::dropLevels() {
  change();
  arenas_.dropLevels();
  coarsest_.clear();
}

}  // namespace rosplat
