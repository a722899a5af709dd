#include "fem/mesh_cube.h"

#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

TetMesh<double> cube_mesh(Index n, double side) {
  NMP_CHECK(n >= 2 && n <= 476, text("n must be in 2..476 vertices along an edge, got ", n));
  NMP_CHECK(std::isfinite(side) && side > 0, text("side must be > 0, got ", side));
  return box_mesh({n - 1, n - 1, n - 1}, Vec3<double>::Constant(side));
}

// Every face diagonal joins two vertices with an even i + j + k, whichever cell it is seen from: a
// cell is one tet on its four even corners, and one at each odd corner p on p and its neighbours.
TetMesh<double> box_mesh(const std::array<Index, 3>& cells, const Vec3<double>& size) {
  Index n_cells = 1;
  for (const Index n : cells) {
    NMP_CHECK(n >= 1 && n <= kMostBoxCells / n_cells,
              text("a box has 1 to ", kMostBoxCells, " cells, got ", cells[0], " x ", cells[1],
                   " x ", cells[2]));
    n_cells *= n;
  }
  NMP_CHECK(size.allFinite() && size.minCoeff() > 0,
            text("the size must be > 0, got ", size(0), ", ", size(1), ", ", size(2)));
  const auto [nx, ny, nz] = cells;
  Matrix<double> vertices((nx + 1) * (ny + 1) * (nz + 1), 3);
  for (Index k = 0, v = 0; k <= nz; ++k)
    for (Index j = 0; j <= ny; ++j)
      for (Index i = 0; i <= nx; ++i, ++v)
        for (int axis = 0; axis < 3; ++axis) {
          const Index at = axis == 0 ? i : axis == 1 ? j : k;
          const auto n = static_cast<double>(cells[static_cast<std::size_t>(axis)]);
          vertices(v, axis) = size(axis) * (static_cast<double>(at) / n - 0.5);
        }

  Tets tets(5 * n_cells, 4);
  Index e = 0;
  for (Index k = 0; k < nz; ++k)
    for (Index j = 0; j < ny; ++j)
      for (Index i = 0; i < nx; ++i) {
        // Corner c is at offsets (c & 1, c >> 1 & 1, c >> 2); cells of odd parity are mirrored in
        // i.
        const int parity = static_cast<int>((i + j + k) % 2);
        const auto vertex = [&, nx = nx, ny = ny](int c) {
          c ^= parity;
          return static_cast<std::int32_t>(
              i + (c & 1) + (nx + 1) * (j + (c >> 1 & 1) + (ny + 1) * (k + (c >> 2))));
        };
        const int cell[5][4] = {
            {0, 3, 6, 5}, {1, 0, 5, 3}, {2, 3, 6, 0}, {4, 0, 6, 5}, {7, 3, 5, 6}};
        for (const auto& tet : cell) {
          for (int a = 0; a < 4; ++a) tets(e, a) = vertex(tet[a]);
          if (parity) std::swap(tets(e, 2), tets(e, 3));  // a mirror turns tets inside out
          ++e;
        }
      }
  return TetMesh<double>(vertices, tets);
}

}  // namespace nmp::fem
