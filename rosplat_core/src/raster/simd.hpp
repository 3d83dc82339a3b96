#pragma once

// Vectors of floats, as wide as the compiler's target has them: GCC's and Clang's own arithmetic,
// and the functions that it lacks. This file and those that include it may include nothing of the
// standard library but types: the linker might keep one target's copy of a function for all.

#include <cstdint>

#if defined(__SSE2__)
#include <immintrin.h>
#elif defined(__ARM_NEON) && defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace rosplat::cpu::ROSPLAT_TARGET {

#if defined(__AVX512F__)
constexpr int kLanes = 16;
#elif defined(__AVX2__)
constexpr int kLanes = 8;
#else
constexpr int kLanes = 4;
#endif

typedef float Floats __attribute__((vector_size(4 * kLanes)));
typedef std::int32_t Ints __attribute__((vector_size(4 * kLanes)));
typedef std::uint32_t Words __attribute__((vector_size(4 * kLanes)));
typedef std::uint16_t Halves __attribute__((vector_size(2 * kLanes)));
typedef std::uint8_t Bytes __attribute__((vector_size(kLanes)));

inline Floats all(float value) { return value - Floats{}; }
inline Ints allInts(std::int32_t value) { return value - Ints{}; }

// 0, 1, 2 and so on.
inline Floats counting() {
  Floats v;
  for (int i = 0; i < kLanes; ++i) v[i] = float(i);
  return v;
}

template <typename Vector, typename T>
Vector load(const T* from) {
  Vector v;
  __builtin_memcpy(&v, from, sizeof(v));
  return v;
}
inline Floats load(const float* from) { return load<Floats>(from); }
template <typename T, typename Vector>
void store(T* to, Vector v) {
  __builtin_memcpy(to, &v, sizeof(v));
}

// a * b + c; rounded once where the target can.
inline Floats fma(Floats a, Floats b, Floats c) {
#if defined(__AVX512F__)
  return _mm512_fmadd_ps(a, b, c);
#elif defined(__AVX2__)
  return _mm256_fmadd_ps(a, b, c);
#elif defined(__ARM_NEON) && defined(__aarch64__)
  return (Floats)vfmaq_f32((float32x4_t)c, (float32x4_t)a, (float32x4_t)b);
#else
  return a * b + c;
#endif
}

inline Floats sqrt(Floats v) {
#if defined(__AVX512F__)
  return _mm512_sqrt_ps(v);
#elif defined(__AVX2__)
  return _mm256_sqrt_ps(v);
#elif defined(__SSE2__)
  return _mm_sqrt_ps(v);
#else
  for (int i = 0; i < kLanes; ++i) v[i] = __builtin_sqrtf(v[i]);
  return v;
#endif
}

// min() and max() return b if either is NaN.
inline Floats min(Floats a, Floats b) {
#if defined(__AVX512F__)
  return _mm512_min_ps(a, b);
#elif defined(__AVX2__)
  return _mm256_min_ps(a, b);
#elif defined(__SSE2__)
  return _mm_min_ps(a, b);
#else
  return a < b ? a : b;
#endif
}
inline Floats max(Floats a, Floats b) {
#if defined(__AVX512F__)
  return _mm512_max_ps(a, b);
#elif defined(__AVX2__)
  return _mm256_max_ps(a, b);
#elif defined(__SSE2__)
  return _mm_max_ps(a, b);
#else
  return a > b ? a : b;
#endif
}
inline Floats clamp(Floats v, Floats least, Floats most) { return min(max(v, least), most); }
inline Floats abs(Floats v) { return (Floats)((Ints)v & 0x7fffffff); }
inline Ints min(Ints a, Ints b) { return a < b ? a : b; }
inline Ints max(Ints a, Ints b) { return a > b ? a : b; }

// Whether any lane is true (-1).
inline bool any(Ints where) {
#if defined(__AVX512F__)
  return _mm512_test_epi32_mask((__m512i)where, (__m512i)where);
#elif defined(__AVX2__)
  return _mm256_movemask_ps((__m256)where);
#elif defined(__SSE2__)
  return _mm_movemask_ps((__m128)where);
#else
  return where[0] | where[1] | where[2] | where[3];
#endif
}

inline Floats toFloats(Ints v) { return __builtin_convertvector(v, Floats); }
// Rounds towards zero. Values must fit an int32.
inline Ints toInts(Floats v) { return __builtin_convertvector(v, Ints); }
inline Floats floor(Floats v) {
  const Ints fits = abs(v) < 8388608.0f;  // from 2^23 on, all floats are integers
  const Floats whole = toFloats(toInts(fits ? v : Floats{}));
  return fits ? whole + toFloats(whole > v) : v;  // true is -1
}

