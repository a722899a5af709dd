#include "nmp/bench_measure.h"

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "autodiff/svd3.h"
#include "base/check.h"
#include "base/random.h"
#include "fem/lane_simulator.h"
#include "fem/mesh_check.h"
#include "fem/mesh_cube.h"
#include "fem/mesh_file.h"
#include "fem/stability.h"
#include "nmp/bench_samples.h"
#include "nmp/body.h"
#include "nn/adam.h"

namespace nmp {

namespace {

using Inference = ad::Tape<float>;

constexpr Index kSteps = 60;           // of the rollouts that are differentiated
constexpr Index kBatch = 4096;         // elements without a mesh
constexpr double kStressMacs = 9584;   // of the stress net, 13 x 80 + 80 x 96 + 96 x 9
constexpr double kMaxSvdError = 2e-6;  // of a batch that counts

std::string number(double value) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.3g", value);
  return digits;
}

// Deformation gradients as a rough motion makes them: of any rotation, strained by tens of percent.
Matrix<float> rough_F(Index n) {
  const Random random(2);
  Matrix<float> F(n, 9);
  for (Index i = 0; i < F.size(); ++i)
    F.data()[i] = static_cast<float>(0.3 * random.normal(static_cast<std::uint64_t>(i)));
  for (const int diagonal : {0, 4, 8}) F.col(diagonal).array() += 1.0f;
  return F;
}

fem::TetMesh<double> read_bob(const std::string& file) {
  fem::RawMesh raw = fem::read_mesh(file);
  fem::turn_and_scale(raw.vertices, 1, true);
  const fem::RepairedMesh repaired = fem::repair(raw, printable(file));
  return fem::TetMesh<double>(repaired.mesh.vertices, repaired.mesh.tets);
}

// Largest errors over a batch: of U Sigma V^T relative to F, and of U^T U and V^T V against I.
struct SvdErrors {
  double reconstruction = 0, orthogonality = 0;
  void add(const Mat3<float>& F, const Mat3<float>& U, const Vec3<float>& sigma,
           const Mat3<float>& V) {
    const Mat3<double> u = U.cast<double>(), v = V.cast<double>(), f = F.cast<double>();
    const Mat3<double> again = u * sigma.cast<double>().asDiagonal() * v.transpose();
    const auto max = [](double& largest, double value) { largest = std::max(largest, value); };
    max(reconstruction, (again - f).norm() / f.norm());
    max(orthogonality, (u.transpose() * u - Mat3<double>::Identity()).norm());
    max(orthogonality, (v.transpose() * v - Mat3<double>::Identity()).norm());
  }
  double largest() const { return std::max(reconstruction, orthogonality); }
};

void set(BenchRow& row, const std::vector<double>& samples) {
  const Summary summary = summarise(samples);
  row.value = summary.median;
  row.spread = summary.spread;
}

void skip(BenchRow& row, const std::string& why) {
  row.verdict = "skipped";
  row.note = why;
}

}  // namespace

void BenchMeasure::each_round() const {
  if (options_.progress) options_.progress(now_);
}

std::vector<std::vector<double>> BenchMeasure::in_turns(
    const std::vector<std::function<void()>>& pieces) const {
  return take_turns(pieces, options_.seconds, options_.repetitions, [this] { each_round(); });
}

BenchCase& BenchMeasure::body() {
  if (body_) return *body_;
  const bool bob = !options_.bob.empty();
  const fem::TetMesh<double> mesh = bob ? read_bob(options_.bob) : fem::cube_mesh(10, 1);
  const double h = bob ? frame_step(fem::stable_time_step(mesh, fem::Material())) : cube_step(10);
  body_ = std::make_unique<BenchCase>(mesh, h);
  body_name_ = bob ? "bob" : "cube";
  return *body_;
}

std::string BenchMeasure::on_body() const {
  return text("on ", body_name_, ", ", body_->mesh().n_vertices(), " vertices, ",
              body_->mesh().n_tets(), " tetrahedra");
}

void BenchMeasure::measure(BenchRow& row) {
  now_ = row.name;
  if (row.name == "stress_module") stress_module(row);
  if (row.name == "gradient") gradient(row);
  if (row.name == "svd") svd(row);
  if (row.name == "bob_rollout") bob_rollout(row);
  if (row.name == "ground_truth") ground_truth(row);
  if (row.name == "allocations") allocations(row);
  if (row.name == "memory") memory(row);
  if (row.verdict.empty())
    row.verdict = bench_verdict(row.value, row.good, row.great, row.less_is_better);
}

// From positions to forces, with everything between. Counted are the products of the net alone.
void BenchMeasure::stress_module(BenchRow& row) {
  BenchCase& bench = body();
  Inference tape(Inference::Mode::inference);
  const auto seconds =
      in_turns({[&] {
                  tape.clear();
                  bench.model().stress.internal_force(bench.mesh(), tape.constant(bench.start().x));
                },
                [&] { sink_ += peak_.run(); }});
  const double flops = 2 * kStressMacs * static_cast<double>(bench.mesh().n_tets());
  std::vector<double> parts = ratios(seconds[1], seconds[0]);
  for (double& part : parts) part *= flops / peak_.flops;
  set(row, parts);
  stress_part_ = row.value;
  const double s = summarise(seconds[0]).median, s_peak = summarise(seconds[1]).median;
  row.note = text(number(flops / s / 1e9), " of ", number(peak_.flops / s_peak / 1e9), " GFLOP/s (",
                  peak_.instructions, " multiply-adds on registers), ", number(s * 1e3), " ms ",
                  on_body());
}

