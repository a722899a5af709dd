// nmp model: what a model file has learned, in physical terms.
//   nmp model info models/bob.safetensors
//   nmp model info models/bob.safetensors --data data/bob --json

#include <memory>

#include "common.h"
#include "nmp/model_info.h"

namespace nmp {
namespace {

struct Options {
  std::string model, data;
  common::Flags flags;
};

std::string vector(const Vec3<double>& v) {
  return "(" + common::number(v(0), 4) + ", " + common::number(v(1), 4) + ", " +
         common::number(v(2), 4) + ")";
}

std::string to_text(const ModelSummary& s) {
  const auto cell = [](const std::optional<double>& value) {
    return value ? common::number(*value, 6) : std::string("-");
  };
  const auto truth = [&](double fem::Material::*member) {
    return s.true_material ? cell((*s.true_material).*member) : std::string("-");
  };
  const std::vector<std::vector<std::string>> rows{
      {"", "learned", "truth"},
      {"Young's modulus [Pa]", cell(s.law.E), truth(&fem::Material::E)},
      {"Poisson's ratio", cell(s.law.nu), truth(&fem::Material::nu)},
      {"density [kg/m3]", cell(s.density), truth(&fem::Material::density)},
      {"gravity [m/s2]", s.gravity ? vector(*s.gravity) : "-",
       s.true_gravity ? vector(*s.true_gravity) : "-"}};
  std::string words =
      s.file + ": trained on " + s.scene + " by " + s.config + ", " + s.state + "; step " +
      common::number(s.h) + " s, integrator " + s.form + "\n\n" + common::table(rows) +
      "\nThe stress law at rest: the isotropic law nearest to it for strains of 0.1 %, from "
      "which its\nstresses differ by " +
      common::number(100 * s.law.misfit) + " %.\n";
  if (s.range.known())
    words += "Seen in training: stretches of " + common::number(s.range.stretch_min) + " to " +
             common::number(s.range.stretch_max) + ", det F of " + common::number(s.range.det_min) +
             " to " + common::number(s.range.det_max) + ".\n";
  if (s.reach)
    words += "The integrator's net acts near the ground: it counts exp(-gap / " +
             common::number(*s.reach) + " m).\n";
  if (!s.density)
    words += "This integrator has no affine part, from which density and gravity could be told.\n";
  return words;
}

void info(const Options& o) {
  const Model<double> model = load_model<double>(o.model);
  std::optional<Dataset> dataset;
  if (!o.data.empty()) dataset.emplace(Dataset::open(o.data));
  ModelSummary summary = summarise(model, dataset ? &*dataset : nullptr);
  summary.file = o.model;
  common::print(o.flags.json ? to_json(summary) + "\n" : common::harmless(to_text(summary)));
}

}  // namespace

void add_model(CLI::App& app) {
  CLI::App& model = common::add_command(app, "model", "Say what a model has learned", "",
                                        {"nmp model info models/bob.safetensors"});
  model.require_subcommand(1);
  CLI::App& command =
      common::add_command(model, "info", "Stiffness, density and gravity, from the weights alone",
                          "Young's modulus and Poisson's ratio of the learned law at rest, how far "
                          "it is from isotropic,\n"
                          "and the density and gravity that the integrator has found. --data adds "
                          "the dataset's own\n"
                          "values.",
                          {"nmp model info models/bob.safetensors",
                           "nmp model info cube.safetensors --data data/cube --json"});
  const auto o = std::make_shared<Options>();
  command.add_option("MODEL", o->model, "File of the model")->required();
  command.add_option("--data", o->data, "Folder of a dataset whose true values to show")
      ->type_name("DIR");
  common::add_json(command, o->flags);
  command.callback([o] { info(*o); });
}

}  // namespace nmp
