#pragma once

#include <malloc.h>

namespace rosplat {

// Returns freed memory to the system: glibc keeps, for each thread, freed memory that lies below
// memory still in use. Takes 20 ms for 300 MB.
inline void returnFreedMemory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace rosplat