void BenchMeasure::gradient(BenchRow& row) {
  BenchRow first = bench_row("stress_module");
  if (std::isnan(stress_part_)) stress_module(first);
  BenchCase& bench = body();
  Inference forward(Inference::Mode::inference);
  ad::Tape<float> tape;
  const auto seconds = in_turns({[&] { bench.gradient(tape, kSteps); },
                                 [&] {
                                   forward.clear();
                                   bench.loss(forward, kSteps);
                                 }});
  set(row, ratios(seconds[0], seconds[1]));
  row.note = text(number(summarise(seconds[0]).median * 1e3), " ms / ",
                  number(summarise(seconds[1]).median * 1e3), " ms ", on_body());
  if (stress_part_ < first.good) {
    row.verdict = "short";
    row.note += text("; does not count while the stress module is at ", number(stress_part_),
                     ", below ", first.good, ": a slow forward pass flatters it");
  }
}

void BenchMeasure::svd(BenchRow& row) {
  const Matrix<float> F = rough_F(kBatch);
  std::vector<Mat3<float>> matrices;
  for (Index e = 0; e < kBatch; ++e) matrices.push_back(load_mat3<float>(F, e));
  Matrix<float> U(kBatch, 9), sigma(kBatch, 3), V(kBatch, 9);
  struct Plain {
    Mat3<float> U, V;
    Vec3<float> sigma;
  };
  std::vector<Plain> plain(kBatch);
  const auto seconds =
      in_turns({[&] {
                  for (std::size_t e = 0; e < matrices.size(); ++e) {
                    const Eigen::JacobiSVD<Mat3<float>> one(
                        matrices[e], Eigen::ComputeFullU | Eigen::ComputeFullV);
                    plain[e] = {one.matrixU(), one.matrixV(), one.singularValues()};
                  }
                },
                [&] { ad::svd_rotation_variant<float>(F, U, sigma, V); }});
  set(row, ratios(seconds[0], seconds[1]));
  SvdErrors eigen, ours;
  for (Index e = 0; e < kBatch; ++e) {
    const auto k = static_cast<std::size_t>(e);
    eigen.add(matrices[k], plain[k].U, plain[k].sigma, plain[k].V);
    ours.add(matrices[k], load_mat3<float>(U, e), load_vec3<float>(sigma, e),
             load_mat3<float>(V, e));
  }
  const auto per_matrix = [](const std::vector<double>& s) {
    return number(summarise(s).median / kBatch * 1e9);
  };
  row.note = text(per_matrix(seconds[0]), " ns / ", per_matrix(seconds[1]), " ns, ", kBatch,
                  " matrices; largest errors of U Sigma V^T and of U^T U, V^T V: ",
                  number(ours.reconstruction), ", ", number(ours.orthogonality), " (Eigen's ",
                  number(eigen.reconstruction), ", ", number(eigen.orthogonality), ")");
  if (!(ours.largest() <= kMaxSvdError)) {
    row.verdict = "short";
    row.note += text("; does not count: an error is above ", kMaxSvdError);
  }
}

void BenchMeasure::bob_rollout(BenchRow& row) {
  if (options_.bob.empty())
    return skip(row,
                "needs the mesh: --meshes DIR, or the environment variable NMP_MESHES, "
                "names the folder of bob.msh");
  const BenchCase& bench = body();
  const auto seconds = in_turns({[&] {
    const RolloutEnd end =
        roll_out<float>(bench.simulation(), bench.start(), 1000, [this](const Frame<float>& f) {
          if (f.t % 100 == 0) each_round();
        });
    if (end.diverged) throw NumericalError("the rollout of BOB diverged " + end.reason);
  }});
  set(row, seconds[0]);
  row.note = text(on_body(), ", ", number(row.value), " ms a frame");
}

void BenchMeasure::ground_truth(BenchRow& row) {
  constexpr Index kTrajectories = 8, kStepsEach = 20;
  const fem::TetMesh<double> mesh = fem::cube_mesh(10, 1);
  const BenchCase bench(mesh, cube_step(10));
  const fem::State<double> start{bench.start().x.cast<double>(), bench.start().v.cast<double>()};
  fem::Physics physics;
  physics.ground = 0;
  const double dt = 1e-5;
  fem::LaneSimulator lanes(mesh, physics, dt, kTrajectories);
  for (Index i = 0; i < kTrajectories; ++i) lanes.set_state(i, start);
  ScalarLoop loop(mesh, physics, dt);
  loop.set_state(start);
  const auto seconds =
      in_turns({[&] { loop.advance(kStepsEach); }, [&] { lanes.advance(kStepsEach); }});
  std::vector<double> speedups = ratios(seconds[0], seconds[1]);
  for (double& speedup : speedups) speedup *= kTrajectories;
  set(row, speedups);
  // Both have made the same steps.
  const double difference = (lanes.state(0).x - loop.state().x).cwiseAbs().maxCoeff();
  if (!(difference < 1e-8))
    throw NumericalError(text("the simulator and the scalar loop are ", difference, " m apart"));
  const double steps = static_cast<double>(mesh.n_tets() * kStepsEach);
  row.note =
      text(number(kTrajectories * steps / summarise(seconds[1]).median / 1e6), " / ",
           number(steps / summarise(seconds[0]).median / 1e6), " million element-steps/s, cube of ",
           mesh.n_tets(), " tetrahedra, ", kTrajectories, " trajectories at a time");
}

