#pragma once

#include "fem/mesh_check.h"
#include "fem/mesh_file.h"
#include "fem/mesh_quality.h"
#include "fem/simulator.h"
#include "fuzz/fuzz.h"

namespace nmp::fuzz {

/// Bounds that keep an input of some KB within the memory that tools/fuzz allows.
inline fem::MeshLimits mesh_limits() {
  fem::MeshLimits limits;
  limits.decoded_bytes = 1u << 20;
  return limits;
}

/// Looks for defects, repairs, builds the body and makes a step with it.
inline void use(const fem::RawMesh& raw) {
  fem::check_mesh(raw);
  const fem::RepairedMesh repaired = fem::repair(raw, "fuzz");
  const fem::TetMesh<double> mesh(repaired.mesh.vertices, repaired.mesh.tets);
  fem::State<double> state{mesh.vertices(), Matrix<double>::Zero(mesh.n_vertices(), 3)};
  fem::Simulator<double>(mesh, fem::Physics(), 1e-5).advance(state, 1);
  touch(state.x.data(), sizeof(double) * static_cast<std::size_t>(state.x.size()));
}

}  // namespace nmp::fuzz
