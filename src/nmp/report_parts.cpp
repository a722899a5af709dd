#include "nmp/report_parts.h"

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/check.h"
#include "base/json_text.h"

namespace nmp::report {

namespace {

using Json = nlohmann::ordered_json;

// Our writers put null where a number is not finite.
double number(const Json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

std::vector<double> numbers(const Json& json) {
  if (!json.is_array()) throw InputError("a list of numbers was expected");
  std::vector<double> values;
  for (const Json& value : json) values.push_back(number(value));
  return values;
}

// A frame, or how often something happened: no reader of JSON makes an integer of 1.5 or 1e300.
long count(const Json& json) {
  constexpr long kMost = 1'000'000'000;
  if (!json.is_number_integer() || json < 0 || json > kMost)
    throw InputError(text("expected an integer from 0 to ", kMost));
  return json.get<long>();
}

// The number of frames that a key names.
long frame_of(const std::string& key) {
  const bool digits =
      !key.empty() && key.size() <= 9 && key.find_first_not_of("0123456789") == std::string::npos;
  if (!digits) throw InputError("expected the number of a frame, found " + in_quotes(key));
  return std::stol(key);
}

// What the parser may be asked for; curves are long.
JsonLimits evaluation_limits() {
  JsonLimits limits;
  limits.values = 1u << 22;
  return limits;
}
JsonLimits line_limits() {
  JsonLimits limits;
  limits.values = 64;
  limits.token_bytes = 4096;
  return limits;
}

ModuleError parse_error(const Json& json) {
  return {number(json.at("relative")), number(json.at("rms")), number(json.at("reference"))};
}

// `n` points, or none if it may be left out.
ModuleCurve parse_curve(const Json& json, std::size_t n) {
  const ModuleCurve curve{numbers(json.at("relative")), numbers(json.at("reference"))};
  if (curve.relative.size() != n || (!curve.reference.empty() && curve.reference.size() != n))
    throw InputError(text("a module's curve has ", curve.relative.size(), " and ",
                          curve.reference.size(), " points, expected ", n));
  return curve;
}

Modules parse_modules(const Json& json) {
  Modules modules;
  modules.stress = parse_error(json.at("stress"));
  for (const auto& [n, error] : json.at("integrator").items())
    modules.integrator[frame_of(n)] = parse_error(error);
  for (const Json& each : json.at("trajectories")) {
    ModuleCurves curves;
    curves.trajectory = each.at("name").get<std::string>();
    curves.frame = numbers(each.at("frame"));
    curves.touching = numbers(each.at("touching"));
    if (curves.frame.empty() || curves.touching.size() != curves.frame.size())
      throw InputError(text("the modules' curves have ", curves.frame.size(), " frames and ",
                            curves.touching.size(), " parts that touch"));
    curves.stress = parse_curve(each.at("stress"), curves.frame.size());
    for (const auto& [n, curve] : each.at("integrator").items())
      curves.integrator[frame_of(n)] = parse_curve(curve, curves.frame.size());
    modules.trajectories.push_back(std::move(curves));
  }
  return modules;
}

// Methods in the order of tables and plots.
constexpr const char* kOrder[] = {
    "neural",      "residual_zeroed", "neural_law",        "neural_integrator",
    "affine_only", "coarse_physics",  "staggered_physics", "ballistic",
    "rest"};

}  // namespace

const Method* Result::find(const std::string& name) const {
  for (const Method& method : methods)
    if (method.name == name) return &method;
  return nullptr;
}

std::size_t rank(const std::string& method) {
  return static_cast<std::size_t>(std::find(std::begin(kOrder), std::end(kOrder), method) -
                                  std::begin(kOrder));
}

Result parse_evaluation(const std::string& document) {
  check_json_text(document, "document", evaluation_limits());
  const Json json = Json::parse(document);
  Result result;
  result.scene = json.at("scene").get<std::string>();
  result.model = json.at("model").get<std::string>();
  result.split = json.at("split").get<std::string>();
  result.trajectories = count(json.at("trajectories"));
  result.frames = count(json.at("frames"));
  if (!json.at("force_error").is_null()) result.force_error = number(json.at("force_error"));
  if (json.contains("modules")) result.modules = parse_modules(json.at("modules"));
  for (const auto& [name, horizons] : json.at("methods").items()) {
    Method method;
    method.name = name;
    for (const auto& [frame, error] : horizons.items()) {
      Error& e = method.horizons[frame_of(frame)];
      e.mean = number(error.at("rmse_mean"));
      e.std = number(error.at("rmse_std"));
      e.relative = number(error.at("relative_mean"));
      e.each = numbers(error.at("rmse_each"));
      e.touched = count(error.at("touched_ground"));
    }
    const Json& details = json.at("details").at(name);
    method.diverged = count(details.at("diverged"));
    method.clamped = count(details.at("clamped"));
    method.reasons = details.at("reasons").get<std::vector<std::string>>();
    method.seconds = number(details.at("seconds"));
    method.mean = numbers(details.at("curve_mean"));
    method.std = numbers(details.at("curve_std"));
    if (method.mean.size() != static_cast<std::size_t>(result.frames) + 1 ||
        method.std.size() != method.mean.size())
      throw InputError(text("the curves of ", printable(name), " have ", method.mean.size(),
                            " and ", method.std.size(), " values, expected ", result.frames + 1));
    if (result.methods.empty())
      for (const auto& entry : method.horizons) result.horizons.push_back(entry.first);
    if (method.horizons.size() != result.horizons.size() ||
        !std::all_of(result.horizons.begin(), result.horizons.end(),
                     [&](long frame) { return method.horizons.count(frame) > 0; }))
      throw InputError("the methods have different horizons");
    result.methods.push_back(method);
  }
  if (!result.horizons.empty() && result.horizons.back() > result.frames)
    throw InputError(text("horizon ", result.horizons.back(), " is beyond frame ", result.frames));
  if (result.methods.empty() || result.horizons.empty()) throw InputError("it holds no error");
  std::stable_sort(result.methods.begin(), result.methods.end(),
                   [](const Method& a, const Method& b) { return rank(a.name) < rank(b.name); });
  return result;
}

Training parse_metrics(const std::string& lines) {
  Training training;
  std::istringstream in(lines);
  std::string line;
  for (long n = 1; std::getline(in, line); ++n) {
    if (line.empty()) continue;
    try {
      check_json_text(line, "text", line_limits());
      const Json json = Json::parse(line);
      const auto event = json.at("event").get<std::string>();
      if (event == "step") {
        const auto name = json.at("stage").get<std::string>();
        const double iteration = json.at("iteration").get<double>();
        auto& stages = training.stages;
        if (stages.empty() || stages.back().name != name ||
            (!stages.back().iteration.empty() && iteration <= stages.back().iteration.back()))
          stages.push_back({name, {}, {}, {}});
        stages.back().iteration.push_back(iteration);
        stages.back().loss.push_back(number(json.at("loss")));
        stages.back().rate.push_back(number(json.at("lr")));
      } else if (event == "stage") {
        const auto value = [&](const char* key) { return number(json.at(key)); };
        training.reports.push_back({json.at("stage").get<std::string>(),
                                    json.at("pairing").get<std::string>(), value("iterations"),
                                    value("planned"), value("rmse_before"), value("rmse_after"),
                                    value("kept"), value("rmse_kept"), value("change"),
                                    value("change_end"), value("seconds")});
      } else if (event == "fit") {
        const std::vector<double> b = numbers(json.at("b"));
        if (b.size() != 3) throw InputError("b must have three numbers");
        training.fit =
            Fit{number(json.at("alpha")), number(json.at("residual")), {b[0], b[1], b[2]}};
      } else {
        throw InputError("unknown event " + in_quotes(event));
      }
    } catch (const nlohmann::json::exception& error) {
      throw InputError(text("metrics, line ", n, ": ", printable(error.what())));
    } catch (const InputError& error) {
      throw InputError(text("metrics, line ", n, ": ", error.what()));
    }
  }
  return training;
}

}  // namespace nmp::report
