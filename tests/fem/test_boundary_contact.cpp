#include <algorithm>

#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "cases.h"
#include "fem/contact.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"

namespace nmp::fem {

namespace {

// Vertices that feel nothing but gravity.
template <class Real>
struct NoStress : ConstitutiveLaw<Real> {
  Var<Real> stress(Var<Real> F) const override {
    return F.tape().constant(Matrix<Real>::Zero(F.rows(), 9));
  }
};

Boundary<double> ground_at(double z) { return {{}, z}; }

}  // namespace

TEST_SUITE("fem/boundary") {
  TEST_CASE("pins are sorted, repeated ones dropped, wrong ones refused (FE18)") {
    const TetMesh<double> mesh = cube_mesh(3, 1);
    CHECK(make_boundary<double>(mesh, {7, 2, 7, 26, 2}, std::nullopt).pinned ==
          std::vector<int>{2, 7, 26});
    CHECK(make_boundary<double>(mesh, {}, 1.5).ground == 1.5);
    for (const int bad : {-1, 27})
      CHECK(contains(message<std::invalid_argument>([&] {
                       make_boundary<double>(mesh, {3, bad}, std::nullopt);
                     }),
                     "pinned vertex " + std::to_string(bad)));
  }

  TEST_CASE("pinned vertices are at rest with velocity 0 at every step; the others pass (FE18)") {
    const TetMesh<double> mesh = jittered_cube(3);
    std::vector<int> all(27);
    for (int v = 0; v < 27; ++v) all[std::size_t(v)] = v;
    for (const std::vector<int>& pins : {std::vector<int>{0, 1, 5}, all, std::vector<int>{}}) {
      for (const bool ground : {false, true}) {
        Physics physics;
        physics.pinned = pins;
        if (ground) physics.ground = -0.5;  // pinned vertices stand on it
        Simulator<double> simulator(mesh, physics, 5e-4);
        State<double> state{mesh.rest(), random_matrix(27, 3, 1)};
        bool held = true, moved = false;
        for (int k = 0; k < 50; ++k) {
          simulator.advance(state, 1);
          for (const int v : pins)
            held &= same_bits(state.x.row(v), mesh.rest().row(v)) &&
                    same_bits(state.v.row(v), Matrix<double>::Zero(1, 3));
          moved |= !same_bits(state.x.row(13), mesh.rest().row(13));
        }
        CHECK(held);
        CHECK(moved == (pins.size() < 27));
      }
    }
  }

  TEST_CASE("adjoints of the pins match differences, and are 0 at pinned vertices (FE18)") {
    const TetMesh<double> mesh = cube_mesh(3, 1);
    const TetMesh<Dual> dual_mesh = mesh.cast<Dual>();
    const Boundary<double> boundary{{0, 5, 26}, std::nullopt};
    const Boundary<Dual> dual_boundary{{0, 5, 26}, std::nullopt};
    const auto f = [&](auto& tape, const auto& in) {
      if constexpr (std::is_same_v<std::decay_t<decltype(tape)>, ad::Tape<double>>)
        return ad::concat<double>(
            {pin_positions(mesh, boundary, in[0]), pin_velocities(boundary, in[1])});
      else
        return ad::concat<Dual>(
            {pin_positions(dual_mesh, dual_boundary, in[0]), pin_velocities(dual_boundary, in[1])});
    };
    const std::vector<Matrix<double>> inputs = {random_matrix(27, 3, 1), random_matrix(27, 3, 2)};
    CHECK(ad::check_gradient(f, inputs).relative <= 1e-7);
    CHECK(ad::dual_error(f, inputs) <= 1e-12);
    ad::Tape<double> tape;
    const auto x = tape.input(inputs[0]);
    tape.backward(pin_positions(mesh, boundary, x), Matrix<double>::Ones(27, 3));
    for (const int v : boundary.pinned) CHECK(x.bar().row(v).cwiseAbs().maxCoeff() == 0);
    CHECK(x.bar().sum() == 3 * 24);
  }
}

TEST_SUITE("fem/contact") {
  TEST_CASE("puts what is below the ground on it, stops its descent, and nothing else") {
    Matrix<double> x(6, 3), v(6, 3);
    x << 1, 2, 0.5, 1, 2, -0.1, 1, 2, -0.2, 1, 2, 0, 1, 2, std::nan(""), 3, 4, -1e-300;
    v << 1, 2, -3, 1, 2, -3, 1, 2, 3, 1, 2, -3, 1, 2, -3, 5, 6, -7;
    Matrix<double> x_wanted = x, v_wanted = v;
    x_wanted(1, 2) = x_wanted(2, 2) = x_wanted(5, 2) = 0;
    v_wanted(1, 2) = v_wanted(5, 2) = 0;
    project_ground<double>(ground_at(0), x, v);
    CHECK(same_bits(x, x_wanted));
    CHECK(same_bits(v, v_wanted));
    project_ground<double>(Boundary<double>{}, x, v);
    CHECK(same_bits(x, x_wanted));
  }

  TEST_CASE("a falling point meets the ground at the step of the discrete law (FE16)") {
    const TetMesh<double> mesh = cube_mesh(2, 1);
    const double h = 1e-3, g = -9.8;
    const Boundary<double> boundary = ground_at(-1.7);
    const NoStress<double> law;
    const SemiImplicitEuler<double> integrator(1000, Vec3<double>(0, 0, g));
    const StepContext<double> context{mesh, h, boundary};
    Matrix<double> x = mesh.rest(), v = random_matrix(8, 3, 3);
    const Matrix<double> x0 = x, v0 = v;
    std::vector<int> first(8, -1), wanted(8, -1);
    for (Index i = 0; i < 8; ++i)
      for (int n = 1; n <= 900; ++n)
        if (wanted[std::size_t(i)] < 0 &&
            x0(i, 2) + n * h * v0(i, 2) + h * h * g * n * (n + 1) / 2 < -1.7)
          wanted[std::size_t(i)] = n;
    bool on_ground = true, slides = true;
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    for (int n = 1; n <= 900; ++n) {
      tape.clear();
      const auto next = step<double>(law, integrator, context, tape.constant(x), tape.constant(v));
      x = next.x.value();
      v = next.v.value();
      for (Index i = 0; i < 8; ++i) {
        int& contact = first[std::size_t(i)];
        if (contact < 0 && x(i, 2) == -1.7) contact = n;
        if (contact > 0) on_ground &= x(i, 2) == -1.7 && v(i, 2) == 0;
        slides &= same_bits(v.row(i).leftCols(2), v0.row(i).leftCols(2));
      }
    }
    CHECK(first == wanted);
    CHECK(*std::min_element(wanted.begin(), wanted.end()) > 0);
    CHECK(on_ground);
    CHECK(slides);
  }

  TEST_CASE("adjoint is that of the branch taken; exactly on the ground nothing is projected") {
    Matrix<double> x = random_matrix(30, 3, 1), v = random_matrix(30, 3, 2);
    const auto f = [](auto& tape, const auto& in) {
      using Real = typename std::decay_t<decltype(in[0].value())>::Scalar;
      (void)tape;
      const Contact<Real> c = project_ground(Boundary<Real>{{}, Real(0.1)}, in[0], in[1]);
      return ad::concat<Real>({c.x, c.v});
    };
    for (Index i = 0; i < 30; ++i)
      if (std::abs(x(i, 2) - 0.1) < 1e-3 || std::abs(v(i, 2)) < 1e-3) x(i, 2) = v(i, 2) = 0.5;
    const ad::GradientCheck result = ad::check_gradient(f, {x, v});
    INFO(result.worst);
    CHECK(result.relative <= 1e-7);
    CHECK(ad::dual_error(f, {x, v}) <= 1e-12);

    x.col(2).setConstant(0.1);
    v.col(2).setConstant(-1);
    ad::Tape<double> tape;
    const auto x_var = tape.input(x), v_var = tape.input(v);
    const auto contact = project_ground(ground_at(0.1), x_var, v_var);
    tape.backward(ad::concat<double>({contact.x, contact.v}), Matrix<double>::Ones(30, 6));
    CHECK(x_var.bar().sum() == 90);
    CHECK(v_var.bar().sum() == 90);
  }
}

}  // namespace nmp::fem
