#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

namespace rosplat {

// How many values the spherical harmonics of a splat are, band 0 among them.
constexpr std::size_t harmonicsOf(int sh_degree) {
  return 3u * (sh_degree + 1u) * (sh_degree + 1u);
}

// Splats in arrays as GaussianArray has them, owned by someone else. Float: float or const float.
template <typename Float>
struct SplatArrays {
  std::size_t count = 0;
  int sh_degree = 0;
  Float* positions = nullptr;     // 3 a splat, x y z [m]
  Float* orientations = nullptr;  // 4 a splat, quaternion x y z w
  Float* scales = nullptr;        // 3 a splat, standard deviations [m]
  Float* opacities = nullptr;     // 1 a splat
  Float* sh = nullptr;            // 3 (sh_degree + 1)^2 a splat

  std::size_t shStride() const { return harmonicsOf(sh_degree); }
};

inline bool allFinite(const float* values, std::size_t count) {
  // A sum of zero times each value is NaN as soon as one value is not finite; it vectorises.
  float sum = 0.0f;
  for (std::size_t i = 0; i < count; ++i) sum += 0.0f * values[i];
  return sum == 0.0f;
}

// Whether a splat's values are valid; holders of a map leave out a splat whose values aren't.
// position: as the map keeps it, relative to its group's origin.
template <typename Float>
bool isUsable(const SplatArrays<Float>& splats, std::size_t i, const float* position) {
  const float* const q = splats.orientations + 4 * i;
  const float* const scale = splats.scales + 3 * i;
  const bool turned = q[0] != 0.0f || q[1] != 0.0f || q[2] != 0.0f || q[3] != 0.0f;
  return allFinite(position, 3) && allFinite(scale, 3) && allFinite(q, 4) && turned &&
         scale[0] >= 0.0f && scale[1] >= 0.0f && scale[2] >= 0.0f &&
         std::isfinite(splats.opacities[i]) &&
         allFinite(splats.sh + splats.shStride() * i, splats.shStride());
}

// Whether a text may name a channel: printable ASCII without spaces.
inline bool isChannelName(const std::string& text) {
  constexpr std::size_t kLongest = 64;
  return !text.empty() && text.size() <= kLongest &&
         std::all_of(text.begin(), text.end(), [](char c) { return c >= '!' && c <= '~'; });
}

}  // namespace rosplat
