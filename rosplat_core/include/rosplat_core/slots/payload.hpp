#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <vector>

#include "rosplat_core/slots/splat_arrays.hpp"

// GaussianArray.payload in the format that rosplat_msgs/doc/quantised.md specifies.
namespace rosplat::payload {

constexpr const char* kFormat = "quantised";

namespace detail {

constexpr unsigned kPositionBits = 24, kScaleBits = 12, kRotationBits = 12, kOpacityBits = 10,
                   kColourBits = 12;
constexpr std::uint32_t stepsOf(unsigned bits) { return (1u << bits) - 1; }
constexpr std::size_t kSplatBytes = 24, kBounds = 5, kBoundsBytes = kBounds * 2 * sizeof(float);
constexpr float kLargestComponent = 0.70710684f;         // just beyond sqrt(1/2)
constexpr float kScaleRange = 16, kGreatestScale = 12;   // [natural logarithm]
constexpr std::uint32_t kNoScale = stepsOf(kScaleBits);  // marks an invalid splat
constexpr std::uint32_t kScaleSteps = stepsOf(kScaleBits) - 2;

struct Bounds {
  float lower = 0, upper = 0;
};

// The bounds of values that come one by one.
class Span {
 public:
  void add(float value) {
    lower_ = std::min(lower_, value);
    upper_ = std::max(upper_, value);
  }
  Bounds bounds() const { return lower_ <= upper_ ? Bounds{lower_, upper_} : Bounds{}; }

 private:
  float lower_ = std::numeric_limits<float>::infinity();
  float upper_ = -std::numeric_limits<float>::infinity();
};

// Maps values to codes and back, in even steps from one bound to the other.
class Steps {
 public:
  Steps(Bounds bounds, std::uint32_t steps)
      : lower_(bounds.lower), step_((double(bounds.upper) - lower_) / steps) {}
  double value(std::uint32_t code) const { return lower_ + code * step_; }
  std::uint32_t code(double value) const {
    return step_ > 0 ? static_cast<std::uint32_t>((value - lower_) / step_ + 0.5) : 0;
  }

 private:
  double lower_, step_;
};

// Reads or writes the bits of a splat from the least significant on.
class Bits {
 public:
  Bits() = default;
  explicit Bits(const std::uint8_t* bytes) { std::memcpy(words_, bytes, sizeof(words_)); }
  std::uint32_t read(unsigned count) {
    const unsigned word = at_ / 64, shift = at_ % 64;
    std::uint64_t bits = words_[word] >> shift;
    if (shift + count > 64) bits |= words_[word + 1] << (64 - shift);
    at_ += count;
    return static_cast<std::uint32_t>(bits & ((std::uint64_t{1} << count) - 1));
  }
  void put(std::uint64_t code, unsigned count) {
    const unsigned word = at_ / 64, shift = at_ % 64;
    words_[word] |= code << shift;
    if (shift + count > 64) words_[word + 1] |= code >> (64 - shift);
    at_ += count;
  }
  void copyTo(std::uint8_t* bytes) const { std::memcpy(bytes, words_, sizeof(words_)); }

