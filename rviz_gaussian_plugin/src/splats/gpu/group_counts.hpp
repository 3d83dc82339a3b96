#pragma once

#include <cstddef>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// Counts of groups, which later shaders sum up as they need it (splat_counts.glsl).
class GroupCounts {
 public:
  // Begins new counts, of so many groups.
  void begin(std::size_t groups) {
    if (groups > kSpan * spans_) {
      const std::size_t spans = ceilDiv(withSlack(groups), kSpan);
      spans_ = 0;  // stays so if memory is lacking
      words_.reserve((2 + kSpan) * spans * sizeof(GLuint));
      words_.zero(0, 2 * spans * sizeof(GLuint));
      spans_ = spans;
    }
    odd_ = !odd_;
  }

  // Binds the counts to a program, which is in use.
  void bind(const gl::Program& program) const {
    program.bind("Counts", words_);
    program.set("spans", static_cast<GLuint>(spans_));
    program.set("first_span", static_cast<GLuint>(odd_ ? spans_ : 0));
  }

  std::size_t bytes() const { return words_.bytes(); }

 private:
  static constexpr std::size_t kSpan = 256;  // groups, as in splat_counts.glsl

  gl::Buffer words_;
  std::size_t spans_ = 0;  // there is room for
  bool odd_ = false;       // which spans are those of the present counts
};

}  // namespace rosplat
