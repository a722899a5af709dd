#include "nmp/bench_case.h"

#include <Eigen/Geometry>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "base/check.h"
#include "base/random.h"
#include "fem/step.h"
#include "fem/volume_penalty.h"

namespace nmp {

namespace {

const fem::Material kMaterial;
constexpr double kGravity = -9.8;

fem::State<float> falling(const fem::TetMesh<double>& mesh) {
  const Random random(1);
  const Mat3<double> turn =
      Eigen::AngleAxis<double>(0.7, Vec3<double>(1, 2, 3).normalized()).toRotationMatrix();
  const Mat3<double> stretch = Vec3<double>(1.05, 0.97, 1.01).asDiagonal();
  Matrix<double> x = mesh.vertices() * (turn * stretch).transpose();
  for (Index i = 0; i < x.size(); ++i)
    x.data()[i] += 0.01 * mesh.mean_edge_length() * random.normal(static_cast<std::uint64_t>(i));
  x.col(2).array() += 0.05 - x.col(2).minCoeff();
  const Matrix<double> v = Eigen::RowVector3d(0.5, 0.2, -1).replicate(x.rows(), 1);
  return {x.cast<float>(), v.cast<float>()};
}

}  // namespace

void make_linear_elastic(StressNet<float>& net, const fem::Lame& lame) {
  const auto weights = net.parameters();
  NMP_CHECK(!net.config().bias && weights.size() == 3 && weights[0]->value().rows() >= 9 &&
                weights[1]->value().rows() >= 9,
            "this needs a stress net without biases, with two hidden layers of 9 units or more");
  // So small that silu(u) = u/2 up to u/2: silu(silu(u)) = u/4.
  constexpr float kSmall = 1e-2f;
  const auto tr = static_cast<float>(lame.lambda / (2 * lame.mu));
  Matrix<float>& first = weights[0]->mutable_value();
  Matrix<float>& second = weights[1]->mutable_value();
  Matrix<float>& last = weights[2]->mutable_value();
  first.topRows(9).setZero();
  second.topRows(9).setZero();
  last.setZero();
  for (int i = 0; i < 9; ++i) {
    constexpr int kC = 3;  // columns of C - I in the features, after the singular values
    first(i, kC + i) = kSmall;
    if (i % 4 == 0)
      for (const int diagonal : {0, 4, 8}) first(i, kC + diagonal) += kSmall * tr;
    second(i, i) = 1;
    last(i, i) = 4 / kSmall;
  }
  net.set_scales(lame.mu, 1);
}

BenchCase::BenchCase(const fem::TetMesh<double>& mesh, double h)
    : mesh_(mesh.cast<float>()),
      boundary_(fem::make_boundary<float>(mesh_, {}, 0.0f)),
      model_(StressNetConfig(), IntegrationNetConfig(), 1),
      start_(falling(mesh)),
      f_true_(Matrix<float>::Zero(mesh.n_vertices(), 3)),
      h_(static_cast<float>(h)) {
  make_linear_elastic(model_.stress, fem::lame(kMaterial.E, kMaterial.nu));
  model_.integration.set_scales({0.5, 3, 1e5, 1e3, "height"});
  model_.integration.set_affine(1 / kMaterial.density, {0, 0, kGravity});
}

Simulation<float> BenchCase::simulation() const {
  return {mesh_, model_.stress, model_.integration, boundary_, h_};
}

ad::Vars<float> BenchCase::step(const ad::Vars<float>& in) const {
  const fem::StepContext<float> context{mesh_, h_, boundary_};
  const ad::Var<float> x = in[0], v = in[1];
  const ad::Var<float> f_int = in[2];
  const ad::Var<float> dv = model_.integration.dv(context, x, v, f_int);
  ad::Tape<float>& tape = x.tape();
  const float n = static_cast<float>(mesh_.n_vertices());
  const auto term = [&](ad::Var<float> value, const Matrix<float>& truth) {
    return ad::scale(ad::squared_norm(ad::subtract(value, tape.constant(truth))), 1 / n);
  };
  ad::Var<float> loss = ad::scale(term(f_int, f_true_), 1e-6f);
  loss = ad::add(loss, term(x, start_.x));
  loss = ad::add(loss, term(ad::add(v, ad::scale(dv, 0.5f)), start_.v));
  constexpr float kEpsilon = 0.05f;
  loss = ad::add(loss, ad::scale(fem::volume_penalty(mesh_, x, kEpsilon), 0.1f));
  const fem::Contact<float> next = fem::advance(context, x, v, dv);
  return {next.x, next.v, loss};
}

ad::Var<float> BenchCase::loss(ad::Tape<float>& tape, Index n_steps) const {
  NMP_CHECK(n_steps >= 1, text("a rollout needs a step, got ", n_steps));
  const ad::Piece<float> piece = [this](ad::Tape<float>&, const ad::Vars<float>& in) {
    return step(in);
  };
  ad::Vars<float> state{tape.constant(start_.x), tape.constant(start_.v)};
  ad::Var<float> loss;
  for (Index k = 0; k < n_steps; ++k) {
    state.push_back(model_.stress.internal_force(mesh_, state[0]));
    const ad::Vars<float> out = ad::checkpoint<float>(piece, state);
    loss = k == 0 ? out[2] : ad::add(loss, out[2]);
    state = {out[0], out[1]};
  }
  return loss;
}

void BenchCase::gradient(ad::Tape<float>& tape, Index n_steps) {
  const auto parameters = model_.parameters();
  tape.clear();
  nn::zero_bars<float>(parameters);
  tape.backward(loss(tape, n_steps));
  const std::string bad = nn::first_non_finite_bar<float>(parameters);
  if (!bad.empty()) throw NumericalError("the gradient of " + bad + " is not finite");
}

double cube_step(Index n) { return 5e-4 * 9 / static_cast<double>(n - 1); }

}  // namespace nmp
