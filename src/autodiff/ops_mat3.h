#pragma once

#include "autodiff/tape.h"

/// Operators on a 3x3 matrix per row, stored row by row in 9 columns.
namespace nmp::ad {

/// C_e = A_e B_e.   #rows x 9 each.
template <class Real>
Var<Real> mat3_product(Var<Real> A, Var<Real> B);
/// (A + A^T) / 2.
template <class Real>
Var<Real> mat3_symmetric(Var<Real> A);
/// det A: #rows x 1. Adjoint: A_bar += det_bar cof(A); no division.
template <class Real>
Var<Real> mat3_det(Var<Real> A);
/// cof A = det A A^-T, defined for every A.
template <class Real>
Var<Real> mat3_cofactor(Var<Real> A);
/// A^-1. @throws std::invalid_argument  at the first row whose determinant is 0 or not finite
template <class Real>
Var<Real> mat3_inverse(Var<Real> A);

/// C - I = F^T F - I = H + H^T + H^T H with H = F - I: #rows x 9. Nothing cancels near F = I.
template <class Real>
Var<Real> right_cauchy_green_minus_identity(Var<Real> F);
/// J - 1 = det F - 1 = tr H + (tr(H)^2 - tr(H^2)) / 2 + det H with H = F - I: #rows x 1.
template <class Real>
Var<Real> det_minus_one(Var<Real> F);

/// cof(F) = det F F^-T, by cross products: defined for every F.
template <class Real>
Mat3<Real> cofactor(const Mat3<Real>& F);

}  // namespace nmp::ad
