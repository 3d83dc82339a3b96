#pragma once

#include <epoxy/gl.h>

#include <cstddef>

#include "gl/buffer.hpp"
#include "gl/object.hpp"

namespace rosplat::gl {

// Waits until a fence is passed. Throws Error if the graphics card doesn't answer for a minute.
void waitFor(GLsync fence);

// Words for the CPU, which waits for these alone: the graphics card goes on. Callers call settle()
// before the first write.
class Readback {
 public:
  explicit Readback(std::size_t words);

  // Submits a copy: of a buffer as the commands submitted so far leave it.
  void ask(const Buffer& buffer) { ask(buffer, 0, buffer.bytes()); }
  // The same of `bytes` bytes of it, from `offset` on, to the byte `to` of this.
  void ask(const Buffer& buffer, std::size_t offset, std::size_t bytes, std::size_t to = 0);
  // For a shader that writes the words: call written() after its dispatch.
  Slice slice() const { return {copy_.id(), 0, bytes_}; }
  void written();
  // Waits for the last ask() or written(), and returns the words. Throws as waitFor().
  const GLuint* wait() const;
  std::size_t bytes() const { return bytes_; }

 private:
  void renewFence();

  Object copy_;
  std::size_t bytes_;
  const GLuint* mapped_ = nullptr;
  GLsync copied_ = nullptr;  // the destructor leaves it to its context
};

}  // namespace rosplat::gl
