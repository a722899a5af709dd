#pragma once

#include <functional>
#include <string>
#include <vector>

#include "fem/mesh_file.h"
#include "fem/one_body.h"
#include "fem/stuffing.h"
#include "fem/surface_check.h"

namespace nmp::fem {

/// How fine a surface is filled: the first of these that is set.
struct FillOptions {
  double size = 0;                     // length of the cells' edges, in the surface's units
  Index resolution = 0;                // cells along the longest side of the bounding box
  Index vertices = 1500;               // about so many of the mesh
  double crumb = 0.01;                 // parts smaller than this part of the largest are dropped
  std::function<void()> poll = [] {};  // called now and then, from any thread; may throw to stop
};

struct FilledSurface {
  RawMesh mesh;
  Lattice lattice;
  BodyParts parts;
  double volume = 0;
  /// How far the surface is from that of the mesh, at the worst of a thousand places, in cells;
  /// and the part of the area that is more than one cell from it.
  double distance = 0;
  Vec3<double> farthest = Vec3<double>::Zero();
  double lost_area = 0;
  std::vector<std::string> warnings;
};

/// Fills a surface with tetrahedra: those of a lattice, cut and warped to it (stuffing.h). Inside
/// is where the winding number (triangle_tree.h) is above 1/2, so that holes are closed, crossing
/// bodies become one, and triangles too many do no harm.
/// @param surface  after repair
/// @throws InputError  if no point of the lattice is inside
/// @throws ConfigError  if the lattice would have more than kMostLatticePoints
/// @param name  of the surface, in errors
FilledSurface fill(const RepairedSurface& surface, const FillOptions& options,
                   const std::string& name);

/// The cells that the options ask for.
double cell_of(const RepairedSurface& surface, const FillOptions& options);
/// The cells for about `vertices` of them: half a lattice point per cell inside, and those on the
/// surface.
double cell_for_vertices(double volume, double area, Index vertices);

}  // namespace nmp::fem
