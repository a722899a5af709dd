#include "fem/scalar_system.h"

#include "base/check.h"

namespace nmp::fem {

ScalarSystem::ScalarSystem(const TetMesh<double>& mesh, const Matrix<double>& mass, double weight,
                           double h, const std::vector<int>& pinned) {
  row_of_.assign(static_cast<std::size_t>(mesh.n_vertices()), 0);
  for (const int v : pinned) row_of_[static_cast<std::size_t>(v)] = -1;
  std::int32_t n = 0;
  for (std::int32_t& row : row_of_)
    if (row == 0) row = n++;

  std::vector<Eigen::Triplet<double>> entries;
  entries.reserve(static_cast<std::size_t>(16 * mesh.n_tets() + n));
  for (Index v = 0; v < mesh.n_vertices(); ++v) {
    const std::int32_t row = row_of_[static_cast<std::size_t>(v)];
    if (row >= 0) entries.emplace_back(row, row, mass(v, 0));
  }
  for (Index e = 0; e < mesh.n_tets(); ++e) {
    const double factor = h * h * mesh.volumes()(e, 0) * weight;
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b) {
        const std::int32_t i = row_of_[static_cast<std::size_t>(mesh.tets()(e, a))],
                           j = row_of_[static_cast<std::size_t>(mesh.tets()(e, b))];
        if (i < 0 || j < 0) continue;
        const auto grad_a = mesh.grad_N().row(e).segment<3>(3 * a);
        entries.emplace_back(i, j, factor * grad_a.dot(mesh.grad_N().row(e).segment<3>(3 * b)));
      }
  }
  Eigen::SparseMatrix<double> A(n, n);
  A.setFromTriplets(entries.begin(), entries.end());
  factor_.compute(A);
  if (factor_.info() != Eigen::Success || !(factor_.vectorD().minCoeff() > 0))
    throw NumericalError(text("the system of projective dynamics (", n,
                              " unknowns) cannot be factored: are masses, "
                              "stiffness and step above 0 and finite?"));
  b_.resize(n, 3);
}

void ScalarSystem::solve(const Matrix<double>& b, Matrix<double>& y) {
  for (std::size_t v = 0; v < row_of_.size(); ++v)
    if (row_of_[v] >= 0) b_.row(row_of_[v]) = b.row(static_cast<Index>(v));
  y_ = factor_.solve(b_);
  for (std::size_t v = 0; v < row_of_.size(); ++v) {
    if (row_of_[v] >= 0)
      y.row(static_cast<Index>(v)) = y_.row(row_of_[v]);
    else
      y.row(static_cast<Index>(v)).setZero();
  }
}

const Eigen::VectorXd& ScalarSystem::inverse_column(Index vertex) {
  const auto found = columns_.find(vertex);
  if (found != columns_.end()) return found->second;
  const std::int32_t row = row_of_[static_cast<std::size_t>(vertex)];
  NMP_CHECK(row >= 0, text("vertex ", vertex, " is pinned: it has no column"));
  const Eigen::VectorXd column = factor_.solve(Eigen::VectorXd::Unit(b_.rows(), row));
  Eigen::VectorXd all = Eigen::VectorXd::Zero(static_cast<Index>(row_of_.size()));
  for (std::size_t v = 0; v < row_of_.size(); ++v)
    if (row_of_[v] >= 0) all(static_cast<Index>(v)) = column(row_of_[v]);
  return columns_.emplace(vertex, std::move(all)).first->second;
}

}  // namespace nmp::fem
