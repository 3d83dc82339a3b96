#include "gpu/radix_sort.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

namespace rosplat {

namespace {
constexpr std::size_t kDigits = 1u << RadixSort::kDigitBits;
// Invocations of a work group: the more, the less each waits. Where subgroups are narrower than the
// driver says, they are too many.
constexpr int kLanes = 512, kFewLanes = 256;
// Up to so many, each block sums up the counts itself, which is faster than one more dispatch.
constexpr std::size_t kFewBlocks = 64;
const Shaders::Files kScatter{"group_sum.glsl", "radix_digit.glsl", "radix_scatter.comp"};

std::size_t blocks(std::size_t count) { return (count + Tally::kBlock - 1) / Tally::kBlock; }
}  // namespace

void PrefixSum::reserve(std::size_t count) {
  most_ = count;
  sums_.reserve((blocks(count) + 1) * sizeof(GLuint));
}

void PrefixSum::run(const gl::Buffer& values, const Tally& count, const Tally& total,
                    std::size_t room, std::size_t each) {
  sum_.use();
  sum_.set("each", static_cast<GLuint>(each));
  sum_.set("room", static_cast<GLuint>(room));
  sum_.bind("Values", values);
  sum_.bind("Sums", sums_);
  sum_.bind("Length", count.words());
  sum_.bind("Total", total.words());
  for (GLuint pass = blocks(most_) > 1 ? 0 : 1; pass < 2; ++pass) {
    sum_.set("pass", pass);
    count.dispatchBlocks();
    gl::storageBarrier();
  }
  glMemoryBarrier(GL_COMMAND_BARRIER_BIT);  // the total is work to dispatch
}

RadixSort::RadixSort(Shaders& shaders)
    : shaders_(shaders),
      count_(shaders.compute({"radix_digit.glsl", "radix_count.comp"})),
      sum_(shaders.compute({"group_sum.glsl", "radix_sum.comp"})),
      scatter_(&shaders.computeInWarps(kScatter, shaders.subgroups() ? kLanes : kFewLanes,
                                       shaders.subgroups())) {}

bool RadixSort::check() {
  if (sortsRight()) return true;
  if (!shaders_.subgroups() || lost_ballots_) return false;
  scatter_ = &shaders_.computeInWarps(kScatter, kFewLanes, true);
  if (sortsRight()) return true;
  lost_ballots_ = true;
  scatter_ = &shaders_.computeInWarps(kScatter, kFewLanes, false);
  return sortsRight();
}

bool RadixSort::sortsRight() {
  // Three full blocks and one that isn't; of each key about six, in the top bits that depths have.
  constexpr std::size_t kKeys = 3 * Tally::kBlock + 1000;
  constexpr GLuint kLeast = 0xbf800000u;
  std::minstd_rand random;
  std::vector<GLuint> keys(kKeys), places(kKeys), sorted(kKeys), found(kKeys);
  for (GLuint& key : keys) key = kLeast + 17 * (random() % 2048);
  std::iota(places.begin(), places.end(), 0u);
  std::stable_sort(places.begin(), places.end(),
                   [&](GLuint a, GLuint b) { return keys[a] < keys[b]; });
  std::transform(places.begin(), places.end(), sorted.begin(), [&](GLuint i) { return keys[i]; });

  const gl::Buffer numbers(2 * gl::Slice::kAlignment, GL_DYNAMIC_COPY);
  Tally count({numbers.id(), 0, Tally::kBytes});
  count.set(kKeys);
  const gl::Slice least{numbers.id(), gl::Slice::kAlignment, Tally::kBytes};
  const std::array<GLuint, Tally::kBytes / sizeof(GLuint)> words{kLeast};
  least.write(words.data());
  gl::Buffer ordered(kKeys * sizeof(GLuint), GL_DYNAMIC_COPY);
  reserve(kKeys);

  const auto holds = [&](const gl::Buffer& buffer, const std::vector<GLuint>& expected) {
    buffer.read(0, found.data(), found.size() * sizeof(GLuint));
    return found == expected;
  };
  keys_.write(0, keys.data(), keys.size() * sizeof(GLuint));
  order(count, least, 2 * kDigitBits, ordered);
  if (!holds(ordered, places)) return false;
  // As values, what was sorted goes through passes of its own; and as if there were many.
  most_ = (kFewBlocks + 1) * Tally::kBlock;
  std::vector<GLuint> values(kKeys);
  std::iota(values.rbegin(), values.rend(), 0u);
  keys_.write(0, keys.data(), keys.size() * sizeof(GLuint));
  ordered.write(0, values.data(), values.size() * sizeof(GLuint));
  sort(count, least, 2 * kDigitBits, ordered);
  std::transform(places.begin(), places.end(), values.begin(),
                 [&](GLuint i) { return static_cast<GLuint>(kKeys) - 1 - i; });
  return holds(keys_, sorted) && holds(ordered, values);
}

void RadixSort::reserve(std::size_t count) {
  most_ = count;
  if (room_.wastes(count)) {
    for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_, &counts_}) buffer->release();
  }
  for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_}) {
    buffer->reserve(count * sizeof(GLuint));
  }
  counts_.reserve((blocks(count) + 1) * kDigits * sizeof(GLuint));
}

void RadixSort::pass(const Tally& count, const gl::Slice& least, int shift,
                     const gl::Buffer& values, const gl::Buffer& sorted_values) {
  count_.bind("Keys", keys_);
  count_.bind("Counts", counts_);
  count_.bind("Length", count.words());
  count_.bind("Least", least);
  count_.use();
  count_.set("shift", static_cast<GLuint>(shift));
  count.dispatchBlocks();
  gl::storageBarrier();

  const bool summed = blocks(most_) > kFewBlocks;
  if (summed) {
    sum_.bind("Counts", counts_);
    sum_.bind("Length", count.words());
    sum_.use();
    gl::dispatch(kDigits);
    gl::storageBarrier();
  }

  scatter_->bind("Keys", keys_);
  scatter_->bind("Values", values);
  scatter_->bind("SortedKeys", next_keys_);
  scatter_->bind("SortedValues", sorted_values);
  scatter_->bind("Counts", counts_);
  scatter_->bind("Length", count.words());
  scatter_->bind("Least", least);
  scatter_->use();
  scatter_->set("shift", static_cast<GLuint>(shift));
  scatter_->set("summed", int(summed));
  count.dispatchBlocks();
  gl::storageBarrier();
}

void RadixSort::run(const Tally& count, const gl::Slice& least, int bits, const gl::Buffer& sorted,
                    bool are_places) {
  const int last = passes(bits) - 1;
  for (int i = 0; i <= last; ++i) {
    // Back and forth, so that the last pass ends where it is to.
    const bool there = (last - i) % 2 == 0;
    scatter_->use();
    scatter_->set("first_pass", int(are_places && i == 0));
    scatter_->set("last_pass", int(are_places && i == last));
    pass(count, least, i * kDigitBits, there ? values_ : sorted, there ? sorted : values_);
    std::swap(keys_, next_keys_);
  }
}

void RadixSort::sort(const Tally& count, const gl::Slice& least, int bits,
                     const gl::Buffer& sorted) {
  run(count, least, bits, sorted, false);
}

void RadixSort::order(const Tally& count, const gl::Slice& least, int bits,
                      const gl::Buffer& places) {
  run(count, least, bits, places, true);
}

std::size_t RadixSort::bytes() const {
  return keys_.bytes() + next_keys_.bytes() + values_.bytes() + counts_.bytes();
}

}  // namespace rosplat