inline Floats gather(const float* from, Ints index) {
#if defined(__AVX512F__)
  return _mm512_i32gather_ps((__m512i)index, from, 4);
#elif defined(__AVX2__)
  return _mm256_i32gather_ps(from, (__m256i)index, 4);
#else
  Floats v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[index[i]];
  return v;
#endif
}
inline Words gather(const std::uint32_t* from, Ints index) {
#if defined(__AVX512F__)
  return (Words)_mm512_i32gather_epi32((__m512i)index, from, 4);
#elif defined(__AVX2__)
  return (Words)_mm256_i32gather_epi32((const int*)from, (__m256i)index, 4);
#else
  Words v;
  for (int i = 0; i < kLanes; ++i) v[i] = from[index[i]];
  return v;
#endif
}

// Loads four words from each of kLanes addresses: to[k][lane] = from[lane][k].
inline void loadFour(const std::uint32_t* const (&from)[kLanes], int first, Words* to) {
#if defined(__SSE2__)
  // Four rows in each 128 bits of four vectors: a 4x4 transposition there puts all lanes in place.
  const auto at = [&](int lane) { return (const __m128i*)(from[lane] + first); };
#if defined(__AVX512F__)
  typedef __m512i Wide;
  const auto rows = [&](int lane) {
    Wide v = _mm512_castsi128_si512(_mm_loadu_si128(at(lane)));
    v = _mm512_inserti32x4(v, _mm_loadu_si128(at(lane + 4)), 1);
    v = _mm512_inserti32x4(v, _mm_loadu_si128(at(lane + 8)), 2);
    return _mm512_inserti32x4(v, _mm_loadu_si128(at(lane + 12)), 3);
  };
#define UNPACK(half, bits, a, b) _mm512_unpack##half##_epi##bits(a, b)
#elif defined(__AVX2__)
  typedef __m256i Wide;
  const auto rows = [&](int lane) {
    return _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128(at(lane))),
                                   _mm_loadu_si128(at(lane + 4)), 1);
  };
#define UNPACK(half, bits, a, b) _mm256_unpack##half##_epi##bits(a, b)
#else
  typedef __m128i Wide;
  const auto rows = [&](int lane) { return _mm_loadu_si128(at(lane)); };
#define UNPACK(half, bits, a, b) _mm_unpack##half##_epi##bits(a, b)
#endif
  const Wide a = rows(0), b = rows(1), c = rows(2), d = rows(3);
  const Wide low_ab = UNPACK(lo, 32, a, b), high_ab = UNPACK(hi, 32, a, b);
  const Wide low_cd = UNPACK(lo, 32, c, d), high_cd = UNPACK(hi, 32, c, d);
  to[0] = (Words)UNPACK(lo, 64, low_ab, low_cd);
  to[1] = (Words)UNPACK(hi, 64, low_ab, low_cd);
  to[2] = (Words)UNPACK(lo, 64, high_ab, high_cd);
  to[3] = (Words)UNPACK(hi, 64, high_ab, high_cd);
#undef UNPACK
#else
  for (int k = 0; k < 4; ++k) {
    for (int lane = 0; lane < kLanes; ++lane) to[k][lane] = from[lane][first + k];
  }
#endif
}

// 2^v for v of -126 to 127, with a relative error of 2e-7.
inline Floats exp2(Floats v) {
  const Floats rounder = all(12582912.0f);  // 1.5 * 2^23: a sum's low bits are v, rounded
  const Floats sum = v + rounder;
  const Floats f = v - (sum - rounder);
  Floats p = all(1.5403530e-4f);  // Taylor's, of e^(f ln 2)
  p = fma(p, f, all(1.3333558e-3f));
  p = fma(p, f, all(9.6181291e-3f));
  p = fma(p, f, all(5.5504109e-2f));
  p = fma(p, f, all(2.4022651e-1f));
  p = fma(p, f, all(6.9314718e-1f));
  p = fma(p, f, all(1.0f));
  return (Floats)((Ints)p + ((Ints)sum << 23));
}

// log2(v) for normal v > 0, with an error of 1e-7 plus 2e-7 of the result.
inline Floats log2(Floats v) {
  // v = m 2^e, m from sqrt(1/2) on; log2(m) = 2 atanh((m - 1) / (m + 1)) / ln 2.
  const Ints e = ((Ints)v - 0x3f3504f3) >> 23;
  const Floats m = (Floats)((Ints)v - (e << 23));
  const Floats s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
  Floats p = all(0.32059890f);  // 2 / (9 ln 2)
  p = fma(p, s2, all(0.41219858f));
  p = fma(p, s2, all(0.57707802f));
  p = fma(p, s2, all(0.96179669f));
  p = fma(p, s2, all(2.88539008f));
  return fma(s, p, toFloats(e));
}

// Converts half floats, in the lower 16 bits. Infinity and NaN are not supported.
inline Floats halfToFloats(Words half) {
  const Floats magnitude = (Floats)((half & 0x7fffu) << 13) * 0x1p112f;
  return (Floats)((Words)magnitude | (half & 0x8000u) << 16);
}

}  // namespace rosplat::cpu::ROSPLAT_TARGET
