#include "fem/mesh_cube.h"

#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

// Every face diagonal joins two vertices with an even i + j + k, whichever cell it is seen from: a
// cell is one tet on its four even corners, and one at each odd corner p on p and its neighbours.
TetMesh<double> cube_mesh(Index n, double side) {
  NMP_CHECK(n >= 2 && n <= 800, text("n must be in 2..800 vertices along an edge, got ", n));
  NMP_CHECK(std::isfinite(side) && side > 0, text("side must be > 0, got ", side));
  Matrix<double> vertices(n * n * n, 3);
  for (Index k = 0, v = 0; k < n; ++k)
    for (Index j = 0; j < n; ++j)
      for (Index i = 0; i < n; ++i, ++v)
        for (int axis = 0; axis < 3; ++axis) {
          const Index at = axis == 0 ? i : axis == 1 ? j : k;
          vertices(v, axis) = side * (static_cast<double>(at) / static_cast<double>(n - 1) - 0.5);
        }

  Tets tets(5 * (n - 1) * (n - 1) * (n - 1), 4);
  Index e = 0;
  for (Index k = 0; k + 1 < n; ++k)
    for (Index j = 0; j + 1 < n; ++j)
      for (Index i = 0; i + 1 < n; ++i) {
        // Corner c is at offsets (c & 1, c >> 1 & 1, c >> 2); cells of odd parity are mirrored in
        // i.
        const int parity = static_cast<int>((i + j + k) % 2);
        const auto vertex = [&](int c) {
          c ^= parity;
          return static_cast<std::int32_t>(i + (c & 1) +
                                           n * (j + (c >> 1 & 1) + n * (k + (c >> 2))));
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
