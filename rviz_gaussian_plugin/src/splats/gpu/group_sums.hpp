#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Runs dispatches whose work groups learn the sums of the groups before them (look_back.glsl).
class GroupSums {
 public:
  // The shaders must outlive it.
  explicit GroupSums(const Shaders& shaders) : shaders_(shaders) {}

  // Makes room for so many sums.
  void reserve(std::size_t count);
  void release() { words_.release(); }
  const gl::Buffer& words() const { return words_; }
  // Tells that a shader has cleared the sums.
  void cleared() { run_ = 0; }
  // Runs the program, which must be in use: a work group for each Tally::kBlock of `count`.
  void run(const gl::Program& program, const Tally& count);
  std::size_t bytes() const { return words_.bytes(); }

 private:
  const Shaders& shaders_;
  gl::Buffer words_;
  GLuint run_ = 0;
};

// Exclusive prefix sums on the GPU.
class PrefixSum {
 public:
  explicit PrefixSum(Shaders& shaders)
      : sum_(shaders.compute({"group_sum.glsl", "look_back.glsl", "prefix_sum.comp"})),
        sums_(shaders) {}

  // Makes room for so many values.
  void reserve(std::size_t count) { sums_.reserve(count / Tally::kBlock + 1); }
  // Sums up uint32 values in place: one for each `each` of `count`. Writes the sum of all to
  // `total`, whose count is at most `room`.
  void run(const gl::Buffer& values, const Tally& count, const Tally& total, std::size_t room,
           std::size_t each = 1);

  std::size_t bytes() const { return sums_.bytes(); }

 private:
  const gl::Program& sum_;
  GroupSums sums_;
};

}  // namespace rosplat
