#include "radix_sort.hpp"

#include <utility>

namespace rosplat {

namespace {
constexpr std::size_t kDigits = 1u << RadixSort::kDigitBits;

std::size_t blocks(std::size_t count) { return (count + Tally::kBlock - 1) / Tally::kBlock; }
}  // namespace

void PrefixSum::reserve(std::size_t count) { sums_.reserve((blocks(count) + 1) * sizeof(GLuint)); }

void PrefixSum::run(const gl::Buffer& values, const Tally& count, const Tally& total,
                    std::size_t room) {
  sum_.use();
  sum_.set("room", static_cast<GLuint>(room));
  values.bind(0);
  sums_.bind(1);
  count.bind(2);
  total.bind(3);
  for (GLuint pass = 0; pass < 2; ++pass) {
    sum_.set("pass", pass);
    count.dispatchBlocks();
    gl::storageBarrier();
  }
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT);  // the total is work to dispatch
}

void RadixSort::reserve(std::size_t count) {
  for (gl::Buffer* buffer : {&keys_, &values_, &next_keys_, &next_values_}) {
    buffer->reserve(count * sizeof(GLuint));
  }
  counts_.reserve((blocks(count) + 1) * kDigits * sizeof(GLuint));
}

void RadixSort::pass(const Tally& count, const gl::Slice& least, int shift, bool first, bool last,
                     const gl::Buffer& sorted_values) {
  keys_.bind(0);
  values_.bind(1);
  next_keys_.bind(2);
  sorted_values.bind(3);
  counts_.bind(4);
  count.bind(5);
  least.bind(6);
  count_.use();
  count_.set("shift", static_cast<GLuint>(shift));
  count.dispatchBlocks();
  gl::storageBarrier();

  sum_.use();
  gl::dispatch(kDigits);
  gl::storageBarrier();

  scatter_.use();
  scatter_.set("shift", static_cast<GLuint>(shift));
  scatter_.set("first_pass", int(first));
  scatter_.set("last_pass", int(last));
  count.dispatchBlocks();
  gl::storageBarrier();
}

void RadixSort::sort(const Tally& count, const gl::Slice& least, int bits) {
  for (int shift = 0; shift < bits; shift += kDigitBits) {
    pass(count, least, shift, false, false, next_values_);
    std::swap(keys_, next_keys_);
    std::swap(values_, next_values_);
  }
}

void RadixSort::order(const Tally& count, const gl::Slice& least, int bits,
                      const gl::Buffer& places) {
  for (int shift = 0; shift < bits; shift += kDigitBits) {
    const bool last = shift + kDigitBits >= bits;
    pass(count, least, shift, shift == 0, last, last ? places : next_values_);
    std::swap(keys_, next_keys_);
    std::swap(values_, next_values_);
  }
}

std::size_t RadixSort::bytes() const {
  return keys_.bytes() + values_.bytes() + next_keys_.bytes() + next_values_.bytes() +
         counts_.bytes();
}

}  // namespace rosplat
