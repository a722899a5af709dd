// nmp reproduce: the paper's tables and studies with the models that ship.
//   nmp reproduce table1 --meshes meshes
//   nmp reproduce table1 --models models --scenes cube,bob --json > table1.json
//   nmp reproduce std --scale small
//   nmp reproduce unseen --scale small --meshes meshes
//   nmp reproduce studies --meshes meshes

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "common.h"
#include "installation.h"
#include "nmp/study.h"
#include "nmp/table1.h"

namespace nmp {
namespace {

struct Options {
  std::string models;  // empty: those that ship
  std::string work = "out/reproduce", meshes, scale = "paper";
  std::vector<std::string> scenes;
  common::Flags flags;
};

Path models_folder(const Options& o) {
  if (!o.models.empty()) return o.models;
  const Path here = "models";
  const Path shipped = std::filesystem::is_directory(here) ? Path() : installed("share/nmp/models");
  return shipped.empty() ? here : shipped;
}

// Runs with the folder of models; where none was named and none is there, an error tells where it
// was looked for.
template <class Run>
auto with_models(const Options& o, const Run& run) {
  const Path models = models_folder(o);
  try {
    return run(models);
  } catch (const IoError& error) {
    if (!o.models.empty() || std::filesystem::is_directory(models)) throw;
    throw IoError(
        text(error.what(),
             "; the models that ship were looked for in ./models and in ../share/nmp/models from "
             "the program's folder: name their folder with --models DIR"));
  }
}

std::string cell_or_dash(const std::optional<double>& value) {
  return value ? common::number(*value) : "-";
}

std::string to_text(const Table1& table) {
  std::vector<std::vector<std::string>> rows{
      {"scene", "frame", "RMSE [m]", "+-", "relative", "net zeroed", "affine only", "coarse",
       "staggered", "density net", "paper's net", "paper", "goal", "diverged", "verdict"}};
  for (const Table1Cell& cell : table.cells)
    rows.push_back({cell.scene, std::to_string(cell.horizon), common::number(cell.error.rmse.mean),
                    common::number(cell.error.rmse.std), common::number(cell.error.relative.mean),
                    cell_or_dash(cell.residual_zeroed), cell_or_dash(cell.affine_only),
                    cell_or_dash(cell.coarse_physics), cell_or_dash(cell.staggered_physics),
                    cell_or_dash(cell.density_form), cell_or_dash(cell.paper_form),
                    cell_or_dash(cell.paper), cell_or_dash(cell.goal),
                    std::to_string(cell.diverged), cell.verdict});
  std::string words = common::table(rows);
  words +=
      "\nrelative: RMSE / rms displacement of the truth. net zeroed: without the integrator's "
      "net.\n"
      "affine only: the true law and two fitted numbers. coarse, staggered: the true law and\n"
      "semi-implicit Euler at a step of a frame, the latter with a staggered start.\n"
      "density net, paper's net: the same law, and an integrator that is a net of f_int / V or of "
      "f_int alone.\n"
      "verdict: missed the goal (tenth: but at most a tenth of the paper's error), met it, or at "
      "or\n"
      "below coarse or staggered physics, too.\n\n";
  for (const Table1::Source& source : table.sources) {
    words += source.model + ": configuration " + source.config +
             ", error of the stress net's forces " + common::number(100 * source.force_error) +
             " %";
    if (source.integrator == "learned") words += "; without the integrator's net it is worse";
    if (source.integrator == "identified")
      words += "; the integrator is identified, not learned: it does without its net";
    words += "\n";
  }
  return words;
}

// Standard deviations alone, as the paper's appendix has them.
std::string to_std_text(const Table1& table) {
  std::vector<std::vector<std::string>> rows{
      {"scene", "frame", "standard deviation [m]", "paper", "trajectories"}};
  for (const Table1Cell& cell : table.cells)
    rows.push_back({cell.scene, std::to_string(cell.horizon), common::number(cell.error.rmse.std),
                    cell_or_dash(cell.paper_std), std::to_string(cell.error.each.size())});
  return common::table(rows);
}

void run(const Options& o, bool std_only) {
  Table1Options options;
  options.work = o.work;
  options.scenes = o.scenes;
  options.mesh_folders = {"."};
  if (!o.meshes.empty()) options.mesh_folders.emplace_back(o.meshes);
  if (o.scale == "smoke") options.horizons = {100};
  if (o.scale != "paper") options.trajectories = 2;
  common::Progress progress("reproduce");
  options.progress = [&](const std::string& what, double part) {
    common::stop_if_requested();
    progress.update(part, what);
  };
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  options.stop = common::stop_requested;
  const Table1 table = with_models(o, [&](const Path& models) {
    options.models = models;
    return reproduce_table1(options);
  });
  progress.clear();
  common::print(o.flags.json ? to_json(table) + "\n"
                : std_only   ? to_std_text(table)
                             : to_text(table));
}

void add_common(CLI::App& command, Options& o, const std::string& scales) {
  command
      .add_option("--models", o.models,
                  "Folder of SCENE.safetensors (default: ./models, else those installed)")
      ->type_name("DIR");
  common::one_of(command.add_option("--scale", o.scale, scales), {"smoke", "small", "paper"});
  command.add_option("--work", o.work, "Folder where trajectories and models are kept, and reused")
      ->type_name("DIR")
      ->capture_default_str();
  command.add_option("--meshes", o.meshes, "Folder that holds bob.msh and spot.msh")
      ->type_name("DIR")
      ->envname("NMP_MESHES");
  common::add_threads(command);
  common::add_json(command, o.flags);
}

void add_table1(CLI::App& parent, const std::string& name, const std::string& summary,
                const std::string& details, std::initializer_list<const char*> examples,
                bool std_only) {
  CLI::App& command = common::add_command(parent, name, summary, details, examples);
  const auto o = std::make_shared<Options>();
  command.add_option("--scenes", o->scenes, "Only these (default: cube,cubexl,spot,bob)")
      ->type_name("NAME,...")
      ->delimiter(',')
      ->allow_extra_args(false);
  add_common(command, *o,
             "smoke: 2 trajectories of 100 frames; small: 2 of 1000; paper: 8 of 1000");
  command.callback([o, std_only] { run(*o, std_only); });
}

// -- studies

std::string to_text(const Study& study) {
  std::string words = study.title + "\n\n" + common::table(study.rows) + "\n";
  for (const std::string& note : study.notes) words += note + "\n";
  return words + "\n";
}

void run_studies(const Options& o, const std::vector<StudyKind>& kinds) {
  StudyOptions options;
  options.scale = o.scale == "smoke"   ? Scale::smoke
                  : o.scale == "small" ? Scale::small
                                       : Scale::paper;
  options.work = o.work;
  options.mesh_folders = {"."};
  if (!o.meshes.empty()) options.mesh_folders.emplace_back(o.meshes);
  options.warn = [](const std::string& what) { common::note("warning: " + what); };
  options.stop = common::stop_requested;
  common::Progress progress("reproduce");
  nlohmann::ordered_json all = nlohmann::ordered_json::array();
  Path report;
  for (std::size_t i = 0; i < kinds.size(); ++i) {
    options.progress = [&](const std::string& what, double part) {
      common::stop_if_requested();
      progress.update((static_cast<double>(i) + part) / static_cast<double>(kinds.size()),
                      text(kinds[i].name, ": ", what));
    };
    const Study study = with_models(o, [&](const Path& models) {
      options.models = models;
      return kinds[i].run(options);
    });
    report = add_to_report(study, options.work);
    progress.clear();
    if (o.flags.json)
      all.push_back(nlohmann::ordered_json::parse(study.json));
    else
      common::print(to_text(study));
  }
  if (o.flags.json)
    common::print(
        common::dump(kinds.size() == 1 ? all[0] : nlohmann::ordered_json{{"studies", all}}) + "\n");
  else
    common::print(report.string() + "\n");
}

void add_studies(CLI::App& parent, const std::string& name, const std::string& summary,
                 const std::vector<StudyKind>& kinds, const char* example) {
  CLI::App& command = common::add_command(
      parent, name, summary,
      "The results become a section of WORK/report.html, beside those of earlier runs.", {example});
  const auto o = std::make_shared<Options>();
  add_common(command, *o,
             "smoke: only shows that it works; small: 2 trajectories and short trainings; paper: 8 "
             "trajectories");
  command.callback([o, kinds] { run_studies(*o, kinds); });
}

}  // namespace

void add_reproduce(CLI::App& app) {
  CLI::App& reproduce = common::add_command(
      app, "reproduce", "Make the paper's tables and studies with the models that ship", "",
      {"nmp reproduce table1 --meshes meshes", "nmp reproduce studies --scale small"});
  reproduce.require_subcommand(1);
  add_table1(
      reproduce, "table1", "RMSE of rollouts over 100, 500 and 1000 frames on the four scenes",
      "Beside it, on the same trajectories: the true law with a coarse integrator, plain and "
      "with a\n"
      "staggered start, two fitted numbers in place of the integrator, the model without its\n"
      "integrator's net, the paper's values, and the goals.",
      {"nmp reproduce table1 --meshes meshes",
       "nmp reproduce table1 --models models --scenes cube,bob --json > table1.json"},
      false);
  add_table1(reproduce, "std", "Standard deviations of the same errors over the trajectories", "",
             {"nmp reproduce std --meshes meshes"}, true);
  for (const StudyKind& kind : study_kinds())
    add_studies(reproduce, kind.name, kind.summary, {kind},
                text("nmp reproduce ", kind.name, " --scale small --meshes meshes").c_str());
  add_studies(reproduce, "studies", "All of the studies, one after another", study_kinds(),
              "nmp reproduce studies --scale smoke --meshes meshes");
}

}  // namespace nmp
