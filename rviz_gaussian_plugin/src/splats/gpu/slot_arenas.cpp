#include "gpu/slot_arenas.hpp"

#include <algorithm>

namespace rosplat {

namespace {

constexpr std::size_t kMostArenaPages = 2048;  // 72 MiB of slots
// In the card's memory from the first: NVIDIA's driver (580) has what is GL_DYNAMIC_DRAW in the
// processor's for some pictures.
constexpr GLenum kUsage = GL_DYNAMIC_COPY;

// A buffer of a size, which begins with what was in another.
gl::Buffer grown(const gl::Buffer& buffer, std::size_t bytes) {
  gl::Buffer larger(bytes, kUsage);
  if (!buffer.id()) return larger;
  larger.copy(buffer, 0, buffer.bytes());
  // NVIDIA's driver (580) clears memory that another program had, and sometimes after the copy.
  glFinish();
  return larger;
}

std::size_t slotsOf(const SlotArenas::Arena& arena) {
  return std::size_t{arena.pages} * SlotPage::kSlots;
}

}  // namespace

void writeZeros(gl::Buffer& buffer, std::size_t offset, std::size_t bytes) {
  const std::vector<std::uint8_t> zeros(bytes);
  buffer.write(offset, zeros.data(), bytes);
}

SlotArenas::SlotArenas() {
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
      writeZeros(arena.bands[band], 0, arena.bands[band].bytes());
    }
  }
  sh_degree_ = std::max(sh_degree_, degree);
}

void SlotArenas::addChannels(std::size_t count) {
  for (Arena& arena : arenas_) {
    const std::vector<float> none(count > channels_ ? slotsOf(arena) : 0, kNoValue);
    for (std::size_t channel = channels_; channel < count; ++channel) {
      arena.channels[channel] = gl::Buffer(none.size() * sizeof(float), kUsage);
      arena.channels[channel].write(0, none.data(), arena.channels[channel].bytes());
    }
  }
  channels_ = std::max(channels_, count);
}

void SlotArenas::addLevels() {
  levels_ = true;
  for (Arena& arena : arenas_) {
    if (arena.levels.id()) continue;
    const std::vector<std::uint8_t> none(slotsOf(arena), 0xff);
    arena.levels = gl::Buffer(none.size(), kUsage);
    arena.levels.write(0, none.data(), none.size());
  }
}

void SlotArenas::dropLevels() {
  levels_ = false;
  for (Arena& arena : arenas_) arena.levels.release();
}

// The last arena grows by a quarter at least, so that what is copied stays in proportion.
void SlotArenas::makeRoom(std::uint32_t pages) {
  for (std::uint32_t first = 0; first < pages; first += arenaPages()) {
    if (placeOf(first).arena == arenas_.size()) arenas_.emplace_back();
    Arena& arena = arenas_[placeOf(first).arena];
    const std::uint32_t wanted = std::min(pages - first, arenaPages());
    if (wanted <= arena.pages) continue;
    Arena larger;
    larger.pages = std::clamp(arena.pages + arena.pages / 4, wanted, arenaPages());
    const std::size_t slots = slotsOf(larger);
    larger.slots = grown(arena.slots, slots * kSlotBytes);
    for (int band = 1; band <= sh_degree_; ++band) {
      larger.bands[band] = grown(arena.bands[band], slots * bandBytes(band));
    }
    for (std::size_t channel = 0; channel < channels_; ++channel) {
      larger.channels[channel] = grown(arena.channels[channel], slots * sizeof(float));
    }
    if (levels_) larger.levels = grown(arena.levels, slots);
    arena = std::move(larger);
  }
}

std::size_t SlotArenas::bytes() const {
  std::size_t bytes = 0;
  for (const Arena& arena : arenas_) {
    bytes += arena.slots.bytes() + arena.levels.bytes();
    for (const gl::Buffer& band : arena.bands) bytes += band.bytes();
    for (const gl::Buffer& channel : arena.channels) bytes += channel.bytes();
  }
  return bytes;
}

}  // namespace rosplat
