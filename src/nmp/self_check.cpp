#include "nmp/self_check.h"

#include <Eigen/Geometry>
#include <cmath>

#include "autodiff/gradient_check.h"
#include "autodiff/ops_basic.h"
#include "autodiff/ops_dense.h"
#include "autodiff/ops_loss.h"
#include "autodiff/ops_mat3.h"
#include "autodiff/ops_rows.h"
#include "autodiff/polar_rotation.h"
#include "fem/contact.h"
#include "fem/deformation_gradient.h"
#include "fem/internal_force.h"
#include "fem/laws.h"
#include "fem/mesh_cube.h"
#include "fem/neo_hookean.h"
#include "fem/projective_law.h"
#include "fem/semi_implicit_euler.h"
#include "fem/step.h"
#include "fem/stvk.h"
#include "nmp/alignment.h"

namespace nmp {

namespace {

using ad::Tape;
using ad::Vars;
using V = Var<double>;
using M = Matrix<double>;
using Inputs = std::vector<M>;

constexpr double kOperatorTolerance = 1e-7, kModuleTolerance = 1e-6;

// One check to be done: what is differentiated with respect to inputs, and to parameters.
struct Check {
  std::string group, what;
  ad::Function<double> f;
  Inputs inputs;
  nn::ParameterList<double> parameters;
};

V at_inputs(const Check& check, Tape<double>& tape) {
  Vars<double> in;
  for (const M& input : check.inputs) in.push_back(tape.constant(input));
  return check.f(tape, in);
}

M uniform(Index rows, Index cols, const Random& random, double low = -1, double high = 1) {
  M m(rows, cols);
  for (Index i = 0; i < m.size(); ++i)
    m.data()[i] = random.uniform(static_cast<std::uint64_t>(i), low, high);
  return m;
}

// Generic deformation gradients, I + 0.3 U(-1, 1).
M deformations(Index rows, const Random& random) {
  M F = 0.3 * uniform(rows, 9, random);
  for (const int diagonal : {0, 4, 8}) F.col(diagonal).array() += 1;
  return F;
}

void move_off_start(const nn::ParameterList<double>& parameters, const Random& random) {
  std::uint64_t k = 0;
  for (auto* p : parameters) {
    const M noise = uniform(p->value().rows(), p->value().cols(), random.split(k++), -0.1, 0.1);
    p->mutable_value() += noise;
  }
}

// -- operators

void add_operators(std::vector<Check>& checks, const Random& random) {
  std::uint64_t k = 0;
  const auto any = [&](Index rows, Index cols, double low = -1, double high = 1) {
    return uniform(rows, cols, random.split(k++), low, high);
  };
  const auto add = [&](const char* what, const ad::Function<double>& f, const Inputs& inputs) {
    checks.push_back({"operator", what, f, inputs, {}});
  };
  using T = Tape<double>;
  const auto F = deformations(5, random.split("F"));

  add("add, subtract, multiply, divide",
      [](T&, const Vars<double>& in) {
        return ad::divide(ad::subtract(ad::add(in[0], in[1]), ad::multiply(in[0], in[1])), in[2]);
      },
      {any(4, 3), any(4, 3), any(4, 3, 0.5, 1.5)});
  add("scale, scale_by",
      [](T&, const Vars<double>& in) { return ad::scale_by(ad::scale(in[0], -1.7, 0.3), in[1]); },
      {any(4, 3), any(1, 1)});
  add("exp, log, sqrt",
      [](T&, const Vars<double>& in) {
        return ad::concat<double>({ad::exp(in[0]), ad::log(in[0]), ad::sqrt(in[0])});
      },
      {any(4, 2, 0.5, 1.5)});
  add("concat, slice",
      [](T&, const Vars<double>& in) {
        return ad::slice(ad::concat<double>({in[0], in[1]}), 1, 3);
      },
      {any(4, 2), any(4, 3)});
  add("sum, mean",
      [](T&, const Vars<double>& in) { return ad::multiply(ad::sum(in[0]), ad::mean(in[0])); },
      {any(5, 3)});
  add("linear", [](T&, const Vars<double>& in) { return ad::linear(in[0], in[1]); },
      {any(5, 4), any(3, 4)});
  add("silu", [](T&, const Vars<double>& in) { return ad::silu(in[0]); }, {any(5, 4, -4, 4)});
  add("gather_rows, scatter_add_rows",
      [](T&, const Vars<double>& in) {
        return ad::scatter_add_rows(ad::gather_rows(in[0], {2, 0, 2, 3}), {1, 0, 1, 2}, 4);
      },
      {any(4, 3)});
  add("add_row, multiply_rows, mask_rows",
      [](T&, const Vars<double>& in) {
        return ad::mask_rows(ad::multiply_rows(ad::add_row(in[0], in[1]), in[2]), {1, 0, 1, 1});
      },
      {any(4, 3), any(1, 3), any(4, 1)});
  add("group_mean, group_subtract, group_transform",
      [](T&, const Vars<double>& in) {
        const V centred = ad::group_subtract(in[0], ad::group_mean(in[0], 3), 3);
        return ad::group_transform(centred, in[1], 3);
      },
      {any(6, 3), any(2, 9)});
  add("group_max, group_sum",
      [](T&, const Vars<double>& in) {
        return ad::multiply(ad::group_max(in[0], 3), ad::group_sum(in[0], 3));
      },
      {any(6, 4)});
  add("row_norm, clamp_rows",
      [](T&, const Vars<double>& in) {
        return ad::concat<double>({ad::row_norm(in[0]), ad::clamp_rows(in[0], 1.0)});
      },
      {any(8, 3)});
  add("mat3_product, mat3_symmetric",
      [](T&, const Vars<double>& in) { return ad::mat3_symmetric(ad::mat3_product(in[0], in[1])); },
      {any(4, 9), any(4, 9)});
  add("mat3_det, mat3_inverse",
      [](T&, const Vars<double>& in) {
        return ad::concat<double>({ad::mat3_det(in[0]), ad::mat3_inverse(in[0])});
      },
      {F});
  add("F^T F - I, det F - 1",
      [](T&, const Vars<double>& in) {
        return ad::concat<double>(
            {ad::right_cauchy_green_minus_identity(in[0]), ad::det_minus_one(in[0])});
      },
      {F});
  add("singular_values_minus_one",
      [](T&, const Vars<double>& in) { return ad::singular_values_minus_one(in[0]); }, {F});
  add("polar_rotation", [](T&, const Vars<double>& in) { return ad::polar_rotation(in[0]); }, {F});
  M at_rest = M::Zero(1, 9);
  for (const int diagonal : {0, 4, 8}) at_rest(0, diagonal) = 1;
  add("polar_rotation at rest, F = I",
      [](T&, const Vars<double>& in) { return ad::polar_rotation(in[0]); }, {at_rest});
  add("squared_norm, mean_square, hinge_squared",
      [](T&, const Vars<double>& in) {
        return ad::add(ad::multiply(ad::squared_norm(in[0]), ad::mean_square(in[0])),
                       ad::hinge_squared(in[0], 0.3));
      },
      {any(4, 3)});
  add("rotation_of_quaternion",
      [](T&, const Vars<double>& in) { return rotation_of_quaternion(in[0]); },
      {any(3, 4, 0.3, 1)});
}

// -- a falling cube of 27 vertices

struct Scenery {
  explicit Scenery(const Random& random)
      : mesh(fem::cube_mesh(3, 1.0)),
        euler(kDensity, gravity()),
        neo_hookean(fem::make_law<double>({"neo-hookean", kE, kNu, kDensity})) {
    // Turned, deformed by a few percent, its lowest vertex 4 mm above the ground: with 3 m/s and
    // h = 5e-4 s it lands on the third step.
    const Eigen::AngleAxisd turn(0.4, Vec3<double>(0.6, 0.7, 0.2).normalized());
    x = mesh.vertices() * turn.toRotationMatrix().transpose() +
        uniform(mesh.n_vertices(), 3, random.split("x"), -0.02, 0.02);
    x.col(2).array() += 0.004 - x.col(2).minCoeff();
    v = uniform(mesh.n_vertices(), 3, random.split("v"), -0.3, 0.3);
    v.col(2).array() -= 3;
    boundary.ground = 0.0;
  }
  static Vec3<double> gravity() { return {0, 0, -9.8}; }
  fem::StepContext<double> context() const { return {mesh, 5e-4, boundary}; }

