#include <nlohmann/json.hpp>

#include "nmp/metrics.h"
#include "nmp/study_tools.h"

namespace nmp {

namespace {
using Json = nlohmann::ordered_json;
using namespace study;
}  // namespace

Study study_trajectories(const StudyOptions& options) {
  Context context(options);
  context.begin("ground truth", 0.8);
  const Dataset dataset = context.training("cube");
  context.begin("drawing", 0.2);
  const fem::Surface surface = surface_of(dataset);

  struct Drawn {
    std::string name;
    bool train;
    std::vector<double> height, path_x, path_y;  // of the centroid [m]
    Matrix<double> x_end;
    double displacement;  // rms, from the first frame to the last [m]
  };
  std::vector<Drawn> all;
  const auto add = [&](const Trajectory& trajectory, bool train) {
    Drawn drawn{trajectory.name(), train, {}, {}, {}, {}, 0};
    Matrix<double> x(trajectory.n_vertices(), 3);
    for (const std::size_t t :
         report::thinned(static_cast<std::size_t>(trajectory.frames()) + 1, 150)) {
      trajectory.read_x<double>(static_cast<Index>(t), x);
      const Eigen::RowVector3d c = x.colwise().mean();
      drawn.height.push_back(c[2]);
      drawn.path_x.push_back(c[0]);
      drawn.path_y.push_back(c[1]);
    }
    drawn.x_end = x;
    drawn.displacement = rmse(x, trajectory.state<double>(0).x);
    all.push_back(drawn);
  };
  for (const Trajectory& trajectory : dataset.train()) add(trajectory, true);
  for (const Trajectory& trajectory : dataset.validation()) add(trajectory, false);

  LinePlot height;
  height.name = "Height of the centroid";
  height.x_label = "frame";
  height.y_label = "z [m]";
  height.log_y = false;
  height.labels = false;
  LinePlot path = height;
  path.name = "Path of the centroid from above";
  path.x_label = "x [m]";
  path.y_label = "y [m]";
  const auto frames = report::thinned(static_cast<std::size_t>(context.frames()) + 1, 150);
  for (const Drawn& drawn : all) {
    const Stroke stroke = drawn.train ? Stroke{6, "", 1, 0.5} : Stroke{1, "", 1.8, 1};
    Curve curve{drawn.name, stroke, {}, drawn.height, {}, {}};
    for (const std::size_t t : frames) curve.x.push_back(static_cast<double>(t));
    height.curves.push_back(curve);
    path.curves.push_back({drawn.name, stroke, drawn.path_x, drawn.path_y, {}, {}});
  }
  const std::string legend =
      report::legend({{{6, "", 1, 0.5}, "training"}, {{1, "", 1.8, 1}, "validation"}});
  Study result{"trajectories", "The recorded motions of CUBE", {}, {}, "", ""};
  for (const LinePlot& plot : {height, path})
    result.figures += "<figure><figcaption>" + plot.name + "</figcaption>" +
                      report::both_widths(plot) + legend + "</figure>\n";

  std::vector<Panel> pictures;
  for (const Drawn& drawn : all) {
    Camera camera(-60, 15);
    camera.include(drawn.x_end);
    const std::array<double, 3> grey{0.45, 0.5, 0.55}, orange{0.85, 0.45, 0.15};
    pictures.push_back(
        {report::short_name(drawn.name),
         draw(drawn.name, surface, {{drawn.x_end, drawn.train ? grey : orange, {}, false}}, camera,
              dataset.manifest().physics.ground, 150)});
  }
  result.figures += panels(pictures);
  std::vector<double> displacements[2];
  for (const Drawn& drawn : all) displacements[drawn.train ? 0 : 1].push_back(drawn.displacement);
  result.rows = {
      {"split", "trajectories", "rms displacement [m]"},
      {"training", std::to_string(displacements[0].size()), mean_and_spread(displacements[0])},
      {"validation", std::to_string(displacements[1].size()), mean_and_spread(displacements[1])}};
  result.notes = {text(
      "Each cube at the last of ", context.frames(),
      " frames, and where its centroid went. They differ in their first orientation and velocity "
      "only.")};
  result.json = Json{{"study", "trajectories"},
                     {"scale", context.scale_name()},
                     {"train", displacements[0]},
                     {"validation", displacements[1]}}
                    .dump();
  return result;
}

}  // namespace nmp
