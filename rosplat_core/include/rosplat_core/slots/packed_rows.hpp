#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "rosplat_core/slots/packed_slot.hpp"
#include "rosplat_core/slots/splat_arrays.hpp"

// GaussianArray.payload in the format that rosplat_msgs/doc/packed.md specifies: slots as displays
// hold them, each with its further bands behind it.
namespace rosplat::packed_rows {

constexpr const char* kFormat = "packed";

// Bytes of the payload of `count` splats.
inline std::size_t size(std::size_t count, int sh_degree) {
  return sizeof(std::uint32_t) * rowWords(sh_degree) * count;
}

// Whether a row is valid: its position and its four half-precision floats (the harmonics' unit and
// the colour) are finite. No other bits can be wrong.
inline bool isUsable(const std::uint32_t* row) {
  float position[3];
  std::memcpy(position, row, sizeof(position));
  const auto finite = [](std::uint32_t half) { return (~half & 0x7c00u) != 0; };
  return allFinite(position, 3) && finite(row[6] >> 16) && finite(row[7]) && finite(row[7] >> 16) &&
         finite(row[8]);
}

// Writes the splat of a row with bands up to sh_degree to the i-th place of arrays. Bands that only
// the arrays have become 0.
inline void unpack(const std::uint32_t* row, int sh_degree, const SplatArrays<float>& to,
                   std::size_t i) {
  const Splat splat = unpackSlot(row);
  std::copy_n(splat.position.begin(), 3, to.positions + 3 * i);
  std::copy_n(splat.orientation.begin(), 4, to.orientations + 4 * i);
  std::copy_n(splat.scale.begin(), 3, to.scales + 3 * i);
  to.opacities[i] = splat.opacity;
  float* const sh = to.sh + to.shStride() * i;
  std::copy_n(splat.color.begin(), 3, sh);
  const int known = std::min(sh_degree, to.sh_degree);
  unpackHarmonics(row, known, bandsOf(row), sh + 3);
  std::fill(sh + harmonicsOf(known), sh + to.shStride(), 0.0f);
}

// Fills arrays with the splats of a payload of size() bytes. The position of an invalid splat
// becomes NaN.
inline void decode(const std::uint8_t* payload, const SplatArrays<float>& splats) {
  std::uint32_t row[rowWords(kMaxShDegree)];
  const std::size_t bytes = size(1, splats.sh_degree);
  for (std::size_t i = 0; i < splats.count; ++i) {
    std::memcpy(row, payload + bytes * i, bytes);
    unpack(row, splats.sh_degree, splats, i);
    if (!isUsable(row)) std::fill_n(splats.positions + 3 * i, 3, std::nanf(""));
  }
}

}  // namespace rosplat::packed_rows
