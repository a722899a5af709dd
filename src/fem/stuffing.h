#pragma once

#include <array>

#include "fem/mesh_file.h"

namespace nmp::fem {

/// A body as the mesher sees it. Called from several threads.
class Solid {
 public:
  virtual ~Solid() = default;
  /// 1 inside, -1 outside, 0 on the surface.
  virtual int side(const Vec3<double>& x) const = 0;
  /// Where the way from a place inside to one outside crosses the surface: 0 to 1.
  virtual double cut(const Vec3<double>& inside, const Vec3<double>& outside) const = 0;
};

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

/// Fills a solid by isosurface stuffing [Labelle, Shewchuk 2007] on a uniform lattice. Every
/// tetrahedron has positive volume, and its angles between faces are from 10.7 to 164.8 degrees,
/// whatever the solid answers; the surface is followed to second order in the size of the cells
/// where it is smooth, edges and corners are cut off within a cell.
/// @param lattice  its outermost points lie outside of the solid
/// @return a mesh, empty if no point of the lattice is inside; two tets may meet in a vertex or an
///         edge only
/// @throws std::invalid_argument  if the lattice has too many points, or an outermost one is inside
RawMesh stuff(const Lattice& lattice, const Solid& solid);

}  // namespace nmp::fem
