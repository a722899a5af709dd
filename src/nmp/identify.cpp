#include "nmp/identify.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/random.h"
#include "fem/stability.h"
#include "nmp/fit_objective.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

bool contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

// A body of this density for which steps of `dt` are just stable. The limit falls with sqrt(E).
double stiffness_for(const Dataset& dataset, fem::Material material, double dt) {
  material.E = 1;
  const double limit =
      fem::stable_time_step(dataset.mesh(), material, dataset.manifest().physics.pinned);
  return limit * limit / (dt * dt);
}

fem::Physics guessed_physics(const Dataset& dataset, const IdentifyOptions& options) {
  const Manifest& manifest = dataset.manifest();
  fem::Physics physics;
  physics.gravity = manifest.physics.gravity;
  physics.ground = manifest.physics.ground;
  physics.pinned = manifest.physics.pinned;
  fem::Material& material = physics.material;
  material.law = !options.law.empty() ? options.law
                 : manifest.law_known ? manifest.physics.material.law
                                      : "neo-hookean";
  material.volume_weight = 3;  // E and nu are what they are called
  const auto guess = [&](const char* name, double otherwise) {
    const auto found = options.guess.find(name);
    return found == options.guess.end() ? otherwise : found->second;
  };
  // What is neither fitted nor guessed is the record's, and nobody's invention.
  const auto fitted = [&](const char* name) { return contains(options.params, name); };
  const auto held = [&](const char* name, double recorded) {
    if (!manifest.law_known && options.guess.count(name) == 0)
      throw ConfigError(
          text(name, " is neither fitted nor known: give it, --guess ", name, "=..."));
    return guess(name, recorded);
  };
  fem::YoungPoisson at_rest{0, 0};
  if (manifest.law_known) at_rest = fem::young_poisson(fem::lame(manifest.physics.material));
  material.density = guess("density", manifest.physics.material.density);
  material.nu = fitted("nu") ? guess("nu", 0.3) : held("nu", at_rest.nu);
  physics.contact.law = "coulomb";
  physics.contact.friction = guess("friction", fitted("friction") ? 0.1 : 0);
  physics.air.drag = guess("drag", fitted("drag") ? 0.1 : 0);
  if (fitted("wind") && physics.air.drag == 0)
    throw ConfigError("wind acts by a drag: fit drag too, or give it, --guess drag=...");
  material.E = fitted("E") ? 1 : held("E", at_rest.E);
  try {
    fem::check(physics);
    if (fitted("E")) material.E = guess("E", stiffness_for(dataset, material, manifest.h / 2));
    fem::check(physics);
  } catch (const std::invalid_argument& error) {
    throw ConfigError(std::string("the guess: ") + error.what());
  }
  return physics;
}

void check_options(const Dataset& dataset, const IdentifyOptions& options) {
  const std::vector<std::string> known{"E", "nu", "density", "friction", "drag", "wind"};
  std::string list;
  for (const std::string& name : known) list += (list.empty() ? "" : ", ") + name;
  for (const std::string& name : options.params)
    if (!contains(known, name))
      throw ConfigError("there is no parameter '" + name + "' to fit; these are: " + list);
  if (options.params.empty()) throw ConfigError("name a parameter to fit; these are: " + list);
  for (const auto& [name, value] : options.guess)
    if (!contains(known, name) || name == "wind")
      throw ConfigError("there is no guess of '" + name +
                        "'; there is one of E, nu, density, "
                        "friction and drag");
  if (!options.law.empty() && !contains(fem::law_names(), options.law))
    throw ConfigError("there is no law '" + options.law + "'");
  if (contains(options.params, "friction") && !dataset.manifest().physics.ground)
    throw ConfigError("friction needs a ground, which the dataset has not");
  if (options.segments < 1 || options.length < 1)
    throw ConfigError("a fit needs at least one segment of at least one frame");
  if (dataset.train().empty())
    throw InputError(dataset.folder().string() + ": there is no training trajectory");
  for (const Trajectory& trajectory : dataset.train())
    if (trajectory.frames() < options.length + 1)
      throw ConfigError(text(trajectory.name(), " has ", trajectory.frames(),
                             " frames, too few for segments of ", options.length));
}

