#pragma once

#include <string>
#include <vector>

#include "fem/material.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// Largest step of semi-implicit Euler that is stable near rest, 2 / omega_max [s], omega_max^2 the
/// largest eigenvalue of M^-1 K with K the stiffness at rest of a material with these constants
/// (pinned vertices held), by power iteration to a relative 1e-4. Under compression the limit
/// falls: by about a tenth at 10 % (design.md section 9).
double stable_time_step(const TetMesh<double>& mesh, const Material& material,
                        const std::vector<int>& pinned = {});

/// A sentence for people if a step of dt [s] is above 0.9 of that limit [s], which leaves room for
/// some compression; empty otherwise. For those who are about to simulate.
std::string stability_warning(double limit, double dt);

}  // namespace nmp::fem
