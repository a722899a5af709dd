#include <algorithm>
#include <cmath>

#include "autodiff/checkpoint.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_loss.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "fem/step.h"
#include "fem/volume_penalty.h"
#include "nmp/affine_fit.h"
#include "nmp/rollout.h"
#include "nmp/setting.h"
#include "nmp/training_loss.h"
#include "nn/schedule.h"

namespace nmp {

namespace {

// Steps `length` from state `start` of a trajectory, the state reset to the truth at its beginning.
struct Segment {
  std::size_t trajectory;
  Index start, length;
};

Index reset_interval(const StageConfig& stage, Index step, Index n_steps) {
  return std::lround(nn::cosine(static_cast<double>(stage.reset_start),
                                static_cast<double>(stage.reset_end), step, n_steps));
}

// Whole passes: every trajectory cut into equal segments of about the reset interval, in random
// order. One pass per epoch.
std::vector<Segment> plan_epochs(const Trajectories& trajectories, const StageConfig& stage,
                                 const Random& random) {
  std::vector<Segment> plan;
  for (Index epoch = 0; epoch < stage.epochs; ++epoch) {
    const Index interval = reset_interval(stage, epoch, stage.epochs);
    std::vector<Segment> pass;
    for (std::size_t i = 0; i < trajectories.size(); ++i) {
      const Index frames = trajectories[i]->frames();
      const Index n = (frames + interval - 1) / interval;
      for (Index k = 0; k < n; ++k)
        pass.push_back({i, frames * k / n, frames * (k + 1) / n - frames * k / n});
    }
    const Random draw = random.split(static_cast<std::uint64_t>(epoch));
    for (std::size_t i = pass.size(); i > 1; --i) std::swap(pass[i - 1], pass[draw.below(i, i)]);
    plan.insert(plan.end(), pass.begin(), pass.end());
  }
  return plan;
}

// Random segments, one per iteration.
std::vector<Segment> plan_iterations(const Trajectories& trajectories, const StageConfig& stage,
                                     const Random& random) {
  std::vector<Segment> plan;
  for (Index i = 0; i < stage.iterations; ++i) {
    const Random draw = random.split(static_cast<std::uint64_t>(i));
    const std::size_t which = draw.below(0, trajectories.size());
    const Index frames = trajectories[which]->frames();
    const Index length = std::min(frames, reset_interval(stage, i, stage.iterations));
    plan.push_back(
        {which, static_cast<Index>(draw.below(1, static_cast<std::uint64_t>(frames - length) + 1)),
         length});
  }
  return plan;
}

std::vector<Segment> plan_segments(const Trajectories& trajectories, const StageConfig& stage,
                                   const Random& random) {
  return stage.epochs > 0 ? plan_epochs(trajectories, stage, random)
                          : plan_iterations(trajectories, stage, random);
}

// sum V Psi [J] of a law that is known.
double elastic_energy(const fem::TetMesh<double>& mesh, const fem::Material& material,
                      const Matrix<double>& x) {
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  Matrix<double> Psi(mesh.n_tets(), 1);
  fem::energy_density<double>(
      material, fem::deformation_gradient<double>(mesh, tape.constant(x)).value(), Psi);
  return mesh.volumes().col(0).dot(Psi.col(0));
}

// Mean squares of what the terms are measured against, per vertex but for the energy, from every
// 10th state.
struct Variances {
  double f = 0, dv = 0, dx = 0, energy = 0;
};

Variances dataset_variances(const Dataset& dataset, const Trajectories& trajectories,
                            bool with_energy) {
  const Index n_vertices = dataset.mesh().n_vertices();
  constexpr Index kStride = 10;
  Matrix<double> now(n_vertices, 3), next(n_vertices, 3);
  Variances sum;
  double n = 0;
  for (const Trajectory* trajectory : trajectories) {
    for (Index t = 0; t + 1 <= trajectory->frames(); t += kStride) {
      n += static_cast<double>(n_vertices);
      trajectory->read_x<double>(t, now);
      trajectory->read_x<double>(t + 1, next);
      sum.dx += (next - now).squaredNorm();
      if (with_energy) {
        const double energy =
            elastic_energy(dataset.mesh(), dataset.manifest().physics.material, now);
        sum.energy += energy * energy * static_cast<double>(n_vertices);
      }
      trajectory->read_v<double>(t, now);
      trajectory->read_v<double>(t + 1, next);
      sum.dv += (next - now).squaredNorm();
      if (!trajectory->has_force()) continue;
      trajectory->read_force<double>(t, now);
      sum.f += now.squaredNorm();
    }
  }
  if (!(sum.dx > 0) || !(sum.dv > 0))
    throw InputError("nothing moves in the training trajectories: there is nothing to learn");
  return {sum.f / n, sum.dv / n, sum.dx / n, sum.energy / n};
}

class RolloutLoss : public TrainingLoss {
 public:
  RolloutLoss(const Model<float>& model, const Dataset& dataset, const Trajectories& trajectories,
              const StageConfig& stage, Learned learned, std::uint64_t seed)
      : model_(model),
        dataset_(dataset),
        trajectories_(trajectories),
        stage_(stage),
        learned_(learned),
        setting_(dataset),
        mesh_(setting_.mesh()),
        plan_(plan_segments(trajectories, stage, Random(seed).split("segments"))),
        has_energy_(learned == Learned::both && stage.energy_weight > 0) {
    if (learned == Learned::integrator && !dataset.manifest().law_known)
      throw ConfigError(
          "training the integrator beside the analytic law needs a dataset whose law is known");
    if (has_energy_ && !model.stress.has_energy())
      throw ConfigError(
          "joint.energy_weight needs a law with an energy: set model.stress.form = \"energy\", or "
          "joint.energy_weight = 0");
    if (has_energy_ && !dataset.manifest().law_known)
      throw ConfigError(
          "joint.energy_weight needs a dataset whose law is known, for the true energy: set "
          "joint.energy_weight = 0");
    variances_ = dataset_variances(dataset, trajectories, has_energy_);
    has_force_ = variances_.f > 0 && !positions_only();
    if (learned == Learned::law && !has_force_ && !positions_only())
      throw InputError(
          "the law is trained on f_int, which the training trajectories do not hold: "
          "train.constitutive.observed = \"positions\" does without, as in 'nmp train positions'");
    x_true_.resize(mesh_.n_vertices(), 3);
    v_true_ = f_true_ = x_true_;
  }

