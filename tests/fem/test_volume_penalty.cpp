#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_mat3.h"
#include "base/parallel.h"
#include "cases.h"
#include "fem/deformation_gradient.h"
#include "fem/volume_penalty.h"

namespace nmp::fem {

namespace {

struct Penalty {
  Matrix<double> value, x_bar;
};

template <class Real>
ad::Var<Real> composed(const TetMesh<Real>& mesh, ad::Var<Real> x, Real epsilon) {
  return ad::hinge_squared(ad::det_minus_one(deformation_gradient(mesh, x)), epsilon);
}

template <class Real, class Function>
Penalty evaluate(const TetMesh<Real>& mesh, const Matrix<double>& x, double epsilon,
                 const Function& function) {
  ad::Tape<Real> tape;
  const auto x_var = tape.input(x.cast<Real>());
  const auto L = function(mesh, x_var, static_cast<Real>(epsilon));
  tape.backward(ad::scale(L, Real(3)));
  return {L.value().template cast<double>(), x_var.bar().template cast<double>()};
}

template <class Real>
std::pair<Penalty, Penalty> both(const TetMesh<Real>& mesh, const Matrix<double>& x,
                                 double epsilon) {
  return {evaluate(mesh, x, epsilon,
                   [](const auto& m, auto in, auto e) { return volume_penalty(m, in, e); }),
          evaluate(mesh, x, epsilon,
                   [](const auto& m, auto in, auto e) { return composed(m, in, e); })};
}

}  // namespace

TEST_SUITE("fem/volume_penalty") {
  TEST_CASE("is the composition of its parts: 1e-12 in double, 1e-5 in float") {
    for (const Index n : {2, 3, 6}) {  // 5, 40 and 625 tets: less than a block, many
      const TetMesh<double> mesh = jittered_cube(n);
      for (const double size : {0.2, 0.5}) {  // some to most beyond epsilon, some inverted
        const Matrix<double> x = deformed(mesh, 7, size);
        const auto [fused, wanted] = both(mesh, x, 0.05);
        check_close(fused.value, wanted.value, 1e-12, wanted.value(0, 0));
        check_close(fused.x_bar, wanted.x_bar, 1e-12, wanted.x_bar.cwiseAbs().maxCoeff());
        const auto [fused_f, wanted_f] = both(mesh.cast<float>(), x, 0.05);
        check_close(fused_f.value, wanted_f.value, 1e-5, wanted.value(0, 0) + 1e-6);
        check_close(fused_f.x_bar, wanted_f.x_bar, 1e-5, wanted.x_bar.cwiseAbs().maxCoeff() + 1e-6);
      }
    }
  }

  TEST_CASE("a block at rest and one beyond epsilon: zero in the first, not in the second") {
    const TetMesh<double> mesh = jittered_cube(5);  // 320 tets
    Matrix<double> x = mesh.rest();
    for (Index v = 0; v < x.rows(); ++v)
      if (x(v, 2) > 0.3) x(v, 2) = 0.3 + 2 * (x(v, 2) - 0.3);
    const auto [fused, wanted] = both(mesh, x, 0.05);
    check_close(fused.x_bar, wanted.x_bar, 1e-12, wanted.x_bar.cwiseAbs().maxCoeff());
    Index still = 0;
    for (Index v = 0; v < x.rows(); ++v) still += fused.x_bar.row(v).norm() == 0;
    CHECK(still > 50);
    CHECK(fused.x_bar.norm() > 0);
    const auto [at_rest, none] = both(mesh, mesh.rest(), 0.05);
    CHECK(at_rest.value(0, 0) == 0);
    CHECK(at_rest.x_bar.norm() == 0);
  }

  TEST_CASE("its adjoint matches central differences and dual numbers") {
    const TetMesh<double> mesh = jittered_cube(3);
    const TetMesh<Dual> dual_mesh = mesh.cast<Dual>();
    const auto penalty = [&](auto& tape, const auto& in) {
      if constexpr (std::is_same_v<std::decay_t<decltype(tape)>, ad::Tape<double>>)
        return volume_penalty(mesh, in[0], 0.02);
      else
        return volume_penalty(dual_mesh, in[0], Dual(0.02));
    };
    const Matrix<double> x = deformed(mesh, 3, 0.2);
    const ad::GradientCheck result = ad::check_gradient(penalty, {x});
    INFO(result.worst);
    CHECK(result.relative <= 1e-7);
    CHECK(result.largest > 0);
    CHECK_FALSE(result.identical);
    CHECK(ad::dual_error(penalty, {x}) <= 1e-12);
  }

  TEST_CASE("the bits do not depend on the number of threads; a NaN stays one") {
    const TetMesh<double> mesh = jittered_cube(9);  // 2560 tets: three chunks
    Matrix<double> x = deformed(mesh, 5, 0.2);
    set_threads(1);
    const Penalty one = both(mesh, x, 0.05).first;
    set_threads(3);
    const Penalty three = both(mesh, x, 0.05).first;
    set_threads(0);
    CHECK(same_bits(one.value, three.value));
    CHECK(same_bits(one.x_bar, three.x_bar));
    x(0, 1) = std::nan("");
    const Penalty unknown = both(mesh, x, 0.05).first;
    CHECK(std::isnan(unknown.value(0, 0)));
    CHECK(std::isnan(unknown.x_bar(0, 1)));
  }

  TEST_CASE("refuses wrong shapes and a negative epsilon") {
    const TetMesh<double> mesh = jittered_cube(3);
    ad::Tape<double> tape;
    CHECK_THROWS_AS(volume_penalty(mesh, tape.input(Matrix<double>::Zero(5, 3)), 0.1),
                    std::invalid_argument);
    CHECK_THROWS_AS(volume_penalty(mesh, tape.input(mesh.rest()), -0.1), std::invalid_argument);
  }
}

}  // namespace nmp::fem
