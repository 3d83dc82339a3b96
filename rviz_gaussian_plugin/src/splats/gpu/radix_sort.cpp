#include "gpu/radix_sort.hpp"

#include <algorithm>
#include <array>
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
constexpr int kMostDropped = 4;         // bits that radix_settle.comp sorts
constexpr std::size_t kSettled = 1024;  // keys that a work group of it sorts
const Shaders::Files kScatter{"group_sum.glsl", "radix_digit.glsl", "radix_scatter.comp"};

std::size_t blocks(std::size_t count) { return std::max(ceilDiv(count, kBlock), 1u); }
}  // namespace

RadixSort::RadixSort(Shaders& shaders)
    : shaders_(shaders),
      count_(shaders.compute({"radix_digit.glsl", "radix_count.comp"})),
      settle_(shaders.compute({"radix_digit.glsl", "radix_settle.comp"})),
      scatter_(&shaders.computeInWarps(kScatter, shaders.subgroups() ? kLanes : kFewLanes,
                                       shaders.subgroups())) {
  for (gl::Buffer* buffer : {&totals_, &next_totals_}) {
    buffer->reserve(kTotals * sizeof(GLuint));
    buffer->zero();
  }
}

bool RadixSort::check() {
  if (sortsInSomeWarps()) return true;
  if (!shaders_.groupsWait()) return false;
  shaders_.giveUpWaiting();
  return sortsInSomeWarps();
}

bool RadixSort::sortsInSomeWarps() {
  lost_ballots_ = false;
  for (const int lanes : {kLanes, kFewLanes}) {
    if (!shaders_.subgroups()) break;
    scatter_ = &shaders_.computeInWarps(kScatter, lanes, true);
    if (sortsRight()) return true;
  }
  lost_ballots_ = shaders_.subgroups();
  scatter_ = &shaders_.computeInWarps(kScatter, kFewLanes, false);
  return sortsRight();
}

bool RadixSort::sortsRight() {
  // Three full blocks and a part of one, with the top bits of depths. About six keys are alike but
  // for their lowest bits, some in these, too. A seventh of the keys is left out.
  constexpr std::size_t kKeys = 3 * kBlock + 1000;
  constexpr GLuint kLeast = 0xbf800000u, kLeftOut = 0xffffffffu;
  const gl::Buffer numbers(gl::Slice::kAlignment, GL_DYNAMIC_COPY);
  const gl::Buffer ordered(kKeys * sizeof(GLuint), GL_DYNAMIC_COPY);
  gl::settle();
  reserve(kKeys);
  std::minstd_rand random;
  for (const Bits bits : {Bits{2 * kDigitBits, true}, Bits{2 * kDigitBits + kMostDropped, false}}) {
    std::vector<GLuint> keys(kKeys), places;
    for (GLuint i = 0; i < kKeys; ++i) {
      const GLuint step = ((1u << bits.bits) - 1) / 2047;
      keys[i] =
          random() % 7 == 0 ? kLeftOut : kLeast + step * (random() % 2047) + 5 * (random() % 4);
      if (keys[i] != kLeftOut) places.push_back(i);
    }
    std::stable_sort(places.begin(), places.end(),
                     [&](GLuint a, GLuint b) { return keys[a] < keys[b]; });
    const std::array<GLuint, 6> tally{static_cast<GLuint>(places.size()), 0, kLeast};
    const gl::Slice seen{numbers.id(), 0, sizeof(tally)};
    seen.write(tally.data(), sizeof(tally));
    keys_.write(0, keys.data(), keys.size() * sizeof(GLuint));
    order(seen, kKeys, kKeys, bits, ordered);
    std::vector<GLuint> found(places.size());
    ordered.read(0, found.data(), found.size() * sizeof(GLuint));
    if (found != places) return false;
  }
  return true;
}

int RadixSort::Bits::passes() const {
  return std::max((bits + (all ? kDigitBits - 1 : kDigitBits - 1 - kMostDropped)) / kDigitBits, 1);
}

