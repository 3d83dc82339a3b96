#include "radix_sort.hpp"

#include <utility>

namespace rosplat {

namespace {
constexpr std::size_t kSumBlock = 2048;  // as in prefix_sum.comp
constexpr std::size_t kDigits = 256;
constexpr std::size_t kSortBlock = 256 * Shaders::kKeysEach;
}  // namespace

void PrefixSum::run(const gl::Buffer& values, std::size_t count, const gl::Buffer& total,
                    std::size_t index) {
  const std::size_t blocks = (count + kSumBlock - 1) / kSumBlock;
  sums_.reserve((blocks + 1) * sizeof(GLuint));
  sum_.use();
  sum_.set("count", static_cast<GLuint>(count));
  sum_.set("total_index", static_cast<GLuint>(index));
  values.bind(0);
  sums_.bind(1);
  total.bind(2);
  for (GLuint pass = 0; pass < 3; ++pass) {
    sum_.set("pass", pass);
    gl::dispatch(pass == 1 ? 1 : blocks);
    gl::storageBarrier();
  }
}

void RadixSort::sort(gl::Buffer& keys, gl::Buffer& values, std::size_t count, int bits,
                     bool has_values) {
  const std::size_t blocks = (count + kSortBlock - 1) / kSortBlock;
  keys_.reserve(count * sizeof(GLuint));
  values_.reserve(count * sizeof(GLuint));
  counts_.reserve(blocks * kDigits * sizeof(GLuint));
  total_.reserve(sizeof(GLuint));
  for (int shift = 0; shift < bits; shift += 8) {
    count_.use();
    count_.set("count", static_cast<GLuint>(count));
    count_.set("blocks", static_cast<GLuint>(blocks));
    count_.set("shift", static_cast<GLuint>(shift));
    keys.bind(0);
    counts_.bind(4);
    gl::dispatch(blocks);
    gl::storageBarrier();

    prefix_sum_.run(counts_, blocks * kDigits, total_, 0);

    scatter_.use();
    scatter_.set("count", static_cast<GLuint>(count));
    scatter_.set("blocks", static_cast<GLuint>(blocks));
    scatter_.set("shift", static_cast<GLuint>(shift));
    scatter_.set("first_pass", shift == 0 && !has_values ? 1 : 0);
    keys.bind(0);
    values.bind(1);
    keys_.bind(2);
    values_.bind(3);
    counts_.bind(4);
    gl::dispatch(blocks);
    gl::storageBarrier();
    std::swap(keys, keys_);
    std::swap(values, values_);
  }
}

std::size_t RadixSort::bytes() const {
  return keys_.bytes() + values_.bytes() + counts_.bytes() + prefix_sum_.bytes();
}

}  // namespace rosplat
