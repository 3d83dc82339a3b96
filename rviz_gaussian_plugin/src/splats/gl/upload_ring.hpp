#pragma once

#include <epoxy/gl.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>

#include "gl/buffer.hpp"
#include "gl/object.hpp"

namespace rosplat::gl {

// Writes to buffers without waiting for the graphics card: data are written once, to memory that
// the card reads, and the card copies them to their buffers in the order of all other commands. A
// part of that memory is written again once the card is through with it. (NVIDIA's driver, 580,
// lost writes by glBufferSubData that followed each other without a glFinish.)
class UploadRing {
 public:
  static constexpr std::size_t kLeastBytes = 512u << 10, kMostBytes = 32u << 20;

  UploadRing() = default;
  UploadRing(const UploadRing&) = delete;
  UploadRing& operator=(const UploadRing&) = delete;

  // Writes `count` items, each of `width` values, to a buffer, from its first-th item on.
  // fill(values, from, n) writes n of the items, from number `from` of 0 to count - 1 on, to memory
  // that is slow to read. Throws Error if the driver has no memory left, or doesn't answer.
  template <typename Value, typename Fill>
  void write(const Buffer& to, std::size_t first, std::size_t count, std::size_t width,
             const Fill& fill) {
    const std::size_t bytes = width * sizeof(Value);
    inChunks<Value>(count, width, fill, [&](std::size_t done, std::size_t n) {
      copy(to, (first + done) * bytes, n * bytes);
    });
  }
  // The same for items that lie in memory.
  template <typename Value>
  void write(const Buffer& to, std::size_t first, std::size_t count, std::size_t width,
             const Value* items) {
    write<Value>(to, first, count, width, [&](Value* values, std::size_t from, std::size_t n) {
      std::memcpy(values, items + from * width, n * width * sizeof(Value));
    });
  }
  // Lets a shader read `count` items, each of `width` values, that fill() writes as above. Calls
  // read(from, first, n) for n items at a time, which begin at the first-th value of `from`. Every
  // driver lets a shader read a slice as large as `from`.
  template <typename Value, typename Fill, typename Read>
  void readByShader(std::size_t count, std::size_t width, const Fill& fill, const Read& read) {
    inChunks<Value>(count, width, fill, [&](std::size_t, std::size_t n) {
      read(Slice{part_.buffer.id(), 0, part_.bytes}, used_ / sizeof(Value), n);
      markInUse(n * width * sizeof(Value));
    });
  }
  // Writes one value everywhere.
  template <typename Value>
  void fill(const Buffer& to, Value value) {
    write<Value>(
        to, 0, to.bytes() / sizeof(Value), 1,
        [value](Value* values, std::size_t, std::size_t n) { std::fill_n(values, n, value); });
  }

  // Call close() after writing, and await() before commands that read what was written, maybe in
  // another context. Only the graphics card waits.
  void close();
  void await() const;

  std::size_t bytes() const { return bytes_; }

 private:
  struct MappedBuffer {
    Object buffer;
    std::size_t bytes = 0;
    std::uint8_t* memory = nullptr;
    GLsync read = nullptr;  // of the card's last read; the destructor leaves it to its context
  };

  // Calls fill(), then take(done, n), for some items at a time. done: number of items taken before.
  template <typename Value, typename Fill, typename Take>
  void inChunks(std::size_t count, std::size_t width, const Fill& fill, const Take& take) {
    const std::size_t bytes = width * sizeof(Value);
    for (std::size_t done = 0, n; done < count; done += n) {
      void* const memory = room(bytes);
      n = std::min(count - done, (part_.bytes - used_) / bytes);
      fill(static_cast<Value*>(memory), done, n);
      take(done, n);
    }
  }
  MappedBuffer makePart();
  // Returns memory for at least so many bytes.
  void* room(std::size_t bytes);
  // Submits a copy of what was written to room().
  void copy(const Buffer& to, std::size_t offset, std::size_t bytes);
  // Marks what was written to room() as in use: not written again before the card is through.
  void markInUse(std::size_t bytes);

  MappedBuffer part_;              // the part that is written to
  std::size_t used_ = 0;           // bytes of `part_` in use
  std::size_t bytes_ = 0;          // of all parts
  std::deque<MappedBuffer> busy_;  // parts that the card may still read, oldest first
  GLsync closed_ = nullptr;
};

}  // namespace rosplat::gl
