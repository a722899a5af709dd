#pragma once

#include <cmath>
#include <cstdint>

#include "base/simd.h"

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
  typename LaneBits<Real>::Element bits = 0;
  for (int l = 0; l < kLanes<Real>; ++l) bits |= mask[l];
  return bits != 0;
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
  static constexpr float largest = 104;        // e^-104 is 0
  static constexpr std::int32_t bias = 127, mantissa = 23;
};
template <>
struct Exponential<double> {
  static constexpr double p[] = {
      0x1.0000000000001p-1,  0x1.5555555555556p-3,  0x1.5555555553d63p-5,  0x1.11111111109b3p-7,
      0x1.6c16c1788bd90p-10, 0x1.a01a01a7c41d5p-13, 0x1.a019b90d2ae7ap-16, 0x1.71de0dae63bb3p-19,
      0x1.289185613a3d6p-22, 0x1.af38a9b0ec855p-26};
  static constexpr double ln2_high = 0x1.62e42feep-1, ln2_low = 0x1.a39ef35793c76p-33;
  static constexpr double rounder = 0x1.8p52;
  static constexpr double largest = 746;
  static constexpr std::int64_t bias = 1023, mantissa = 52;
};
}  // namespace detail

/// e^-|x|, NaN counting as a large number.
template <class Real>
NMP_INLINE Lanes<Real> exp_of_minus_absolute(Lanes<Real> x) {
  using E = detail::Exponential<Real>;
  using V = Lanes<Real>;
  using Bits = LaneMask<Real>;
  const V size = absolute<Real>(x);
  const V limit = all_lanes<Real>(E::largest);
  const V y = -(size < limit ? size : limit);
  // y = k ln 2 + r.
  const V rounded = y * Real(1.4426950408889634) + E::rounder;
  const V k = rounded - E::rounder;
  const V r = (y - k * E::ln2_high) - k * E::ln2_low;
  constexpr int n = sizeof(E::p) / sizeof(E::p[0]);
  V p = all_lanes<Real>(E::p[n - 1]);
  NMP_UNROLL
  for (int i = n - 2; i >= 0; --i) p = p * r + E::p[i];
  // times 2^(k + 64), then 2^-64, since 2^k itself may have no exponent of its own.
  const Bits exponent = reinterpret_cast<Bits>(rounded) -
                        reinterpret_cast<Bits>(all_lanes<Real>(E::rounder)) + (E::bias + 64);
  const V power = reinterpret_cast<V>(exponent << E::mantissa);
  return (r * r * p + r + Real(1)) * power * Real(0x1p-64);
}

/// sigma(x) = 1 / (1 + e^-x) and 1 - sigma(x), each to about 2 ulp.
template <class Real>
struct Sigmoid {
  Lanes<Real> value, complement;
};
template <class Real>
NMP_INLINE Sigmoid<Real> sigmoid(Lanes<Real> x) {
  const Lanes<Real> e = exp_of_minus_absolute<Real>(x);
  const Lanes<Real> large = Real(1) / (Real(1) + e), small = e * large;
  const LaneMask<Real> positive = x > Real(0);
  return {positive ? large : small, positive ? small : large};
}

/// x sigma(x), to 4 ulp for |x| <= 88.
template <class Real>
NMP_INLINE Lanes<Real> silu(Lanes<Real> x) {
  return x * sigmoid<Real>(x).value;
}

/// Its derivative sigma (1 + x (1 - sigma)).
template <class Real>
NMP_INLINE Lanes<Real> silu_slope(Lanes<Real> x) {
  const Sigmoid<Real> s = sigmoid<Real>(x);
  return s.value * (Real(1) + x * s.complement);
}

}  // namespace nmp
