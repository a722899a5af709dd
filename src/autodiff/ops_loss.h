#pragma once

#include "autodiff/tape.h"

namespace nmp::ad {

/// Sum of the squares of all entries: 1 x 1.
template <class Real>
Var<Real> squared_norm(Var<Real> a);
/// squared_norm / number of entries. @throws std::invalid_argument  if a is empty
template <class Real>
Var<Real> mean_square(Var<Real> a);
/// Mean over all entries of max(|a| - eps, 0)^2: 1 x 1. With a = det F - 1 this is the local volume
/// preservation (paper eq. 3) as a mean over elements. At the edge the adjoint is 0.
template <class Real>
Var<Real> hinge_squared(Var<Real> a, Real eps);

}  // namespace nmp::ad
