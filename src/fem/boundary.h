#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "autodiff/parameter.h"
#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

using ad::Var;

/// Where a body is held (S_BC of Alg. 1) and what it may touch (C of Alg. 1).
template <class Real>
struct Boundary {
  std::vector<int> pinned;     // ascending, each once
  std::optional<Real> ground;  // height z of the ground plane [m]
  /// Coulomb's mu of the ground, 1 x 1 [-], differentiable; none: it is frictionless.
  std::shared_ptr<const ad::Parameter<Real>> friction = nullptr;
};

/// Sorts the pinned vertices and drops repetitions.
/// @throws std::invalid_argument  naming the first index outside the mesh
template <class Real>
Boundary<Real> make_boundary(const TetMesh<Real>& mesh, std::vector<int> pinned,
                             std::optional<Real> ground);
/// mu of a ground, frozen until asked for, named "friction".
/// @throws std::invalid_argument  unless it is >= 0 and finite
template <class Real>
std::shared_ptr<ad::Parameter<Real>> make_friction(double mu);

/// S_BC: pinned vertices are put at their rest positions with velocity 0; the others pass bitwise.
/// Adjoint: 0 at pinned vertices.
template <class Real>
Var<Real> pin_positions(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Var<Real> x);
template <class Real>
Var<Real> pin_velocities(const Boundary<Real>& boundary, Var<Real> v);

/// The plain function, in place.
template <class Real>
void pin(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, View<Real> x, View<Real> v);

}  // namespace nmp::fem
