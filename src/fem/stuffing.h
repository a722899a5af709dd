#pragma once

#include "fem/lattice.h"
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
