#pragma once

#include "fem/mesh_file.h"

namespace nmp::fem {

/// What one_body did.
struct BodyParts {
  Index n_parts = 0;   // that are left
  Index n_crumbs = 0;  // parts that were dropped
  double crumb_volume = 0;
  Index n_cut_tets = 0;      // tets dropped where the body met itself along an edge only
  Index n_cut_vertices = 0;  // vertices doubled where it met itself in a vertex only
};

/// Lets tets hang together by faces: of those that meet along an edge only the smaller ones are
/// dropped, those that meet in a vertex only get one each, drawn apart by `apart`. Then every edge
/// of the surface has two triangles (outside, a bubble may still touch it in a vertex). Then drops
/// parts that are smaller than `crumb` times the largest.
/// @param mesh   tets with positive volume, a face shared by two at most
/// @param crumb  1: the largest part alone is left
BodyParts one_body(RawMesh& mesh, double apart, double crumb);

}  // namespace nmp::fem
