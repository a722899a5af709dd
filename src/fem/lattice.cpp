#include "fem/lattice.h"

namespace nmp::fem {

std::array<Index, 3> Lattice::indices(Index point) const {
  const bool is_centre = point >= n_corners();
  const Index p = is_centre ? point - n_corners() : point;
  const Index nx = cells[0] + !is_centre, ny = cells[1] + !is_centre;
  return {p % nx, p / nx % ny, p / nx / ny};
}

Vec3<double> Lattice::place(Index point) const {
  const auto [i, j, k] = indices(point);
  const double half = point >= n_corners() ? 0.5 : 0;
  return low + cell * Vec3<double>(static_cast<double>(i) + half, static_cast<double>(j) + half,
                                   static_cast<double>(k) + half);
}

bool Lattice::is_even(Index point) const {
  const auto [i, j, k] = indices(point);
  return (i + j + k) % 2 == 0;
}

}  // namespace nmp::fem
