#pragma once

#include <array>

#include "autodiff/types.h"

namespace nmp::fem {

/// A body-centred cubic lattice: the corners of cubic cells, and their centres. Its tetrahedra, all
/// alike, have two adjacent centres and an edge of the face between them as corners.
struct Lattice {
  Vec3<double> low;            // corner of the first cell
  double cell = 1;             // its edges
  std::array<Index, 3> cells;  // along x, y, z

  Index n_corners() const { return (cells[0] + 1) * (cells[1] + 1) * (cells[2] + 1); }
  Index n_points() const { return n_corners() + cells[0] * cells[1] * cells[2]; }
  /// Corner (i, j, k) is number i + (cells[0] + 1) (j + (cells[1] + 1) k); centres come after.
  Index corner(Index i, Index j, Index k) const {
    return i + (cells[0] + 1) * (j + (cells[1] + 1) * k);
  }
  Index centre(Index i, Index j, Index k) const {
    return n_corners() + i + cells[0] * (j + cells[1] * k);
  }
  std::array<Index, 3> indices(Index point) const;
  Vec3<double> place(Index point) const;
  /// i + j + k is even. The two ends of an edge of length `cell` differ in it.
  bool is_even(Index point) const;
};

/// The most points a lattice may have: their memory is about 2 GB.
constexpr Index kMostLatticePoints = Index(1) << 26;

}  // namespace nmp::fem
