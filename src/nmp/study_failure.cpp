#include <algorithm>
#include <nlohmann/json.hpp>

#include "nmp/setting.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
}  // namespace

Study study_failure(const StudyOptions& options) {
  Context context(options);
  const Model<float> model = context.model("bob");
  context.begin("ground truth", 0.4);
  const Dataset dataset = context.validation("bob");
  const Setting<float> setting(dataset);
  const Simulation<float> simulation = setting.simulation(model);
  context.begin("neural", 0.5);
  const Measured measured = measure(context, simulation, dataset, context.trajectories());
  const Index last = context.horizons().back();
  const std::vector<double>& errors = measured.rmse.at(last);
  const auto worst =
      static_cast<std::size_t>(std::max_element(errors.begin(), errors.end()) - errors.begin());
  const Trajectory& truth = dataset.validation()[worst];

  Study result{"failure", "The worst case", {}, {header(context, {"on BOB"})}, "", ""};
  Errors worst_alone;
  for (const auto& [t, each] : measured.rmse) worst_alone[t] = {each[worst]};
  result.rows.push_back(row({truth.name()}, worst_alone));
  result.rows.push_back(row({"mean of all"}, measured.rmse));

  const Matrix<double> x_true = truth.state<double>(last).x;
  const Matrix<double> x = snapshots(simulation, truth.state<float>(0), {last})[last];
  const double largest = (x - x_true).rowwise().norm().maxCoeff();
  Camera camera(-60, 12);
  camera.include(x);
  camera.include(x_true);
  const fem::Surface surface = surface_of(dataset);
  result.figures = panels(
      {{text("recorded, frame ", last),
        draw("recorded", surface, {{x_true, {0.45, 0.5, 0.55}, {}, false}}, camera)},
       {"predicted", draw("predicted", surface, {{x, {0.1, 0.5, 0.75}, {}, false}}, camera)},
       {"distance between them, brightest " + report::length(largest),
        draw("distance", surface, {{x, {}, error_values(x, x_true, largest), false}}, camera)}});
  std::vector<Line> lines;
  for (std::size_t i = 0; i < errors.size(); ++i)
    lines.push_back({dataset.validation()[i].name(), measured.curves[i]});
  result.figures += lines_figure("Error over time of each trajectory", "RMSE [m]", true, lines);
  result.notes = {text("Of ", errors.size(),
                       " validation trajectories, the one with the largest "
                       "error at frame ",
                       last, ": ", truth.name(), ", ", number(errors[worst]),
                       " m; the vertex that is furthest off, ", report::length(largest), ".")};
  result.json = Json{{"study", "failure"},          {"scale", context.scale_name()},
                     {"trajectory", truth.name()},  {"rmse", errors[worst]},
                     {"largest_distance", largest}, {"all", Json::parse(json_of(measured))}}
                    .dump();
  return result;
}

}  // namespace nmp
