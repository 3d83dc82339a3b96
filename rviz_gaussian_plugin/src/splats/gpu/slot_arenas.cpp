#include "gpu/slot_arenas.hpp"

#include <algorithm>
#include <utility>

namespace rosplat {

namespace {

// 36 MiB of slots: to make room, one arena is copied at most.
constexpr std::size_t kMostArenaPages = 1024;
// Keeps buffers in the card's memory from the start: NVIDIA's driver (580) keeps GL_DYNAMIC_DRAW
// buffers in the processor's memory for some pictures.
constexpr GLenum kUsage = GL_DYNAMIC_COPY;

std::size_t slotsOf(const SlotArenas::Arena& arena) {
  return std::size_t{arena.pages} * SlotPage::kSlots;
}

}  // namespace

SlotArenas::SlotArenas(gl::UploadRing& ring) : ring_(&ring) {
  const std::size_t pages =
      std::min(gl::largestStorageBuffer() / (SlotPage::kSlots * kSlotBytes), kMostArenaPages);
  while (2u << arena_bits_ <= pages) ++arena_bits_;
}

void SlotArenas::clear() {
  arenas_.clear();
  sh_degree_ = 0;
  channels_ = 0;
  levels_ = false;
}

void SlotArenas::addBands(int degree) {
  for (Arena& arena : arenas_) {
    for (int band = sh_degree_ + 1; band <= degree; ++band) {
      arena.bands[band] = gl::Buffer(slotsOf(arena) * bandBytes(band), kUsage);
      gl::settle();
      arena.bands[band].zero();
    }
  }
  sh_degree_ = std::max(sh_degree_, degree);
}

void SlotArenas::addChannels(std::size_t count) {
  for (Arena& arena : arenas_) {
    for (std::size_t channel = channels_; channel < count; ++channel) {
      arena.channels[channel] = gl::Buffer(slotsOf(arena) * sizeof(float), kUsage);
      gl::settle();
      ring_->fill(arena.channels[channel], kNoValue);
    }
  }
  channels_ = std::max(channels_, count);
}

void SlotArenas::addLevels() {
  levels_ = true;
  for (Arena& arena : arenas_) {
    if (arena.levels.id()) continue;
    arena.levels = gl::Buffer(slotsOf(arena), kUsage);
    gl::settle();
    ring_->fill(arena.levels, std::uint8_t{0xff});
  }
}

void SlotArenas::dropLevels() {
  levels_ = false;
  // A slot of Qt may call this with another context current: see gl::Object.
  for (Arena& arena : arenas_) arena.levels = gl::Buffer();
}

// The last arena grows by a quarter at least, so that copies stay in proportion to its size.
void SlotArenas::makeRoom(std::uint32_t pages) {
  for (std::uint32_t first = 0; first < pages; first += arenaPages()) {
    if (placeOf(first).arena == arenas_.size()) arenas_.emplace_back();
    Arena& arena = arenas_[placeOf(first).arena];
    const std::uint32_t wanted = std::min(pages - first, arenaPages());
    if (wanted <= arena.pages) continue;
    Arena larger;
    larger.pages = std::clamp(arena.pages + arena.pages / 4, wanted, arenaPages());
    std::vector<std::pair<const gl::Buffer*, gl::Buffer*>> buffers;
    const auto grow = [&](const gl::Buffer& from, gl::Buffer& to, std::size_t of_slot) {
      to = gl::Buffer(slotsOf(larger) * of_slot, kUsage);
      buffers.emplace_back(&from, &to);
    };
    grow(arena.slots, larger.slots, kSlotBytes);
    for (std::size_t band = 1; band <= std::size_t(sh_degree_); ++band) {
      grow(arena.bands[band], larger.bands[band], bandBytes(int(band)));
    }
    for (std::size_t channel = 0; channel < channels_; ++channel) {
      grow(arena.channels[channel], larger.channels[channel], sizeof(float));
    }
    if (levels_) grow(arena.levels, larger.levels, 1);
    gl::settle();
    for (const auto& [from, to] : buffers) {
      if (from->id()) to->copy(*from, 0, from->bytes());
    }
    arena = std::move(larger);
  }
}

std::size_t SlotArenas::bytes() const {
  std::size_t bytes = 0;
  for (const Arena& arena : arenas_) {
    bytes += arena.levels.bytes();
    forEachArray([&bytes](std::size_t, const gl::Buffer& held) { bytes += held.bytes(); }, arena);
  }
  return bytes;
}

}  // namespace rosplat
