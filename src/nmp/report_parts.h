#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

/// What the commands wrote that a report is made of, read back.
namespace nmp::report {

struct Error {
  double mean = 0, std = 0, relative = 0;
  std::vector<double> each;
  long touched = 0;
};

struct Method {
  std::string name;
  std::map<long, Error> horizons;
  long diverged = 0, clamped = 0;
  std::vector<std::string> reasons;
  double seconds = 0;
  std::vector<double> mean, std;  // at every frame
};

/// Errors of the modules along the record (module_errors.h). NaN: not known.
struct ModuleError {
  double relative = 0, rms = 0, reference = 0;
};
struct ModuleCurve {
  std::vector<double> relative, reference;  // the latter may be empty
};
struct ModuleCurves {
  std::string trajectory;
  std::vector<double> frame, touching;
  ModuleCurve stress;
  std::map<long, ModuleCurve> integrator;  // by length of the window
};
struct Modules {
  ModuleError stress;
  std::map<long, ModuleError> integrator;
  std::vector<ModuleCurves> trajectories;  // empty: no forces were recorded
};

/// A document of `nmp eval --json`.
struct Result {
  std::string scene, model, split;
  long trajectories = 0, frames = 0;
  std::optional<double> force_error;  // none: no forces were recorded
  Modules modules;
  std::vector<Method> methods;  // in the order in which they are shown
  std::vector<long> horizons;

  const Method* find(const std::string& name) const;
};
/// @throws InputError, or an exception of the JSON library
Result parse_evaluation(const std::string& document);

/// Steps of one stage of a training run, in the order of the file.
struct Stage {
  std::string name;
  std::vector<double> iteration, loss, rate;
};
struct StageReport {
  std::string stage, pairing;
  double iterations = 0, planned = 0, rmse_before = 0, rmse_after = 0, kept = 0, rmse_kept = 0,
         change = 0, change_end = 0, seconds = 0;
};
struct Fit {
  double alpha = 0, residual = 0;
  std::array<double, 3> b{};
};
/// Lines of `nmp train`'s metrics.
struct Training {
  std::vector<Stage> stages;
  std::vector<StageReport> reports;
  std::optional<Fit> fit;
};
/// @throws InputError  with the line
Training parse_metrics(const std::string& lines);

/// Place of a method in tables and plots; unknown ones come last.
std::size_t rank(const std::string& method);

}  // namespace nmp::report
