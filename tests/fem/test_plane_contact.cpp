#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "cases.h"
#include "fem/friction.h"
#include "fem/laws.h"
#include "fem/plane_contact.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"

namespace nmp::fem {

namespace {

// A vertex that slips, one that sticks, one that leaves, one that is above and one that the step
// takes beyond, for the ground z = 0 with mu = 0.3; and one beyond that moves out again.
Matrix<double> ground_x() {
  Matrix<double> x(6, 3);
  x << 0, 0, -1e-3, 0, 0, -1e-3, 0, 0, -1e-3, 0, 0, 0.5, 0, 0, 0.01, 1, 2, -0.1;
  return x;
}
Matrix<double> ground_v() {
  Matrix<double> v(6, 3);
  v << 3, 4, -2, 0.3, 0.4, -2, 3, 4, 1, 3, 4, -2, -0.6, 0.8, -1.1, 1, 1, 12;
  return v;
}

// The same, turned by R and moved along the plane's normal by d.
struct Turned {
  Mat3<double> R = random_rotation(5);
  double d = 0.7;
  Matrix<double> x() const {
    Matrix<double> turned = ground_x() * R.transpose();
    turned.rowwise() += d * R.col(2).transpose();
    return turned;
  }
  Matrix<double> v() const { return ground_v() * R.transpose(); }
  template <class Real>
  Boundary<Real> boundary() const {
    Boundary<Real> boundary;
    boundary.planes = {{R.col(2).template cast<Real>(), Real(d), Real(0.3)}};
    return boundary;
  }
};

}  // namespace

TEST_SUITE("fem/plane_contact") {
  TEST_CASE("a turned plane does what the ground does") {
    Boundary<double> ground{{}, 0.0};
    ground.friction = make_friction<double>(0.3);
    const double h = 0.01;
    Matrix<double> x = ground_x(), v = ground_v();
    rub<double>(ground, h, x, v);
    const Matrix<double> rubbed = v;
    x += h * v;
    project_ground<double>(ground, x, v);

    const Turned turned;
    const auto plane = turned.boundary<double>();
    Matrix<double> x_turned = turned.x(), v_turned = turned.v();
    rub_on_planes<double>(plane, h, x_turned, v_turned);
    check_close(Matrix<double>(v_turned * turned.R), rubbed, 1e-14, 1);
    CHECK_FALSE(v_turned.isApprox(turned.v(), 1e-3));
    x_turned += h * v_turned;
    project_planes<double>(plane, x_turned, v_turned);
    check_close(Matrix<double>(v_turned * turned.R), v, 1e-14, 1);
    x_turned.rowwise() -= turned.d * turned.R.col(2).transpose();
    check_close(Matrix<double>(x_turned * turned.R), x, 1e-14, 1);
  }

  TEST_CASE("the adjoints are those of the branch taken") {
    const Turned turned;
    const auto f = [&](auto& tape, const auto& in) {
      using Real = typename std::decay_t<decltype(in[0].value())>::Scalar;
      (void)tape;
      const auto boundary = turned.boundary<Real>();
      const auto v = rub_on_planes(boundary, Real(0.01), in[0], in[1]);
      const Contact<Real> after = project_planes(boundary, {in[0], v});
      return ad::multiply(after.x, ad::add(after.v, in[0]));
    };
    const ad::GradientCheck result = ad::check_gradient(f, {turned.x(), turned.v()});
    INFO(result.worst);
    CHECK(result.relative <= 1e-8);
    CHECK(result.largest > 0);
    CHECK(ad::dual_error(f, {turned.x(), turned.v()}) <= 1e-13);
  }

  TEST_CASE("a body that falls into a wedge of two planes touches both and stays inside") {
    const TetMesh<double> mesh = jittered_cube(2);
    Boundary<double> boundary;
    const double s = std::sqrt(0.5);
    boundary.planes = {{{s, 0, s}, -0.75, 0.9}, {{-s, 0, s}, -0.75, 0.9}};
    const SemiImplicitEuler<double> euler(1000, {0, 0, -9.8});
    const auto law = make_law<double>(Material());
    const StepContext<double> context{mesh, 1e-4, boundary};
    State<double> state{mesh.vertices(), Matrix<double>::Zero(8, 3)};
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    double lowest[2] = {1, 1};
    for (int k = 0; k < 2000; ++k) {
      tape.clear();
      const Step<double> next =
          step<double>(*law, euler, context, tape.constant(state.x), tape.constant(state.v));
      state.x = next.x.value();
      state.v = next.v.value();
      for (std::size_t i = 0; i < 2; ++i) {
        const Plane<double>& plane = boundary.planes[i];
        lowest[i] = std::min(lowest[i], (state.x * plane.normal).minCoeff() - plane.height);
      }
    }
    for (const double height : lowest) CHECK(std::abs(height) <= 1e-12);
  }

  TEST_CASE("plain and taped steps are one") {
    const TetMesh<double> mesh = jittered_cube(3);
    const Turned turned;
    Boundary<double> boundary = turned.boundary<double>();
    boundary.ground = -0.2;
    boundary.planes.push_back({{-1, 0, 0}, -0.4, 0});
    boundary.pinned = {2, 5};
    move_pins<double>(boundary, random_matrix(2, 3, 1), random_matrix(2, 3, 2));
    Matrix<double> x = mesh.vertices(), v = random_matrix(x.rows(), 3, 3, -9, 9);
    const Matrix<double> dv = random_matrix(x.rows(), 3, 4);
    const StepContext<double> context{mesh, 0.01, boundary};
    ad::Tape<double> tape;
    const Contact<double> taped = advance(context, tape.input(x), tape.input(v), tape.constant(dv));
    advance<double>(mesh, boundary, 0.01, dv, x, v);
    CHECK(same_bits(taped.x.value(), x));
    CHECK(same_bits(taped.v.value(), v));
  }
}

TEST_SUITE("fem/boundary") {
  TEST_CASE("pins go where they are moved to") {
    const TetMesh<double> mesh = jittered_cube(2);
    Boundary<double> boundary = make_boundary<double>(mesh, {6, 1}, {});
    const Matrix<double> to = random_matrix(2, 3, 1), speed = random_matrix(2, 3, 2);
    move_pins<double>(boundary, to, speed);
    Matrix<double> x = mesh.vertices(), v = random_matrix(8, 3, 3);
    const Matrix<double> v_before = v;
    pin<double>(mesh, boundary, x, v);
    CHECK(same_bits(x.row(1), to.row(0)));  // in ascending order
    CHECK(same_bits(v.row(6), speed.row(1)));
    CHECK(same_bits(v.row(2), v_before.row(2)));
    CHECK_THROWS_AS(move_pins<double>(boundary, random_matrix(3, 3, 1), speed),
                    std::invalid_argument);
  }
}

TEST_SUITE("fem/integrator") {
  TEST_CASE("semi-implicit Euler is differentiable in the density") {
    const TetMesh<double> mesh = jittered_cube(2);
    SemiImplicitEuler<double> euler(2.5, {0, 1, -9.8});
    euler.density.set_frozen(false);
    const Boundary<double> boundary;
    const Matrix<double> f = random_matrix(8, 3, 1), weight = random_matrix(8, 3, 2);
    const auto loss = [&](ad::Tape<double>& tape) {
      const Var<double> x = tape.constant(mesh.vertices());
      const Var<double> dv =
          euler.dv(StepContext<double>{mesh, 0.1, boundary}, x, x, tape.constant(f));
      return ad::mean_square(ad::multiply(dv, tape.constant(weight)));
    };
    const ad::GradientCheck result = ad::check_gradient(loss, {&euler.density});
    CHECK(result.relative <= 1e-8);
    CHECK(result.largest > 0);
  }
}

}  // namespace nmp::fem