int RadixSort::Bits::dropped() const { return std::max(bits - kDigitBits * passes(), 0); }

void RadixSort::reserve(std::size_t count) {
  if (room_.wastes(count)) {
    for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_, &sums_}) buffer->release();
  }
  for (gl::Buffer* buffer : {&keys_, &next_keys_, &values_}) {
    buffer->reserve(count * sizeof(GLuint));
  }
  sums_.reserve((1 + blocks(count) * kDigits) * sizeof(GLuint));
}

void RadixSort::order(const gl::Slice& seen, std::size_t count, std::size_t expected, Bits bits,
                      const gl::Buffer& places) {
  if (count > 0) run(seen, count, expected, bits, places);
}

void RadixSort::sort(const gl::Slice& seen, std::size_t expected, int bits,
                     const gl::Buffer& sorted) {
  run(seen, 0, expected, {bits}, sorted);
}

void RadixSort::run(const gl::Slice& seen, std::size_t count, std::size_t expected, Bits bits,
                    const gl::Buffer& sorted) {
  const auto dropped = static_cast<GLuint>(bits.dropped());
  const std::size_t first_expected = count > 0 ? count : expected;
  std::swap(totals_, next_totals_);
  count_.use();
  count_.bind("Keys", keys_);
  count_.bind("Totals", totals_);
  count_.bind("NextTotals", next_totals_);
  count_.bind("Sums", sums_);
  count_.bind("Seen", seen);
  count_.set("passes", static_cast<GLuint>(bits.passes()));
  count_.set("first_count", static_cast<GLuint>(count));
  count_.set("dropped", dropped);
  gl::dispatch(std::clamp<std::size_t>(ceilDiv(first_expected, kLeastCounted), 1, kMostCounters));
  gl::storageBarrier();

  scatter_->use();
  scatter_->bind("Totals", totals_);
  scatter_->bind("Sums", sums_);
  scatter_->bind("Seen", seen);
  scatter_->set("dropped", dropped);
  // Values go back and forth between two buffers, so that `sorted` is written last.
  const gl::Buffer &to = dropped > 0 ? values_ : sorted, &from = dropped > 0 ? sorted : values_;
  const int last = bits.passes() - 1;
  for (int pass = 0; pass <= last; ++pass) {
    const bool there = (last - pass) % 2 == 0;
    scatter_->bind("Keys", keys_);
    scatter_->bind("Values", there ? from : to);
    scatter_->bind("SortedKeys", next_keys_);
    scatter_->bind("SortedValues", there ? to : from);
    scatter_->set("pass", static_cast<GLuint>(pass));
    scatter_->set("are_places", int(count > 0 && pass == 0));
    scatter_->set("first_count", static_cast<GLuint>(pass == 0 ? count : 0));
    scatter_->set("last_pass", int(count > 0 && dropped == 0 && pass == last));
    for (const bool announcing : {true, false}) {
      if (announcing && shaders_.groupsWait()) continue;
      scatter_->set("announcing", int(announcing));
      gl::dispatch(blocks(pass == 0 ? first_expected : expected));
      gl::storageBarrier();
    }
    std::swap(keys_, next_keys_);
  }
  if (dropped == 0) return;
  settle_.use();
  settle_.bind("Keys", keys_);
  settle_.bind("Values", values_);
  settle_.bind("SortedValues", sorted);
  settle_.bind("Seen", seen);
  settle_.bind("Settled", seen);
  settle_.set("dropped", dropped);
  gl::dispatch(std::max(ceilDiv(expected, kSettled), 1u));
  gl::storageBarrier();
}

std::size_t RadixSort::bytes() const {
  return keys_.bytes() + next_keys_.bytes() + values_.bytes() + sums_.bytes() + totals_.bytes() +
         next_totals_.bytes();
}

}  // namespace rosplat
