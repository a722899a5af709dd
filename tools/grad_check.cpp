// nmp grad-check: compare the gradients of this build with central differences.
//   nmp grad-check
//   nmp grad-check --model cube.safetensors --json

#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "common.h"
#include "nmp/self_check.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string model;  // check its modules; empty: untrained ones
  common::Flags flags;
};

void print(const Options& o, const std::vector<CheckRow>& rows) {
  std::vector<std::vector<std::string>> lines{{"gradient", "relative error", "tolerance", ""}};
  Json json = Json::array();
  for (const CheckRow& row : rows) {
    lines.push_back({row.group + ": " + row.what, common::number(row.error),
                     common::number(row.tolerance), row.ok ? "ok" : "FAILED"});
    json.push_back({{"group", row.group},
                    {"what", row.what},
                    {"error", std::isfinite(row.error) ? Json(row.error) : Json("infinite")},
                    {"tolerance", row.tolerance},
                    {"ok", row.ok},
                    {"worst", row.worst}});
  }
  common::print(o.flags.json ? common::dump({{"checks", json}}) + "\n" : common::table(lines));
}

void run(const Options& o) {
  std::optional<Model<double>> model;
  if (!o.model.empty()) model.emplace(load_model<double>(o.model));
  common::Progress progress("grad-check");
  SelfCheckOptions options;
  options.seed = o.flags.seed.value_or(1);
  options.model = model ? &*model : nullptr;
  options.progress = [&](double part, const std::string& what) {
    common::stop_if_requested();
    progress.update(part, what);
  };
  const std::vector<CheckRow> rows = self_check(options);
  progress.clear();
  print(o, rows);
  const auto failed = std::count_if(rows.begin(), rows.end(), [](auto& row) { return !row.ok; });
  for (const CheckRow& row : rows)
    if (!row.ok) common::note(row.what + ": " + row.worst);
  if (failed > 0) throw NumericalError(text(failed, " of ", rows.size(), " gradients are wrong"));
}

}  // namespace

void add_grad_check(CLI::App& app) {
  CLI::App& check = common::add_command(
      app, "grad-check", "Compare this build's gradients with central differences",
      "Operators, laws, networks and rollouts of ten steps, in double precision. Exit code 4 if a\n"
      "gradient is wrong.",
      {"nmp grad-check", "nmp grad-check --model cube.safetensors --json"});
  const auto o = std::make_shared<Options>();
  check
      .add_option("--model", o->model, "Check the modules of this model (default: untrained ones)")
      ->type_name("FILE");
  common::add_seed(check, o->flags);
  common::add_threads(check);
  common::add_json(check, o->flags);
  check.callback([o] { run(*o); });
}

}  // namespace nmp
