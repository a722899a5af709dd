#pragma once

#include <Eigen/SparseCholesky>
#include <unordered_map>
#include <vector>

#include "fem/tet_mesh.h"

namespace nmp::fem {

/// The constant matrix of projective dynamics, one for x, y and z (DiffPD):
///   A = diag(m) + h^2 sum_e V_e w B_e^T B_e,   (B_e^T B_e)_ab = grad N_a . grad N_b,
/// factored once. Pinned vertices are left out: their rows of a solution are 0.
class ScalarSystem {
 public:
  /// @param mass    m: #V x 1 [kg]   @param weight  w [Pa]   @param h  [s]
  /// @param pinned  ascending, each once
  /// @throws NumericalError  if it cannot be factored
  ScalarSystem(const TetMesh<double>& mesh, const Matrix<double>& mass, double weight, double h,
               const std::vector<int>& pinned);

  bool is_free(Index vertex) const { return row_of_[static_cast<std::size_t>(vertex)] >= 0; }
  /// A y = b.   b, y #V x 3
  void solve(const Matrix<double>& b, Matrix<double>& y);
  /// The column of A^-1 that belongs to a vertex that is not pinned: #V, kept once it is computed.
  const Eigen::VectorXd& inverse_column(Index vertex);

 private:
  std::vector<std::int32_t> row_of_;  // of a vertex; -1 if it is pinned
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor_;
  Matrix<double> b_, y_;
  std::unordered_map<Index, Eigen::VectorXd> columns_;
};

}  // namespace nmp::fem
