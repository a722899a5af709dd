#pragma once

#include "autodiff/types.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// The shape of a mesh and of its tets, in numbers.
struct MeshQuality {
  double volume = 0;                                 // [m3]
  Vec3<double> low, high;                            // of the bounding box [m]
  double edge_min = 0, edge_mean = 0, edge_max = 0;  // [m]
  double dihedral_min = 0, dihedral_max = 0;         // angles between two faces of a tet [degrees]
  Index dihedral_min_tet = 0, dihedral_max_tet = 0;  // where
  double aspect_max = 0;  // longest edge / shortest height; regular: 1.22
  Index aspect_max_tet = 0;
};

MeshQuality quality(const TetMesh<double>& mesh);

}  // namespace nmp::fem
