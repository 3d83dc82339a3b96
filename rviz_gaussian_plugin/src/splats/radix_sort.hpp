#pragma once

#include <cstddef>

#include "gl_objects.hpp"
#include "shaders.hpp"

namespace rosplat {

// Exclusive prefix sums on the GPU.
class PrefixSum {
 public:
  explicit PrefixSum(const Shaders& shaders) : sum_(shaders.compute({"prefix_sum.comp"})) {}

  // Sums up the first count uint32 of a buffer in place; their total goes to total[index].
  void run(const gl::Buffer& values, std::size_t count, const gl::Buffer& total, std::size_t index);

  std::size_t bytes() const { return sums_.bytes(); }

 private:
  gl::Program sum_;
  gl::Buffer sums_;
};

// A stable radix sort of uint32 keys with uint32 values on the GPU, the least first.
class RadixSort {
 public:
  explicit RadixSort(const Shaders& shaders)
      : count_(shaders.compute({"radix_count.comp"})),
        scatter_(shaders.compute({"radix_scatter.comp"})),
        prefix_sum_(shaders) {}

  // Sorts by the lowest `bits` bits of the keys. Without values, they are the keys' places. Both
  // buffers hold the result, and may be others than before.
  void sort(gl::Buffer& keys, gl::Buffer& values, std::size_t count, int bits, bool has_values);

  std::size_t bytes() const;

 private:
  gl::Program count_, scatter_;
  PrefixSum prefix_sum_;
  gl::Buffer keys_, values_, counts_, total_;
};

}  // namespace rosplat
