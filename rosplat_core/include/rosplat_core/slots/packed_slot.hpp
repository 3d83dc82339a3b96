#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "rosplat_core/slots/splat_arrays.hpp"

namespace rosplat {

constexpr int kMaxShDegree = 3;

// A slot as the GPU holds it, 36 bytes and 4 for each further coefficient of spherical harmonics:
//   position   3 x float32 [m]
//   opacity    16 bits, linear                  scale    3 x 16 bits, logarithmic: 0.03 % apart
//   rotation   48 bits: the three smallest components of the quaternion, and which is missing
//   colour     3 x float16, band 0              change   16 bits: when the slot last changed
//   sh         11, 11 and 10 bits for R, G, B, as fractions of the slot's largest coefficient
// splat_slot.glsl reads it.
constexpr int kSlotWords = 9;
constexpr int kChangeWord = 8;                                       // its upper half
constexpr std::array<int, kMaxShDegree + 1> kBandWords{0, 3, 5, 7};  // beside the slot, by band
constexpr double kTicksPerSecond = 4;                                // of `change`, modulo 2^16

// Words of a row: a slot with its further bands behind it.
inline constexpr int rowWords(int sh_degree) {
  return kSlotWords + (sh_degree + 1) * (sh_degree + 1) - 1;
}
// A row without the position, for memory in which that lies apart (HostSlots).
constexpr int kFirstAppearanceWord = 3;
inline constexpr int appearanceWords(int sh_degree) {
  return rowWords(sh_degree) - kFirstAppearanceWord;
}
// Where a band, from 1 on, begins in it.
inline constexpr int appearanceBand(int band) { return appearanceWords(band - 1); }
// Pointers to the bands in a row, by band; null for band 0, which the slot holds.
template <typename Word>
std::array<Word*, kMaxShDegree + 1> bandsOf(Word* row) {
  return {nullptr, row + kSlotWords, row + rowWords(1), row + rowWords(2)};
}

// What a slot holds, unpacked.
struct Splat {
  std::array<float, 3> position{};     // [m], relative to the group's origin
  std::array<float, 4> orientation{};  // quaternion x y z w of any length but zero
  std::array<float, 3> scale{};        // standard deviations [m]
  float opacity = 0;                   // 0 to 1
  std::array<float, 3> color{};        // band 0 of the spherical harmonics
};

// The i-th splat of arrays.
Splat splatAt(const SplatArrays<const float>& arrays, std::size_t i);

// A copy of a slot's words, for a node, or out of memory in which they lie apart (HostSlots).
struct PackedSlot {
  std::array<std::uint32_t, kSlotWords> words{};
  std::array<std::array<std::uint32_t, kBandWords.back()>, kMaxShDegree + 1> bands{};

  std::array<const std::uint32_t*, kMaxShDegree + 1> bandWords() const {
    return {bands[0].data(), bands[1].data(), bands[2].data(), bands[3].data()};
  }
};

// Radius of the ellipsoid on which alpha falls to 1/255 [m], -1 for a splat that never reaches
// that.
float extentOf(float opacity, float largest_scale);

// Packs a splat of finite values. sh: the coefficients of bands 1 to sh_degree, RGB interleaved;
// bands[b]: room for kBandWords[b] words, for 1 <= b <= sh_degree. A value beyond a field's range
// becomes the nearest in that range.
void packSlot(const Splat& splat, const float* sh, int sh_degree, std::uint32_t* slot,
              const std::array<std::uint32_t*, kMaxShDegree + 1>& bands);

// A splat as packSlot() kept it; the quaternion has unit length.
Splat unpackSlot(const std::uint32_t* slot);
// A part of unpackSlot() in less time.
float slotOpacity(const std::uint32_t* slot);
float largestScale(const std::uint32_t* slot);

// The coefficients of bands 1 to sh_degree, as packSlot() takes them.
// sh: room for harmonicsOf(sh_degree) - 3 floats.
void unpackHarmonics(const std::uint32_t* slot, int sh_degree,
                     const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands, float* sh);
std::vector<float> unpackHarmonics(const std::uint32_t* slot, int sh_degree,
                                   const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands);

}  // namespace rosplat