std::vector<FitSegment> draw_segments(const Dataset& dataset, const IdentifyOptions& options) {
  const Random random = Random(options.seed).split("segments");
  std::vector<FitSegment> segments;
  const std::size_t n = dataset.train().size();
  for (std::size_t i = 0; i < static_cast<std::size_t>(options.segments); ++i) {
    const Trajectory& trajectory = dataset.train()[i % n];
    const auto starts = static_cast<std::uint64_t>(trajectory.frames() - options.length);
    segments.push_back({&trajectory, 1 + static_cast<Index>(random.below(i, starts))});
  }
  for (std::size_t i = 0; i < std::min(n, segments.size()); ++i) segments[i].trajectory->verify();
  return segments;
}

// Half a unit in the last place of a recorded position [m].
double rounding(const Dataset& dataset) { return std::ldexp(dataset.mesh().diagonal(), -24); }

// Names the combination of parameters that the positions say nothing of, if there is one: a small
// change of it moves the vertices by less than the record is rounded.
void check_told(const FitObjective& objective, const Eigen::MatrixXd& gauss_newton,
                double record_rounding) {
  const Eigen::VectorXd scales = objective.scales();
  const Eigen::MatrixXd scaled = scales.asDiagonal() * gauss_newton * scales.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(scaled);
  const double moved = std::sqrt(std::max(0.0, solver.eigenvalues()(0)) /
                                 static_cast<double>(objective.n_residuals()));
  if (moved > record_rounding) return;
  Index worst = 0;
  solver.eigenvectors().col(0).cwiseAbs().maxCoeff(&worst);
  throw InputError(text("these positions do not tell ", objective.label(worst), ": a change of ",
                        scales(worst), " moves the vertices by ", moved,
                        " m, and they are recorded to ", record_rounding,
                        " m. Leave it out, or use trajectories in which it acts"));
}

class Fit {
 public:
  Fit(const Dataset& dataset, const IdentifyOptions& options)
      : dataset_(dataset),
        options_(options),
        guess_(guessed_physics(dataset, options)),
        model_(dataset, guess_),
        segments_(draw_segments(dataset, options)) {
    for (const std::string& name : options.params) {
      const std::string fitted = name == "density" ? "E" : name;
      if (!contains(names_, fitted)) names_.push_back(fitted);
    }
  }

  Identified run() {
    if (contains(options_.params, "E") && options_.guess.count("E") == 0) look_for_stiffness();
    // The steps per frame follow the stiffness, and what is fitted follows them a little.
    Index substeps = model_.stable_substeps();
    for (int round = 0; round < 4; ++round) {
      solve(substeps, round == 0);
      const Index wanted = model_.stable_substeps();
      if (wanted == substeps) break;
      substeps = wanted;
    }
    return std::move(result_);
  }

 private:
  // Begins with that one of stiffnesses sqrt(10) apart that strays least from the record: one much
  // too stiff blows up where a segment begins compressed, from one much too soft the way is long.
  void look_for_stiffness() {
    constexpr int kStiffer = 1, kSofter = 8;
    double& log_E = model_.parameter("E").mutable_value()(0, 0);
    const double first = log_E;
    double best = first, least = std::numeric_limits<double>::infinity();
    for (int k = -kStiffer; k <= kSofter; ++k) {
      if (options_.progress)
        options_.progress("a first E", static_cast<double>(k + kStiffer) / (kStiffer + kSofter));
      log_E = first - 0.5 * k * std::log(10);
      const FitObjective objective(model_, names_, segments_, options_.length,
                                   model_.stable_substeps());
      if (const double value = objective.value(); value < least) {
        least = value;
        best = log_E;
      }
    }
    log_E = best;
    guess_.material.E = std::exp(best);
  }

