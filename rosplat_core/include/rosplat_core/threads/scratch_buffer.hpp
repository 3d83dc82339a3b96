#pragma once

#include <cstddef>
#include <memory>

namespace rosplat {

// Working memory of a thread. Growing loses the values; new memory is uninitialised.
template <typename T>
class ScratchBuffer {
 public:
  T* reserve(std::size_t size) {
    if (size > size_) {
      memory_.reset();
      size_ = 0;
      memory_.reset(new T[size + size / 4]);
      size_ = size + size / 4;
    }
    return memory_.get();
  }
  // The same, but shrinks the memory if less than a quarter of it is needed.
  T* fit(std::size_t size) {
    if (size < size_ / 4) {
      memory_.reset();
      size_ = 0;
    }
    return reserve(size);
  }
  T* get() const { return memory_.get(); }
  T& operator[](std::size_t i) const { return memory_[i]; }
  std::size_t bytes() const { return size_ * sizeof(T); }

 private:
  std::unique_ptr<T[]> memory_;
  std::size_t size_ = 0;
};

}  // namespace rosplat
