#pragma once

#include <vector>

#include "autodiff/tape.h"

/// Element-wise operators, columns and sums. Shapes must agree exactly unless a docstring says
/// otherwise; a mismatch throws std::invalid_argument with both shapes. Results are new values.
namespace nmp::ad {

/// Element-wise, same shapes.
template <class Real>
Var<Real> add(Var<Real> a, Var<Real> b);
template <class Real>
Var<Real> subtract(Var<Real> a, Var<Real> b);
template <class Real>
Var<Real> multiply(Var<Real> a, Var<Real> b);
template <class Real>
Var<Real> divide(Var<Real> a, Var<Real> b);

/// factor * a + offset, with constants.
template <class Real>
Var<Real> scale(Var<Real> a, Real factor, Real offset = Real(0));
/// s a, for s 1 x 1.
template <class Real>
Var<Real> scale_by(Var<Real> a, Var<Real> s);

template <class Real>
Var<Real> exp(Var<Real> a);
/// @throws std::invalid_argument  at the first entry <= 0 or NaN
template <class Real>
Var<Real> log(Var<Real> a);
/// @throws std::invalid_argument  at the first entry < 0 or NaN; the adjoint at 0 is infinite
template <class Real>
Var<Real> sqrt(Var<Real> a);

/// Columns of all inputs side by side; equal numbers of rows, at least one input.
template <class Real>
Var<Real> concat(const std::vector<Var<Real>>& parts);
/// Columns begin, ..., begin + n - 1.
template <class Real>
Var<Real> slice(Var<Real> a, Index begin, Index n);

/// 1 x 1, summed down the columns one after another in index order, in chunks of 1024 rows.
template <class Real>
Var<Real> sum(Var<Real> a);
/// sum / number of entries. @throws std::invalid_argument  if a is empty
template <class Real>
Var<Real> mean(Var<Real> a);

}  // namespace nmp::ad
