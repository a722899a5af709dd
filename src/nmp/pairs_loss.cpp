#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "autodiff/ops_basic.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_mat3.h"
#include "autodiff/ops_rows.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "nmp/random_rotation.h"
#include "nmp/training_loss.h"

namespace nmp {

namespace {

// Squared norms of C - I.   #T x 1
Matrix<double> strain_of(ad::Var<double> F) {
  return ad::right_cauchy_green_minus_identity(F).value().rowwise().squaredNorm();
}

// n elements of a state: n_strained of those with the largest |C - I|, the others at random.
std::vector<Index> choose_elements(ad::Var<double> F, Index n, Index n_strained,
                                   const Random& draw) {
  std::vector<Index> elements(static_cast<std::size_t>(F.rows()));
  std::iota(elements.begin(), elements.end(), Index(0));
  if (n >= F.rows()) return elements;
  const Matrix<double> strain = strain_of(F);
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

// An element of a state, by how much it is strained; ties fall to what comes first.
struct Strained {
  double strain;
  Index t, element;
  bool operator<(const Strained& other) const {
    return std::tie(other.strain, t, element) < std::tie(strain, other.t, other.element);
  }
};

// The n most strained of all elements of every kExtremeStride-th state of a trajectory, by state.
constexpr Index kExtremeStride = 2;
std::vector<Strained> most_strained(const fem::TetMesh<double>& mesh, const Trajectory& trajectory,
                                    Index n, ad::Tape<double>& tape) {
  const auto size = static_cast<std::size_t>(n);
  std::vector<Strained> found;
  Matrix<double> x(mesh.n_vertices(), 3);
  double least = 0;  // strain of the last of those that are kept
  const auto keep_best = [&] {
    if (found.size() <= size) return;
    std::nth_element(found.begin(), found.begin() + n - 1, found.end());
    found.resize(size);
    least = found.back().strain;
  };
  for (Index t = 1; t <= trajectory.frames(); t += kExtremeStride) {
    trajectory.read_x<double>(t, x);
    tape.clear();
    const Matrix<double> strain = strain_of(fem::deformation_gradient(mesh, tape.constant(x)));
    for (Index e = 0; e < strain.rows(); ++e)
      if (strain(e, 0) > least) found.push_back({strain(e, 0), t, e});
    if (found.size() > 4 * size) keep_best();
  }
  keep_best();
  std::sort(found.begin(), found.end(), [](const Strained& a, const Strained& b) {
    return std::tie(a.t, a.element) < std::tie(b.t, b.element);
  });
  return found;
}

class PairsLoss : public TrainingLoss {
 public:
  PairsLoss(const Model<float>& model, const Dataset& dataset, const Trajectories& trajectories,
            const StageConfig& stage, std::uint64_t seed)
      : model_(model), batch_(stage.batch), random_(Random(seed).split("pairs")) {
    if (!dataset.manifest().law_known)
      throw ConfigError(
          "train.constitutive.method = \"pairs\" needs a dataset whose law is known; use "
          "\"rollout\" for one that was recorded elsewhere, as 'nmp train positions' does");
    const fem::TetMesh<double>& mesh = dataset.mesh();
    const auto law = fem::make_law<double>(dataset.manifest().physics.material);

    // The pool: from each of `frames` random states an equal number of elements, then the extremes
    // of each trajectory.
    const auto n_trajectories = static_cast<Index>(trajectories.size());
    const auto per_trajectory = static_cast<Index>(stage.extreme * static_cast<double>(stage.pool) /
                                                   static_cast<double>(n_trajectories));
    const Index at_random = stage.pool - n_trajectories * per_trajectory;
    const Index per_frame = std::min(mesh.n_tets(), std::max<Index>(1, at_random / stage.frames));
    const auto n_strained = static_cast<Index>(stage.strained * static_cast<double>(per_frame));
    const Index room = stage.frames * per_frame + n_trajectories * per_trajectory;
    has_energy_ = model.stress.has_energy();
    in_.resize(room, has_energy_ ? 9 : StressNet<double>::kFeatures);
    target_.resize(room, 9);
    weight_.resize(room, 1);
    ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
    Matrix<double> x(mesh.n_vertices(), 3);
    const auto deformation = [&](const Trajectory& trajectory, Index t) {
      trajectory.read_x<double>(t, x);
      tape.clear();
      return fem::deformation_gradient(mesh, tape.constant(x));
    };
    for (Index k = 0; k < stage.frames; ++k) {
      const Random draw = random_.split("state").split(static_cast<std::uint64_t>(k));
      const Trajectory& trajectory = *trajectories[draw.below(0, trajectories.size())];
      const auto t =
          static_cast<Index>(draw.below(1, static_cast<std::uint64_t>(trajectory.frames()) + 1));
      const ad::Var<double> F = deformation(trajectory, t);
      add(F, choose_elements(F, per_frame, n_strained, draw.split("elements")), *law, stage.turned);
    }
    for (const Trajectory* trajectory : trajectories) {
      if (per_trajectory == 0) break;
      const std::vector<Strained> found = most_strained(mesh, *trajectory, per_trajectory, tape);
      for (auto begin = found.begin(); begin != found.end();) {
        std::vector<Index> elements;
        const Index t = begin->t;
        for (; begin != found.end() && begin->t == t; ++begin) elements.push_back(begin->element);
        add(deformation(*trajectory, t), elements, *law, stage.turned);
      }
    }
  }

  ad::Var<float> operator()(ad::Tape<float>& tape, Index iteration) override {
    const Random draw = random_.split("batch").split(static_cast<std::uint64_t>(iteration));
    MatrixMap<float> in = tape.allocate(batch_, in_.cols()), target = tape.allocate(batch_, 9);
    MatrixMap<float> weight = tape.allocate(batch_, 1);
    for (Index i = 0; i < batch_; ++i) {
      const auto row = static_cast<Index>(
          draw.below(static_cast<std::uint64_t>(i), static_cast<std::uint64_t>(n_pairs_)));
      for (Index c = 0; c < in_.cols(); ++c) in(i, c) = in_(row, c);
      for (Index c = 0; c < 9; ++c) target(i, c) = target_(row, c);
      weight(i, 0) = weight_(row, 0);
    }
    const ad::Var<float> input = tape.constant(in);
    const ad::Var<float> P = has_energy_ ? ad::scale(model_.stress.stress(input),
                                                     static_cast<float>(1 / model_.stress.scale()))
                                         : model_.stress.rotated_stress(input);
    const ad::Var<float> error = ad::subtract(P, tape.constant(target));
    return ad::mean_square(ad::multiply_rows(error, tape.constant(weight)));
  }

 private:
  // Pairs of elements of a state.
  void add(ad::Var<double> all, const std::vector<Index>& elements,
           const fem::ConstitutiveLaw<double>& law, double turned) {
    const ad::Var<double> seen = ad::gather_rows(all, elements);
    Matrix<double> FQ = seen.value();
    const Random turns = random_.split("turn");
    for (Index e = 0; e < FQ.rows(); ++e) {
      const auto row = static_cast<std::uint64_t>(n_pairs_ + e);
      const Random turn = turns.split(row);
      if (turn.split("whether").uniform(0) >= turned) continue;
      store_mat3<double>(FQ, e, load_mat3<double>(FQ, e) * random_rotation(turn));
    }
    const ad::Var<double> F = all.tape().constant(FQ);
    const auto features = StressNet<double>::features(F);
    const auto P = law.stress(F).value();
    in_.middleRows(n_pairs_, F.rows()) = (has_energy_ ? F : features.z).value().cast<float>();
    for (Index e = 0; e < F.rows(); ++e, ++n_pairs_) {
      Mat3<double> scaled = load_mat3<double>(P, e) / model_.stress.scale();
      if (!has_energy_) scaled = load_mat3<double>(features.R.value(), e).transpose() * scaled;
      store_mat3<float>(target_, n_pairs_, scaled.cast<float>());
      weight_(n_pairs_, 0) = static_cast<float>(1 / std::sqrt(1 + scaled.squaredNorm() / 9));
    }
  }

  const Model<float>& model_;
  Index batch_, n_pairs_ = 0;
  Random random_;
  bool has_energy_ = false;
  // #pool x 13: features, or x 9: F of a law with an energy; x 9: R^T P* / scale, or P* / scale;
  // x 1: the square root of w.
  Matrix<float> in_, target_, weight_;
};

}  // namespace

std::unique_ptr<TrainingLoss> make_pairs_loss(const Model<float>& model, const Dataset& dataset,
                                              const Trajectories& trajectories,
                                              const StageConfig& stage, std::uint64_t seed) {
  return std::make_unique<PairsLoss>(model, dataset, trajectories, stage, seed);
}

}  // namespace nmp
