#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "fem/surface.h"
#include "fem/tet_mesh.h"

namespace nmp::capi {

/// What a nmp_mesh is: a mesh in both precisions, its surface, and what loading it found.
struct Mesh {
  explicit Mesh(const fem::TetMesh<double>& mesh)
      : double_precision(mesh),
        single_precision(mesh.cast<float>()),
        triangles(fem::surface_triangles(mesh.tets())) {}

  template <class Real>
  const fem::TetMesh<Real>& in() const;

  fem::TetMesh<double> double_precision;
  fem::TetMesh<float> single_precision;
  fem::Triangles triangles;
  std::string report;
  std::vector<std::int32_t> file_vertices;  // that its vertices are there; empty: the same numbers
};

template <>
inline const fem::TetMesh<double>& Mesh::in<double>() const {
  return double_precision;
}
template <>
inline const fem::TetMesh<float>& Mesh::in<float>() const {
  return single_precision;
}

}  // namespace nmp::capi