// A meter that counts nothing would please everybody: it must see a matrix and a vector.
void BenchMeasure::check_meter() {
  options_.heap.start();
  const float value = sink_;
  const Matrix<float> matrix = Matrix<float>::Constant(60, 60, value);
  const std::vector<float> vector(1000, value);
  sink_ += matrix.sum() + vector.back();
  const HeapUse use = options_.heap.read();
  if (use.allocations != 2 || use.peak_bytes < 4 * (60 * 60 + 1000))
    throw NumericalError(text("the heap meter has counted ", use.allocations, " allocations of ",
                              use.peak_bytes, " bytes instead of 2 of 18400"));
}

void BenchMeasure::allocations(BenchRow& row) {
  if (!options_.heap.start) return skip(row, "this program cannot count its allocations");
  check_meter();
  const BenchCase& bench = body();
  constexpr Index kFirst = 10, kLast = 60;
  HeapUse use;
  each_round();
  const RolloutEnd end =
      roll_out<float>(bench.simulation(), bench.start(), kLast, [&](const Frame<float>& frame) {
        if (frame.t == kFirst) options_.heap.start();
        if (frame.t == kLast) use = options_.heap.read();
      });
  if (end.diverged) throw NumericalError("the rollout diverged " + end.reason);
  row.value = static_cast<double>(use.allocations) / static_cast<double>(kLast - kFirst);
  row.note = text(use.allocations, " from step ", kFirst, " to ", kLast, ", both modules neural, ",
                  on_body());
}

// Everything that is allocated from the mesh to the optimiser's step, files of a dataset aside.
void BenchMeasure::memory(BenchRow& row) {
  if (!options_.heap.start) return skip(row, "this program cannot count its allocations");
  constexpr Index kVertices = 22, kLong = 200;
  check_meter();
  each_round();
  options_.heap.start();
  std::size_t tape_bytes = 0;
  {
    BenchCase bench(fem::cube_mesh(kVertices, 1), cube_step(kVertices));
    ad::Tape<float> tape;
    nn::Adam<float> adam(bench.model().parameters());
    bench.gradient(tape, kLong);
    adam.step(1e-3);
    tape_bytes = tape.peak_bytes();
  }
  const HeapUse use = options_.heap.read();
  row.value = static_cast<double>(use.peak_bytes) / 1e9;
  row.note = text("all of the heap: mesh, states, nets, moments and the tape's ",
                  number(static_cast<double>(tape_bytes) / 1e9), " GB; cube of ", kVertices,
                  "^3 vertices");
}

void BenchMeasure::measure(BenchTime& time) {
  now_ = time.name;
  const StressNet<float>& net = body().model().stress;
  ad::Tape<float> tape;
  Inference forward(Inference::Mode::inference);
  const Random random(3);
  Matrix<float> z(kBatch, StressNet<float>::kFeatures);
  for (Index i = 0; i < z.size(); ++i)
    z.data()[i] = static_cast<float>(0.2 * random.normal(static_cast<std::uint64_t>(i)));
  const Matrix<float> F = rough_F(kBatch), y_bar = Matrix<float>::Ones(kBatch, 9);
  const auto parameters = body().model().parameters();
  const auto backward = [&](ad::Var<float> y) { tape.backward(y, y_bar); };
  const auto begin = [&] {
    tape.clear();
    nn::zero_bars<float>(parameters);
  };
  nn::Adam<float> adam(parameters);
  const auto values = nn::values(parameters);
  std::function<void()> piece;
  if (time.name == "stress_mlp_forward")
    piece = [&] {
      forward.clear();
      net.rotated_stress(forward.constant(z));
    };
  if (time.name == "stress_mlp_gradient")
    piece = [&] {
      begin();
      backward(net.rotated_stress(tape.input(z)));
    };
  if (time.name == "stress_module_gradient")
    piece = [&] {
      begin();
      backward(net.stress(tape.input(F)));
    };
  if (time.name == "training_iteration")
    piece = [&] {
      body().gradient(tape, kSteps);
      adam.step(1e-6);
    };
  piece();  // the first one fetches memory from the system
  const Summary summary = summarise(in_turns({piece})[0]);
  nn::set_values(parameters, values);  // what is measured next is the same body
  time.seconds = summary.median;
  time.spread = summary.spread;
}

}  // namespace nmp
