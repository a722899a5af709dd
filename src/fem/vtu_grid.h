#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "fem/mesh_file.h"

namespace nmp::fem {

/// A VTU file with values at its points.
struct VtuGrid {
  RawMesh mesh;
  /// By name: #V x components, finite.
  std::map<std::string, Matrix<double>> point_data;
};

/// What read_vtu reads, and the arrays of PointData that are wanted, of those that the file has.
/// @throws InputError  as read_vtu, also for a wanted array of another length or with values that
///         are not finite
VtuGrid read_vtu_grid(std::string_view bytes, const std::string& name,
                      const std::vector<std::string>& wanted, const MeshLimits& limits = {});

}  // namespace nmp::fem
