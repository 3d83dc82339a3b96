#pragma once

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

// Fills arrays with the splats of a payload of size() bytes. The position of an invalid splat
// becomes NaN.
inline void decode(const std::uint8_t* payload, const SplatArrays<float>& splats) {
  std::uint32_t row[rowWords(kMaxShDegree)];
  const std::size_t bytes = size(1, splats.sh_degree);
  for (std::size_t i = 0; i < splats.count; ++i) {
    std::memcpy(row, payload + bytes * i, bytes);
    Splat splat = unpackSlot(row);
    if (!isUsable(row)) splat.position.fill(std::nanf(""));
    float* const sh = splats.sh + splats.shStride() * i;
    std::memcpy(splats.positions + 3 * i, splat.position.data(), sizeof(splat.position));
    std::memcpy(splats.orientations + 4 * i, splat.orientation.data(), sizeof(splat.orientation));
    std::memcpy(splats.scales + 3 * i, splat.scale.data(), sizeof(splat.scale));
    std::memcpy(sh, splat.color.data(), sizeof(splat.color));
    splats.opacities[i] = splat.opacity;
    unpackHarmonics(row, splats.sh_degree, bandsOf<const std::uint32_t>(row), sh + 3);
  }
}

}  // namespace rosplat::packed_rows
