#include "autodiff/ops_dense.h"

#include <algorithm>
#include <cmath>

#include "autodiff/gemm.h"
#include "autodiff/loops.h"
#include "base/simd_math.h"

namespace nmp::ad {

// y = x W^T,   x_bar += y_bar W,  W_bar += y_bar^T x.
template <class Real>
Var<Real> linear(Var<Real> x, Var<Real> W) {
  NMP_CHECK(x.cols() == W.cols(), text("linear needs x #rows x K and W N x K, got ",
                                       shape(x.value()), " and ", shape(W.value())));
  constexpr bool kFast = kHasLanes<Real>;
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

// y = x W,   x_bar += y_bar W^T,  W_bar += x^T y_bar.
template <class Real>
Var<Real> linear_transposed(Var<Real> x, Var<Real> W) {
  NMP_CHECK(x.cols() == W.rows(), text("linear_transposed needs x #rows x N and W N x K, got ",
                                       shape(x.value()), " and ", shape(W.value())));
  constexpr bool kFast = kHasLanes<Real>;
  MatrixMap<Real> y = x.tape().allocate(x.rows(), W.cols());
  y.setZero();
  if constexpr (kFast)
    multiply_adjoint_x<Real>(x.value(), W.value(), y);
  else
    multiply_adjoint_x_reference<Real>(x.value(), W.value(), y);
  return x.tape().record("linear_transposed", {x, W}, y, [x, W](const ConstMatrixMap<Real>& y_bar) {
    if constexpr (kFast) {
      if (x.needs_grad()) multiply<Real>(y_bar, W.value(), x.bar(), true);
      if (W.needs_grad()) multiply_adjoint_W<Real>(x.value(), y_bar, W.bar());
    } else {
      if (x.needs_grad()) multiply_reference<Real>(y_bar, W.value(), x.bar(), true);
      if (W.needs_grad()) multiply_adjoint_W_reference<Real>(x.value(), y_bar, W.bar());
    }
  });
}

namespace {

// y = a sigma(a) and, if wanted, sigma(a) = 1 / (1 + exp(-a)).
template <class Real>
void silu_lanes(const Real* a, Real* y, Real* sigma) {
  const Silu<Real> silu = silu_parts<Real>(load(a));
  store<Real>(y, silu.y);
  if (sigma) store<Real>(sigma, silu.sigma);
}

template <class Real>
void silu_range(const Real* a, Index n, Real* y, Real* sigma) {
  if constexpr (kHasLanes<Real>) {
    constexpr Index kWidth = kLanes<Real>;
    Index i = 0;
    for (; i + kWidth <= n; i += kWidth) silu_lanes(a + i, y + i, sigma ? sigma + i : nullptr);
    if (i == n) return;
    Real in[kWidth] = {}, y_out[kWidth], sigma_out[kWidth];
    std::copy(a + i, a + n, in);
    silu_lanes(in, y_out, sigma_out);
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

namespace {
// At +-infinity, sigma (1 - sigma) is 0 and must stay so: a finite bound in place of a does it.
template <class Real>
Real bounded(const Real& a) {
  constexpr double kFar = 1e4;
  const Real far = a < Real(-kFar) ? Real(-kFar) : a;
  return far > Real(kFar) ? Real(kFar) : far;
}
}  // namespace

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
    for_entries(x.size(), [&](Index begin, Index n) {
      const Real *in = x.data() + begin, *s = sigma + begin, *out_bar = y_bar.data() + begin;
      Real* in_bar = a_bar.data() + begin;
      for (Index i = 0; i < n; ++i)
        in_bar[i] += out_bar[i] * (s[i] * (Real(1) + bounded(in[i]) * (Real(1) - s[i])));
    });
  });
}

// y = sigma (1 + a (1 - sigma)),   a_bar += y_bar sigma (1 - sigma) (2 + a (1 - 2 sigma)).
template <class Real>
Var<Real> silu_slope(Var<Real> a) {
  auto& tape = a.tape();
  const auto x = a.value();
  MatrixMap<Real> y = tape.allocate(a.rows(), a.cols());
  Real* sigma = tape.template keep<Real>(y.size());
  silu_forward(x.data(), y.size(), y.data(), sigma);
  for_entries(y.size(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i)
      y.data()[i] = sigma[i] * (Real(1) + bounded(x.data()[i]) * (Real(1) - sigma[i]));
  });
  return tape.record("silu_slope", {a}, y, [a, sigma](const ConstMatrixMap<Real>& y_bar) {
    const auto in = a.value();
    MatrixMap<Real> a_bar = a.bar();
    for_entries(in.size(), [&](Index begin, Index n) {
      for (Index i = begin; i < begin + n; ++i) {
        const Real s = sigma[i], rest = Real(1) - s;
        a_bar.data()[i] +=
            y_bar.data()[i] * (s * rest * (Real(2) + bounded(in.data()[i]) * (rest - s)));
      }
    });
  });
}

#define NMP_INSTANTIATE(Real)                                 \
  template Var<Real> linear_transposed(Var<Real>, Var<Real>); \
  template Var<Real> silu_slope(Var<Real>);                   \
  template Var<Real> linear(Var<Real>, Var<Real>);            \
  template Var<Real> silu(Var<Real>);                         \
  template void silu_forward(const Real*, Index, Real*, Real*);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
