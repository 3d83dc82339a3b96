#pragma once

#include <cstddef>

namespace rosplat {

// How many values a splat's harmonics are.
inline std::size_t harmonicsOf(int sh_degree) { return 3u * (sh_degree + 1u) * (sh_degree + 1u); }

}  // namespace rosplat
