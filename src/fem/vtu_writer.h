#pragma once

#include <string>
#include <vector>

#include "fem/tet_mesh.h"

namespace nmp::fem {

/// Values of a grid, a row for each vertex or tet.
struct VtuField {
  std::string name;
  Matrix<float> values;
};

/// What a VTU file of tetrahedra holds.
struct VtuContent {
  const Matrix<double>& vertices;  // #V x 3
  const Tets& tets;
  std::vector<VtuField> point_data, cell_data;
};

struct VtuStyle {
  bool binary = false;  // appended raw, with sizes of 64 bits; else text
  bool zlib = false;    // binary alone: arrays compressed in blocks
  bool single = false;  // vertices as Float32 and indices as Int32, not Float64 and Int64
};

/// The bytes of a VTU file.
std::string to_vtu(const VtuContent& content, const VtuStyle& style);

}  // namespace nmp::fem
