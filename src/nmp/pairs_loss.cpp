#include <algorithm>
#include <cmath>
#include <numeric>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_mat3.h"
#include "autodiff/ops_rows.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "nmp/training_loss.h"

namespace nmp {

namespace {

// n elements of a state: n_strained of those with the largest |C - I|, the others at random.
std::vector<Index> choose_elements(ad::Var<double> F, Index n, Index n_strained,
                                   const Random& draw) {
  std::vector<Index> elements(static_cast<std::size_t>(F.rows()));
  std::iota(elements.begin(), elements.end(), Index(0));
  if (n >= F.rows()) return elements;
  const Matrix<double> strain =
      ad::right_cauchy_green_minus_identity(F).value().rowwise().squaredNorm();
  const auto more_strained = [&](Index a, Index b) {
    return strain(a, 0) != strain(b, 0) ? strain(a, 0) > strain(b, 0) : a < b;
  };
  const auto rest = elements.begin() + n_strained;
  std::nth_element(elements.begin(), rest, elements.end(), more_strained);
  std::sort(elements.begin(), rest);
  std::sort(rest, elements.end());
  for (auto i = static_cast<std::size_t>(n_strained); i < static_cast<std::size_t>(n); ++i)
    std::swap(elements[i], elements[i + draw.below(i, elements.size() - i)]);
  elements.resize(static_cast<std::size_t>(n));
  return elements;
}

class PairsLoss : public TrainingLoss {
 public:
  PairsLoss(const Model<float>& model, const Dataset& dataset, const Trajectories& trajectories,
            const StageConfig& stage, std::uint64_t seed)
      : model_(model), batch_(stage.batch), random_(Random(seed).split("pairs")) {
    if (!dataset.manifest().law_known)
      throw ConfigError(
          "train.constitutive.method = \"pairs\" needs a dataset whose law is known; use "
          "\"rollout\" for one that was recorded elsewhere");
    const fem::TetMesh<double>& mesh = dataset.mesh();
    const auto law = fem::make_law<double>(dataset.manifest().physics.material);

    // The pool: from each of `frames` random states an equal number of elements.
    const Index per_frame = std::min(mesh.n_tets(), std::max<Index>(1, stage.pool / stage.frames));
    const auto n_strained = static_cast<Index>(stage.strained * static_cast<double>(per_frame));
    z_.resize(stage.frames * per_frame, StressNet<double>::kFeatures);
    target_.resize(z_.rows(), 9);
    weight_.resize(z_.rows(), 1);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    Matrix<double> x(mesh.n_vertices(), 3);
    for (Index k = 0; k < stage.frames; ++k) {
      const Random draw = random_.split("state").split(static_cast<std::uint64_t>(k));
      const Trajectory& trajectory = *trajectories[draw.below(0, trajectories.size())];
      trajectory.read_x<double>(
          static_cast<Index>(draw.below(1, static_cast<std::uint64_t>(trajectory.frames()) + 1)),
          x);
      tape.clear();
      const ad::Var<double> all = fem::deformation_gradient(mesh, tape.constant(x));
      const ad::Var<double> F =
          ad::gather_rows(all, choose_elements(all, per_frame, n_strained, draw.split("elements")));
      const auto features = StressNet<double>::features(F);
      const auto P = law->stress(F).value();
      z_.middleRows(k * per_frame, per_frame) = features.z.value().cast<float>();
      for (Index e = 0; e < per_frame; ++e) {
        const Mat3<double> rotated = load_mat3<double>(features.R.value(), e).transpose() *
                                     load_mat3<double>(P, e) / model.stress.scale();
        const Index row = k * per_frame + e;
        store_mat3<float>(target_, row, rotated.cast<float>());
        weight_(row, 0) = static_cast<float>(1 / std::sqrt(1 + rotated.squaredNorm() / 9));
      }
    }
  }

  ad::Var<float> operator()(ad::Tape<float>& tape, Index iteration) override {
    const Random draw = random_.split("batch").split(static_cast<std::uint64_t>(iteration));
    MatrixMap<float> z = tape.allocate(batch_, z_.cols()), target = tape.allocate(batch_, 9);
    MatrixMap<float> weight = tape.allocate(batch_, 1);
    for (Index i = 0; i < batch_; ++i) {
      const auto row = static_cast<Index>(
          draw.below(static_cast<std::uint64_t>(i), static_cast<std::uint64_t>(z_.rows())));
      for (Index c = 0; c < z_.cols(); ++c) z(i, c) = z_(row, c);
      for (Index c = 0; c < 9; ++c) target(i, c) = target_(row, c);
      weight(i, 0) = weight_(row, 0);
    }
    const ad::Var<float> error =
        ad::subtract(model_.stress.rotated_stress(tape.constant(z)), tape.constant(target));
    return ad::mean_square(ad::multiply_rows(error, tape.constant(weight)));
  }

 private:
  const Model<float>& model_;
  Index batch_;
  Random random_;
  // #pool x 13; x 9: R^T P* / scale; x 1: the square root of w.
  Matrix<float> z_, target_, weight_;
};

}  // namespace

std::unique_ptr<TrainingLoss> make_pairs_loss(const Model<float>& model, const Dataset& dataset,
                                              const Trajectories& trajectories,
                                              const StageConfig& stage, std::uint64_t seed) {
  return std::make_unique<PairsLoss>(model, dataset, trajectories, stage, seed);
}

}  // namespace nmp