 private:
  std::uint64_t words_[kSplatBytes / 8] = {};
  unsigned at_ = 0;
};

// Linear for small colours and logarithmic for large ones, which are few.
inline float companded(float colour) {
  return std::copysign(std::log1p(std::fabs(colour)), colour);
}

inline std::vector<float> scaleTable(Bounds bounds) {
  const Steps logarithm(bounds, kScaleSteps);
  std::vector<float> table(kNoScale + 1, 0.0f);
  for (std::uint32_t code = 1; code < kNoScale; ++code) {
    table[code] = static_cast<float>(std::exp(logarithm.value(code - 1)));
  }
  table.back() = std::numeric_limits<float>::quiet_NaN();
  return table;
}

inline std::vector<float> colourTable(Bounds bounds) {
  const Steps steps(bounds, stepsOf(kColourBits));
  std::vector<float> table(stepsOf(kColourBits) + 1);
  for (std::uint32_t code = 0; code < table.size(); ++code) {
    const double value = steps.value(code);
    table[code] = static_cast<float>(std::copysign(std::expm1(std::fabs(value)), value));
  }
  return table;
}

// The size of one step of harmonics, by strength.
inline const std::array<float, 256>& units() {
  static const std::array<float, 256> table = [] {
    std::array<float, 256> units{};
    for (int strength = 1; strength < 256; ++strength) {
      units[strength] = static_cast<float>(std::exp2((strength - 128) / 8.0) / 127);
    }
    return units;
  }();
  return table;
}

// The value below which a share of ascending values lies, as NumPy's quantile.
inline double quantile(const std::vector<float>& ascending, double share) {
  const double at = share * static_cast<double>(ascending.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const double lower = ascending[below];
  return lower + (at - below) * (ascending[std::min(below + 1, ascending.size() - 1)] - lower);
}

inline float largestScale(const SplatArrays<const float>& splats, std::size_t i) {
  const float* const scale = splats.scales + 3 * i;
  return std::max({scale[0], scale[1], scale[2]});
}

}  // namespace detail

// Bytes of the payload of `count` splats.
inline std::size_t size(std::size_t count, int sh_degree) {
  const std::size_t rest = harmonicsOf(sh_degree) - 3;
  return detail::kBoundsBytes + count * (detail::kSplatBytes + (rest > 0 ? 1 + rest : 0));
}

// Whether a payload keeps splats precisely enough: no stray splat may make the steps of all too
// large. A step of position may be a 16th of the median splat's size, or a 65,536th of the range of
// 90 % of the positions; the largest scale may be e^12 times the median. usable: by isUsable().
inline bool suits(const SplatArrays<const float>& splats, const std::vector<bool>& usable) {
  std::vector<std::size_t> kept;
  for (std::size_t i = 0; i < splats.count; ++i) {
    if (usable[i]) kept.push_back(i);
  }
  if (kept.empty()) return true;
  const std::size_t stride = 1 + kept.size() / 4096;
  double span = 0, most = 0;
  std::vector<float> some;
  for (int k = 0; k < 3; ++k) {
    detail::Span all;
    for (const std::size_t i : kept) all.add(splats.positions[3 * i + k]);
    span = std::max(span, double(all.bounds().upper) - all.bounds().lower);
    some.clear();
    for (std::size_t at = 0; at < kept.size(); at += stride) {
      some.push_back(splats.positions[3 * kept[at] + k]);
    }
    std::sort(some.begin(), some.end());
    most = std::max(most, detail::quantile(some, 0.95) - detail::quantile(some, 0.05));
  }
  some.clear();
  for (std::size_t at = 0; at < kept.size(); at += stride) {
    some.push_back(detail::largestScale(splats, kept[at]));
  }
  std::sort(some.begin(), some.end());
  const double median = detail::quantile(some, 0.5);
  float largest = 0;
  for (const std::size_t i : kept) largest = std::max(largest, detail::largestScale(splats, i));
  const double step = span / (detail::stepsOf(detail::kPositionBits) + 1.0);
  return step <= std::max(median / 16, most / 65536) &&
         (median == 0 || largest <= median * std::exp(double(detail::kGreatestScale)));
}

// Writes the payload of splats, of size() bytes. usable: by isUsable().
inline void encode(const SplatArrays<const float>& splats, const std::vector<bool>& usable,
                   std::uint8_t* payload) {
  using namespace detail;
  const std::size_t n = splats.count, stride = splats.shStride();
  float greatest = -std::numeric_limits<float>::infinity();  // logarithm of a scale
  for (std::size_t i = 0; i < n; ++i) {
    if (usable[i]) greatest = std::max(greatest, std::log(largestScale(splats, i)));
  }
  Span spans[kBounds];
  for (std::size_t i = 0; i < n; ++i) {
    if (!usable[i]) continue;
    for (int k = 0; k < 3; ++k) {
      spans[k].add(splats.positions[3 * i + k]);
      const float logarithm = std::log(splats.scales[3 * i + k]);
      if (std::isfinite(logarithm) && logarithm >= greatest - kScaleRange) spans[3].add(logarithm);
      spans[4].add(companded(splats.sh[stride * i + k]));
    }
  }
  Bounds bounds[kBounds];
  for (std::size_t k = 0; k < kBounds; ++k) bounds[k] = spans[k].bounds();
  static_assert(sizeof(bounds) == kBoundsBytes);
  std::memcpy(payload, bounds, kBoundsBytes);
  const Steps positions[] = {{bounds[0], stepsOf(kPositionBits)},
                             {bounds[1], stepsOf(kPositionBits)},
                             {bounds[2], stepsOf(kPositionBits)}};
  const Steps logarithms(bounds[3], kScaleSteps), colours(bounds[4], stepsOf(kColourBits));
  const Steps component({-kLargestComponent, kLargestComponent}, stepsOf(kRotationBits));
  const Steps opacity({0, 1}, stepsOf(kOpacityBits));
  std::uint8_t* const packed = payload + kBoundsBytes;
  for (std::size_t i = 0; i < n; ++i) {
    Bits bits;
    if (usable[i]) {
      for (int k = 0; k < 3; ++k) {
        bits.put(positions[k].code(splats.positions[3 * i + k]), kPositionBits);
      }
      for (int k = 0; k < 3; ++k) {
        const float logarithm = std::log(splats.scales[3 * i + k]);
        bits.put(logarithm < bounds[3].lower ? 0 : 1 + logarithms.code(logarithm), kScaleBits);
      }
      const float* const q = splats.orientations + 4 * i;
      unsigned left_out = 0;
      for (unsigned k = 1; k < 4; ++k) {
        if (std::fabs(q[k]) > std::fabs(q[left_out])) left_out = k;
      }
      bits.put(left_out, 2);
      double ratios[3], squares = 1;
      for (unsigned k = 0; k < 3; ++k) {
        ratios[k] = double(q[(left_out + k + 1) % 4]) / q[left_out];
        squares += ratios[k] * ratios[k];
      }
      for (const double ratio : ratios) {
        bits.put(component.code(ratio / std::sqrt(squares)), kRotationBits);
      }
      bits.put(opacity.code(std::clamp(splats.opacities[i], 0.0f, 1.0f)), kOpacityBits);
      for (int k = 0; k < 3; ++k) {
        bits.put(colours.code(companded(splats.sh[stride * i + k])), kColourBits);
      }
    } else {
      for (int k = 0; k < 3; ++k) bits.put(0, kPositionBits);
      for (int k = 0; k < 3; ++k) bits.put(kNoScale, kScaleBits);
    }
    bits.copyTo(packed + kSplatBytes * i);
  }
  const std::size_t rest = harmonicsOf(splats.sh_degree) - 3;
  if (rest == 0) return;
  std::uint8_t* const strengths = packed + kSplatBytes * n;
  auto* harmonics = reinterpret_cast<std::int8_t*>(strengths + n);
  for (std::size_t i = 0; i < n; ++i, harmonics += rest) {
    const float* const sh = splats.sh + stride * i + 3;
    float most = 0;
    for (std::size_t k = 0; usable[i] && k < rest; ++k) most = std::max(most, std::fabs(sh[k]));
    const float strength = most > 0 ? std::ceil(8 * std::log2(most)) + 128 : 0;
    strengths[i] = static_cast<std::uint8_t>(std::clamp(strength, 0.0f, 255.0f));
    for (std::size_t k = 0; k < rest; ++k) {
      const float steps = strengths[i] > 0 ? std::nearbyint(sh[k] / units()[strengths[i]]) : 0;
      harmonics[k] = static_cast<std::int8_t>(std::clamp(steps, -127.0f, 127.0f));
    }
  }
}

// Fills arrays with the splats of a payload of size() bytes. Throws std::invalid_argument for
// invalid bounds.
inline void decode(const std::uint8_t* payload, const SplatArrays<float>& splats) {
  using namespace detail;
  Bounds bounds[kBounds];
  std::memcpy(bounds, payload, kBoundsBytes);
  for (const auto& [lower, upper] : bounds) {
    if (!std::isfinite(lower) || !std::isfinite(upper) || lower > upper) {
      throw std::invalid_argument("payload has bounds that are not finite, or the wrong way round");
    }
  }
  const std::size_t n = splats.count, stride = splats.shStride();
  const Steps positions[] = {{bounds[0], stepsOf(kPositionBits)},
                             {bounds[1], stepsOf(kPositionBits)},
                             {bounds[2], stepsOf(kPositionBits)}};
  const Steps component({-kLargestComponent, kLargestComponent}, stepsOf(kRotationBits));
  const Steps opacity({0, 1}, stepsOf(kOpacityBits));
  const std::vector<float> scales = scaleTable(bounds[3]), colours = colourTable(bounds[4]);
  const std::uint8_t* const packed = payload + kBoundsBytes;
  for (std::size_t i = 0; i < n; ++i) {
    Bits bits(packed + kSplatBytes * i);
    for (int k = 0; k < 3; ++k) {
      splats.positions[3 * i + k] =
          static_cast<float>(positions[k].value(bits.read(kPositionBits)));
    }
    for (int k = 0; k < 3; ++k) splats.scales[3 * i + k] = scales[bits.read(kScaleBits)];
    float* const q = splats.orientations + 4 * i;
    const std::uint32_t left_out = bits.read(2);
    double squares = 0;
    for (unsigned k = 1; k <= 3; ++k) {
      const double value = component.value(bits.read(kRotationBits));
      squares += value * value;
      q[(left_out + k) % 4] = static_cast<float>(value);
    }
    q[left_out] = static_cast<float>(std::sqrt(std::max(0.0, 1 - squares)));
    splats.opacities[i] = static_cast<float>(opacity.value(bits.read(kOpacityBits)));
    for (int k = 0; k < 3; ++k) splats.sh[stride * i + k] = colours[bits.read(kColourBits)];
  }
  const std::size_t rest = harmonicsOf(splats.sh_degree) - 3;
  if (rest == 0) return;
  const std::uint8_t* const strengths = packed + kSplatBytes * n;
  const auto* harmonics = reinterpret_cast<const std::int8_t*>(strengths + n);
  for (std::size_t i = 0; i < n; ++i, harmonics += rest) {
    const float step = units()[strengths[i]];
    float* const sh = splats.sh + stride * i + 3;
    for (std::size_t k = 0; k < rest; ++k) sh[k] = step * harmonics[k];
  }
}

}  // namespace rosplat::payload
