#include "nmp/replay.h"

#include <cmath>

#include "fem/laws.h"
#include "fem/stability.h"
#include "nmp/metrics.h"
#include "nmp/model.h"
#include "nmp/setting.h"

namespace nmp {

namespace {

bool neural_law(const ReplayOptions& o) { return o.constitutive == "neural"; }
bool neural_integrator(const ReplayOptions& o) { return o.integrator == "neural"; }

void check(const ReplayOptions& o) {
  const auto known = [](const std::string& name, const std::vector<std::string>& names) {
    for (const std::string& each : names)
      if (name == each) return;
    throw ConfigError("there is no module '" + name + "'");
  };
  if (!neural_law(o)) known(o.constitutive, fem::law_names());
  known(o.integrator, {"neural", "semi-implicit"});
  if (o.model.empty() && (neural_law(o) || neural_integrator(o)))
    throw ConfigError(text("the ", neural_law(o) ? "law" : "integrator",
                           " is neural: name a model (--model), or an analytic one (",
                           neural_law(o) ? "--constitutive stvk" : "--integrator semi-implicit",
                           ")"));
  if ((o.E || o.nu) && neural_law(o)) throw ConfigError("E and nu belong to an analytic law");
  if (o.dt && neural_integrator(o))
    throw ConfigError("dt belongs to the integrator semi-implicit; the neural one steps by h");
}

fem::Material material(const ReplayOptions& o, const Manifest& manifest) {
  if (!manifest.law_known && !(o.E && o.nu))
    throw ConfigError("the dataset does not tell its law: E and nu must be given");
  fem::Material material = manifest.physics.material;
  material.law = o.constitutive;
  material.E = o.E.value_or(material.E);
  material.nu = o.nu.value_or(material.nu);
  try {
    fem::check(material);
  } catch (const std::invalid_argument& error) {
    throw ConfigError(error.what());
  }
  return material;
}

Index count_substeps(double h, const std::optional<double>& dt) {
  if (!dt) return 1;
  const double n = std::round(h / *dt);
  if (!(n >= 1 && n <= 1e9 && std::abs(n * *dt - h) <= 1e-9 * h))
    throw ConfigError(text("dt = ", *dt, " s must divide the time between frames, ", h, " s"));
  return static_cast<Index>(n);
}

// Frames are kept until it is known how many there are.
struct Kept {
  Matrix<float> x, v, f_int;
};

// Leaves roll_out, whose only way out is an exception.
struct Stop {};

template <class Real>
Replay replay_as(const Dataset& dataset, const ReplayOptions& o) {
  const Manifest& manifest = dataset.manifest();
  const fem::Physics& physics = manifest.physics;
  const Trajectory& record = find_trajectory(dataset, o.train_split, o.trajectory);
  record.verify();
  const Index n_frames = o.frames > 0 ? o.frames : record.frames();

  const Setting<Real> setting(dataset);

  // The two seams.
  std::optional<Model<Real>> model;
  if (!o.model.empty()) model.emplace(load_model<Real>(o.model));
  std::unique_ptr<fem::ConstitutiveLaw<Real>> analytic;
  if (!neural_law(o)) analytic = fem::make_law<Real>(material(o, manifest));
  const fem::ConstitutiveLaw<Real>& law = analytic ? *analytic : model->stress;
  const fem::Integrator<Real>& integrator =
      neural_integrator(o) ? static_cast<const fem::Integrator<Real>&>(model->integration)
                           : setting.euler();

  const Index substeps =
      neural_integrator(o) ? model->info.substeps : count_substeps(manifest.h, o.dt);
  const double step = manifest.h / static_cast<double>(substeps);
  if (neural_integrator(o) && o.warn)
    if (const std::string words = step_misfit(model->info, manifest); !words.empty()) o.warn(words);

  if (o.warn && !neural_integrator(o) && (analytic || manifest.law_known)) {
    const double limit = fem::stable_time_step(
        dataset.mesh(), analytic ? material(o, manifest) : physics.material, physics.pinned);
    const std::string warning = fem::stability_warning(limit, step);
    if (!warning.empty()) o.warn(warning);
  }

  // A model that was trained in the paper's literal loop is rolled out in it.
  const double stagger = model ? setting.stagger(model->info, substeps) : dataset.stagger(substeps);
  Simulation<Real> simulation = setting.simulation(law, integrator, stagger, substeps);
  simulation.strict = o.strict;
  const fem::TetMesh<Real>& mesh = setting.mesh();

  std::vector<Kept> kept;
  Replay result;
  result.trajectory = record.name();
  Matrix<double> x(mesh.n_vertices(), 3), x_true(mesh.n_vertices(), 3);
  bool watch_range = neural_law(o) && o.warn && model->info.range.known();
  const auto show = [&](const Frame<Real>& frame) {
    if (!o.output.empty())
      kept.push_back({frame.x.template cast<float>(), frame.v.template cast<float>(),
                      frame.f_int.template cast<float>()});
    if (frame.t <= record.frames()) {
      x = frame.x.template cast<double>();
      record.read_x<double>(frame.t, x_true);
      result.rmse.push_back(rmse(x, x_true));
    }
    if (watch_range) {
      const StrainRange range = strain_range(dataset.mesh(), frame.x.template cast<double>());
      if (model->info.range.exceeded_by(range)) {
        watch_range = false;
        o.warn(text("frame ", frame.t, ": stretches of ", range.stretch_min, " ... ",
                    range.stretch_max, ", det F of ", range.det_min, " ... ", range.det_max,
                    " go beyond the training's (", model->info.range.stretch_min, " ... ",
                    model->info.range.stretch_max, ", ", model->info.range.det_min, " ... ",
                    model->info.range.det_max, "): the learned law is a guess there"));
      }
    }
    result.end.frames = frame.t;
    if (o.show)
      o.show({frame.t, Matrix<double>(frame.x.template cast<double>()),
              Matrix<double>(frame.v.template cast<double>()),
              Matrix<double>(frame.f_int.template cast<double>())});
    if (o.progress) o.progress(static_cast<double>(frame.t) / static_cast<double>(n_frames));
    if (o.stop && o.stop()) throw Stop();
  };
  try {
    result.end = roll_out<Real>(simulation, record.state<Real>(0), n_frames, show);
  } catch (const Stop&) {
  }
  if (result.end.n_inverted > 0 && o.warn)
    o.warn(text("elements were inside out, det F <= 0, ", result.end.n_inverted,
                " times in all, first at ", result.end.first_inverted));

  if (!kept.empty()) {
    TrajectoryWriter writer(o.output, static_cast<Index>(kept.size()) - 1, mesh.n_vertices(), 0,
                            manifest.h);
    for (std::size_t t = 0; t < kept.size(); ++t)
      writer.write(static_cast<Index>(t), kept[t].x.cast<double>(), kept[t].v.cast<double>(),
                   kept[t].f_int.cast<double>());
    writer.commit();
  }
  return result;
}

}  // namespace

Replay replay(const ReplayOptions& options) {
  check(options);
  const Dataset dataset = Dataset::open(options.dataset);
  return neural_law(options) || neural_integrator(options) ? replay_as<float>(dataset, options)
                                                           : replay_as<double>(dataset, options);
}

}  // namespace nmp
