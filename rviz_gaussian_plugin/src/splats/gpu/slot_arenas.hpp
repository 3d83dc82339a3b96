#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gl/buffer.hpp"
#include "gl/upload_ring.hpp"
#include "rosplat_core/map/slot_pages.hpp"

namespace rosplat {

// Memory of the GPU for pages of slots, by place, in arenas whose buffers are small enough for
// shaders. Growth copies only the last arena, until that is full.
class SlotArenas {
 public:
  struct Arena {
    gl::Buffer slots;                                // kSlotWords a slot
    std::array<gl::Buffer, kMaxShDegree + 1> bands;  // kBandWords a slot, from band 1 on
    gl::Buffer levels;                               // a byte a slot, if there are any
    std::array<gl::Buffer, kMostChannels> channels;  // a float a slot
    std::uint32_t pages = 0;                         // room for so many
  };
  // Where a page is.
  struct Place {
    std::uint32_t arena, page;
  };

  // ring: writes the first content of new buffers; must outlive this.
  explicit SlotArenas(gl::UploadRing& ring);

  void clear();
  // Make room for so many pages, for further bands, channels and levels. Throw gl::Error when the
  // driver has no memory left.
  void makeRoom(std::uint32_t pages);
  void addBands(int degree);            // of zeros
  void addChannels(std::size_t count);  // up to so many, of kNoValue
  // Adds a level for each slot, 255; frees the levels.
  void addLevels();
  void dropLevels();

  Place placeOf(std::uint32_t place) const {
    return {place >> arena_bits_, place & (arenaPages() - 1)};
  }
  const std::vector<Arena>& arenas() const { return arenas_; }
  Arena& operator[](std::uint32_t arena) { return arenas_[arena]; }
  int shDegree() const { return sh_degree_; }
  std::size_t channels() const { return channels_; }
  std::size_t bytes() const;

 private:
  std::uint32_t arenaPages() const { return 1u << arena_bits_; }

  gl::UploadRing* ring_;
  unsigned arena_bits_ = 0;  // how many bits of a place are the page's number in its arena
  std::vector<Arena> arenas_;
  int sh_degree_ = 0;
  std::size_t channels_ = 0;
  bool levels_ = false;
};

constexpr std::size_t kSlotBytes = kSlotWords * sizeof(std::uint32_t);
constexpr std::size_t bandBytes(int band) {
  return static_cast<std::size_t>(kBandWords[std::size_t(band)]) * sizeof(std::uint32_t);
}
}  // namespace rosplat
