#pragma once

#include <string>
#include <vector>

#include "fem/finding.h"
#include "fem/mesh_file.h"

namespace nmp::fem {

/// What can be wrong with a mesh, worst first.
enum class MeshDefect {
  no_tet,           // a surface, or nothing
  bad_index,        // a corner that names no vertex
  not_finite,       // a vertex
  repeated_vertex,  // a tet with two equal corners
  flat,             // |6 V_e| <= 1e-12 of the longest edge cubed, as in TetMesh
  scale,            // bounding box below 1e-6 or above 1e6 in diagonal: no body in metres
  inverted,         // 6 V_e below that
  repeated_cell,    // four corners that an earlier tet has
  unreferenced,     // a vertex that belongs to no tet
  sliver,           // 6 V_e <= 1e-3 of the longest edge cubed (a regular tet: 0.71)
  coincident,       // a vertex at the very place of an earlier one
  non_manifold,     // a tet with a face that more than two tets share
  parts,            // bodies that share no vertex, if there is more than one
  far_away,         // coordinates above 1000 times the size: recorded as float they lose digits
  units,            // bounding box below 1e-3 or above 100 in diagonal: other units than metres?
};

/// A part is named by its lowest vertex.
using MeshFinding = Finding<MeshDefect>;

MeshRule rule(MeshDefect defect);
/// "inverted_tets": for programs.
const char* name(MeshDefect defect);
/// "12 tets are inverted (0, 5, 7, ...)"
std::string describe(const MeshFinding& finding);

struct MeshFindings : Findings<MeshDefect> {
  Index n_parts = 0;
};

/// Looks for every defect, naming the first `n_shown` of each. Time n log n. Defects of shape are
/// looked for in tets with four corners that exist; faces and parts are those of the mesh without
/// repeated cells.
MeshFindings check_mesh(const RawMesh& mesh, std::size_t n_shown = 10);

struct RepairedMesh {
  RawMesh mesh;
  std::vector<std::string> warnings;         // what was found, and what was done about it
  std::vector<std::int32_t> given_vertices;  // that its vertices were before, ascending
};

/// A mesh that TetMesh accepts. Inverted tets are turned by exchanging two corners, repeated cells
/// and vertices of no tet are dropped (which renumbers the vertices after them); what cannot be
/// mended without guessing is refused, the rest is only warned of: see rule().
/// @throws InputError  with all that is refused, with numbers and counts
/// @param name  of the mesh, in the error
RepairedMesh repair(const RawMesh& mesh, const std::string& name);

}  // namespace nmp::fem
