#pragma once

#include <algorithm>
#include <cstddef>

#include "gl/gl_objects.hpp"

namespace rosplat {

// Room to make for a number that may be larger in the next frame, and grows by a factor.
constexpr std::size_t withSlack(std::size_t count, double growth = 1) {
  return static_cast<std::size_t>(growth * static_cast<double>(count + count / 8));
}

// How much of a number's room is used: there is more at once, but less only after a while.
class UsageTracker {
 public:
  // Notes what is needed; true where for long not a quarter was of what there is.
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

// A number that shaders find, with the work that it makes for those that follow, so that none of it
// has to wait for the CPU. splat_common.glsl has the same.
class Tally {
 public:
  static constexpr std::size_t kBlock = 4096;
  static constexpr std::size_t kBytes = 12 * sizeof(GLuint);
  static constexpr std::size_t kWanted = 1;  // word: the number with room for all

  // In a slice of kBytes.
  explicit Tally(const gl::Slice& words) : words_(words) { set(0); }

  // Makes it a number that is known here.
  void set(std::size_t count);
  // A shader is to make it another one.
  void forget();

  const gl::Slice& words() const { return words_; }  // for a shader to bind
  // Runs the compute program in use for 256, or for kBlock, a work group.
  void dispatchGroups() const;
  void dispatchBlocks() const;
  // Draws triangle strips of four vertices.
  void drawQuads() const;

 private:
  void dispatch(std::size_t word) const;

  gl::Slice words_;
  bool known_ = false;
  std::size_t count_ = 0;
};

// What is counted for a view, side by side, so that one copy brings the CPU all of it.
class Tallies {
 public:
  enum Of : std::size_t { kVisible, kPairs, kSlotWords, kOrder, kDepthRange, kZero, kCount };

  Tallies() : words_(kCount * gl::Slice::kAlignment, GL_DYNAMIC_COPY), copy_(kCount * kStride) {}

  gl::Slice of(Of what) const { return {words_.id(), what * gl::Slice::kAlignment, Tally::kBytes}; }
  void ask() { copy_.ask(words_); }
  // Waits for what was asked for last: a word of it.
  GLuint wait(Of what, std::size_t word) const { return copy_.wait()[what * kStride + word]; }

 private:
  static constexpr std::size_t kStride = gl::Slice::kAlignment / sizeof(GLuint);

  gl::Buffer words_;
  gl::Readback copy_;
};

}  // namespace rosplat
