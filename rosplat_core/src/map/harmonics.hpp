#pragma once

#include <algorithm>
#include <cstddef>

namespace rosplat {

// How many values a splat's harmonics are.
inline std::size_t harmonicsOf(int sh_degree) { return 3u * (sh_degree + 1u) * (sh_degree + 1u); }

// Copies a splat's harmonics to another degree: cuts bands off, or adds zero bands.
inline void copyHarmonics(const float* from, int from_degree, float* to, int to_degree) {
  const std::size_t have = harmonicsOf(std::min(from_degree, to_degree));
  std::copy_n(from, have, to);
  std::fill_n(to + have, harmonicsOf(to_degree) - have, 0.0f);
}

}  // namespace rosplat
