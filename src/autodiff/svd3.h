#pragma once

#include "autodiff/types.h"

namespace nmp::ad {

template <class Real>
struct Svd3 {
  Mat3<Real> U, V;
  Vec3<Real> sigma;
};

/// Rotation-variant singular value decomposition F = U diag(sigma) V^T with det U = det V = +1,
/// sigma_1 >= sigma_2 >= |sigma_3|, the sign of sigma_3 that of det F. At F = I it returns U = V =
/// I exactly. One-sided Jacobi: accurate for rank-deficient F and for entries from 1e-150 to 1e150.
/// A non-finite F gives NaN in every entry.
template <class Real>
Svd3<Real> svd_rotation_variant(const Mat3<Real>& F);

/// Matrices or vectors side by side: entry k of item e is at[k * stride + e].
template <class Entry>
struct Strided {
  Entry* at;
  Index stride;
};
/// The same decomposition of `n` matrices at once, one per SIMD lane. A matrix's bits do not depend
/// on n or on the others; they may differ from the single one's by rounding.
template <class Real>
void svd_rotation_variant(Strided<const Real> F, Index n, Strided<Real> U, Strided<Real> sigma,
                          Strided<Real> V);

/// The decomposition of every row of a batch.   F #rows x 9  ->  U, V #rows x 9, sigma #rows x 3
template <class Real>
void svd_rotation_variant(const ConstView<Real>& F, View<Real> U, View<Real> sigma, View<Real> V);

}  // namespace nmp::ad
