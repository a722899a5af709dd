#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "autodiff/types.h"

namespace nmp::fem {

/// #T x 4 vertex indices; (x1 - x0) x (x2 - x0) . (x3 - x0) > 0 at rest.
using Tets = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4>;

/// Up to this 6 V_e over its longest edge cubed a tet is flat; rounding alone makes some 1e-15.
constexpr double kFlat = 1e-12;

/// Rest geometry of a tetrahedral mesh, with everything a step reads laid out once. Immutable, and
/// cheap to copy: copies share the data, so an operator that keeps a copy can never see it freed.
template <class Real>
class TetMesh {
 public:
  /// @param vertices  #V x 3  rest positions X [m]
  /// @throws std::invalid_argument  if there is no tet, an index is out of range, a tet is inverted
  ///         or flat (kFlat), a vertex is not finite or belongs to no tet: each with its number
  TetMesh(const Matrix<double>& vertices, const Tets& tets);

  Index n_vertices() const { return data_->vertices.rows(); }
  Index n_tets() const { return data_->tets.rows(); }
  /// #V x 3 [m], as given.
  const Matrix<double>& vertices() const { return data_->vertices; }
  const Tets& tets() const { return data_->tets; }
  /// #V x 3 [m], as Real.
  const Matrix<Real>& rest() const { return data_->rest; }
  /// V_e: #T x 1 [m3]
  const Matrix<Real>& volumes() const { return data_->volumes; }
  /// Gradients of the linear shape functions: #T x 12 [1/m], corner a in columns 3a, 3a+1, 3a+2.
  const Matrix<Real>& grad_N() const { return data_->grad_N; }
  /// Lumped rest volume V_i, a quarter of each tet around the vertex: #V x 1 [m3]
  const Matrix<Real>& vertex_volumes() const { return data_->vertex_volumes; }
  /// 1 / V_i: #V x 1 [1/m3]
  const Matrix<Real>& reciprocal_vertex_volumes() const { return data_->reciprocal_vertex_volumes; }
  /// Corners around vertex v, as 4 e + a in ascending order: corners()[k] for k in
  /// [corner_begin()[v], corner_begin()[v + 1]).
  const std::vector<std::int32_t>& corner_begin() const { return data_->corner_begin; }
  const std::vector<std::int32_t>& corners() const { return data_->corners; }

  double total_volume() const { return data_->total_volume; }
  double mean_edge_length() const { return data_->mean_edge_length; }
  /// Diagonal of the bounding box at rest [m].
  double diagonal() const { return data_->diagonal; }

  template <class Other>
  TetMesh<Other> cast() const {
    return TetMesh<Other>(vertices(), tets());
  }

 private:
  struct Data {
    Matrix<double> vertices;
    Tets tets;
    Matrix<Real> rest, volumes, grad_N, vertex_volumes, reciprocal_vertex_volumes;
    std::vector<std::int32_t> corner_begin, corners;
    double total_volume = 0, mean_edge_length = 0, diagonal = 0;
  };
  std::shared_ptr<const Data> data_;
};

}  // namespace nmp::fem
