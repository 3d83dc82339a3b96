#pragma once

#include <cstddef>

#include "gl/buffer.hpp"
#include "gl/program.hpp"
#include "gl/shaders.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// How many bits a number takes.
constexpr int bitsOf(std::size_t value) { return value ? 1 + bitsOf(value >> 1) : 0; }

// A stable radix sort of uint32 keys with uint32 values on the GPU, the least first. Write the keys
// to keys(): two buffers take turns in that role. The values end in a buffer of the caller, which
// the passes write to in between, too.
class RadixSort {
 public:
  // The shaders must outlive it.
  explicit RadixSort(Shaders& shaders);

  // Sorts some keys and compares the result with the CPU's. If work groups can't wait for each
  // other, or lanes don't vote as the driver says, later sorts do without that. Returns false if
  // nothing helps. The buffers' content is lost.
  bool check();
  // Whether check() gave up the driver's subgroups.
  bool lostBallots() const { return lost_ballots_; }

  // Makes room to sort so many keys. Shrinks the buffers if recent calls asked for much less than
  // there is. The buffers' content may be lost.
  void reserve(std::size_t count);
  const gl::Buffer& keys() const { return keys_; }
  // Returns where to write the values that sort() shall leave in `sorted`; may be `sorted` itself.
  const gl::Buffer& values(int bits, const gl::Buffer& sorted) const {
    return passes(bits) % 2 == 0 ? sorted : values_;
  }
  // Free for other use between sorts.
  const gl::Buffer& spareKeys() const { return next_keys_; }

  // Writes the indices of the first `count` keys, but for those of kNone, to `places`, in the order
  // of the lowest `bits` bits, one at least, of the keys' distances from the nearest. seen: a
  // SeenTally: how many aren't kNone, and the nearest; expected: about how many. The keys are lost.
  void order(const gl::Slice& seen, std::size_t count, std::size_t expected, int bits,
             const gl::Buffer& places);
  // Sorts all keys() in place, and values() to `sorted`.
  void sort(const gl::Slice& seen, std::size_t expected, int bits, const gl::Buffer& sorted);

  std::size_t bytes() const;

  static constexpr int kDigitBits = 8;

 private:
  static int passes(int bits) { return (bits + kDigitBits - 1) / kDigitBits; }

  // count: 0: as `seen` has it; no key is kNone, and they have values.
  void run(const gl::Slice& seen, std::size_t count, std::size_t expected, int bits,
           const gl::Buffer& sorted);
  bool chooseWarps();
  bool sortAndCompare();

  Shaders& shaders_;
  bool lost_ballots_ = false;
  const gl::Program& count_;
  const gl::Program* scatter_;
  gl::Buffer keys_, next_keys_, values_;
  gl::Buffer totals_, next_totals_;  // how many keys have a digit; next_totals_ are 0 between sorts
  gl::Buffer sums_;                  // as radix_scatter.comp has them
  UsageTracker room_;
};

}  // namespace rosplat
