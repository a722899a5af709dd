#pragma once

#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

using ad::Var;

/// F_e = sum_a x_a (x) grad N_a   (paper Sec. 3.2)
/// @param x  #V x 3  deformed positions [m]
/// @return   #T x 9  deformation gradient [-]
/// Adjoint: x_bar_i += sum over corners of F_bar_e grad N_a. Linear, keeps the mesh.
template <class Real>
Var<Real> deformation_gradient(const TetMesh<Real>& mesh, Var<Real> x);

/// The plain function.
template <class Real>
void deformation_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& x, View<Real> F);

/// F_e += sign s_e F_e(x), with s_e = 1 for scale == nullptr: what the adjoint of internal_force
/// adds.
/// @param scale  s: #T x 1, or nullptr
template <class Real>
void add_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& x, const Matrix<Real>* scale,
                  Real sign, View<Real> F);

/// The transposed map, y_i += sign sum over the corners (e, a) of vertex i of s_e A_e grad N_a,
/// summed in ascending order of corners: the adjoint of deformation_gradient for s_e = 1, and
/// -f_int for s_e = V_e, A_e = P_e.
/// @param scale    s: #T x 1, or nullptr for 1
/// @param corners  #T x 12 workspace
template <class Real>
void add_transposed_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& A,
                             const Matrix<Real>* scale, Real sign, View<Real> corners,
                             View<Real> y);

}  // namespace nmp::fem
