#include <cmath>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_rows.h"
#include "nmp/affine_fit.h"
#include "nmp/training_loss.h"
#include "nn/schedule.h"

namespace nmp {

namespace {

class WindowsLoss : public TrainingLoss {
 public:
  WindowsLoss(const Model<float>& model, const Dataset& dataset, const Trajectories& trajectories,
              const StageConfig& stage, std::uint64_t seed)
      : model_(model),
        dataset_(dataset),
        trajectories_(trajectories),
        stage_(stage),
        random_(Random(seed).split("windows")) {
    const auto& pinned = dataset.manifest().physics.pinned;
    std::vector<char> is_pinned(static_cast<std::size_t>(dataset.mesh().n_vertices()), 0);
    for (const int i : pinned) is_pinned[static_cast<std::size_t>(i)] = 1;
    for (Index i = 0; i < dataset.mesh().n_vertices(); ++i)
      if (!is_pinned[static_cast<std::size_t>(i)]) free_.push_back(i);
    for (const Trajectory* trajectory : trajectories) {
      if (!trajectory->has_force())
        throw InputError(
            text(trajectory->name(),
                 ": expected the tensor f_int, from which "
                 "train.integration.method = \"windows\" learns, found none; leave the "
                 "stage out, --set train.integration.iterations=0"));
      if (trajectory->frames() < stage.window_end)
        throw InputError(text(trajectory->name(), " has ", trajectory->frames(),
                              " frames, fewer than the longest window of ", stage.window_end,
                              "; choose a shorter one with train.integration.window_end"));
    }
  }

  ad::Var<float> operator()(ad::Tape<float>& tape, Index iteration) override {
    const Random draw = random_.split(static_cast<std::uint64_t>(iteration));
    const auto n = static_cast<Index>(std::lround(
        nn::cosine(static_cast<double>(stage_.window_start), static_cast<double>(stage_.window_end),
                   iteration, stage_.iterations)));
    const Trajectory& trajectory = *trajectories_[draw.below(0, trajectories_.size())];
    const auto start =
        static_cast<Index>(draw.below(1, static_cast<std::uint64_t>(trajectory.frames() - n) + 1));
    const Index n_vertices = dataset_.mesh().n_vertices(), n_states = n + 1;
    const Index n_samples = std::max<Index>(1, stage_.batch / n_states);
    const std::vector<Index> samples = draw_samples(trajectory, start, n_samples, draw);

    // Row i n_states + k of the samples is vertex i at state start + k.
    MatrixMap<float> cloud = tape.allocate(n_states * n_vertices, 3);
    MatrixMap<float> v = tape.allocate(n_samples * n_states, 3);
    MatrixMap<float> force = tape.allocate(n_samples * n_states, 3);
    MatrixMap<float> target = tape.allocate(n_samples, 3), mask = tape.allocate(n_samples, 3);
    rows_.resize(static_cast<std::size_t>(n_samples * n_states));
    states_.resize(rows_.size());
    mask.setOnes();
    x_.resize(n_vertices, 3);
    v_.resize(n_vertices, 3);
    f_.resize(n_vertices, 3);
    const double h = dataset_.manifest().h;
    for (Index k = 0; k < n_states; ++k) {
      trajectory.read_x<double>(start + k, x_);
      trajectory.read_v<double>(start + k, v_);
      trajectory.read_force<double>(start + k, f_);
      cloud.middleRows(k * n_vertices, n_vertices) = x_.cast<float>();
      const std::vector<char> touch = touching(dataset_.manifest(), x_, v_);
      for (Index i = 0; i < n_samples; ++i) {
        const Index vertex = samples[static_cast<std::size_t>(i)], row = i * n_states + k;
        rows_[static_cast<std::size_t>(row)] = k * n_vertices + vertex;
        states_[static_cast<std::size_t>(row)] = k;
        const double reciprocal_V = dataset_.mesh().reciprocal_vertex_volumes()(vertex, 0);
        const double f_scale = model_.integration.raw_force() ? 1 : reciprocal_V;
        for (Index c = 0; c < 3; ++c) {
          const double f = f_scale * f_(vertex, c);
          force(row, c) = static_cast<float>(f);
          v(row, c) = static_cast<float>(internal_velocity(v_(vertex, c), f, c));
          if (k == 0) target(i, c) = static_cast<float>(-v_(vertex, c) / h);
          if (k == n) target(i, c) += static_cast<float>(v_(vertex, c) / h);
        }
        if (touch[static_cast<std::size_t>(vertex)]) mask(i, 2) = 0;
      }
    }

    IntegrationNet<float>::Batch batch;
    batch.cloud = tape.constant(cloud);
    batch.group = n_vertices;
    batch.rows = &rows_;
    batch.meshes = &states_;
    batch.v = tape.constant(v);
    batch.force = tape.constant(force);
    const auto a = model_.integration.acceleration(batch);

    // sum_k w_k a_k per sample, with w = (1 - s, 1, ..., 1, s).
    const auto s = static_cast<float>(model_.info.stagger);
    MatrixMap<float> weights = tape.allocate(n_samples * n_states, 1);
    for (Index row = 0; row < weights.rows(); ++row) {
      const Index k = row % n_states;
      weights(row, 0) = k == 0 ? 1 - s : k == n ? s : 1;
    }
    const ad::Var<float> sum =
        ad::group_sum(ad::multiply_rows(a.total, tape.constant(weights)), n_states);
    const ad::Var<float> error =
        ad::multiply(ad::subtract(sum, tape.constant(target)), tape.constant(mask));
    const auto scale =
        static_cast<float>(1 / (static_cast<double>(n) * model_.integration.scales().a));
    const ad::Var<float> loss = ad::mean_square(ad::scale(error, scale));
    if (!model_.integration.affine()) return loss;
    return ad::add(
        loss, ad::scale(ad::mean_square(a.residual), static_cast<float>(stage_.residual_penalty)));
  }

