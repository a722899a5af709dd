#include "autodiff/ops_dense.h"

#include <cmath>
#include <cstdint>
#include <cstring>

#include "autodiff/gemm.h"
#include "autodiff/loops.h"
#include "base/simd.h"

namespace nmp::ad {

// y = x W^T,   x_bar += y_bar W,  W_bar += y_bar^T x.
template <class Real>
Var<Real> linear(Var<Real> x, Var<Real> W) {
  NMP_CHECK(x.cols() == W.cols(), text("linear needs x #rows x K and W N x K, got ",
                                       shape(x.value()), " and ", shape(W.value())));
  constexpr bool kFast = std::is_same_v<Real, float> || std::is_same_v<Real, double>;
  MatrixMap<Real> y = x.tape().allocate(x.rows(), W.rows());
  if constexpr (kFast)
    multiply<Real>(x.value(), W.value(), y);
  else
    multiply_reference<Real>(x.value(), W.value(), y, false);
  return x.tape().record("linear", {x, W}, y, [x, W](const ConstMatrixMap<Real>& y_bar) {
    if constexpr (kFast) {
      if (x.needs_grad()) multiply_adjoint_x<Real>(y_bar, W.value(), x.bar());
      if (W.needs_grad()) multiply_adjoint_W<Real>(y_bar, x.value(), W.bar());
    } else {
      if (x.needs_grad()) multiply_adjoint_x_reference<Real>(y_bar, W.value(), x.bar());
      if (W.needs_grad()) multiply_adjoint_W_reference<Real>(y_bar, x.value(), W.bar());
    }
  });
}

namespace {

// How exp(-t) = 2^-k exp(r), k = round(t / ln 2), r = k ln 2 - t in [-ln 2 / 2, ln 2 / 2] is
// computed.
template <class Real>
struct ExpTraits;

template <>
struct ExpTraits<float> {
  using Bits = std::uint32_t;
  static constexpr int kMantissa = 23, kBias = 127;
  // ln 2 = high + low; k times high is exact, since high has 10 bits and k is below 2^10.
  static constexpr float kLn2High = 0.693359375f, kLn2Low = -2.12194440054690583e-4f;
  static constexpr int kDegree = 7;           // r^8 / 8! < 6e-9
  static constexpr float kLargest = 112;      // 112 exp(-112) rounds to 0
  static constexpr float kRound = 0x1.8p23f;  // added, it leaves the rounded number in the low bits
};

template <>
struct ExpTraits<double> {
  using Bits = std::uint64_t;
  static constexpr int kMantissa = 52, kBias = 1023;
  static constexpr double kLn2High = 0.693145751953125, kLn2Low = 1.42860682030941723212e-6;
  static constexpr int kDegree = 13;       // r^14 / 14! < 5e-18
  static constexpr double kLargest = 760;  // 760 exp(-760) rounds to 0
  static constexpr double kRound = 0x1.8p52;
};

template <class To, class From>
To bit_cast(From from) {
  static_assert(sizeof(To) == sizeof(From));
  To to;
  std::memcpy(&to, &from, sizeof(to));
  return to;
}

// sum_k r^k / k!  for k = 0, ..., kDegree, by Horner's rule.
template <int kDegree, class Real>
Real exp_series(Real r) {
  constexpr double kFactorial[] = {1,        1,         2,          6,          24,
                                   120,      720,       5040.,      40320.,     362880.,
                                   3628800., 39916800., 479001600., 6227020800.};
  Real p = static_cast<Real>(1 / kFactorial[kDegree]);
  NMP_UNROLL
  for (int k = kDegree - 1; k >= 0; --k) p = p * r + static_cast<Real>(1 / kFactorial[k]);
  return p;
}

constexpr Index kSiluBlock = 64;

// y = a sigma(a), sigma(a) = 1 / (1 + exp(-a)), for exactly kSiluBlock entries: never a remainder
// loop, so an entry's bits do not depend on its place. With t = |a| and e = exp(-t) nothing
// overflows: sigma = 1 / (1 + e) for a >= 0 and e / (1 + e) for a < 0. The powers of two of a small
// e come last, and in two halves, so that y is accurate where sigma is no longer a normal number.
template <class Real>
[[gnu::noinline]] void silu_block(const Real* a, Real* __restrict y, Real* __restrict sigma) {
  using Traits = ExpTraits<Real>;
  using Bits = typename Traits::Bits;
  constexpr Real kLog2e = static_cast<Real>(1.44269504088896340736);
  Real in[kSiluBlock];
  std::memcpy(in, a, sizeof(in));
  for (Index i = 0; i < kSiluBlock; ++i) {
    const Real x = in[i] < -Traits::kLargest ? -Traits::kLargest : in[i];
    const bool negative = x < 0;
    const Real magnitude = negative ? -x : x;
    const Real t = magnitude > Traits::kLargest ? Traits::kLargest : magnitude;  // keeps a NaN

    const Real shifted = t * kLog2e + Traits::kRound;
    const Real k = shifted - Traits::kRound;
    const Real r = (k * Traits::kLn2High - t) + k * Traits::kLn2Low;
    const Real p = exp_series<Traits::kDegree>(r);
    const Bits k_bits = bit_cast<Bits>(shifted) - bit_cast<Bits>(Traits::kRound);
    const Bits k_half = k_bits >> 1;
    const Real half = bit_cast<Real>((Traits::kBias - k_half) << Traits::kMantissa);
    const Real rest = bit_cast<Real>((Traits::kBias - (k_bits - k_half)) << Traits::kMantissa);

    const Real quotient = (negative ? p : Real(1)) / (Real(1) + p * half * rest);
    const Real first = negative ? half : Real(1);
    const Real second = negative ? rest : Real(1);
    sigma[i] = quotient * first * second;
    y[i] = x * quotient * first * second;
  }
}

template <class Real>
void silu_range(const Real* a, Index n, Real* y, Real* sigma) {
  if constexpr (std::is_same_v<Real, float> || std::is_same_v<Real, double>) {
    Real unused[kSiluBlock];
    Index i = 0;
    for (; i + kSiluBlock <= n; i += kSiluBlock)
      silu_block(a + i, y + i, sigma ? sigma + i : unused);
    if (i == n) return;
    Real in[kSiluBlock] = {}, y_out[kSiluBlock], sigma_out[kSiluBlock];
    std::copy(a + i, a + n, in);
    silu_block(in, y_out, sigma_out);
    std::copy(y_out, y_out + (n - i), y + i);
    if (sigma) std::copy(sigma_out, sigma_out + (n - i), sigma + i);
  } else {
    using std::exp;
    for (Index i = 0; i < n; ++i) {
      const Real s = Real(1) / (Real(1) + exp(-a[i]));
      y[i] = a[i] * s;
      if (sigma) sigma[i] = s;
    }
  }
}

}  // namespace

template <class Real>
void silu_forward(const Real* a, Index n, Real* y, Real* sigma) {
  for_entries(n, [&](Index begin, Index size) {
    silu_range(a + begin, size, y + begin, sigma ? sigma + begin : nullptr);
  });
}

// y = a sigma,   a_bar += y_bar sigma (1 + a (1 - sigma)).
template <class Real>
Var<Real> silu(Var<Real> a) {
  auto& tape = a.tape();
  MatrixMap<Real> y = tape.allocate(a.rows(), a.cols());
  Real* sigma = a.needs_grad() ? tape.template keep<Real>(y.size()) : nullptr;
  silu_forward(a.value().data(), y.size(), y.data(), sigma);
  return tape.record("silu", {a}, y, [a, sigma](const ConstMatrixMap<Real>& y_bar) {
    const auto x = a.value();
    MatrixMap<Real> a_bar = a.bar();
    // At +-infinity, sigma (1 - sigma) is 0 and must stay so: a finite bound in its place does it.
    constexpr double kFar = 1e4;
    for_entries(x.size(), [&](Index begin, Index n) {
      const Real *in = x.data() + begin, *s = sigma + begin, *out_bar = y_bar.data() + begin;
      Real* in_bar = a_bar.data() + begin;
      for (Index i = 0; i < n; ++i) {
        const Real far = in[i] < Real(-kFar) ? Real(-kFar) : in[i];
        const Real near = far > Real(kFar) ? Real(kFar) : far;
        in_bar[i] += out_bar[i] * (s[i] * (Real(1) + near * (Real(1) - s[i])));
      }
    });
  });
}

#define NMP_INSTANTIATE(Real)                      \
  template Var<Real> linear(Var<Real>, Var<Real>); \
  template Var<Real> silu(Var<Real>);              \
  template void silu_forward(const Real*, Index, Real*, Real*);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
