#pragma once

#include "autodiff/tape.h"
#include "base/simd.h"
#include "fem/block.h"
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
/// @param corners  16 x #T workspace
template <class Real>
void add_transposed_gradient(const TetMesh<Real>& mesh, const ConstView<Real>& A,
                             const Matrix<Real>* scale, Real sign, View<Real> corners,
                             View<Real> y);

// -- the pieces, for operators that do more with a block of elements while they have it

/// The rows of x (#V x 3) one after another, each followed by a 0: a vertex is then one vector.
/// @return  #V x 4 in `memory`, row-major, valid until that is used again
template <class Real>
const Real* padded_rows(const ConstView<Real>& x, Workspace<Real>& memory);
/// F of elements begin, ..., begin + count - 1; further lanes repeat the last one.
/// @param x_rows  of padded_rows()
template <class Real>
void gradient_of_block(const TetMesh<Real>& mesh, const Real* x_rows, Index begin, Index count,
                       Block<Real, 9>& F);
/// (s_e A_e grad N_a, 0) for the corners a = 0, ..., 3 of those elements, into column e of
/// `corners`.
template <class Real>
void corners_of_block(const TetMesh<Real>& mesh, const Block<Real, 9>& A, const Block<Real, 1>& s,
                      Index begin, Index count, View<Real> corners);
/// y_i += sum of the corners (16 x #T) around vertex i, in ascending order.
template <class Real>
void sum_corners(const TetMesh<Real>& mesh, const ConstView<Real>& corners, View<Real> y);

}  // namespace nmp::fem