  void solve(Index substeps, bool first) {
    FitObjective objective(model_, names_, segments_, options_.length, substeps);
    const double n = static_cast<double>(objective.n_residuals());
    FitObjective::Derivatives now = derivatives(objective);
    if (first) result_.rms_guess = std::sqrt(2 * now.value / n);
    if (first) check_told(objective, now.gauss_newton, rounding(dataset_));
    double damping = 1e-3;
    result_.converged = false;
    while (!result_.converged && result_.iterations < options_.max_iterations) {
      ++result_.iterations;
      const Eigen::VectorXd theta = objective.theta();
      bool better = false;
      Eigen::VectorXd step;
      for (int attempt = 0; attempt < 12 && !better; ++attempt) {
        Eigen::MatrixXd damped = now.gauss_newton;
        damped.diagonal() *= 1 + damping;
        step = damped.ldlt().solve(-now.gradient);
        // No further than a factor e of E and the like in one step.
        const double size = step.cwiseQuotient(objective.scales()).cwiseAbs().maxCoeff();
        if (size > 10) step *= 10 / size;
        objective.set_theta(theta + step);
        better = objective.value() < now.value;
        damping = better ? std::max(damping / 10, 1e-9) : damping * 10;
      }
      if (!better) {
        objective.set_theta(theta);
        result_.converged = true;  // to rounding
        break;
      }
      const double moved = step.cwiseQuotient(objective.scales()).cwiseAbs().maxCoeff();
      now = derivatives(objective);
      result_.converged = moved < 1e-4;
    }
    check_told(objective, now.gauss_newton, rounding(dataset_));
    report(objective, now, substeps);
  }

  // How far the parameters would move if every step were halved, times 4/3: what a method of second
  // order is still off.
  Eigen::VectorXd step_error(const Eigen::MatrixXd& gauss_newton, Index substeps) {
    const FitObjective finer(model_, names_, segments_, options_.length, 2 * substeps);
    return 4.0 / 3 * gauss_newton.ldlt().solve(finer.gradient());
  }

  FitObjective::Derivatives derivatives(const FitObjective& objective) {
    Index done = 0;
    const auto tell = [&] {
      if (!options_.progress) return;
      const double rms = result_.rms > 0 ? result_.rms : result_.rms_guess;
      options_.progress(
          text("iteration ", result_.iterations, rms > 0 ? text(", rms ", rms, " m") : ""),
          static_cast<double>(done) / static_cast<double>(objective.n_segments()));
    };
    tell();
    FitObjective::Derivatives found = objective.derivatives([&] {
      ++done;
      tell();
    });
    result_.rms = std::sqrt(2 * found.value / static_cast<double>(objective.n_residuals()));
    return found;
  }

  // Cov = A^-1 S A^-1 with A = J^T J and the scatter S of the segments' gradients, and what the
  // rounding of the record and the size of the step add.
  void report(const FitObjective& objective, const FitObjective::Derivatives& now, Index substeps) {
    const Index p = objective.n(), s = objective.n_segments();
    const Eigen::MatrixXd inverse = now.gauss_newton.ldlt().solve(Eigen::MatrixXd::Identity(p, p));
    const double n = static_cast<double>(objective.n_residuals());
    Eigen::MatrixXd covariance;
    if (s > p)
      covariance =
          inverse * now.scatter * inverse * static_cast<double>(s) / static_cast<double>(s - p);
    else
      covariance = inverse * (2 * now.value / (n - static_cast<double>(p)));
    covariance += inverse * std::pow(rounding(dataset_), 2);
    const Eigen::VectorXd shift = step_error(now.gauss_newton, substeps);
    covariance += shift * shift.transpose();

    result_.physics = model_.physics();
    result_.substeps = substeps;
    result_.n_segments = s;
    result_.length = options_.length;
    result_.parameters.clear();
    result_.notes.clear();
    const bool ratio = contains(options_.params, "E") && contains(options_.params, "density");
    const bool density = contains(options_.params, "density") && !ratio;
    const fem::Material& held = guess_.material;
    const fem::Physics& truth = dataset_.manifest().physics;
    const bool known = dataset_.manifest().law_known;
    std::optional<fem::YoungPoisson> at_rest;
    if (known) at_rest = fem::young_poisson(fem::lame(truth.material));
    for (Index k = 0; k < p; ++k) {
      IdentifiedParameter found;
      const double value = objective.theta()(k), std = std::sqrt(covariance(k, k));
      found.name = objective.label(k);
      found.value = value;
      found.std = std;
      if (found.name == "log E") {
        const double E = std::exp(value);
        if (ratio) {
          found = {
              "E/density", "m2/s2", held.E / held.density, E / held.density, std * E / held.density,
              {}};
          if (known) found.truth = at_rest->E / truth.material.density;
        } else if (density) {
          found = {"density",
                   "kg/m3",
                   held.density,
                   held.E * held.density / E,
                   std * held.E * held.density / E,
                   {}};
          if (known) found.truth = truth.material.density;
        } else {
          found = {"E", "Pa", held.E, E, std * E, {}};
          if (known) found.truth = at_rest->E;
        }
      } else if (found.name == "nu") {
        found.unit = "-";
        found.guess = held.nu;
        if (known) found.truth = at_rest->nu;
      } else if (found.name == "friction") {
        found.unit = "-";
        found.guess = guess_.contact.friction;
        if (truth.contact.law == "coulomb") found.truth = truth.contact.friction;
      } else if (found.name == "drag") {
        found.unit = "1/s";
        found.guess = guess_.air.drag;
        if (known) found.truth = truth.air.drag;
      } else {
        const Index axis = found.name.back() - 'x';
        found.unit = "m/s";
        found.guess = guess_.air.wind(axis);
        if (known) found.truth = truth.air.wind(axis);
      }
      result_.parameters.push_back(found);
    }
    if (ratio)
      result_.notes.push_back(
          "Positions alone fix E and density by their ratio only: a body ten times as stiff and "
          "ten times as heavy moves the same way. The ratio was fitted; weigh the body for the "
          "rest.");
    if (density)
      result_.notes.push_back(
          text("E was held at ", held.E, " Pa; the density is as right as that number is."));
    else if (!ratio && contains(options_.params, "E"))
      result_.notes.push_back(text("E is that of a body of ", held.density,
                                   " kg/m3, which was taken as given: positions fix E / density."));
    if (!result_.converged)
      result_.notes.push_back(text("Not converged after ", result_.iterations, " iterations."));
  }

