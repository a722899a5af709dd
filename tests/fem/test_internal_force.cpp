#include <Eigen/Eigenvalues>

#include "autodiff/ops_loss.h"
#include "autodiff/ops_mat3.h"
#include "cases.h"
#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"
#include "fem/laws.h"
#include "fem/neo_hookean.h"
#include "fem/stvk.h"

namespace nmp::fem {

namespace {

const char* const kLaws[] = {"neo-hookean", "stvk"};

// dE/dx along u, by dual numbers: E = sum_e V_e Psi(F_e).
double energy_slope(const std::string& law, const TetMesh<double>& mesh, const Matrix<double>& x,
                    const Matrix<double>& u) {
  const Lame c = lame(5e5, 0.45);
  Matrix<Dual> x_dual(x.rows(), 3), F(mesh.n_tets(), 9), Psi(mesh.n_tets(), 1);
  for (Index i = 0; i < x.size(); ++i) x_dual.data()[i] = Dual(x.data()[i], u.data()[i]);
  deformation_gradient<Dual>(mesh.cast<Dual>(), x_dual, F);
  if (law == "stvk")
    stvk_energy<Dual>(F, c.mu, c.lambda, Psi);
  else
    neo_hookean_energy<Dual>(F, c.mu, c.lambda, Psi);
  double slope = 0;
  for (Index e = 0; e < mesh.n_tets(); ++e) slope += mesh.volumes()(e, 0) * Psi(e, 0).d;
  return slope;
}

}  // namespace

TEST_SUITE("fem/internal_force") {
  TEST_CASE("f_int = -dE/dx by dual numbers and by differences of the energy (FE1)") {
    const TetMesh<double> mesh = jittered_cube(3);
    for (const std::string law : kLaws) {
      CAPTURE(law);
      Simulator<double> simulator(mesh, free_flight(law), 1e-5);
      const Matrix<double> x = deformed(mesh, 1, 0.1);
      const Matrix<double> f = simulator.internal_force(x);
      Matrix<double> by_dual(f.rows(), 3), by_difference(f.rows(), 3);
      for (Index k = 0; k < f.size(); ++k) {
        Matrix<double> u = Matrix<double>::Zero(f.rows(), 3);
        u.data()[k] = 1;
        by_dual.data()[k] = -energy_slope(law, mesh, x, u);
        const auto slope = [&](double h) {
          return (simulator.energy({x + h * u, u}).elastic -
                  simulator.energy({x - h * u, u}).elastic) /
                 (2 * h);
        };
        by_difference.data()[k] = -(4 * slope(1e-4) - slope(2e-4)) / 3;
      }
      const double scale = f.cwiseAbs().maxCoeff();
      check_close(f, by_dual, 1e-12, scale);
      check_close(f, by_difference, 1e-7, scale);
    }
  }

  TEST_CASE("rigid motion makes no force and no energy (FE4)") {
    const TetMesh<double> mesh = jittered_cube(5);
    const double area = 1.0 / 16, E = 5e5;
    for (const std::string law : kLaws) {
      Simulator<double> simulator(mesh, free_flight(law), 1e-5);
      for (std::uint64_t seed = 1; seed <= 10; ++seed) {
        const Matrix<double> x = (mesh.rest() * random_rotation(seed).transpose()).rowwise() +
                                 random_matrix(1, 3, seed).row(0);
        CHECK(simulator.internal_force(x).cwiseAbs().maxCoeff() <= 1e-12 * E * area);
        CHECK(std::abs(simulator.energy({x, x}).elastic) <= 1e-14 * E);
        const Matrix<double> stretched = 1.001 * x;  // the same check sees a stretch of 1e-3
        CHECK(simulator.internal_force(stretched).cwiseAbs().maxCoeff() > 1e-12 * E * area);
        CHECK(simulator.energy({stretched, x}).elastic > 1e-14 * E);
      }
    }
  }

  TEST_CASE("stiffness at rest: symmetric, six free motions, no seventh (FE5)") {
    const TetMesh<double> mesh = jittered_cube(3);
    for (const std::string law_name : kLaws) {
      Material material;
      material.law = law_name;
      const auto law = make_law<double>(material);
      ad::Tape<double> tape;
      const auto x = tape.input(mesh.rest());
      const auto f = law->internal_force(mesh, x);
      const Index n = f.value().size();
      Matrix<double> K(n, n);
      for (Index k = 0; k < n; ++k) {
        Matrix<double> f_bar = Matrix<double>::Zero(f.rows(), 3);
        f_bar.data()[k] = -1;
        tape.backward(f, f_bar);
        K.row(k) = Eigen::Map<const Eigen::RowVectorXd>(x.bar().data(), n);
      }
      CHECK(difference(K, K.transpose(), K.cwiseAbs().maxCoeff()) <= 1e-13);
      const Eigen::VectorXd values =
          Eigen::SelfAdjointEigenSolver<Matrix<double>>(K, Eigen::EigenvaluesOnly).eigenvalues();
      const double largest = values[n - 1];
      CHECK(values.head(6).cwiseAbs().maxCoeff() <= 1e-10 * largest);
      CHECK(values[6] > 1e-6 * largest);
    }
  }

  TEST_CASE("volume penalty: a mean over elements of the hinge, and its gradient (FE20)") {
    const TetMesh<double> mesh = cube_mesh(2, 1);
    const double width = 0.05;
    const auto penalty = [&](double J, Matrix<double>* F_bar) {
      ad::Tape<double> tape;
      Matrix<double> F(mesh.n_tets(), 9);
      deformation_gradient<double>(mesh, std::cbrt(J) * mesh.rest(), F);
      const auto F_var = tape.input(F);
      const auto L = ad::hinge_squared(ad::det_minus_one(F_var), width);
      tape.backward(L);
      if (F_bar) *F_bar = F_var.bar();
      return L.value()(0, 0);
    };
    for (const double J : {1.1, 0.9}) {
      Matrix<double> F_bar;
      CHECK(std::abs(penalty(J, &F_bar) - 0.0025) <= 1e-13 * 0.0025 * 20);  // 0.1 - 0.05 cancels
      const double factor = 2 * (std::abs(J - 1) - width) * (J > 1 ? 1 : -1) / 5;
      Matrix<double> wanted = Matrix<double>::Zero(5, 9);  // cof(s I) = s^2 I
      for (const int k : {0, 4, 8}) wanted.col(k).setConstant(factor * std::cbrt(J * J));
      check_close(F_bar, wanted, 1e-13, 0.1 / 5);
    }
    Matrix<double> F_bar;
    CHECK(penalty(0.96, &F_bar) == 0);
    CHECK(F_bar.cwiseAbs().maxCoeff() == 0);
  }
}

}  // namespace nmp::fem
