#pragma once

#include <cstdint>
#include <vector>

#include "fem/tet_mesh.h"

namespace nmp::fem {

/// #F x 3 vertex indices, counter-clockwise seen from outside.
using Triangles = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3>;

/// The faces of tets that belong to one tet only, their normals (x1 - x0) x (x2 - x0) pointing out
/// of it; ordered by tet, then by the corner opposite to the face.
/// @param tets  #T x 4, positively oriented as in TetMesh
/// @throws std::invalid_argument  naming the tets if a face belongs to more than two of them
Triangles surface_triangles(const Tets& tets);

/// The surface by itself.
struct Surface {
  std::vector<std::int32_t> vertices;  // of the mesh, ascending: those that lie on the surface
  Triangles triangles;                 // indices into `vertices`
};
/// @throws std::invalid_argument  as surface_triangles
Surface extract_surface(const Tets& tets);

/// The rows of values of all vertices that belong to the surface's, in its order; none of none.
/// @param values  #V x k   @return  #surface.vertices x k
Matrix<double> on_surface(const Matrix<double>& values, const Surface& surface);

/// The edges of triangles, each once: #E x 2, the smaller vertex first, ascending.
Eigen::Matrix<std::int32_t, Eigen::Dynamic, 2> edges_of(const Triangles& triangles);

}  // namespace nmp::fem
