#pragma once

#include "autodiff/svd3.h"
#include "autodiff/tape.h"

namespace nmp::ad {

/// The decompositions of a batch, in a tape's arena, so that several operators can share them.
template <class Real>
struct Svd3Batch {
  MatrixMap<Real> U, sigma, V;  // #rows x 9, x 3, x 9
};

/// Two singular values are tied if they differ by at most kTieGap eps sigma_1, eps the unit spacing
/// at 1: computed values of an exact tie were seen to differ by 6 eps.
constexpr double kTieGap = 16;

/// Decomposes every row of F (#rows x 9) into memory of F's tape.
template <class Real>
Svd3Batch<Real> decompose(Var<Real> F);

/// Sigma - 1: #rows x 3, sorted, the last one signed (svd3.h).
/// Adjoint: F_bar += U diag(sigma_bar) V^T, exact for separate singular values. Where values of
/// equal size meet, so at F = I, sorting has a kink; there the adjoint is the mean over the tied
/// values (sigma_3 < 0 counting with its size): it does not depend on which U and V were found, is
/// unchanged by rotations of F, and is exact if what follows treats the tied values alike.
template <class Real>
Var<Real> singular_values_minus_one(Var<Real> F, const Svd3Batch<Real>& svd);
template <class Real>
Var<Real> singular_values_minus_one(Var<Real> F);

}  // namespace nmp::ad
