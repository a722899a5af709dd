#include "nmp/model_info.h"

#include <Eigen/Dense>
#include <cmath>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "base/random.h"

namespace nmp {

// With t = tr(e) I and the unknowns 2 mu and lambda:
//   [ sum e:e  sum e:t ] [ 2 mu   ]   [ sum P:e ]
//   [ sum e:t  sum t:t ] [ lambda ] = [ sum P:t ].
EffectiveLaw effective_law(const fem::ConstitutiveLaw<double>& law, double strain, Index n) {
  NMP_CHECK(strain > 0 && n >= 6, "an effective law needs a strain above 0 and 6 of them at least");
  const Random random = Random(1).split("strains");
  Matrix<double> F(n, 9), e(n, 9), t = Matrix<double>::Zero(n, 9);
  for (Index i = 0; i < n; ++i) {
    Mat3<double> A;
    for (Index k = 0; k < 9; ++k)
      A(k / 3, k % 3) = random.normal(static_cast<std::uint64_t>(9 * i + k));
    const Mat3<double> direction = A + A.transpose();
    const Mat3<double> e_i = strain * direction / direction.norm();
    store_mat3<double>(e, i, e_i);
    store_mat3<double>(t, i, e_i.trace() * Mat3<double>::Identity());
    store_mat3<double>(F, i, Mat3<double>::Identity() + e_i);
  }
  ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
  const Matrix<double> P = law.stress(tape.constant(F)).value();

  Eigen::Matrix2d A;
  A << e.squaredNorm(), e.cwiseProduct(t).sum(), e.cwiseProduct(t).sum(), t.squaredNorm();
  const Eigen::Vector2d b(P.cwiseProduct(e).sum(), P.cwiseProduct(t).sum());
  const Eigen::Vector2d solution = A.ldlt().solve(b);
  const double mu = solution(0) / 2, lambda = solution(1);
  EffectiveLaw effective;
  const fem::YoungPoisson constants = fem::young_poisson({mu, lambda});
  effective.E = constants.E;
  effective.nu = constants.nu;
  effective.misfit = (P - 2 * mu * e - lambda * t).norm() / P.norm();
  return effective;
}

ModelSummary summarise(const Model<double>& model, const Dataset* dataset) {
  ModelSummary summary;
  summary.scene = model.info.scene;
  summary.dataset = model.info.dataset;
  summary.config = parse_train_config(model.info.config, "the model's configuration").name;
  summary.state = model.info.state;
  summary.h = model.info.h;
  summary.form = model.integration.config().form;
  summary.law = effective_law(model.stress);
  summary.range = model.info.range;
  if (model.integration.affine()) {
    summary.density = 1 / model.integration.alpha();
    summary.gravity = model.integration.b();
  }
  if (const auto reach = model.integration.reach())
    summary.reach = *reach * model.integration.scales().gap;
  if (!dataset) return summary;
  const Manifest& manifest = dataset->manifest();
  if (manifest.law_known) {
    fem::Material& material = summary.true_material.emplace(manifest.physics.material);
    if (material.law == "projective") {
      const fem::YoungPoisson constants = fem::young_poisson(fem::lame(material));
      material.E = constants.E;
      material.nu = constants.nu;
    }
  }
  summary.true_gravity = manifest.physics.gravity;
  return summary;
}

std::string to_json(const ModelSummary& summary) {
  using Json = nlohmann::ordered_json;
  const auto vector = [](const Vec3<double>& v) { return Json{v(0), v(1), v(2)}; };
  const auto& truth = summary.true_material;
  const Json json{
      {"model", summary.file},
      {"scene", summary.scene},
      {"trained_on", summary.dataset},
      {"config", summary.config},
      {"state", summary.state},
      {"h", summary.h},
      {"integrator", summary.form},
      {"learned",
       {{"E", summary.law.E},
        {"nu", summary.law.nu},
        {"misfit", summary.law.misfit},
        {"density", summary.density ? Json(*summary.density) : Json()},
        {"gravity", summary.gravity ? vector(*summary.gravity) : Json()},
        {"reach", summary.reach ? Json(*summary.reach) : Json()}}},
      {"seen_in_training",
       {{"stretch", summary.range.known()
                        ? Json{summary.range.stretch_min, summary.range.stretch_max}
                        : Json()},
        {"det_F",
         summary.range.known() ? Json{summary.range.det_min, summary.range.det_max} : Json()}}},
      {"truth",
       {{"E", truth ? Json(truth->E) : Json()},
        {"nu", truth ? Json(truth->nu) : Json()},
        {"density", truth ? Json(truth->density) : Json()},
        {"gravity", summary.true_gravity ? vector(*summary.true_gravity) : Json()}}}};
  return json.dump(1);
}

}  // namespace nmp
