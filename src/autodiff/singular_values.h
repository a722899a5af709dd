#pragma once

#include <limits>

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

/// Sorted singular values have a kink where two of them meet; the basis U, V is arbitrary there.
/// The mean of the tied adjoints is the choice that does not depend on the basis. s2 takes part
/// with its size: its sign is turned off and on again. Without branches, for loops over lanes.
template <class Real>
inline void average_ties(Real s0, Real s1, Real s2, Real& b0, Real& b1, Real& b2) {
  const Real gap = Real(kTieGap * double(std::numeric_limits<Real>::epsilon())) * s0;
  const Real sign = s2 < Real(0) ? Real(-1) : Real(1);
  const bool tie_01 = s0 - s1 <= gap, tie_12 = s1 - sign * s2 <= gap;
  const Real last = b2 * sign;
  const Real all = (b0 + b1 + last) / Real(3), first = (b0 + b1) / Real(2),
             second = (b1 + last) / Real(2);
  const Real with_0 = tie_12 ? all : first;  // the mean over those tied to s0, if any
  const Real with_2 = tie_01 ? all : second;
  b0 = tie_01 ? with_0 : b0;
  b1 = tie_01 ? with_0 : (tie_12 ? with_2 : b1);
  b2 = sign * (tie_12 ? with_2 : last);
}

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
