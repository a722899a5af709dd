#include "autodiff/ops_loss.h"

#include <cmath>

#include "autodiff/loops.h"
#include "autodiff/ops_basic.h"

namespace nmp::ad {

// L = sum_i a_i^2,   a_bar_i = 2 a_i L_bar.
template <class Real>
Var<Real> squared_norm(Var<Real> a) {
  return sum(multiply(a, a));
}

template <class Real>
Var<Real> mean_square(Var<Real> a) {
  return mean(multiply(a, a));
}

// L = mean_i max(|a_i| - eps, 0)^2,   a_bar_i = 2 max(|a_i| - eps, 0) sign(a_i) / n L_bar.
template <class Real>
Var<Real> hinge_squared(Var<Real> a, Real eps) {
  using std::abs;
  NMP_CHECK(eps >= Real(0), text("hinge_squared needs eps >= 0, got ", eps));
  auto& tape = a.tape();
  const auto x = a.value();
  MatrixMap<Real> excess = tape.allocate(x.rows(), x.cols());
  for_entries(x.size(), [&](Index begin, Index n) {
    for (Index i = begin; i < begin + n; ++i) {
      const Real over = abs(x.data()[i]) - eps;
      excess.data()[i] = over < Real(0) ? Real(0) : over;  // keeps a NaN
    }
  });
  const Var<Real> over = tape.record("hinge", {a}, excess, [a](const ConstMatrixMap<Real>& bar) {
    const auto value = a.value();
    MatrixMap<Real> a_bar = a.bar();
    // The square that follows makes the adjoint continuous: bar is 0 wherever the excess is.
    for_entries(value.size(), [&](Index begin, Index n) {
      for (Index i = begin; i < begin + n; ++i)
        a_bar.data()[i] += value.data()[i] < Real(0) ? -bar.data()[i] : bar.data()[i];
    });
  });
  return mean_square(over);
}

#define NMP_INSTANTIATE(Real)                 \
  template Var<Real> squared_norm(Var<Real>); \
  template Var<Real> mean_square(Var<Real>);  \
  template Var<Real> hinge_squared(Var<Real>, Real);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
