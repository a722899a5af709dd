#pragma once

#include <cstdint>
#include <vector>

#include "fem/mesh_file.h"

namespace nmp::fem {

/// Makes one vertex of those at the same place, within 1e-9 of the bounding box's diagonal: some
/// programs write every tet with four vertices of its own.
/// @return  for each vertex that is left, ascending, its number before
std::vector<Index> weld(RawMesh& mesh);

}  // namespace nmp::fem
