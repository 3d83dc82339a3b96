#include "rosplat_core/slots/packed_slot.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "rosplat_core/slots/constants.hpp"

namespace rosplat {

namespace {

constexpr float kLargestHalf = 65504.0f;
constexpr float kLeastScaleLog2 = -40, kScaleOctaves = 64;  // 1 pm to 16,777 km
constexpr float kScaleSteps = 65534;
constexpr float kQuaternionSteps = 16383;  // to either side
constexpr float kSqrtHalf = 0.70710678f;

// The nearest integer, ties to even, of a number between -2^22 and 2^22. Does what std::lrint()
// does, but without a function call.
int nearest(float value) {
  value += 0x1.8p23f;
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  return int(bits - 0x4b400000u);
}

// To the nearest half-precision float, ties to even; beyond the largest, the largest.
std::uint32_t toHalf(float value) {
  value = std::clamp(value, -kLargestHalf, kLargestHalf);
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof(bits));
  const std::uint32_t sign = bits >> 16 & 0x8000u;
  bits &= 0x7fffffffu;
  if (bits < 0x38800000u) {  // subnormal: adding 0.5 shifts the mantissa to where it belongs
    float magnitude;
    std::memcpy(&magnitude, &bits, sizeof(bits));
    magnitude += 0.5f;
    std::memcpy(&bits, &magnitude, sizeof(bits));
    return sign | (bits - 0x3f000000u);
  }
  bits += 0xfffu + (bits >> 13 & 1u);
  return sign | ((bits - 0x38000000u) >> 13);
}

// In a float's fields, the bits of a half mean 2^-112 of its value, subnormal or not.
float fromHalf(std::uint32_t half) {
  const std::uint32_t bits = (half & 0x8000u) << 16 | (half & 0x7fffu) << 13;
  float value;
  std::memcpy(&value, &bits, sizeof(bits));
  return value * 0x1p112f;
}

std::uint32_t toLogScale(float scale) {
  const float octaves = std::log2(scale) - kLeastScaleLog2;  // minus infinity for 0
  if (!(octaves >= 0)) return 0;
  return 1u + std::uint32_t(nearest(std::min(octaves / kScaleOctaves, 1.0f) * kScaleSteps));
}

float fromLogScale(std::uint32_t code) {
  if (code == 0) return 0;
  return std::exp2(kLeastScaleLog2 + kScaleOctaves * float(code - 1) / kScaleSteps);
}

// A fraction from -1 to 1 as a signed number of `steps` to either side; mask: the bits to keep.
std::uint32_t toFraction(float value, float steps, std::uint32_t mask) {
  return std::uint32_t(nearest(std::clamp(value, -1.0f, 1.0f) * steps)) & mask;
}

std::uint64_t toSmallestThree(const std::array<float, 4>& orientation) {
  double length = 0;  // squared; in double it is only zero for a zero quaternion
  for (float v : orientation) length += double(v) * v;
  const auto magnitude = [](float a, float b) { return std::fabs(a) < std::fabs(b); };
  const auto missing = std::size_t(
      std::max_element(orientation.begin(), orientation.end(), magnitude) - orientation.begin());
  const double factor =
      std::copysign(1 / (std::sqrt(length) * kSqrtHalf), double(orientation[missing]));
  std::uint64_t packed = missing;
  for (std::size_t i = 0, shift = 2; i < 4; ++i) {
    if (i == missing) continue;
    packed |= std::uint64_t(toFraction(float(orientation[i] * factor), kQuaternionSteps, 0x7fffu))
              << shift;
    shift += 15;
  }
  return packed;
}

std::array<float, 4> fromSmallestThree(std::uint64_t packed) {
  const std::size_t missing = packed & 3u;
  std::array<float, 4> orientation{};
  float rest = 1;
  for (std::size_t i = 0, shift = 2; i < 4; ++i) {
    if (i == missing) continue;
    const auto bits = std::int32_t(std::uint32_t(packed >> shift) << 17) >> 17;
    orientation[i] = float(bits) / kQuaternionSteps * kSqrtHalf;
    rest -= orientation[i] * orientation[i];
    shift += 15;
  }
  orientation[missing] = std::sqrt(std::max(rest, 0.0f));
  return orientation;
}

}  // namespace

float extentOf(float opacity, float largest_scale) {
  if (!(opacity >= kCutoffAlpha)) return -1.0f;
  return std::sqrt(2.0f * std::log(255.0f * opacity)) * largest_scale;
}

