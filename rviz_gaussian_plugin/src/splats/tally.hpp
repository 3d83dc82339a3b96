#pragma once

#include <cstddef>

#include "gl_objects.hpp"

namespace rosplat {

// Room to make for a number that may be larger in the next frame.
constexpr std::size_t withSlack(std::size_t count) { return count + count / 8; }

// A number that shaders find, with the work that it makes for those that follow, so that none of it
// has to wait for the CPU. splat_common.glsl has the same.
class Tally {
 public:
  // Throws gl::Error where the driver has no memory.
  Tally();

  // Makes it a number that is known here.
  void set(std::size_t count);
  // A shader is to make it another one.
  void forget();

  void bind(GLuint storage_binding) const { words_.bind(storage_binding); }
  // Runs the compute program in use for 256, or for kBlock, a work group.
  void dispatchGroups() const;
  void dispatchBlocks() const;
  // Draws triangle strips of four vertices.
  void drawQuads() const;

  static constexpr std::size_t kBlock = 4096;
  static constexpr std::size_t kBytes = 12 * sizeof(GLuint);
  static constexpr std::size_t kWanted = 1;  // word: the number with room for all
  const gl::Buffer& words() const { return words_; }

 private:
  void dispatch(std::size_t word) const;

  gl::Buffer words_;
  std::size_t known_;
};

}  // namespace rosplat
