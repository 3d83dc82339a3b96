#pragma once

#include <atomic>
#include <cstdlib>
#include <new>

// Memory that runs out, for the one file of a test that includes this.
namespace failing_memory {

// How many allocations succeed yet, and how many fail then; of threads that aren't spared.
inline std::atomic<int> left{0}, failures{0};
inline thread_local bool spared = false;

inline void* allocate(std::size_t size, std::size_t alignment = 0) {
  if (!spared && failures > 0 && left-- <= 0) {
    if (failures-- > 0) throw std::bad_alloc();
    ++failures;
  }
  void* const memory =
      alignment == 0
          ? std::malloc(size)
          : std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
  if (memory) return memory;
  throw std::bad_alloc();
}

}  // namespace failing_memory

void* operator new(std::size_t size) { return failing_memory::allocate(size); }
void* operator new(std::size_t size, std::align_val_t alignment) {
  return failing_memory::allocate(size, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t, std::align_val_t) noexcept { std::free(memory); }
