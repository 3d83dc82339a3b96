#pragma once

#include <malloc.h>

namespace rosplat {

// Returns memory that was freed to the system: glibc keeps it for each thread, below what still is
// in use. Takes 20 ms for 300 MB.
inline void returnFreedMemory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace rosplat
