#pragma once

#include <algorithm>
#include <cstddef>

#include "gl/gl_objects.hpp"

namespace rosplat {

constexpr GLuint ceilDiv(std::size_t a, std::size_t b) {
  return static_cast<GLuint>((a + b - 1) / b);
}

// Returns the room to make for a count that may be larger in the next frame, and grows by a factor.
constexpr std::size_t withSlack(std::size_t count, double growth = 1) {
  return static_cast<std::size_t>(growth * static_cast<double>(count + count / 8));
}

// Tracks how much of a room is used: the room grows at once, but shrinks only after kPatience uses.
class UsageTracker {
 public:
  // Notes a use. Returns true if, for kPatience uses, less than a quarter of the room was needed.
  bool wastes(std::size_t needed) {
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

// A count that a shader finds, with the sizes of the dispatches that process it, so that these need
// not wait for the CPU. splat_common.glsl has the same.
class Tally {
 public:
  static constexpr std::size_t kBlock = 4096;
  static constexpr std::size_t kBytes = 8 * sizeof(GLuint);
  static constexpr std::size_t kWanted = 1;  // word: what the count would be with room for all

  // words: of kBytes; get a count of 0.
  explicit Tally(const gl::Slice& words) : words_(words) { set(0); }

  // Sets a count that the CPU knows.
  void set(std::size_t count);
  // Tells that a shader will set another count.
  void forget();

  const gl::Slice& words() const { return words_; }  // for a shader to bind
  // Run the compute program in use, a work group for each 256, or each kBlock, of the count.
  void dispatchGroups() const;
  void dispatchBlocks() const;

 private:
  void dispatch(std::size_t word) const;

  gl::Slice words_;
  bool known_ = false;
  std::size_t count_ = 0;
};

// The counts of a view, side by side, so that one copy brings all of them to the CPU.
class Tallies {
 public:
  enum Of : std::size_t {
    kVisible,
    kMacroPairs,
    kLists,  // pairs of a splat and a tile, then segments; as tile_touch.comp has them
    kSlotWords,
    kOrder,
    kDepthRange,
    kZero,
    kCount
  };

  Tallies() : words_(kCount * gl::Slice::kAlignment, GL_DYNAMIC_COPY), copy_(kCount * kStride) {}

  gl::Slice of(Of what) const { return {words_.id(), what * gl::Slice::kAlignment, Tally::kBytes}; }
  void ask() { copy_.ask(words_); }
  // Waits for the copy of the last ask(), and returns a word of a count.
  GLuint wait(Of what, std::size_t word) const { return copy_.wait()[what * kStride + word]; }

 private:
  static constexpr std::size_t kStride = gl::Slice::kAlignment / sizeof(GLuint);

  gl::Buffer words_;
  gl::Readback copy_;
};

}  // namespace rosplat
