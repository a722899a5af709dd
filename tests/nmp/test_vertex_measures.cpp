#include "nmp/vertex_measures.h"

#include <Eigen/LU>
#include <cmath>

#include "fem/cases.h"
#include "fem/deformation_gradient.h"
#include "fem/mesh_cube.h"
#include "nmp/nets.h"

using namespace nmp;

namespace {

fem::Material material(const std::string& law = "neo-hookean") {
  fem::Material m;
  m.law = law;
  return m;
}

Matrix<double> row_of(const Mat3<double>& m) {
  Matrix<double> row(1, 9);
  store_mat3<double>(row, 0, m);
  return row;
}

}  // namespace

TEST_SUITE("nmp/vertex_measures") {
  TEST_CASE("the von Mises stress is that of the textbook") {
    const Mat3<double> I = Mat3<double>::Identity();
    // Undeformed, sigma = P: uniaxial tension, shear, pressure.
    CHECK(von_mises(row_of(I), row_of(Vec3<double>(7, 0, 0).asDiagonal()))(0) ==
          doctest::Approx(7).epsilon(1e-14));
    Mat3<double> shear = Mat3<double>::Zero();
    shear(0, 1) = shear(1, 0) = 2;
    CHECK(von_mises(row_of(I), row_of(shear))(0) == doctest::Approx(2 * std::sqrt(3.0)));
    CHECK(von_mises(row_of(I), row_of(-5 * I))(0) <= 1e-14);
    shear(1, 0) = -2;  // a learned law's stress need not be symmetric: that part counts for nothing
    CHECK(von_mises(row_of(I), row_of(shear))(0) <= 1e-14);
    // sigma = P F^T / J: three principal stresses under a stretch.
    const Vec3<double> stretch(2, 1, 0.5), P(3, 4, 5), sigma = P.cwiseProduct(stretch);
    const double wanted =
        std::sqrt((std::pow(sigma[0] - sigma[1], 2) + std::pow(sigma[1] - sigma[2], 2) +
                   std::pow(sigma[2] - sigma[0], 2)) /
                  2);
    CHECK(von_mises(row_of(stretch.asDiagonal()), row_of(P.asDiagonal()))(0) ==
          doctest::Approx(wanted).epsilon(1e-14));
    CHECK(std::isnan(von_mises(row_of(-I), row_of(I))(0)));
    CHECK_THROWS_AS(von_mises(Matrix<double>::Zero(2, 9), Matrix<double>::Zero(1, 9)),
                    std::invalid_argument);
  }

  TEST_CASE("a body that is stretched as a whole has the law's stress everywhere, turned or not") {
    const auto mesh = fem::jittered_cube(4);
    Matrix<double> x = mesh.vertices();
    x.col(0) *= 1.1;
    const Mat3<double> R =
        Eigen::AngleAxis<double>(0.8, Vec3<double>(1, 2, 3).normalized()).toRotationMatrix();
    for (const std::string& law : fem::law_names()) {
      CAPTURE(law);
      const StressLaw stress = analytic_stress(material(law));
      const Matrix<double> F = row_of(Vec3<double>(1.1, 1, 1).asDiagonal());
      const double wanted = von_mises(F, stress.stress(F))(0);
      CHECK(wanted > 1e4);
      for (const Matrix<double>& each : {x, Matrix<double>(x * R.transpose())}) {
        const VertexMeasures m = measure_vertices(mesh, each, stress);
        CHECK((m.stress.array() / wanted - 1).abs().maxCoeff() <= 1e-9);
        CHECK((m.det.array() - 1.1).abs().maxCoeff() <= 1e-12);
      }
    }
    CHECK(measure_vertices(mesh, x).stress.size() == 0);
    // With mu = E / (2 (1 + nu)) and J = 1.1: sigma_1 - sigma_2 = mu (1.1^2 - 1) / J.
    const double mu = 5e5 / 2.9;
    CHECK(measure_vertices(mesh, x, analytic_stress(material())).stress(0) ==
          doctest::Approx(mu * 0.21 / 1.1).epsilon(1e-9));
  }

  TEST_CASE("values of elements are weighted with volumes; inverted ones have no stress") {
    const auto mesh = fem::jittered_cube(6);
    const Matrix<double> x = fem::deformed(mesh, 5);
    Matrix<double> sum = Matrix<double>::Zero(mesh.n_vertices(), 2);
    for (Index e = 0; e < mesh.n_tets(); ++e) {
      const auto corner = [&](const Matrix<double>& X, int a) {
        return Vec3<double>(X.row(mesh.tets()(e, a)));
      };
      const auto volume = [&](const Matrix<double>& X) {
        const Vec3<double> o = corner(X, 0);
        return (corner(X, 1) - o).cross(corner(X, 2) - o).dot(corner(X, 3) - o) / 6;
      };
      for (int a = 0; a < 4; ++a)
        sum.row(mesh.tets()(e, a)) += Eigen::RowVector2d(volume(x), volume(mesh.vertices()));
    }
    const VertexMeasures measures = measure_vertices(mesh, x);
    CHECK((sum.col(0).cwiseQuotient(sum.col(1)) - measures.det).cwiseAbs().maxCoeff() <= 1e-12);
    CHECK_THROWS_AS(vertex_means(mesh, Matrix<double>::Zero(3, 1)), std::invalid_argument);

    // One vertex pulled through the opposite face of its elements: NaN around it, numbers
    // elsewhere.
    Matrix<double> folded = mesh.vertices();
    folded.row(0) += Eigen::RowVector3d(0.5, 0.5, 0.5);
    const VertexMeasures m = measure_vertices(mesh, folded, analytic_stress(material()));
    CHECK(std::isnan(m.stress(0)));
    CHECK(std::isfinite(m.stress(mesh.n_vertices() - 1)));
    CHECK(m.det.allFinite());
  }

  TEST_CASE("a learned law tells the stress of its net") {
    TrainConfig config;
    config.stress.hidden = {8, 8};
    Model<float> model(config.stress, config.integration, 3);
    model.stress.set_scales(1e5, 0.1);
    const auto mesh = fem::jittered_cube(3);
    const Matrix<double> x = fem::deformed(mesh, 7);
    const StressLaw law = learned_stress(model);
    Matrix<double> F(mesh.n_tets(), 9);
    fem::deformation_gradient<double>(mesh, x, F);
    ad::Tape<float> tape(ad::Tape<float>::Mode::inference);
    const Matrix<float> F_float = F.cast<float>();
    const Matrix<float> P = model.stress.stress(tape.constant(F_float)).value();
    CHECK(law.stress(F) == P.cast<double>());
    CHECK(measure_vertices(mesh, x, law).stress ==
          vertex_means(mesh, von_mises(F, P.cast<double>())));
  }
}