Splat splatAt(const SplatArrays<const float>& arrays, std::size_t i) {
  Splat splat;
  std::copy_n(arrays.positions + 3 * i, 3, splat.position.begin());
  std::copy_n(arrays.orientations + 4 * i, 4, splat.orientation.begin());
  std::copy_n(arrays.scales + 3 * i, 3, splat.scale.begin());
  std::copy_n(arrays.sh + arrays.shStride() * i, 3, splat.color.begin());
  splat.opacity = arrays.opacities[i];
  return splat;
}

void packSlot(const Splat& splat, const float* sh, int sh_degree, std::uint32_t* slot,
              const std::array<std::uint32_t*, kMaxShDegree + 1>& bands) {
  const std::size_t coefficients = harmonicsOf(sh_degree) - 3;
  float largest = 0;
  for (std::size_t i = 0; i < coefficients; ++i) largest = std::max(largest, std::fabs(sh[i]));
  const std::uint32_t sh_scale = toHalf(largest);
  const float unit = fromHalf(sh_scale);

  std::memcpy(slot, splat.position.data(), sizeof(splat.position));
  slot[3] = std::uint32_t(nearest(std::clamp(splat.opacity, 0.0f, 1.0f) * 65535.0f)) |
            toLogScale(splat.scale[0]) << 16;
  slot[4] = toLogScale(splat.scale[1]) | toLogScale(splat.scale[2]) << 16;
  const std::uint64_t rotation = toSmallestThree(splat.orientation);
  slot[5] = std::uint32_t(rotation);
  slot[6] = std::uint32_t(rotation >> 32) | sh_scale << 16;
  slot[7] = toHalf(splat.color[0]) | toHalf(splat.color[1]) << 16;
  slot[8] = toHalf(splat.color[2]);

  const float fraction = unit > 0 ? 1 / unit : 0;
  for (int band = 1; band <= sh_degree; ++band) {
    for (int i = 0; i < kBandWords[band]; ++i, sh += 3) {
      bands[band][i] = toFraction(sh[0] * fraction, 1023, 0x7ffu) |
                       toFraction(sh[1] * fraction, 1023, 0x7ffu) << 11 |
                       toFraction(sh[2] * fraction, 511, 0x3ffu) << 22;
    }
  }
}

float slotOpacity(const std::uint32_t* slot) { return float(slot[3] & 0xffffu) / 65535.0f; }

float largestScale(const std::uint32_t* slot) {
  return fromLogScale(std::max({slot[3] >> 16, slot[4] & 0xffffu, slot[4] >> 16}));
}

Splat unpackSlot(const std::uint32_t* slot) {
  Splat splat;
  std::memcpy(splat.position.data(), slot, sizeof(splat.position));
  splat.opacity = slotOpacity(slot);
  splat.scale = {fromLogScale(slot[3] >> 16), fromLogScale(slot[4] & 0xffffu),
                 fromLogScale(slot[4] >> 16)};
  splat.orientation = fromSmallestThree(std::uint64_t(slot[6] & 0xffffu) << 32 | slot[5]);
  splat.color = {fromHalf(slot[7] & 0xffffu), fromHalf(slot[7] >> 16), fromHalf(slot[8] & 0xffffu)};
  return splat;
}

void unpackHarmonics(const std::uint32_t* slot, int sh_degree,
                     const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands, float* sh) {
  const float unit = fromHalf(slot[6] >> 16);
  const auto fraction = [unit](std::uint32_t word, int shift, int bits, float steps) {
    return float(std::int32_t(word << (32 - shift - bits)) >> (32 - bits)) * (unit / steps);
  };
  for (int band = 1; band <= sh_degree; ++band) {
    for (int i = 0; i < kBandWords[band]; ++i, sh += 3) {
      const std::uint32_t word = bands[band][i];
      sh[0] = fraction(word, 0, 11, 1023);
      sh[1] = fraction(word, 11, 11, 1023);
      sh[2] = fraction(word, 22, 10, 511);
    }
  }
}

std::vector<float> unpackHarmonics(
    const std::uint32_t* slot, int sh_degree,
    const std::array<const std::uint32_t*, kMaxShDegree + 1>& bands) {
  std::vector<float> sh(harmonicsOf(sh_degree) - 3);
  unpackHarmonics(slot, sh_degree, bands, sh.data());
  return sh;
}

}  // namespace rosplat
