#include "fem/weld.h"

#include <array>
#include <cmath>
#include <map>

namespace nmp::fem {

std::vector<Index> weld(RawMesh& mesh) {
  const Index n = mesh.vertices.rows();
  std::vector<Index> left;
  if (n == 0) return left;
  const auto low = mesh.vertices.colwise().minCoeff().eval();
  const double reach = std::max(1e-9 * (mesh.vertices.colwise().maxCoeff() - low).norm(), 1e-300);
  // Cells of twice the reach: what is near stands in a cell or in the next one.
  using Cell = std::array<double, 3>;
  std::map<Cell, std::vector<std::int32_t>> cells;
  std::vector<std::int32_t> now(static_cast<std::size_t>(n), -1);
  for (Index v = 0; v < n; ++v) {
    Cell cell, at;
    for (Index k = 0; k < 3; ++k)
      cell[static_cast<std::size_t>(k)] = std::floor((mesh.vertices(v, k) - low(k)) / (2 * reach));
    std::int32_t& found = now[static_cast<std::size_t>(v)];
    for (int neighbour = 0; neighbour < 27 && found < 0; ++neighbour) {
      at = {cell[0] + neighbour % 3 - 1, cell[1] + neighbour / 3 % 3 - 1,
            cell[2] + neighbour / 9 - 1};
      const auto inside = cells.find(at);
      if (inside == cells.end()) continue;
      for (const std::int32_t other : inside->second) {
        const Index before = left[static_cast<std::size_t>(other)];
        if ((mesh.vertices.row(before) - mesh.vertices.row(v)).norm() <= reach) found = other;
      }
    }
    if (found >= 0) continue;
    found = static_cast<std::int32_t>(left.size());
    cells[cell].push_back(found);
    left.push_back(v);
  }
  Matrix<double> vertices(static_cast<Index>(left.size()), 3);
  for (Index v = 0; v < vertices.rows(); ++v)
    vertices.row(v) = mesh.vertices.row(left[static_cast<std::size_t>(v)]);
  mesh.vertices = vertices;
  for (Index e = 0; e < mesh.tets.rows(); ++e)
    for (Index a = 0; a < 4; ++a) mesh.tets(e, a) = now[static_cast<std::size_t>(mesh.tets(e, a))];
  return left;
}

}  // namespace nmp::fem
