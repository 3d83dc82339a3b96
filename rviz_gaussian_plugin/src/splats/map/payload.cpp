#include "map/payload.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "map/gaussian_map.hpp"

namespace rosplat {

namespace {

constexpr unsigned kPositionBits = 24, kScaleBits = 12, kRotationBits = 12, kOpacityBits = 10,
                   kColourBits = 12;
constexpr std::size_t kSplatBytes = 24, kBounds = 5, kBoundsBytes = kBounds * 2 * sizeof(float);
constexpr float kLargestComponent = 0.70710684f;  // just beyond sqrt(1/2)

std::size_t restOf(int sh_degree) { return 3u * ((sh_degree + 1u) * (sh_degree + 1u) - 1u); }

// From codes to values, evenly from one bound to the other.
struct Scale {
  Scale(float lower, float upper, unsigned steps)
      : lower(lower), step((double(upper) - double(lower)) / steps) {}
  double operator()(std::uint32_t code) const { return lower + code * step; }

  double lower;
  double step;
};

// Reads the bits of a splat from the least significant on.
class Bits {
 public:
  explicit Bits(const std::uint8_t* bytes) { std::memcpy(words_, bytes, sizeof(words_)); }
  std::uint32_t take(unsigned count) {
    const unsigned word = at_ / 64, shift = at_ % 64;
    std::uint64_t bits = words_[word] >> shift;
    if (shift + count > 64) bits |= words_[word + 1] << (64 - shift);
    at_ += count;
    return static_cast<std::uint32_t>(bits & ((std::uint64_t{1} << count) - 1));
  }

 private:
  std::uint64_t words_[kSplatBytes / 8];
  unsigned at_ = 0;
};

// Code 0 is a scale of zero, the greatest one of a splat that means nothing.
std::vector<float> scaleTable(const float* bounds) {
  constexpr std::uint32_t kCodes = 1u << kScaleBits;
  const Scale logarithm(bounds[0], bounds[1], kCodes - 3);
  std::vector<float> table(kCodes, 0.0f);
  for (std::uint32_t code = 1; code + 1 < kCodes; ++code) {
    table[code] = static_cast<float>(std::exp(logarithm(code - 1)));
  }
  table.back() = std::numeric_limits<float>::quiet_NaN();
  return table;
}

std::vector<float> colourTable(const float* bounds) {
  constexpr std::uint32_t kCodes = 1u << kColourBits;
  const Scale companded(bounds[0], bounds[1], kCodes - 1);
  std::vector<float> table(kCodes);
  for (std::uint32_t code = 0; code < kCodes; ++code) {
    const double value = companded(code);
    table[code] = static_cast<float>(std::copysign(std::expm1(std::fabs(value)), value));
  }
  return table;
}

// What a step of harmonics is worth by strength.
std::array<float, 256> stepTable() {
  std::array<float, 256> table{};
  for (int strength = 1; strength < 256; ++strength) {
    table[strength] = static_cast<float>(std::exp2((strength - 128) / 8.0) / 127);
  }
  return table;
}

}  // namespace

std::size_t payloadBytes(std::size_t count, int sh_degree) {
  const std::size_t rest = restOf(sh_degree);
  return kBoundsBytes + count * (kSplatBytes + (rest > 0 ? 1 + rest : 0));
}

GaussianBatch DecodedPayload::decode(const GaussianBatch& batch) {
  if (batch.format.empty()) return batch;
  float bounds[kBounds][2];
  std::memcpy(bounds, batch.payload.data, sizeof(bounds));
  for (const auto& [lower, upper] : bounds) {
    if (!std::isfinite(lower) || !std::isfinite(upper) || lower > upper) {
      throw BatchError("payload has bounds that are not finite, or the wrong way round");
    }
  }
  const std::size_t n = batch.count, rest = restOf(batch.sh_degree);
  positions_.resize(3 * n);
  orientations_.resize(4 * n);
  scales_.resize(3 * n);
  opacities_.resize(n);
  sh_.resize((3 + rest) * n);
  constexpr unsigned kPositionSteps = (1u << kPositionBits) - 1;
  const Scale positions[] = {{bounds[0][0], bounds[0][1], kPositionSteps},
                             {bounds[1][0], bounds[1][1], kPositionSteps},
                             {bounds[2][0], bounds[2][1], kPositionSteps}};
  const Scale component(-kLargestComponent, kLargestComponent, (1u << kRotationBits) - 1);
  const Scale opacity(0, 1, (1u << kOpacityBits) - 1);
  const std::vector<float> scales = scaleTable(bounds[3]), colours = colourTable(bounds[4]);
  const std::uint8_t* const splats = batch.payload.data + kBoundsBytes;
  for (std::size_t i = 0; i < n; ++i) {
    Bits bits(splats + kSplatBytes * i);
    for (int k = 0; k < 3; ++k) {
      positions_[3 * i + k] = static_cast<float>(positions[k](bits.take(kPositionBits)));
    }
    for (int k = 0; k < 3; ++k) scales_[3 * i + k] = scales[bits.take(kScaleBits)];
    const std::uint32_t left_out = bits.take(2);
    double squares = 0;
    for (unsigned k = 1; k <= 3; ++k) {
      const double value = component(bits.take(kRotationBits));
      squares += value * value;
      orientations_[4 * i + (left_out + k) % 4] = static_cast<float>(value);
    }
    orientations_[4 * i + left_out] = static_cast<float>(std::sqrt(std::max(0.0, 1 - squares)));
    opacities_[i] = static_cast<float>(opacity(bits.take(kOpacityBits)));
    for (int k = 0; k < 3; ++k) sh_[(3 + rest) * i + k] = colours[bits.take(kColourBits)];
  }
  if (rest > 0) {
    static const std::array<float, 256> kSteps = stepTable();
    const std::uint8_t* const strengths = splats + kSplatBytes * n;
    const auto* harmonics = reinterpret_cast<const std::int8_t*>(strengths + n);
    for (std::size_t i = 0; i < n; ++i, harmonics += rest) {
      const float step = kSteps[strengths[i]];
      float* const sh = &sh_[(3 + rest) * i + 3];
      for (std::size_t k = 0; k < rest; ++k) sh[k] = step * harmonics[k];
    }
  }
  GaussianBatch decoded = batch;
  decoded.positions = positions_;
  decoded.orientations = orientations_;
  decoded.scales = scales_;
  decoded.opacities = opacities_;
  decoded.sh = sh_;
  return decoded;
}

}  // namespace rosplat
