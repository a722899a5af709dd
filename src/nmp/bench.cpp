#include "nmp/bench.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "base/check.h"
#include "base/parallel.h"
#include "base/simd.h"
#include "nmp/bench_measure.h"
#include "nmp/config.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

// A row before it is measured.
const std::vector<BenchRow>& table() {
  static const std::vector<BenchRow> rows{
      {"stress_module", "stress module forward, floating-point operations / peak", "", kNone, 0,
       0.40, 0.55, false, "", ""},
      {"gradient", "(loss + gradient) / forward, 60-step rollout, checkpointed", "", kNone, 0, 4.2,
       3.6, true, "", ""},
      {"svd", "Eigen JacobiSVD<Matrix3f> / batched SVD, per matrix", "", kNone, 0, 30, 70, false,
       "", ""},
      {"bob_rollout", "BOB rollout, 1000 frames, both modules neural", "s", kNone, 0, 1.6, 1.0,
       true, "", ""},
      {"ground_truth", "ground truth in double / scalar Eigen loop, element-steps per second", "",
       kNone, 0, 4, 6, false, "", ""},
      {"allocations", "heap allocations per step of a steady rollout", "", kNone, 0, 0, 0, true, "",
       ""},
      {"memory", "peak memory of a 200-step training iteration on CUBEXL", "GB", kNone, 0, 1.0, 0.5,
       true, "", ""}};
  return rows;
}

const std::vector<BenchTime>& times() {
  static const std::vector<BenchTime> list{
      {"stress_mlp_forward", "stress MLP forward, 4096 elements", 0, 0},
      {"stress_mlp_gradient", "stress MLP forward and backward, 4096 elements", 0, 0},
      {"stress_module_gradient", "stress module forward and backward, 4096 elements", 0, 0},
      {"training_iteration", "training iteration of 60 steps, both modules", 0, 0}};
  return list;
}

// @throws ConfigError
void check_names(const std::vector<std::string>& only) {
  std::vector<std::string> known = bench_row_names();
  for (const std::string& name : bench_time_names()) known.push_back(name);
  for (const std::string& name : only) {
    if (std::find(known.begin(), known.end(), name) != known.end()) continue;
    const std::string nearest = nearest_name(name, known);
    std::string all;
    for (const std::string& each : known) all += (all.empty() ? "" : ", ") + each;
    throw ConfigError("there is no row " + in_quotes(name) +
                      (nearest.empty() ? "" : "; did you mean " + nearest + "?") + " (there are " +
                      all + ")");
  }
}

template <class List>
std::vector<std::string> names(const List& list) {
  std::vector<std::string> result;
  for (const auto& each : list) result.push_back(each.name);
  return result;
}

}  // namespace

std::vector<std::string> bench_row_names() { return names(table()); }
std::vector<std::string> bench_time_names() { return names(times()); }

BenchRow bench_row(const std::string& name) {
  for (const BenchRow& row : table())
    if (row.name == name) return row;
  throw std::invalid_argument("there is no row " + in_quotes(name));
}

std::string bench_verdict(double value, double good, double great, bool less_is_better) {
  const auto reaches = [&](double goal) { return less_is_better ? value <= goal : value >= goal; };
  return reaches(great) ? "great" : reaches(good) ? "good" : "short";
}

BenchResult bench(const BenchOptions& options) {
  check_names(options.only);
  const auto wanted = [&](const std::string& name, bool by_default) {
    const auto& only = options.only;
    return only.empty() ? by_default : std::find(only.begin(), only.end(), name) != only.end();
  };
  BenchMeasure bench(options);
  BenchResult result;
  for (BenchRow row : table()) {
    if (!wanted(row.name, true)) continue;
    bench.measure(row);
    result.rows.push_back(row);
  }
  for (BenchTime time : times()) {
    if (!wanted(time.name, false)) continue;
    bench.measure(time);
    result.times.push_back(time);
  }
  result.threads = threads();
  result.simd_bits = 8 * static_cast<int>(kSimdBytes);
  result.peak_instructions = bench.peak().instructions;
  result.body = bench.body_name();
  if (!result.body.empty()) {
    result.n_vertices = bench.body().mesh().n_vertices();
    result.n_tets = bench.body().mesh().n_tets();
    result.h = static_cast<double>(bench.body().simulation().h);
  }
  return result;
}

std::string to_json(const BenchResult& result) {
  Json rows = Json::array(), list = Json::array();
  for (const BenchRow& row : result.rows)
    rows.push_back({{"name", row.name},
                    {"what", row.what},
                    {"value", std::isfinite(row.value) ? Json(row.value) : Json()},
                    {"unit", row.unit},
                    {"spread", row.spread},
                    {"good", row.good},
                    {"great", row.great},
                    {"better", row.less_is_better ? "less" : "more"},
                    {"verdict", row.verdict},
                    {"note", row.note}});
  for (const BenchTime& time : result.times)
    list.push_back({{"name", time.name},
                    {"what", time.what},
                    {"seconds", time.seconds},
                    {"spread", time.spread}});
  const Json json{{"rows", rows},
                  {"times", list},
                  {"threads", result.threads},
                  {"build_simd_bits", result.simd_bits},
                  {"peak_instructions", result.peak_instructions},
                  {"body",
                   {{"name", result.body},
                    {"n_vertices", result.n_vertices},
                    {"n_tets", result.n_tets},
                    {"h", result.h}}}};
  return json.dump(1);
}

}  // namespace nmp
