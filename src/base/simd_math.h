#pragma once

#include <cmath>
#include <cstdint>

#include "base/simd.h"

#if defined(__AVX512DQ__)
#include <immintrin.h>
#endif

/// Functions of SIMD vectors, without branches: a lane's bits do not depend on the other lanes.
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
};
template <>
struct LaneBits<double> {
  using Vector = std::int64_t __attribute__((vector_size(kSimdBytes)));
  using Element = std::int64_t;
};
template <class Real>
using LaneMask = typename LaneBits<Real>::Vector;

template <class Real>
NMP_INLINE Lanes<Real> all_lanes(Real value) {
  return value - Lanes<Real>{};
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
  static constexpr float rounder = 0x1.8p23f;  // x + rounder has the nearest integer to x last
  static constexpr float largest = 112;        // 112 e^-112 is 0
  static constexpr std::int32_t bias = 127, mantissa = 23, lift = 64;
  static constexpr float normal = 86;  // x e^-x is a normal number up to there
  static constexpr float unlift = 0x1p-64f;
};
template <>
struct Exponential<double> {
  static constexpr double p[] = {
      0x1.0000000000001p-1,  0x1.5555555555556p-3,  0x1.5555555553d63p-5,  0x1.11111111109b3p-7,
      0x1.6c16c1788bd90p-10, 0x1.a01a01a7c41d5p-13, 0x1.a019b90d2ae7ap-16, 0x1.71de0dae63bb3p-19,
      0x1.289185613a3d6p-22, 0x1.af38a9b0ec855p-26};
  static constexpr double ln2_high = 0x1.62e42feep-1, ln2_low = 0x1.a39ef35793c76p-33;
  static constexpr double rounder = 0x1.8p52;
  static constexpr double largest = 760;
  static constexpr std::int64_t bias = 1023, mantissa = 52, lift = 128;
  static constexpr double normal = 707;
  static constexpr double unlift = 0x1p-128;
};
}  // namespace detail

/// y = x sigma(x), sigma(x) = 1 / (1 + e^-x) and 1 - sigma(x), each to 4 ulp, also where they are
/// no longer normal numbers. A NaN stays one.
template <class Real>
struct Silu {
  Lanes<Real> y, sigma, complement;
  /// dy/dx = sigma (1 + x (1 - sigma)).
  Lanes<Real> slope;
};

namespace detail {
// In `far` lanes, e^-|x| may not be a normal number: its powers of two come last, in two parts.
// Other lanes get the same bits with and without.
template <class Real, bool far>
NMP_INLINE Silu<Real> silu_of(Lanes<Real> x) {
  using E = Exponential<Real>;
  using V = Lanes<Real>;
  using Bits = LaneMask<Real>;
  V a = x, t = absolute<Real>(x);
  if constexpr (far) {
    const V lowest = all_lanes<Real>(-E::largest), highest = all_lanes<Real>(E::largest);
    a = x < lowest ? lowest : x;
    t = t > highest ? highest : t;
  }
  // e^-t = 2^k e^r.
  const V rounded = E::rounder - t * Real(1.4426950408889634);
  const V k = rounded - E::rounder;
  const V r = (-t - k * E::ln2_high) - k * E::ln2_low;
  constexpr int n = sizeof(E::p) / sizeof(E::p[0]);
  V p = all_lanes<Real>(E::p[n - 1]);
  NMP_UNROLL
  for (int i = n - 2; i >= 0; --i) p = p * r + E::p[i];
  p = r * r * p + r + Real(1);
  const Bits exponent = reinterpret_cast<Bits>(rounded) -
                        reinterpret_cast<Bits>(all_lanes<Real>(E::rounder)) +
                        (E::bias + (far ? E::lift : 0));
  const V power = reinterpret_cast<V>(exponent << E::mantissa);
  const Bits negative = a < Real(0);
  Silu<Real> result;
  if constexpr (far) {
    const V tail = all_lanes<Real>(E::unlift), one = all_lanes<Real>(1);
    const V large = Real(1) / (Real(1) + p * power * tail), small = p * large;
    const V first = negative ? power : one, second = negative ? tail : one;
    const V q = negative ? small : large;
    result.y = a * q * first * second;
    result.sigma = q * first * second;
    result.complement = negative ? large : small * power * tail;
  } else {
    const V e = p * power, large = Real(1) / (Real(1) + e), small = e * large;
    result.sigma = negative ? small : large;
    result.y = a * result.sigma;
    result.complement = negative ? large : small;
  }
  result.slope = result.sigma * (Real(1) + (negative ? a : t) * result.complement);
  return result;
}

template <class Real>
[[gnu::noinline]] Silu<Real> silu_far(Lanes<Real> x) {
  return silu_of<Real, true>(x);
}
}  // namespace detail

template <class Real>
NMP_INLINE Silu<Real> silu_parts(Lanes<Real> x) {
  // Not true of a NaN.
  const LaneMask<Real> near = absolute<Real>(x) <= Real(detail::Exponential<Real>::normal);
  if (__builtin_expect(any<Real>(~near), 0)) return detail::silu_far<Real>(x);
  return detail::silu_of<Real, false>(x);
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
