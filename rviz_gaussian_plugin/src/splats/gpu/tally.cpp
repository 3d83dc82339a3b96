#include "gpu/tally.hpp"

#include <algorithm>
#include <array>

namespace rosplat {

namespace {

constexpr std::size_t kGroups = 2, kBlocks = 5;  // words

}  // namespace

void Tally::set(std::size_t count) {
  if (known_ && count_ == count) return;
  known_ = true;
  count_ = count;
  const auto n = static_cast<GLuint>(count);
  const GLuint groups = ceilDiv(count, 256), blocks = std::max(ceilDiv(count, kBlock), 1u);
  const GLuint group_rows = std::max(ceilDiv(groups, 65535), 1u);
  const GLuint block_rows = ceilDiv(blocks, 65535);
  const std::array<GLuint, 8> words{
      n, n, ceilDiv(groups, group_rows), group_rows, 1, ceilDiv(blocks, block_rows), block_rows, 1};
  static_assert(sizeof(words) == kBytes);
  words_.write(words.data());
}

void Tally::forget() { known_ = false; }

void Tally::dispatch(std::size_t word) const {
  glBindBuffer(GL_DISPATCH_INDIRECT_BUFFER, words_.buffer);
  glDispatchComputeIndirect(static_cast<GLintptr>(words_.offset + word * sizeof(GLuint)));
}

void Tally::dispatchGroups() const { dispatch(kGroups); }

void Tally::dispatchBlocks() const { dispatch(kBlocks); }

}  // namespace rosplat
