#include "autodiff/gradient_check.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"
#include "fem/neo_hookean.h"

namespace nmp::fem {

namespace {

Matrix<double> gradient(const TetMesh<double>& mesh, const Matrix<double>& x) {
  Matrix<double> F(mesh.n_tets(), 9);
  deformation_gradient<double>(mesh, x, F);
  return F;
}

Matrix<double> force(const TetMesh<double>& mesh, const Matrix<double>& P) {
  Matrix<double> corners(16, mesh.n_tets()), f(mesh.n_vertices(), 3);
  internal_force<double>(mesh, P, corners, f);
  return f;
}

// Sum of outward area vectors of the surface triangles around each vertex, over 3: the closed
// surface around a vertex, seen from its shape function.
Matrix<double> surface_areas(const TetMesh<double>& mesh) {
  Matrix<double> areas = Matrix<double>::Zero(mesh.n_vertices(), 3);
  const int face[4][3] = {
      {1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};  // outward; inner ones cancel
  for (Index e = 0; e < mesh.n_tets(); ++e)
    for (const auto& f : face) {
      const auto X = [&](int c) { return Vec3<double>(mesh.rest().row(mesh.tets()(e, f[c]))); };
      const Vec3<double> area = (X(1) - X(0)).cross(X(2) - X(0)) / 2;
      for (const int corner : f) areas.row(mesh.tets()(e, corner)) += area.transpose() / 3;
    }
  return areas;
}

}  // namespace

TEST_SUITE("fem/deformation_gradient") {
  TEST_CASE("patch: an affine map has its own gradient in every element (FE2)") {
    const TetMesh<double> mesh = jittered_cube(5);
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const Mat3<double> F0 = load_mat3<double>(random_F(1, seed), 0);
      const Matrix<double> x =
          (mesh.rest() * F0.transpose()).rowwise() + Vec3<double>(0.3, -2, 1).transpose();
      Matrix<double> wanted(mesh.n_tets(), 9);
      for (Index e = 0; e < mesh.n_tets(); ++e) store_mat3<double>(wanted, e, F0);
      check_close(gradient(mesh, x), wanted, 1e-13, F0.norm());
    }
  }

  TEST_CASE("patch: a uniform stress acts on the surface alone, with P0 N A (FE2)") {
    const TetMesh<double> mesh = jittered_cube(5);
    const Matrix<double> areas = surface_areas(mesh);
    const double area = 1.0 / 16;
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
      const Mat3<double> F0 = load_mat3<double>(random_F(1, seed), 0);
      Matrix<double> P(mesh.n_tets(), 9);
      neo_hookean_stress<double>(gradient(mesh, mesh.rest() * F0.transpose()), 1.7e5, 1.5e6, P);
      const Mat3<double> P0 = load_mat3<double>(P, 0);
      const Matrix<double> f = force(mesh, P);
      check_close(f, -areas * P0.transpose(), 1e-12, P0.norm() * area);
      double inner = 0;
      for (Index v = 0; v < mesh.n_vertices(); ++v)
        if (mesh.rest().row(v).cwiseAbs().maxCoeff() < 0.5 - 1e-9)
          inner = std::max(inner, f.row(v).norm());
      CHECK(inner <= 1e-12 * P0.norm() * area);
    }
  }

  TEST_CASE("an element's bits depend neither on its place nor on the number of threads") {
    const TetMesh<double> mesh =
        jittered_cube(8);  // 1715 tets: two chunks, the last block not full
    const Matrix<double> x = deformed(mesh, 4);
    const Matrix<double> P = random_matrix(mesh.n_tets(), 9, 5);
    set_threads(1);
    const Matrix<double> F1 = gradient(mesh, x), f1 = force(mesh, P);
    for (const int n : {2, 3, 8}) {
      set_threads(n);
      CHECK(same_bits(gradient(mesh, x), F1));
      CHECK(same_bits(force(mesh, P), f1));
    }
    set_threads(0);
    const Index last = mesh.n_tets() - 1;
    Tets one(1, 4);
    one << 0, 1, 2, 3;
    Matrix<double> X(4, 3), x1(4, 3);
    for (int a = 0; a < 4; ++a) {
      X.row(a) = mesh.vertices().row(mesh.tets()(last, a));
      x1.row(a) = x.row(mesh.tets()(last, a));
    }
    CHECK(same_bits(gradient(TetMesh<double>(X, one), x1), F1.row(last)));
  }

  TEST_CASE("adjoint of F and of f_int match central differences and dual numbers") {
    const TetMesh<double> mesh = jittered_cube(3);
    const auto check = [](const auto& f, const Matrix<double>& input) {
      const ad::GradientCheck result = ad::check_gradient(f, {input});
      INFO(result.worst);
      CHECK(result.relative <= 1e-7);
      CHECK(result.largest > 0);
      CHECK_FALSE(result.identical);
      CHECK(ad::dual_error(f, {input}) <= 1e-12);
    };
    const TetMesh<Dual> dual_mesh = mesh.cast<Dual>();
    const auto pick = [&](const auto& tape) -> const auto& {
      if constexpr (std::is_same_v<std::decay_t<decltype(tape)>, ad::Tape<double>>)
        return mesh;
      else
        return dual_mesh;
    };
    check([&](auto& tape, const auto& in) { return deformation_gradient(pick(tape), in[0]); },
          deformed(mesh, 1));
    check([&](auto& tape, const auto& in) { return internal_force(pick(tape), in[0]); },
          random_matrix(mesh.n_tets(), 9, 2));
  }

  TEST_CASE("f_int is minus the adjoint of F, weighted by volume: <f_int(P), u> = -<V P, grad u>") {
    const TetMesh<double> mesh = jittered_cube(4);
    const Matrix<double> P = random_matrix(mesh.n_tets(), 9, 1);
    const Matrix<double> u = random_matrix(mesh.n_vertices(), 3, 2);
    const Matrix<double> VP = (P.array().colwise() * mesh.volumes().col(0).array()).matrix();
    const double left = force(mesh, P).cwiseProduct(u).sum();
    const double right = -VP.cwiseProduct(gradient(mesh, u)).sum();
    CHECK(std::abs(left - right) <= 1e-13 * std::abs(right));
    CHECK(std::abs(right) > 1e-3);
  }

  TEST_CASE("refuses wrong shapes") {
    const TetMesh<double> mesh = jittered_cube(3);
    ad::Tape<double> tape;
    CHECK_THROWS_AS(deformation_gradient(mesh, tape.input(Matrix<double>::Zero(5, 3))),
                    std::invalid_argument);
    CHECK_THROWS_AS(internal_force(mesh, tape.input(Matrix<double>::Zero(5, 9))),
                    std::invalid_argument);
  }
}

}  // namespace nmp::fem
