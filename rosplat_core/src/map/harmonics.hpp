#pragma once

#include <algorithm>
#include <cstddef>

namespace rosplat {

// Values of a splat's harmonics.
inline std::size_t harmonicsOf(int sh_degree) { return 3u * (sh_degree + 1u) * (sh_degree + 1u); }

// A splat's harmonics of another degree: bands cut off, or zero bands added.
inline void copyHarmonics(const float* from, int from_degree, float* to, int to_degree) {
  const std::size_t have = harmonicsOf(std::min(from_degree, to_degree));
  std::copy_n(from, have, to);
  std::fill_n(to + have, harmonicsOf(to_degree) - have, 0.0f);
}

}  // namespace rosplat
