#pragma once

#include <functional>

#include "fem/material.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// Positions of static equilibrium under gravity on a frictionless ground, held at its pins, of a
/// body with the law "projective": #V x 3 [m]. Starts with the rest shape, unless it is pinned let
/// down or lifted until it touches the ground. Implicit steps, stopped whenever the kinetic energy
/// has a peak, until a peak is below that of a slow motion, a ten-thousandth of sqrt(g diagonal).
/// @throws std::invalid_argument  as ProjectiveDynamics, and for a body with neither ground nor
/// pins;
///         NumericalError  if it does not come to rest
/// @param go_on  asked after every step; false ends it, with an empty matrix
Matrix<double> settle(const TetMesh<double>& mesh, const Physics& physics,
                      const std::function<bool()>& go_on = {});

}  // namespace nmp::fem
