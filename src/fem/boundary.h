#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "autodiff/parameter.h"
#include "autodiff/tape.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

using ad::Var;

/// A half-space that vertices are kept in: n . x >= height.
template <class Real>
struct Plane {
  Vec3<Real> normal{0, 0, 1};  // n, of length 1
  Real height = 0;             // [m]
  Real friction = 0;           // Coulomb's mu [-]
};

/// Where a body is held (S_BC of Alg. 1) and what it may touch (C of Alg. 1).
template <class Real>
struct Boundary {
  std::vector<int> pinned;     // ascending, each once
  std::optional<Real> ground;  // height z of the ground plane [m]
  /// Coulomb's mu of the ground, 1 x 1 [-], differentiable; none: it is frictionless.
  std::shared_ptr<const ad::Parameter<Real>> friction = nullptr;
  /// More planes (fem/plane_contact.h). Integration nets and Simulator know only the ground.
  std::vector<Plane<Real>> planes = {};
  /// Where a step leaves the pinned vertices, one row each [m], [m/s]; empty: at rest.
  Matrix<Real> pin_x = {}, pin_v = {};
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

/// Moves pinned vertices.
/// @param x, v  one row for each of boundary.pinned [m], [m/s]
template <class Real>
void move_pins(Boundary<Real>& boundary, const Matrix<Real>& x, const Matrix<Real>& v);

/// S_BC: pinned vertices are put at their rest positions with velocity 0, or where they have been
/// moved to; the others pass bitwise. Adjoint: 0 at pinned vertices.
template <class Real>
Var<Real> pin_positions(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, Var<Real> x);
template <class Real>
Var<Real> pin_velocities(const Boundary<Real>& boundary, Var<Real> v);

/// The plain function, in place.
template <class Real>
void pin(const TetMesh<Real>& mesh, const Boundary<Real>& boundary, View<Real> x, View<Real> v);

}  // namespace nmp::fem
