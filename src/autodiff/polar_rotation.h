#pragma once

#include <atomic>
#include <cstdint>

#include "autodiff/singular_values.h"
#include "autodiff/svd3.h"
#include "autodiff/tape.h"

namespace nmp::ad {

/// R = U V^T of F = U diag(sigma) V^T (svd3.h): #rows x 9.
/// Adjoint: F_bar += U W V^T, W_ij = (A_ij - A_ji) / (sigma_i + sigma_j), A = U^T R_bar V: only
/// sums of singular values divide, so it is exact at F = I (lineage of the formula: differentiate
/// R, not U and V). A sum below kMinSigmaSum is replaced by it and counted.
template <class Real>
Var<Real> polar_rotation(Var<Real> F, const Svd3Batch<Real>& svd);
template <class Real>
Var<Real> polar_rotation(Var<Real> F);

/// The sum of two singular values below which the rotation is not determined by F: reached only by
/// elements that are inverted or crushed to a line. 1e-6 bounds the adjoint at 1e6 times R_bar.
constexpr double kMinSigmaSum = 1e-6;

/// The adjoint on one matrix.
template <class Real>
Mat3<Real> polar_rotation_adjoint(const Svd3<Real>& svd, const Mat3<Real>& R_bar);

namespace detail {
inline std::atomic<std::uint64_t> polar_rotation_floors{0};
}

/// How often the floor kMinSigmaSum has acted in adjoints of this process.
inline std::uint64_t polar_rotation_floor_count() { return detail::polar_rotation_floors; }

}  // namespace nmp::ad