  ad::Var<float> operator()(ad::Tape<float>& tape, Index iteration) override {
    Segment segment = plan_[static_cast<std::size_t>(iteration)];
    const Trajectory& truth = *trajectories_[segment.trajectory];
    const Simulation<float> simulation = this->simulation();
    if (positions_only()) {  // whose velocity needs a frame before
      segment.start = std::min(std::max<Index>(segment.start, 1), truth.frames() - 1);
      segment.length = std::min(segment.length, truth.frames() - segment.start);
    }
    Matrix<float> x_start(mesh_.n_vertices(), 3), v_start(mesh_.n_vertices(), 3);
    truth.read_x<float>(segment.start, x_start);
    const ad::Var<float> x = tape.constant(x_start);
    ad::Vars<float> state{x};
    if (positions_only()) {
      v_start = velocity_from_positions<float>(truth, segment.start, dataset_.manifest().h,
                                               simulation.substeps, simulation.stagger > 0);
      state.push_back(fem::pin_velocities(simulation.boundary, tape.constant(v_start)));
    } else {
      truth.read_v<float>(segment.start, v_start);
      state.push_back(internal_velocity(simulation, x, tape.constant(v_start)));
    }
    ad::Var<float> loss;
    for (Index k = 0; k <= segment.length; ++k) {
      const bool last = k == segment.length;
      const ad::Piece<float> piece = [this, &truth, segment, k, last](ad::Tape<float>&,
                                                                      const ad::Vars<float>& in) {
        return step(truth, segment.start + k, k == 0, last, in);
      };
      if (simulation.law.keeps_nothing())
        state.push_back(simulation.law.internal_force(mesh_, state[0]));
      ad::Vars<float> out = ad::checkpoint<float>(piece, state);
      loss = k == 0 ? out.back() : ad::add(loss, out.back());
      if (!last) state = {out[0], out[1]};
    }
    return ad::scale(loss, 1.0f / static_cast<float>(segment.length));
  }

 private:
  bool positions_only() const { return stage_.observed == "positions"; }

  Simulation<float> simulation() const {
    const fem::ConstitutiveLaw<float>& law = model_.stress;
    const fem::Integrator<float>& integrator = model_.integration;
    return setting_.simulation(learned_ == Learned::integrator ? setting_.law() : law,
                               learned_ == Learned::law ? setting_.euler() : integrator,
                               model_.info);
  }

