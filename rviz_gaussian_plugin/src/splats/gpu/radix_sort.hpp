#pragma once

#include <cstddef>

#include "gl/gl_objects.hpp"
#include "gl/shaders.hpp"
#include "gpu/group_sums.hpp"
#include "gpu/tally.hpp"

namespace rosplat {

// How many bits a number takes.
constexpr int bitsOf(std::size_t value) { return value ? 1 + bitsOf(value >> 1) : 0; }

// A stable radix sort of uint32 keys with uint32 values on the GPU, the least first. Keys are
// written to keys(), which is whoever's turn it is. Values end in a buffer from outside, which all
// passes use.
class RadixSort {
 public:
  // The shaders must outlive it.
  explicit RadixSort(Shaders& shaders);

  // Sorts some keys and compares with what the CPU makes of them; where work groups don't wait for
  // each other, or lanes don't vote, as the driver says, from then on without that. False where
  // nothing helps. What is in the buffers is lost.
  bool check();
  // Whether check() gave up what the driver says that it can.
  bool lostBallots() const { return lost_ballots_; }

  // Makes room for so many, which may be less than there is if that is much more than anybody has
  // asked for of late; what was in the buffers may be lost.
  void reserve(std::size_t count);

  const gl::Buffer& keys() const { return keys_; }
  // Where values are to be written that sort() is to leave in another buffer, which it may be.
  const gl::Buffer& values(int bits, const gl::Buffer& sorted) const {
    return passes(bits) % 2 == 0 ? sorted : values_;
  }
  // Free while nothing is sorted; the second one only where no values are in it.
  const gl::Buffer& spareKeys() const { return next_keys_; }
  const gl::Buffer& spareValues() const { return values_; }

  // Sorts by the lowest `bits` bits, one at least, of the keys' distances from the first word of
  // `least`: keys() in place, values() to another buffer.
  void sort(const Tally& count, const gl::Slice& least, int bits, const gl::Buffer& sorted);
  // Writes where the keys were before, in their new order, to another buffer; keys are used up.
  void order(const Tally& count, const gl::Slice& least, int bits, const gl::Buffer& places);

  std::size_t bytes() const;

  static constexpr int kDigitBits = 8;

 private:
  static int passes(int bits) { return (bits + kDigitBits - 1) / kDigitBits; }

  // are_places: the values are 0, 1, 2..., and nobody needs the keys any more.
  void run(const Tally& count, const gl::Slice& least, int bits, const gl::Buffer& sorted,
           bool are_places);

  bool sortsInSomeWarps();
  bool sortsRight();

  Shaders& shaders_;
  bool lost_ballots_ = false;
  const gl::Program& count_;
  const gl::Program* scatter_;
  gl::Buffer keys_, next_keys_, values_;
  gl::Buffer totals_, next_totals_;  // how many keys have a digit; those of the next sort are 0
  GroupSums sums_;
  UsageTracker room_;
};

}  // namespace rosplat
