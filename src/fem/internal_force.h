#pragma once

#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

using ad::Var;

/// Elastic force on every vertex, f_int = -sum_e V_e P_e grad N_a   (paper Sec. 3.2; our minus
/// sign, so that E = sum_e V_e Psi(F_e), f_int = -dE/dx and M a = f_int + f_ext).
/// @param P  #T x 9  first Piola-Kirchhoff stress [Pa]
/// @return   #V x 3  force [N]
/// @throws std::invalid_argument  if P is not mesh.n_tets() x 9
/// Adjoint: P_bar_e += -V_e F_e(f_bar). Linear, keeps the mesh.
template <class Real>
Var<Real> internal_force(const TetMesh<Real>& mesh, Var<Real> P);

/// The plain function. @param corners  16 x #T workspace
template <class Real>
void internal_force(const TetMesh<Real>& mesh, const ConstView<Real>& P, View<Real> corners,
                    View<Real> f_int);

}  // namespace nmp::fem