  const Dataset& dataset_;
  const IdentifyOptions& options_;
  fem::Physics guess_;
  PhysicalModel model_;
  std::vector<FitSegment> segments_;
  std::vector<std::string> names_;
  Identified result_;
};

}  // namespace

Identified identify(const Dataset& dataset, const IdentifyOptions& options) {
  check_options(dataset, options);
  return Fit(dataset, options).run();
}

std::string to_json(const Identified& found) {
  Json json;
  json["law"] = found.physics.material.law;
  json["density"] = found.physics.material.density;
  json["parameters"] = Json::object();
  for (const IdentifiedParameter& each : found.parameters) {
    Json& entry = json["parameters"][each.name];
    entry = {{"guess", each.guess}, {"value", each.value}, {"std", each.std}, {"unit", each.unit}};
    if (each.truth) entry["truth"] = *each.truth;
  }
  json["rms"] = {{"guess", found.rms_guess}, {"fit", found.rms}};
  json["segments"] = found.n_segments;
  json["frames"] = found.length;
  json["substeps"] = found.substeps;
  json["iterations"] = found.iterations;
  json["converged"] = found.converged;
  json["notes"] = found.notes;
  return json.dump(1);
}

std::string to_table(const Identified& found) {
  std::ostringstream out;
  const auto cell = [&](const std::string& words, std::size_t width) {
    out << words << std::string(words.size() < width ? width - words.size() : 1, ' ');
  };
  const auto number = [](double value, int digits) {
    std::ostringstream words;
    words.precision(digits);
    words << value;
    return words.str();
  };
  cell("", 14);
  cell("fitted", 14);
  cell("+-", 12);
  cell("unit", 8);
  cell("guess", 12);
  out << "recorded with\n";
  for (const IdentifiedParameter& each : found.parameters) {
    cell(each.name, 14);
    cell(number(each.value, 6), 14);
    cell(number(each.std, 2), 12);
    cell(each.unit, 8);
    cell(number(each.guess, 4), 12);
    out << (each.truth ? number(*each.truth, 6) : "-") << "\n";
  }
  out << "law " << found.physics.material.law << ", " << found.n_segments << " segments of "
      << found.length << " frames, " << found.substeps << " steps per frame; rms of x - x* "
      << number(found.rms, 3) << " m, with the guess " << number(found.rms_guess, 3) << " m; "
      << found.iterations << " iterations\n";
  for (const std::string& note : found.notes) out << note << "\n";
  return out.str();
}

}  // namespace nmp