  static constexpr double kE = 5e5, kNu = 0.45, kDensity = 1000;
  fem::TetMesh<double> mesh;
  fem::Boundary<double> boundary;
  fem::SemiImplicitEuler<double> euler;
  std::unique_ptr<fem::ConstitutiveLaw<double>> neo_hookean;
  M x, v;
};

struct Laws {
  fem::NeoHookean<double> neo_hookean{Scenery::kE, Scenery::kNu};
  fem::StVK<double> stvk{Scenery::kE, Scenery::kNu};
  fem::ProjectiveLaw<double> projective{Scenery::kE, Scenery::kNu, 1};
};

void add_laws(std::vector<Check>& checks, const Scenery& scenery, Laws& laws,
              const Random& random) {
  const fem::TetMesh<double>& mesh = scenery.mesh;
  using T = Tape<double>;
  checks.push_back(
      {"law",
       "deformation_gradient",
       [&mesh](T&, const Vars<double>& in) { return fem::deformation_gradient(mesh, in[0]); },
       {scenery.x},
       {}});
  checks.push_back(
      {"law",
       "internal_force",
       [&mesh](T&, const Vars<double>& in) { return fem::internal_force(mesh, in[0]); },
       {uniform(mesh.n_tets(), 9, random.split("P"))},
       {}});
  const M F = deformations(5, random.split("F"));
  const auto add_law = [&](const std::string& name, const auto& law, auto& constants) {
    constants.log_E.set_frozen(false);
    constants.nu.set_frozen(false);
    checks.push_back({"law",
                      name + ": stress, by F, log E and nu",
                      [&law](T&, const Vars<double>& in) { return law.stress(in[0]); },
                      {F},
                      {&constants.log_E, &constants.nu}});
  };
  add_law("neo-hookean", laws.neo_hookean, laws.neo_hookean.parameters);
  add_law("stvk", laws.stvk, laws.stvk.parameters);
  add_law("projective", laws.projective, laws.projective.parameters);
  checks.push_back({"law",
                    "ground contact",
                    [&scenery](T&, const Vars<double>& in) {
                      const auto c = fem::project_ground(scenery.boundary, in[0], in[1]);
                      return ad::concat<double>({c.x, c.v});
                    },
                    {uniform(8, 3, random.split("contact")), uniform(8, 3, random.split("v"))},
                    {}});
}

// -- the networks and whole rollouts

V rollout(const Scenery& scenery, const fem::ConstitutiveLaw<double>& law,
          const fem::Integrator<double>& integrator, V x, V v) {
  constexpr int kSteps = 10;
  const ad::Piece<double> piece = [&](Tape<double>&, const Vars<double>& in) -> Vars<double> {
    const auto step = fem::step(law, integrator, scenery.context(), in[0], in[1]);
    return {step.x, step.v};
  };
  Vars<double> state{x, v};
  for (int k = 0; k < kSteps; ++k) state = ad::checkpoint(piece, state);
  return ad::concat<double>(state);
}

void add_modules(std::vector<Check>& checks, const Scenery& scenery, StressNet<double>& stress,
                 const std::vector<IntegrationNet<double>*>& integrators, const Random& random) {
  using T = Tape<double>;
  const fem::TetMesh<double>& mesh = scenery.mesh;
  checks.push_back({"module",
                    "stress net: P by F and its weights",
                    [&stress](T&, const Vars<double>& in) { return stress.stress(in[0]); },
                    {deformations(5, random.split("F"))},
                    stress.parameters()});
  checks.push_back(
      {"module",
       "stress net: f_int by x and its weights",
       [&stress, &mesh](T&, const Vars<double>& in) { return stress.internal_force(mesh, in[0]); },
       {scenery.x},
       stress.parameters()});
  const auto weights = [](IntegrationNet<double>& net) {
    nn::ParameterList<double> list = net.parameters();
    for (auto* p : net.affine_parameters()) list.push_back(p);
    return list;
  };
  for (IntegrationNet<double>* net : integrators) {
    const M f = net->scales().f * uniform(mesh.n_vertices(), 3, random.split("f"));
    const M per_volume =
        net->raw_force() ? f : M(f.array().colwise() * mesh.vertex_volumes().col(0).array());
    checks.push_back({"module",
                      "integration net (" + net->config().form + ", " + net->config().alignment +
                          "): dv by x, v, f_int and its weights",
                      [net, &scenery](T&, const Vars<double>& in) {
                        return net->dv(scenery.context(), in[0], in[1], in[2]);
                      },
                      {scenery.x, scenery.v, per_volume},
                      weights(*net)});
  }

  IntegrationNet<double>& net = *integrators.front();
  const auto add_rollout = [&](const char* what, const fem::ConstitutiveLaw<double>& law,
                               const fem::Integrator<double>& integrator,
                               const nn::ParameterList<double>& parameters) {
    checks.push_back({"rollout",
                      what,
                      [&scenery, &law, &integrator](T&, const Vars<double>& in) {
                        return rollout(scenery, law, integrator, in[0], in[1]);
                      },
                      {scenery.x, scenery.v},
                      parameters});
  };
  // The affine numbers are left to the check of the module: a step that suits the weights moves
  // alpha, 1e-3, so far that vertices land on another step.
  nn::ParameterList<double> both = stress.parameters();
  for (auto* p : net.parameters()) both.push_back(p);
  add_rollout("neural law, neural integrator", stress, net, both);
  add_rollout("neural law, semi-implicit Euler", stress, scenery.euler, stress.parameters());
  add_rollout("neo-hookean law, neural integrator", *scenery.neo_hookean, net, net.parameters());
  add_rollout("neo-hookean law, semi-implicit Euler", *scenery.neo_hookean, scenery.euler, {});
}

// What differences of results of size 1 and step kStep are off by, from rounding alone: measured
// 3e-8 for rollouts.
double rounding(const std::string& group) { return group == "rollout" ? 2e-7 : 1e-8; }

constexpr double kStep = 6e-6;

// The worse of inputs and parameters.
ad::GradientCheck compare(const Check& check, double unit,
                          const ad::GradientCheckOptions& options) {
  ad::GradientCheck worse =
      ad::check_gradient([&](Tape<double>& tape,
                             const Vars<double>& in) { return ad::scale(check.f(tape, in), unit); },
                         check.inputs, options);
  if (check.parameters.empty()) return worse;
  const ad::GradientCheck weights = ad::check_gradient(
      [&](Tape<double>& tape) { return ad::scale(at_inputs(check, tape), unit); }, check.parameters,
      16, options);
  const double largest = std::min(worse.largest, weights.largest);
  if (!(weights.relative <= worse.relative)) worse = weights;
  worse.largest = largest;
  return worse;
}

CheckRow run(const Check& check, std::uint64_t seed) {
  Tape<double> tape(Tape<double>::Mode::inference);
  const V y = at_inputs(check, tape);
  const double size = y.value().norm() / std::sqrt(static_cast<double>(y.value().size()));
  const double unit = size > 0 ? 1 / size : 1;  // results of size 1

  const bool small = check.group == "operator" || check.group == "law";
  CheckRow row{check.group, check.what, 0, small ? kOperatorTolerance : kModuleTolerance,
               false,       ""};
  ad::GradientCheckOptions options;
  options.seed = seed;
  // First without allowance for rounding; then with it; then with a smaller step, because the
  // largest of many values and the ground have kinks, which a difference may straddle.
  for (const auto& [step, allowance] :
       {std::pair(kStep, 0.0), std::pair(kStep, 1.0), std::pair(kStep / 10, 10.0)}) {
    options.step = step;
    options.floor = allowance * rounding(check.group);
    const ad::GradientCheck found = compare(check, unit, options);
    const bool checked = found.largest > 0;
    row.error = found.relative;
    row.worst = checked ? found.worst : "every gradient is zero";
    row.ok = checked && found.relative <= row.tolerance;
    if (row.ok || !checked || small) break;
  }
  return row;
}

}  // namespace

std::vector<CheckRow> self_check(const SelfCheckOptions& options) {
  const Random random = Random(options.seed).split("self_check");
  const Scenery scenery(random.split("scenery"));
  Laws laws;

  // Untrained modules of every form, moved off the start, where much is zero.
  std::vector<Model<double>> untrained;
  if (!options.model) {
    for (const char* form : {"affine", "density", "paper"}) {
      IntegrationNetConfig config;
      config.form = form;
      config.alignment = untrained.empty() ? "quaternion" : "free";
      Model<double>& model = untrained.emplace_back(StressNetConfig(), config, options.seed);
      move_off_start(model.parameters(), random.split(form));
      model.stress.set_scales(1e5, 0.1);
      IntegrationScales scales{0.5, 3, 1e5, 3000, "height"};
      if (model.integration.raw_force())
        scales.f = 1e5 / static_cast<double>(scenery.mesh.n_vertices());
      model.integration.set_scales(scales);
      if (model.integration.affine()) model.integration.set_affine(1e-3, Scenery::gravity());
    }
  }
  Model<double>& model = options.model ? *options.model : untrained.front();
  std::vector<IntegrationNet<double>*> integrators;
  for (Model<double>& each : untrained) integrators.push_back(&each.integration);
  if (options.model) integrators.push_back(&options.model->integration);
  nn::set_frozen(model.parameters(), false);

  std::vector<Check> checks;
  add_operators(checks, random.split("operators"));
  add_laws(checks, scenery, laws, random.split("laws"));
  add_modules(checks, scenery, model.stress, integrators, random.split("modules"));
  std::vector<CheckRow> rows;
  for (const Check& check : checks) {
    if (options.progress)
      options.progress(static_cast<double>(rows.size()) / static_cast<double>(checks.size()),
                       check.what);
    rows.push_back(run(check, options.seed));
  }
  return rows;
}

}  // namespace nmp
