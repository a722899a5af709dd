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

struct Material {
  std::string law = "neo-hookean";  // or "stvk"
  double E = 5e5;                   // Young's modulus [Pa]
  double nu = 0.45;                 // Poisson's ratio [-]
  double density = 1000;            // rho [kg/m3]
};

/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const Material& material);

/// Everything besides the mesh that a body's motion depends on.
struct Physics {
  Material material;
  Vec3<double> gravity{0, 0, -9.8};  // [m/s2]
  std::optional<double> ground;      // height z of the ground plane [m]; none without contact
  std::vector<int> pinned;           // vertices held at their rest positions
};

/// Everything but the pins, which make_boundary checks against a mesh.
/// @throws std::invalid_argument  naming key and range, if anything is outside
void check(const Physics& physics);

}  // namespace nmp::fem
