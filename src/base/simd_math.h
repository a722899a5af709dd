#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "base/simd.h"

#if defined(__AVX__)
#include <immintrin.h>
#endif

/// Functions of SIMD vectors: a lane's bits do not depend on the other lanes.
namespace nmp {

template <class Real>
using Lanes = typename Simd<Real>::Vector;

/// Integers as wide as Real, one per lane: what a comparison of two Lanes<Real> gives, 0 or all
/// bits.
template <class Real>
struct LaneBits;
template <>
struct LaneBits<float> {
  using Vector = std::int32_t __attribute__((vector_size(kSimdBytes)));
  using Element = std::int32_t;
  static constexpr Element magnitude = 0x7fffffff;
};
template <>
struct LaneBits<double> {
  using Vector = std::int64_t __attribute__((vector_size(kSimdBytes)));
  using Element = std::int64_t;
  static constexpr Element magnitude = 0x7fffffffffffffff;
};
template <class Real>
using LaneMask = typename LaneBits<Real>::Vector;
template <class Real>
using LaneElement = typename LaneBits<Real>::Element;

template <class Real>
NMP_INLINE Lanes<Real> all_lanes(Real value) {
  return value - Lanes<Real>{};
}

/// 0, 1, 2, ...
template <class Real>
NMP_INLINE LaneMask<Real> lane_numbers() {
  LaneMask<Real> numbers = {};
  for (int l = 0; l < kLanes<Real>; ++l) numbers[l] = l;
  return numbers;
}

// Loops over the lanes, since the vector extension has no functions; one instruction each.
template <class Real>
NMP_INLINE Lanes<Real> square_root(Lanes<Real> x) {
  for (int l = 0; l < kLanes<Real>; ++l) x[l] = std::sqrt(x[l]);
  return x;
}

template <class Real>
NMP_INLINE Lanes<Real> absolute(Lanes<Real> x) {
  for (int l = 0; l < kLanes<Real>; ++l) x[l] = std::abs(x[l]);
  return x;
}

/// 1 / x and 1 / sqrt(x) with 11 correct bits at least: fast where the processor has them, to the
/// last bit elsewhere.
template <class Real>
NMP_INLINE Lanes<Real> rough_reciprocal(Lanes<Real> x) {
#if defined(__AVX512F__)
  if constexpr (sizeof(Real) == 4) return (Lanes<Real>)_mm512_rcp14_ps((__m512)x);
#elif defined(__AVX__)
  if constexpr (sizeof(Real) == 4) return (Lanes<Real>)_mm256_rcp_ps((__m256)x);
#endif
  return Real(1) / x;
}
template <class Real>
NMP_INLINE Lanes<Real> rough_reciprocal_root(Lanes<Real> x) {
#if defined(__AVX512F__)
  if constexpr (sizeof(Real) == 4) return (Lanes<Real>)_mm512_rsqrt14_ps((__m512)x);
#elif defined(__AVX__)
  if constexpr (sizeof(Real) == 4) return (Lanes<Real>)_mm256_rsqrt_ps((__m256)x);
#endif
  return Real(1) / square_root<Real>(x);
}

/// a - b c, rounded once: only where kFusedSteps<Real>.
#if defined(__AVX512F__)
template <class Real>
inline constexpr bool kFusedSteps = sizeof(Real) == 4;
NMP_INLINE Lanes<float> fused_step(Lanes<float> a, Lanes<float> b, Lanes<float> c) {
  return (Lanes<float>)_mm512_fnmadd_ps((__m512)b, (__m512)c, (__m512)a);
}
#elif defined(__AVX__) && defined(__FMA__)
template <class Real>
inline constexpr bool kFusedSteps = sizeof(Real) == 4;
NMP_INLINE Lanes<float> fused_step(Lanes<float> a, Lanes<float> b, Lanes<float> c) {
  return (Lanes<float>)_mm256_fnmadd_ps((__m256)b, (__m256)c, (__m256)a);
}
#else
template <class Real>
inline constexpr bool kFusedSteps = false;
#endif

/// 1 / x to 1 ulp, for normal numbers of which that is one too.
template <class Real>
NMP_INLINE Lanes<Real> reciprocal(Lanes<Real> x) {
#if defined(__AVX512F__)
  if constexpr (sizeof(Real) == 4) {
    // A Newton step: faster than a division where many are needed.
    const Lanes<Real> y = rough_reciprocal<Real>(x);
    return y + y * fused_step(all_lanes<Real>(1), x, y);
  }
#endif
  return Real(1) / x;
}

template <class Real>
NMP_INLINE bool any(LaneMask<Real> mask) {
#if defined(__AVX512DQ__)
  if constexpr (sizeof(Real) == 4) return _mm512_movepi32_mask((__m512i)mask) != 0;
  return _mm512_movepi64_mask((__m512i)mask) != 0;
#else
  typename LaneBits<Real>::Element bits = 0;
  for (int l = 0; l < kLanes<Real>; ++l) bits |= mask[l];
  return bits != 0;
#endif
}

namespace detail {
// e^r = 1 + r + r^2 p(r) on |r| <= ln 2 / 2, p through Chebyshev points: to 1e-8 and 2e-17.
template <class Real>
struct Exponential;
template <>
struct Exponential<float> {
  static constexpr float p[] = {0x1.000000p-1f, 0x1.5554dcp-3f, 0x1.55551ap-5f, 0x1.120b6ep-7f,
                                0x1.6d1110p-10f};
  static constexpr float ln2_high = 0x1.62e4p-1f, ln2_low = 0x1.7f7d1cp-20f;
  static constexpr float rounder = 0x1.8p23f + 127;  // x + rounder ends with x, rounded, + bias
  static constexpr float largest = 112;              // 112 e^-112 is 0
  static constexpr std::int32_t mantissa = 23, lift = 64;
  static constexpr float near = 40;  // up to there a fused step with ln 2 as a float does
  static constexpr float unlift = 0x1p-64f;
};
template <>
struct Exponential<double> {
  static constexpr double p[] = {
      0x1.0000000000001p-1,  0x1.5555555555556p-3,  0x1.5555555553d63p-5,  0x1.11111111109b3p-7,
      0x1.6c16c1788bd90p-10, 0x1.a01a01a7c41d5p-13, 0x1.a019b90d2ae7ap-16, 0x1.71de0dae63bb3p-19,
      0x1.289185613a3d6p-22, 0x1.af38a9b0ec855p-26};
  static constexpr double ln2_high = 0x1.62e42feep-1, ln2_low = 0x1.a39ef35793c76p-33;
  static constexpr double rounder = 0x1.8p52 + 1023;
  static constexpr double largest = 760;
  static constexpr std::int64_t mantissa = 52, lift = 128;
  static constexpr double near = 707;  // x e^-x is a normal number up to there
  static constexpr double unlift = 0x1p-128;
};
}  // namespace detail

namespace detail {
// Of the rows a and b of a matrix, `d` apart: its blocks of d x d, those off the diagonal
// exchanged.
template <class Real, int d, std::size_t... l>
NMP_INLINE void exchange(Lanes<Real>& a, Lanes<Real>& b, std::index_sequence<l...>) {
  constexpr int n = kLanes<Real>;
  const Lanes<Real> low =
      __builtin_shufflevector(a, b, (l & d ? n + static_cast<int>(l) - d : static_cast<int>(l))...);
  b = __builtin_shufflevector(a, b, (l & d ? n + static_cast<int>(l) : static_cast<int>(l) + d)...);
  a = low;
}
template <class Real, int d>
NMP_INLINE void transpose_steps(Lanes<Real> (&rows)[kLanes<Real>]) {
  if constexpr (d < kLanes<Real>) {
    NMP_UNROLL
    for (int i = 0; i < kLanes<Real>; ++i)
      if (!(i & d))
        exchange<Real, d>(rows[i], rows[i + d], std::make_index_sequence<kLanes<Real>>());
    transpose_steps<Real, 2 * d>(rows);
  }
}
}  // namespace detail

/// rows[i][l] <-> rows[l][i].
template <class Real>
NMP_INLINE void transpose(Lanes<Real> (&rows)[kLanes<Real>]) {
  detail::transpose_steps<Real, 1>(rows);
}

/// to(k, r) = from(r, k) for `rows` rows of `from`, each of `columns` numbers. Whole vectors are
/// read and written: the memory of the rows of both must reach to multiples of kLanes.
template <class Real, class Index>
void transpose_padded(const Real* from, Index from_stride, Index rows, Index columns, Real* to,
                      Index to_stride) {
  constexpr Index kWidth = kLanes<Real>;
  for (Index r = 0; r < rows; r += kWidth) {
    for (Index k = 0; k < columns; k += kWidth) {
      Lanes<Real> block[kWidth];
      NMP_UNROLL
      for (Index i = 0; i < kWidth; ++i)
        block[i] = r + i < rows ? load(from + (r + i) * from_stride + k) : Lanes<Real>{};
      transpose<Real>(block);
      const Index n = columns - k < kWidth ? columns - k : kWidth;
      for (Index i = 0; i < n; ++i) store<Real>(to + (k + i) * to_stride + r, block[i]);
    }
  }
}

/// y = x sigma(x), sigma(x) = 1 / (1 + e^-x) and 1 - sigma(x), each to 4 ulp, also where they are
/// no longer normal numbers. A NaN stays one.
template <class Real>
struct Silu {
  Lanes<Real> y, sigma, complement;
  /// dy/dx = sigma (1 + x (1 - sigma)).
  Lanes<Real> slope;
};

namespace detail {
// e^t = p 2^k for t in [-largest, largest], p in [2^-1/2, 2^1/2]; the last bits of `rounded` hold
// k.
template <class Real>
struct Power {
  Lanes<Real> p, rounded;
};
template <class Real, bool near>
NMP_INLINE Power<Real> exponential_parts(Lanes<Real> t) {
  using E = Exponential<Real>;
  const Lanes<Real> rounded = E::rounder + t * Real(1.4426950408889634);
  const Lanes<Real> k = rounded - E::rounder;
  Lanes<Real> r;
  if constexpr (near && kFusedSteps<Real>)
    r = fused_step(t, k, all_lanes<Real>(Real(0.6931471805599453)));
  else
    r = (t - k * E::ln2_high) - k * E::ln2_low;
  constexpr int n = sizeof(E::p) / sizeof(E::p[0]);
  Lanes<Real> p = all_lanes<Real>(E::p[n - 1]);
  NMP_UNROLL
  for (int i = n - 2; i >= 0; --i) p = p * r + E::p[i];
  p = p * r + Real(1);
  return {p * r + Real(1), rounded};
}

}  // namespace detail

/// For x that is_near().
template <class Real>
NMP_INLINE Silu<Real> silu_near(Lanes<Real> x) {
  using E = detail::Exponential<Real>;
  const detail::Power<Real> power = detail::exponential_parts<Real, true>(-x);
  // The shift leaves k + bias alone: the rounder ends with the bias.
  const Lanes<Real> scale =
      reinterpret_cast<Lanes<Real>>(reinterpret_cast<LaneMask<Real>>(power.rounded) << E::mantissa);
  const Lanes<Real> e = power.p * scale;
  Silu<Real> result;
  result.sigma = reciprocal<Real>(Real(1) + e);
  result.complement = e * result.sigma;
  result.y = x * result.sigma;
  result.slope = result.sigma + result.y * result.complement;
  return result;
}

namespace detail {
// For any x: e^-|x| may not be a normal number, so that its powers of two come last, in two parts.
// Lanes that are near get the bits of silu_near().
template <class Real>
[[gnu::noinline]] Silu<Real> silu_anywhere(Lanes<Real> x, LaneMask<Real> near) {
  using E = Exponential<Real>;
  using V = Lanes<Real>;
  const V one = all_lanes<Real>(1), tail = all_lanes<Real>(E::unlift);
  const V largest = all_lanes<Real>(E::largest);
  const V a = x < -largest ? -largest : x;
  V t = absolute<Real>(x);
  t = t > largest ? largest : t;
  const Power<Real> power = exponential_parts<Real, false>(-t);
  // The exponent of 2^(k + lift), never below the normal ones.
  const V scale = reinterpret_cast<V>((reinterpret_cast<LaneMask<Real>>(power.rounded) + E::lift)
                                      << E::mantissa);
  const V large = Real(1) / (Real(1) + power.p * scale * tail), small = power.p * large;
  const LaneMask<Real> negative = a < Real(0);
  const V first = negative ? scale : one, second = negative ? tail : one;
  const V q = negative ? small : large;
  Silu<Real> far;
  far.y = a * q * first * second;
  far.sigma = q * first * second;
  far.complement = negative ? large : small * scale * tail;
  far.slope = far.sigma * (Real(1) + (negative ? a : t) * far.complement);

  const Silu<Real> result = silu_near<Real>(near ? x : V{});
  return {near ? result.y : far.y, near ? result.sigma : far.sigma,
          near ? result.complement : far.complement, near ? result.slope : far.slope};
}
}  // namespace detail

/// The bits of |x|, or `than` where that is larger; those of a NaN are larger than any number's.
template <class Real>
NMP_INLINE LaneMask<Real> larger_magnitude(LaneMask<Real> than, Lanes<Real> x) {
  const LaneMask<Real> bits = reinterpret_cast<LaneMask<Real>>(x) & LaneBits<Real>::magnitude;
  return bits > than ? bits : than;
}
/// Whether all numbers of that magnitude are such that silu_near() is right for them.
template <class Real>
NMP_INLINE bool is_near(LaneMask<Real> magnitude) {
  const auto limit = reinterpret_cast<LaneMask<Real>>(
      all_lanes<Real>(static_cast<Real>(detail::Exponential<Real>::near)));
  return !any<Real>(magnitude > limit);
}

template <class Real>
NMP_INLINE Silu<Real> silu_parts(Lanes<Real> x) {
  // Not true of a NaN.
  const LaneMask<Real> near = absolute<Real>(x) <= Real(detail::Exponential<Real>::near);
  if (__builtin_expect(any<Real>(~near), 0)) return detail::silu_anywhere<Real>(x, near);
  return silu_near<Real>(x);
}

template <class Real>
NMP_INLINE Lanes<Real> silu(Lanes<Real> x) {
  return silu_parts<Real>(x).y;
}
template <class Real>
NMP_INLINE Lanes<Real> silu_slope(Lanes<Real> x) {
  return silu_parts<Real>(x).slope;
}

}  // namespace nmp