  // One step from the state `in` = (x, v), or (x, v, f_int): the losses at that state and the next
  // state. The first state of a segment is the truth, so that only its force says something; the
  // last is not left.
  ad::Vars<float> step(const Trajectory& truth, Index t, bool first, bool last,
                       const ad::Vars<float>& in) {
    const Simulation<float> simulation = this->simulation();
    const fem::StepContext<float> context{mesh_, simulation.h, simulation.boundary};
    const ad::Var<float> x = in[0], v = in[1];
    const ad::Var<float> f_int = in.size() > 2 ? in[2] : simulation.law.internal_force(mesh_, x);
    const ad::Var<float> dv = simulation.integrator.dv(context, x, v, f_int);

    truth.read_x<float>(t, x_true_);
    ad::Tape<float>& tape = x.tape();
    ad::Var<float> loss = tape.constant(Matrix<float>::Zero(1, 1));
    const auto add_term = [&](ad::Var<float> error, double variance, double weight = 1) {
      const double n = static_cast<double>(mesh_.n_vertices());
      loss = ad::add(
          loss, ad::scale(ad::squared_norm(error), static_cast<float>(weight / (n * variance))));
    };
    const double force_weight = learned_ == Learned::both ? stage_.force_weight : 1;
    if (learned_ != Learned::integrator && has_force_ && force_weight > 0) {
      truth.read_force<float>(t, f_true_);
      add_term(ad::subtract(f_int, tape.constant(f_true_)), variances_.f, force_weight);
    }
    if (has_energy_) loss = ad::add(loss, energy_term(x));
    if (!first) {
      add_term(ad::subtract(x, tape.constant(x_true_)), variances_.dx);
      if (learned_ != Learned::law && !positions_only()) {
        truth.read_v<float>(t, v_true_);
        const ad::Var<float> reported = ad::add(v, ad::scale(dv, simulation.stagger));
        add_term(ad::multiply(ad::subtract(reported, tape.constant(v_true_)), velocity_mask(tape)),
                 variances_.dv);
      }
      if (learned_ == Learned::both && stage_.volume_weight > 0) {
        const auto epsilon = static_cast<float>(stage_.volume_epsilon);
        loss = ad::add(loss,
                       ad::scale(fem::volume_penalty(mesh_, x, epsilon),
                                 static_cast<float>(stage_.volume_weight) / (epsilon * epsilon)));
      }
    }
    if (last) return {loss};
    fem::Contact<float> next = fem::advance(context, x, v, dv);
    for (Index k = 1; k < simulation.substeps; ++k) {
      const ad::Var<float> f = simulation.law.internal_force(mesh_, next.x);
      next = fem::advance(context, next.x, next.v,
                          simulation.integrator.dv(context, next.x, next.v, f));
    }
    return {next.x, next.v, loss};
  }

  // Of the learned law's energy at x and the true law's at x*.
  ad::Var<float> energy_term(ad::Var<float> x) const {
    ad::Tape<float>& tape = x.tape();
    const double truth = elastic_energy(dataset_.mesh(), dataset_.manifest().physics.material,
                                        x_true_.cast<double>());
    const ad::Var<float> Psi = model_.stress.energy_density(fem::deformation_gradient(mesh_, x));
    const ad::Var<float> energy =
        ad::linear_transposed(tape.constant(mesh_.volumes().transpose()), Psi);
    const Matrix<float> true_energy = Matrix<float>::Constant(1, 1, static_cast<float>(truth));
    return ad::scale(ad::squared_norm(ad::subtract(energy, tape.constant(true_energy))),
                     static_cast<float>(stage_.energy_weight / variances_.energy));
  }

  // 0 where v* is set by a boundary rather than by dv: pinned vertices, vertical at the ground.
  ad::Var<float> velocity_mask(ad::Tape<float>& tape) const {
    MatrixMap<float> mask = tape.allocate(mesh_.n_vertices(), 3);
    mask.setOnes();
    const std::vector<char> touch =
        touching(dataset_.manifest(), x_true_.cast<double>(), v_true_.cast<double>());
    for (Index i = 0; i < mask.rows(); ++i)
      if (touch[static_cast<std::size_t>(i)]) mask(i, 2) = 0;
    for (const int i : setting_.boundary().pinned) mask.row(i).setZero();
    return tape.constant(mask);
  }

  const Model<float>& model_;
  const Dataset& dataset_;
  Trajectories trajectories_;
  StageConfig stage_;
  Learned learned_;
  Setting<float> setting_;
  const fem::TetMesh<float>& mesh_;
  std::vector<Segment> plan_;
  Variances variances_;
  bool has_force_ = false, has_energy_;
  Matrix<float> x_true_, v_true_, f_true_;
};

}  // namespace

std::unique_ptr<TrainingLoss> make_rollout_loss(const Model<float>& model, const Dataset& dataset,
                                                const Trajectories& trajectories,
                                                const StageConfig& stage, Learned learned,
                                                std::uint64_t seed) {
  return std::make_unique<RolloutLoss>(model, dataset, trajectories, stage, learned, seed);
}

Index rollout_iterations(const Trajectories& trajectories, const StageConfig& stage) {
  return static_cast<Index>(plan_segments(trajectories, stage, Random(0)).size());
}

}  // namespace nmp
