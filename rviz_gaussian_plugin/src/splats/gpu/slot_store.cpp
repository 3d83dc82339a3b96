#include "gpu/slot_store.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr std::size_t kWord = sizeof(std::uint32_t);
constexpr std::size_t kSlotBytes = kSlotWords * kWord;
constexpr std::uint32_t kMostArenaPages = 2048;  // 72 MiB of slots

std::size_t bandBytes(int band) { return kBandWords[band] * kWord; }

// Opacity 0: empty slots.
void writeZeros(gl::Buffer& buffer, std::size_t offset, std::size_t bytes) {
  const std::vector<std::uint32_t> zeros(bytes / kWord);
  buffer.write(offset, zeros.data(), bytes);
}

// A buffer for so many slots, which begins with what was in another.
gl::Buffer grown(const gl::Buffer& buffer, std::size_t bytes) {
  gl::Buffer larger(bytes, GL_DYNAMIC_DRAW);
  if (buffer.id()) larger.copy(buffer);
  return larger;
}

}  // namespace

SlotStore::SlotStore()
    : arena_pages_(static_cast<std::uint32_t>(std::clamp<std::size_t>(
          gl::largestStorageBuffer() / (SlotPage::kSlots * kSlotBytes), 1, kMostArenaPages))) {}

void SlotStore::addBands(int degree) {
  for (Arena& arena : arenas_) {
    for (int band = sh_degree_ + 1; band <= degree; ++band) {
      arena.bands[band] =
          gl::Buffer(arena.pages * SlotPage::kSlots * bandBytes(band), GL_DYNAMIC_DRAW);
      writeZeros(arena.bands[band], 0, arena.bands[band].bytes());
    }
  }
  sh_degree_ = std::max(sh_degree_, degree);
}

// The last arena grows by a quarter at least, so that what is copied stays in proportion.
void SlotStore::makeRoom(std::uint32_t pages) {
  for (std::uint32_t first = 0; first < pages; first += arena_pages_) {
    if (first / arena_pages_ == arenas_.size()) arenas_.emplace_back();
    Arena& arena = arenas_[first / arena_pages_];
    const std::uint32_t wanted = std::min(pages - first, arena_pages_);
    if (wanted <= arena.pages) continue;
    Arena larger;
    larger.pages = std::clamp(arena.pages + arena.pages / 4, wanted, arena_pages_);
    const std::size_t slots = std::size_t{larger.pages} * SlotPage::kSlots;
    larger.slots = grown(arena.slots, slots * kSlotBytes);
    for (int band = 1; band <= sh_degree_; ++band) {
      larger.bands[band] = grown(arena.bands[band], slots * bandBytes(band));
    }
    arena = std::move(larger);
  }
}

void SlotStore::apply(const GaussianEdit& edit, double now) {
  ++edits_;
  if (edit.clear) {
    arenas_.clear();
    held_.clear();
    sh_degree_ = 0;
    capacity_ = 0;
  }
  capacity_ = std::max(capacity_, edit.capacity);
  pages_.apply(edit);
  addBands(edit.sh_degree);
  makeRoom(static_cast<std::uint32_t>(pages_.pages().size()));
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
  for (int band = 1; band <= sh_degree_; ++band) {
    gl::Buffer& target = piece.arena->bands[band];
    const std::size_t offset = piece.first * bandBytes(band);
    const std::size_t bytes = piece.count * bandBytes(band);
    if (band <= edit.sh_degree) {
      target.write(offset, &edit.bands[band][kBandWords[band] * piece.source], bytes);
    } else {
      writeZeros(target, offset, bytes);
    }
  }
}

GaussianEdit SlotStore::edit(const SlotPage& page) const {
  const Place place = placeOf(page);
  const Arena& arena = arenas_[place.arena];
  const auto read = [&](const gl::Buffer& from, std::size_t words) {
    std::vector<std::uint32_t> values(SlotPage::kSlots * words);
    from.read(place.page * values.size() * kWord, values.data(), values.size() * kWord);
    return values;
  };
  std::array<std::vector<std::uint32_t>, kMaxShDegree + 1> bands;
  for (int band = 1; band <= sh_degree_; ++band) {
    bands[band] = read(arena.bands[band], static_cast<std::size_t>(kBandWords[band]));
  }
  return editOf(pages_.groupOf(page), page.first_slot, read(arena.slots, kSlotWords),
                std::move(bands), sh_degree_);
}

std::size_t SlotStore::bytes() const {
  std::size_t bytes = 0;
  for (const Arena& arena : arenas_) {
    bytes += arena.slots.bytes();
    for (const gl::Buffer& band : arena.bands) bytes += band.bytes();
  }
  return bytes;
}

}  // namespace rosplat
