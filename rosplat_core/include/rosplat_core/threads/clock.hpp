#pragma once

#include <chrono>

namespace rosplat {

// The time of a clock that never jumps. [s]
inline double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace rosplat
