#include "nmp/vertex_measures.h"

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "autodiff/tape.h"
#include "base/check.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"

namespace nmp {

namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

}  // namespace

Matrix<double> vertex_means(const fem::TetMesh<double>& mesh, const Matrix<double>& values) {
  NMP_CHECK(
      values.rows() == mesh.n_tets() && values.cols() == 1,
      text("a value for each of ", mesh.n_tets(), " elements is needed, got ", shape(values)));
  const Matrix<double>& V = mesh.volumes();
  Matrix<double> means(mesh.n_vertices(), 1);
  for (Index i = 0; i < mesh.n_vertices(); ++i) {
    const auto begin = mesh.corner_begin()[static_cast<std::size_t>(i)];
    const auto end = mesh.corner_begin()[static_cast<std::size_t>(i) + 1];
    double sum = 0, volume = 0;
    for (auto k = begin; k < end; ++k) {
      const Index e = mesh.corners()[static_cast<std::size_t>(k)] / 4;
      sum += V(e, 0) * values(e, 0);
      volume += V(e, 0);
    }
    means(i, 0) = sum / volume;
  }
  return means;
}

Matrix<double> von_mises(const Matrix<double>& F, const Matrix<double>& P) {
  NMP_CHECK(F.cols() == 9 && P.cols() == 9 && F.rows() == P.rows(),
            text("F and P must be #T x 9, got ", shape(F), " and ", shape(P)));
  Matrix<double> result(F.rows(), 1);
  for (Index e = 0; e < F.rows(); ++e) {
    const Mat3<double> F_e = load_mat3<double>(F, e);
    const double J = F_e.determinant();
    const Mat3<double> sigma = load_mat3<double>(P, e) * F_e.transpose() / J;
    Mat3<double> s = (sigma + sigma.transpose()) / 2;
    s -= s.trace() / 3 * Mat3<double>::Identity();
    result(e, 0) = J > 0 ? std::sqrt(1.5) * s.norm() : kNaN;
  }
  return result;
}

Matrix<double> right_side_out(const Matrix<double>& F) {
  NMP_CHECK(F.cols() == 9, text("F must be #T x 9, got ", shape(F)));
  Matrix<double> defined = F;
  for (Index e = 0; e < F.rows(); ++e)
    if (!(load_mat3<double>(F, e).determinant() > 0))
      store_mat3<double>(defined, e, Mat3<double>::Identity());
  return defined;
}

Matrix<double> von_mises(const Matrix<double>& F, const StressLaw& law) {
  return von_mises(F, law.stress(right_side_out(F)));
}

StressLaw analytic_stress(const fem::Material& material) {
  const fem::Lame constants = fem::lame(material);
  return {text(material.law, " (E = ", material.E, " Pa, nu = ", material.nu, ")"),
          [material, constants](const Matrix<double>& F) {
            Matrix<double> P(F.rows(), 9);
            fem::stress<double>(material, constants, F, P);
            return P;
          }};
}

StressLaw learned_stress(const Model<float>& model) {
  return {"learned", [&model](const Matrix<double>& F) {
            ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
            const Matrix<float> F_float = F.cast<float>();
            return Matrix<double>(
                model.stress.stress(tape.constant(F_float)).value().template cast<double>());
          }};
}

VertexMeasures measure_vertices(const fem::TetMesh<double>& mesh, const ConstView<double>& x,
                                const StressLaw& law) {
  Matrix<double> F(mesh.n_tets(), 9), det(mesh.n_tets(), 1);
  fem::deformation_gradient<double>(mesh, x, F);
  for (Index e = 0; e < mesh.n_tets(); ++e) det(e, 0) = load_mat3<double>(F, e).determinant();
  VertexMeasures measures{vertex_means(mesh, det), {}};
  if (law) measures.stress = vertex_means(mesh, von_mises(F, law));
  return measures;
}

}  // namespace nmp
