#pragma once

#include <cstdint>

/// Vectors of doubles, by GCC's and Clang's vector extension, for LaneSimulator.
namespace nmp::fem {

/// Eight lanes whatever the processor, in parts as wide as its registers: compilers split wider
/// vectors badly.
constexpr int kLanes = 8;
#if defined(__AVX512F__)
constexpr int kWidth = 8;
#elif defined(__AVX__)
constexpr int kWidth = 4;
#else
constexpr int kWidth = 2;
#endif
constexpr int kParts = kLanes / kWidth;
typedef double Lanes __attribute__((vector_size(8 * kWidth)));
typedef std::int64_t LaneFlags __attribute__((vector_size(8 * kWidth)));
typedef std::uint64_t LaneBits __attribute__((vector_size(8 * kWidth)));

constexpr double kLn2High = 0x1.62e42fefp-1, kLn2Low = 0x1.473de6af278edp-34;

/// ln J for normal J > 0 to 1 ulp, without a branch; anything for other J.
// J = 2^k m with m in [sqrt(1/2), sqrt(2)); f = m - 1, s = f / (2 + f) and
// ln m = 2 atanh(s) = f - (f^2/2 - s (f^2/2 + R)),  R = s^2 (2/3 + 2/5 s^2 + ...): here a
// polynomial in s^2 through 7 Chebyshev points of [0, 0.0295].
inline Lanes natural_log(const Lanes& J) {
  constexpr std::uint64_t kSqrtHalf = 0x3fe6a09e667f3bcd, kExponent = 0x7ff0000000000000;
  constexpr std::uint64_t kBias = std::uint64_t(1023) << 52;
  constexpr std::uint64_t kTwo52 = 0x4330000000000000;  // the bits of 2^52
  const LaneBits bits = reinterpret_cast<LaneBits>(J);
  const LaneBits from = bits - kSqrtHalf + kBias;  // exponent field k + 1023
  const LaneBits m_bits = bits - (from & kExponent) + kBias;
  const LaneBits k_bits = ((from & kExponent) >> 52) | kTwo52;
  const Lanes k = reinterpret_cast<Lanes>(k_bits) - (4503599627370496.0 + 1023.0);
  const Lanes f = reinterpret_cast<Lanes>(m_bits) - 1.0;
  const Lanes s = f / (2.0 + f), z = s * s, z2 = z * z;
  const Lanes R =
      z *
      ((0x1.5555555555558p-1 + z * 0x1.99999999952d7p-2) +
       z2 * ((0x1.2492492df281ap-2 + z * 0x1.c71c62e3f11e6p-3) +
             z2 * ((0x1.7462b51cb66b1p-3 + z * 0x1.39fe51a7c18f9p-3) + z2 * 0x1.2b5900de53b32p-3)));
  const Lanes half_f2 = 0.5 * f * f;
  return k * kLn2High - ((half_f2 - (s * (half_f2 + R) + k * kLn2Low)) - f);
}

}  // namespace nmp::fem
