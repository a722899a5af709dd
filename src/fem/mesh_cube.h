#pragma once

#include "fem/tet_mesh.h"

namespace nmp::fem {

/// The regular cube of CUBE and CUBEXL, centred at the origin: n^3 vertices, (n-1)^3 cells of five
/// tets, the split mirrored on cells of odd parity so that faces match (design.md section 2).
/// Vertex (i, j, k) has number i + n (j + n k).
/// @param n     vertices along an edge, 2..800
/// @param side  [m], > 0
TetMesh<double> cube_mesh(Index n, double side);

}  // namespace nmp::fem