 private:
  std::vector<Index> draw_samples(const Trajectory& trajectory, Index start, Index n,
                                  const Random& draw) {
    // Those on the ground at the start are few, and all that there is to learn of friction.
    std::vector<Index> grounded;
    if (stage_.contact > 0) {
      x_.resize(dataset_.mesh().n_vertices(), 3);
      v_.resize(dataset_.mesh().n_vertices(), 3);
      trajectory.read_x<double>(start, x_);
      trajectory.read_v<double>(start, v_);
      const std::vector<char> touch = touching(dataset_.manifest(), x_, v_);
      for (const Index i : free_)
        if (touch[static_cast<std::size_t>(i)]) grounded.push_back(i);
    }
    const auto n_grounded =
        grounded.empty() ? 0
                         : static_cast<Index>(std::lround(stage_.contact * static_cast<double>(n)));
    std::vector<Index> samples;
    for (Index i = 0; i < n; ++i) {
      const std::vector<Index>& from = i < n_grounded ? grounded : free_;
      samples.push_back(from[draw.below(2 + static_cast<std::uint64_t>(i), from.size())]);
    }
    return samples;
  }

  // The velocity that the net sees in a rollout stands s dv early; the affine part knows dv well
  // enough for that.
  double internal_velocity(double v, double f_density, Index axis) const {
    if (!model_.integration.affine()) return v;
    const double a = model_.integration.alpha() * f_density + model_.integration.b()[axis];
    return v - model_.info.stagger * dataset_.manifest().h * a;
  }

  const Model<float>& model_;
  const Dataset& dataset_;
  Trajectories trajectories_;
  StageConfig stage_;
  Random random_;
  std::vector<Index> free_, rows_, states_;
  Matrix<double> x_, v_, f_;
};

}  // namespace

std::unique_ptr<TrainingLoss> make_windows_loss(const Model<float>& model, const Dataset& dataset,
                                                const Trajectories& trajectories,
                                                const StageConfig& stage, std::uint64_t seed) {
  return std::make_unique<WindowsLoss>(model, dataset, trajectories, stage, seed);
}

}  // namespace nmp
