#pragma once

#include <optional>
#include <string>
#include <vector>

#include "autodiff/types.h"

namespace nmp::fem {

/// First and second Lame constants [Pa].
struct Lame {
  double mu, lambda;
};

/// mu = E / (2 (1 + nu)),  lambda = E nu / ((1 + nu)(1 - 2 nu)).
/// @throws std::invalid_argument  naming the key and its range, unless E > 0, -1 < nu < 0.5 with
///         0.5 - nu > 1e-6, all finite
Lame lame(double E, double nu);

/// Young's modulus [Pa] and Poisson's ratio.
struct YoungPoisson {
  double E, nu;
};
/// The inverse of lame(E, nu).
YoungPoisson young_poisson(const Lame& constants);

struct Material {
  std::string law = "neo-hookean";  // or "stvk", "projective"
  double E = 5e5;                   // Young's modulus [Pa]
  double nu = 0.45;                 // Poisson's ratio [-]
  double density = 1000;            // rho [kg/m3]
  /// Of the law "projective", w_v / lambda (projective_law.h): 1 is DiffPD's, which acts as a third
  /// of lambda; 3 makes it the material that E and nu say.
  double volume_weight = 1;
};

/// What a material is for small strains: the constants that its law's tangent at rest has.
/// @throws std::invalid_argument  as lame(E, nu)
Lame lame(const Material& material);

/// What Material::law may be.
const std::vector<std::string>& law_names();

/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const Material& material);

/// What the ground does to a body that touches it. Explicit simulators have a level ground,
/// frictionless or with Coulomb's law; the rest is for ProjectiveDynamics. Learned simulators are
/// told of no friction.
struct GroundContact {
  std::string law = "frictionless";  // or "coulomb", "penalty" (DiffPD's)
  double friction = 0;               // mu of "coulomb" [-]
  /// Of "penalty", at a depth d and a tangential velocity u_T: the normal force k_n d^2, and
  /// against u_T the smaller of k_f |u_T| and penalty_friction times the normal force.
  double k_n = 1e3;               // [N/m2]
  double k_f = 0.1;               // [N s/m]
  double penalty_friction = 1e4;  // [-]
  Vec3<double> normal{0, 0, 1};   // of length 1, out of the ground
};
/// What GroundContact::law may be.
const std::vector<std::string>& contact_law_names();
/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const GroundContact& contact);

/// Air that drags every vertex along: an acceleration c (w - v).
struct Air {
  double drag = 0;             // c [1/s]
  Vec3<double> wind{0, 0, 0};  // w [m/s]
};
/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const Air& air);

/// Everything besides the mesh that a body's motion depends on.
struct Physics {
  Material material;
  Vec3<double> gravity{0, 0, -9.8};  // [m/s2]
  std::optional<double> ground;  // height of the ground plane, z, or n . x [m]; none: no contact
  GroundContact contact;
  Air air;
  std::vector<int> pinned;  // vertices held at their rest positions
};

/// Everything but the pins, which make_boundary checks against a mesh.
/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const Physics& physics);
/// The same, and that its ground is one that explicit simulators know.
void check_explicit(const Physics& physics);

}  // namespace nmp::fem
