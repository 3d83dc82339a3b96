#pragma once

#include <algorithm>
#include <cstddef>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/readback.hpp"

namespace rosplat {

constexpr GLuint ceilDiv(std::size_t a, std::size_t b) {
  return static_cast<GLuint>((a + b - 1) / b);
}

// Returns the room to make for a count that may be larger in the next frame, and grows by a factor.
constexpr std::size_t withSlack(std::size_t count, double growth = 1) {
  return static_cast<std::size_t>(growth * static_cast<double>(count + count / 8));
}

// Returns for how many to dispatch work groups if there were `count` in the last frame. These share
// what there is. So if it is much more than before, the frame takes longer, but lacks nothing.
constexpr std::size_t likely(std::size_t count, std::size_t room) {
  return std::min(std::max(withSlack(count), room / 8), room);
}

// Tracks how much of a room is used: the room grows at once, but shrinks only after kPatience uses.
class UsageTracker {
 public:
  // Notes a use. Returns true if, for kPatience uses, less than a quarter of the room was needed.
  bool noteUse(std::size_t needed) {
    size_ = std::max(size_, needed);
    most_ = std::max(most_, needed);
    if (++uses_ < kPatience) return false;
    const bool wasted = most_ < size_ / 4;
    if (wasted) size_ = most_;
    uses_ = 0;
    most_ = 0;
    return wasted;
  }

 private:
  static constexpr int kPatience = 64;

  std::size_t size_ = 0, most_ = 0;
  int uses_ = 0;
};

// The counts of a view that shaders find, side by side, so that one shader reports all of them to
// the CPU. Each begins with a count; splat_common.glsl has Tally and SeenTally.
class Tallies {
 public:
  enum Of : std::size_t {
    kSeen,        // a SeenTally
    kMacroPairs,  // a Tally, and as the nearest key of a SeenTally 0
    kLists,       // pairs of a splat and a tile, then segments; as macro_count.comp has them
    kOrder,
    kCount
  };
  // Words of a Tally and a SeenTally.
  static constexpr std::size_t kNumber = 0, kWanted = 1, kNearest = 2, kFarthest = 3;

  Tallies() : words_(kCount * gl::Slice::kAlignment, GL_DYNAMIC_COPY), report_(kCount * kStride) {
    gl::settle();
    words_.zero();
  }

  gl::Slice of(Of what) const { return {words_.id(), what * gl::Slice::kAlignment, kBytes}; }
  // Lets a program report them, as tile_list.comp does. Call reported() after its dispatch.
  void bind(const gl::Program& program) const {
    program.bind("Tallies", words_);
    program.bind("Report", report_.slice());
  }
  void reported() { report_.written(); }
  // Waits for the last report, and returns a word of a count.
  GLuint wait(Of what, std::size_t word) const { return report_.wait()[what * kStride + word]; }

 private:
  static constexpr std::size_t kStride = gl::Slice::kAlignment / sizeof(GLuint);
  static constexpr std::size_t kBytes = 6 * sizeof(GLuint);
  static_assert(kCount * kStride == 256);  // as tile_list.comp has it

  gl::Buffer words_;
  gl::Readback report_;
};

}  // namespace rosplat
