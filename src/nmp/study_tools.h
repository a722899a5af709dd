#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"
#include "nmp/model.h"
#include "nmp/picture.h"
#include "nmp/report_html.h"
#include "nmp/rollout.h"
#include "nmp/scene.h"
#include "nmp/study.h"
#include "nmp/train_config.h"

/// What the studies share: data and models made once and kept in the work folder, rollouts
/// measured, pictures.
namespace nmp::study {

/// The options of a study with what follows from its scale, and its progress in parts.
class Context {
 public:
  explicit Context(const StudyOptions& options) : options_(options) {}

  bool smoke() const { return options_.scale == Scale::smoke; }
  Scale scale() const { return options_.scale; }
  const char* scale_name() const;
  /// One of three, by the scale.
  Index pick(Index smoke, Index small, Index paper) const;
  Index frames() const { return pick(50, 1000, 1000); }
  Index trajectories() const { return pick(1, 2, 8); }
  /// The paper's horizons that frames() has; else the last frame.
  std::vector<Index> horizons() const;

  /// The next part of the work, so much of the whole; reports come through part().
  void begin(const std::string& what, double share);
  void part(double done) const;

  /// A scene that ships, its mesh looked for where the options say.
  Scene scene(const std::string& name) const;
  /// Its trajectories, made if they are not there.
  Dataset data(const std::string& folder, const Scene& scene) const;
  /// The validation trajectories of a scene that ships, those that all commands use.
  Dataset validation(const std::string& scene) const;
  /// The training trajectories too, fewer and shorter at smaller scales.
  Dataset training(const std::string& scene) const;

  Model<float> model(const std::string& scene) const;
  /// File of a model trained with a configuration, made if no earlier call has: its name holds a
  /// hash of all that it is made from.
  /// @param stage  of the configuration   @param start  a model to go on from; empty: none
  Path trained(const std::string& name, const TrainConfig& config, const Dataset& dataset,
               const std::string& stage = "all", const Path& start = {}) const;
  Path model_path(const std::string& scene) const;

 private:
  const StudyOptions& options_;
  std::string what_;
  double begin_ = 0, share_ = 0;
};

using Errors = std::map<Index, std::vector<double>>;  // RMSE by horizon, of each trajectory [m]
/// Rollouts of a pairing on the first n trajectories of a dataset's validation split.
struct Measured {
  Errors rmse;
  std::vector<std::vector<double>> curves;  // rmse at every frame of each trajectory [m]
  Index diverged = 0;
  double seconds = 0;  // of one rollout, the median
};
/// @param observe  shown every frame of trajectory i
template <class Real>
Measured measure(const Context& context, const Simulation<Real>& simulation, const Dataset& dataset,
                 Index n_trajectories,
                 const std::function<void(Index i, const Frame<Real>&)>& observe = {});

double mean(const std::vector<double>& values);
/// "0.00056 +- 0.0001", "-" of nothing.
std::string mean_and_spread(const std::vector<double>& values);
/// "%.3g"
std::string number(double value);

/// A table's header and rows: first cells, a column of errors for each horizon, last cells.
using Row = std::vector<std::string>;
Row header(const Context& context, Row first, const Row& last = {});
Row row(Row first, const Errors& errors, const Row& last = {});
/// {"rmse": {"100": {"mean":, "std":, "each":}}, "diverged":, "seconds":}
std::string json_of(const Measured& measured);

/// Of a dataset's mesh.
fem::Surface surface_of(const Dataset& dataset);
/// States of a rollout that pictures are made of: of the last frame, or of frames asked for.
template <class Real>
std::map<Index, Matrix<double>> snapshots(const Simulation<Real>& simulation,
                                          const fem::State<Real>& start,
                                          const std::vector<Index>& frames);
/// Distance between vertices, divided by `scale` and limited to 1: to colour by.
std::vector<double> error_values(const Matrix<double>& x, const Matrix<double>& x_true,
                                 double scale);

/// Pictures in a row, each with a caption.
struct Panel {
  std::string caption, svg;
};
std::string panels(const std::vector<Panel>& all);
/// The first validation trajectory at a frame, as recorded and as rolled out.
std::string recorded_and_predicted(const std::string& name, const Simulation<float>& simulation,
                                   const Dataset& dataset, Index frame);
/// Values over the frames.
struct Line {
  std::string label;
  std::vector<double> y;
  std::optional<Stroke> stroke = {};  // none: by its place
};
std::string lines_figure(const std::string& name, const std::string& y_label, bool log_y,
                         const std::vector<Line>& lines);
/// Errors over time of several methods, the mean over their trajectories.
std::string error_figure(const std::map<std::string, Measured>& all, const std::string& of = "");

}  // namespace nmp::study
