#pragma once

#include <array>

#include "fem/tet_mesh.h"

namespace nmp::fem {

/// The regular cube of CUBE and CUBEXL, centred at the origin: n^3 vertices, (n-1)^3 cells of five
/// tets, the split mirrored on cells of odd parity so that faces match (design.md section 2).
/// Vertex (i, j, k) has number i + n (j + n k).
/// @param n     vertices along an edge, 2..476: TetMesh numbers corners in 31 bits
/// @param side  [m], > 0
TetMesh<double> cube_mesh(Index n, double side);

/// A box, centred at the origin, of the same cells of five tets.
/// @param cells  along x, y, z, each >= 1; at most kMostBoxCells of them
/// @param size   [m], each > 0
TetMesh<double> box_mesh(const std::array<Index, 3>& cells, const Vec3<double>& size);

/// As many as TetMesh numbers.
constexpr Index kMostBoxCells = (Index(1) << 29) / 5;

}  // namespace nmp::fem
