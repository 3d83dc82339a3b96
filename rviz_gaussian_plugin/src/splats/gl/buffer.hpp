#pragma once

#include <epoxy/gl.h>

#include <cstddef>
#include <vector>

#include "gl/object.hpp"

namespace rosplat::gl {

// A buffer object with immutable size.
class Buffer {
 public:
  Buffer() = default;
  // Callers call settle() before they write. Throws Error if the driver has no memory.
  Buffer(std::size_t bytes, GLenum usage);

  GLuint id() const { return object_.id(); }
  std::size_t bytes() const { return bytes_; }
  void write(std::size_t offset, const void* data, std::size_t bytes);
  // Waits for the graphics card.
  void read(std::size_t offset, void* data, std::size_t bytes) const;
  void zero() { zero(0, bytes_); }
  void zero(std::size_t offset, std::size_t bytes);  // whole words
  // Copies `bytes` bytes of another buffer, from `offset` on, to the byte `to` of this one.
  void copy(const Buffer& from, std::size_t offset, std::size_t bytes, std::size_t to = 0);
  // Makes room for so many bytes, and if it grows for some more: growing waits for the graphics
  // card. The content is lost if the buffer grows.
  void reserve(std::size_t bytes, std::size_t more = 0);
  // Frees the memory.
  void release();
  // Makes room for the values and writes them to the start of the buffer.
  template <typename Value>
  void upload(const std::vector<Value>& values) {
    const std::size_t bytes = values.size() * sizeof(Value);
    reserve(bytes, bytes / 8);
    write(0, values.data(), bytes);
  }

 private:
  Object object_;
  std::size_t bytes_ = 0;
};

// Waits until the driver has finished making new buffers.
void settle();

// The largest buffer that a shader can read. [bytes]
std::size_t largestStorageBuffer();

// A part of a buffer for a shader to bind.
struct Slice {
  static constexpr std::size_t kAlignment = 256;  // of `offset`, for every driver [bytes]

  GLuint buffer = 0;
  std::size_t offset = 0, bytes = 0;

  void write(const void* data, std::size_t size) const;
};

}  // namespace rosplat::gl
