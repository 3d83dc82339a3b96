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
// Invocations of a work group: the more, the less each waits. If subgroups are narrower than the
// driver says, kLanes are too many.
constexpr int kLanes = 512, kFewLanes = 256;
constexpr std::size_t kBlock = 4096;  // keys that a work group sorts at once, as in the shaders
// Work groups that count digits, and keys that each counts if there are few.
constexpr std::size_t kMostCounters = 512, kLeastCounted = 1024;
// Digits of all passes that there may be; radix_count.comp has the same.
constexpr std::size_t kTotals = kDigits * 32 / RadixSort::kDigitBits;
const Shaders::Files kScatter{"group_sum.glsl", "radix_digit.glsl", "radix_scatter.comp"};

std::size_t blocks(std::size_t count) { return std::max(ceilDiv(count, kBlock), 1u); }
}  // namespace

RadixSort::RadixSort(Shaders& shaders)
    : shaders_(shaders),
      count_(shaders.compute({"radix_digit.glsl", "radix_count.comp"})),
      scatter_(&shaders.computeInWarps(kScatter, shaders.subgroups() ? kLanes : kFewLanes,
                                       shaders.subgroups())) {
  for (gl::Buffer* buffer : {&totals_, &next_totals_}) {
    buffer->reserve(kTotals * sizeof(GLuint));
    buffer->zero();
  }
}

bool RadixSort::check() {
  if (chooseWarps()) return true;
  if (!shaders_.groupsWait()) return false;
  shaders_.giveUpWaiting();
  return chooseWarps();
}

bool RadixSort::chooseWarps() {
  lost_ballots_ = false;
  for (const int lanes : {kLanes, kFewLanes}) {
    if (!shaders_.subgroups()) break;
    scatter_ = &shaders_.computeInWarps(kScatter, lanes, true);
    if (sortAndCompare()) return true;
  }
  lost_ballots_ = shaders_.subgroups();
  scatter_ = &shaders_.computeInWarps(kScatter, kFewLanes, false);
  return sortAndCompare();
}

bool RadixSort::sortAndCompare() {
  // Three full blocks and a part of one; each key about six times, with the top bits of depths; a
  // seventh of them to be left out.
  constexpr std::size_t kKeys = 3 * kBlock + 1000;
  constexpr GLuint kLeast = 0xbf800000u, kLeftOut = 0xffffffffu;
  std::minstd_rand random;
  std::vector<GLuint> keys(kKeys), values(kKeys);
  for (GLuint& key : keys) key = random() % 7 == 0 ? kLeftOut : kLeast + 17 * (random() % 2048);
  const auto placesInOrder = [&] {
    std::vector<GLuint> places;
    for (GLuint i = 0; i < kKeys; ++i) {
      if (keys[i] != kLeftOut) places.push_back(i);
    }
    std::stable_sort(places.begin(), places.end(),
                     [&](GLuint a, GLuint b) { return keys[a] < keys[b]; });
    return places;
  };

  const gl::Buffer numbers(gl::Slice::kAlignment, GL_DYNAMIC_COPY);
  gl::Buffer ordered(kKeys * sizeof(GLuint), GL_DYNAMIC_COPY);
  gl::settle();
  const gl::Slice seen{numbers.id(), 0, 6 * sizeof(GLuint)};
  reserve(kKeys);
  const auto write = [&](std::size_t count) {
    const std::array<GLuint, 6> tally{static_cast<GLuint>(count), 0, kLeast};
    seen.write(tally.data(), sizeof(tally));
    keys_.write(0, keys.data(), keys.size() * sizeof(GLuint));
  };
  const auto holds = [&](const gl::Buffer& buffer, const std::vector<GLuint>& expected) {
    std::vector<GLuint> found(expected.size());
    buffer.read(0, found.data(), found.size() * sizeof(GLuint));
    return found == expected;
  };
  std::vector<GLuint> places = placesInOrder();
  write(places.size());
  order(seen, kKeys, places.size(), 2 * kDigitBits, ordered);
  if (!holds(ordered, places)) return false;
  // sort() moves values in passes of its own, unlike order(), and leaves out none.
  std::replace(keys.begin(), keys.end(), kLeftOut, kLeast);
  places = placesInOrder();
  std::iota(values.rbegin(), values.rend(), 0u);
  write(kKeys);
  ordered.write(0, values.data(), values.size() * sizeof(GLuint));
  sort(seen, kKeys, 2 * kDigitBits, ordered);
  std::transform(places.begin(), places.end(), values.begin(), [&](GLuint i) { return keys[i]; });
  for (GLuint& i : places) i = static_cast<GLuint>(kKeys) - 1 - i;
  return holds(keys_, values) && holds(ordered, places);
}

void RadixSort::reserve(std::size_t count) {
  if (room_.noteUse(count)) {
    for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_, &sums_}) buffer->release();
  }
  for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_}) {
    buffer->reserve(count * sizeof(GLuint));
  }
  sums_.reserve((1 + blocks(count) * kDigits) * sizeof(GLuint));
}

void RadixSort::order(const gl::Slice& seen, std::size_t count, std::size_t expected, int bits,
                      const gl::Buffer& places) {
  if (count > 0) run(seen, count, expected, bits, places);
}

void RadixSort::sort(const gl::Slice& seen, std::size_t expected, int bits,
                     const gl::Buffer& sorted) {
  run(seen, 0, expected, bits, sorted);
}

void RadixSort::run(const gl::Slice& seen, std::size_t count, std::size_t expected, int bits,
                    const gl::Buffer& sorted) {
  const std::size_t first_expected = count > 0 ? count : expected;
  std::swap(totals_, next_totals_);
  count_.use();
  count_.bind("Keys", keys_);
  count_.bind("Totals", totals_);
  count_.bind("NextTotals", next_totals_);
  count_.bind("Sums", sums_);
  count_.bind("Seen", seen);
  count_.set("passes", static_cast<GLuint>(passes(bits)));
  count_.set("first_count", static_cast<GLuint>(count));
  gl::dispatch(std::clamp<std::size_t>(ceilDiv(first_expected, kLeastCounted), 1, kMostCounters));
  gl::storageBarrier();

  scatter_->use();
  scatter_->bind("Totals", totals_);
  scatter_->bind("Sums", sums_);
  scatter_->bind("Seen", seen);
  const int last = passes(bits) - 1;
  for (int pass = 0; pass <= last; ++pass) {
    // Values go back and forth between two buffers, so that the last pass writes to `sorted`.
    const bool there = (last - pass) % 2 == 0;
    scatter_->bind("Keys", keys_);
    scatter_->bind("Values", there ? values_ : sorted);
    scatter_->bind("SortedKeys", next_keys_);
    scatter_->bind("SortedValues", there ? sorted : values_);
    scatter_->set("pass", static_cast<GLuint>(pass));
    scatter_->set("are_places", int(count > 0 && pass == 0));
    scatter_->set("first_count", static_cast<GLuint>(pass == 0 ? count : 0));
    scatter_->set("last_pass", int(count > 0 && pass == last));
    for (const bool announcing : {true, false}) {
      if (announcing && shaders_.groupsWait()) continue;
      scatter_->set("announcing", int(announcing));
      gl::dispatch(blocks(pass == 0 ? first_expected : expected));
      gl::storageBarrier();
    }
    std::swap(keys_, next_keys_);
  }
}

std::size_t RadixSort::bytes() const {
  return keys_.bytes() + next_keys_.bytes() + values_.bytes() + sums_.bytes() + totals_.bytes() +
         next_totals_.bytes();
}

}  // namespace rosplat
