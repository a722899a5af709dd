#include "nmp/study_tools.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <stdexcept>

#include "base/check.h"
#include "nmp/data_gen.h"
#include "nmp/metrics.h"
#include "nmp/training_run.h"

namespace nmp::study {

using Json = nlohmann::ordered_json;

const char* Context::scale_name() const {
  return options_.scale == Scale::smoke   ? "smoke"
         : options_.scale == Scale::small ? "small"
                                          : "paper";
}

Index Context::pick(Index smoke, Index small, Index paper) const {
  return options_.scale == Scale::smoke ? smoke : options_.scale == Scale::small ? small : paper;
}

std::vector<Index> Context::horizons() const {
  if (smoke()) return {frames()};
  return {100, 500, 1000};
}

void Context::begin(const std::string& what, double share) {
  begin_ += share_;
  share_ = share;
  what_ = what;
  part(0);
}

void Context::part(double done) const {
  if (options_.progress) options_.progress(what_, std::min(1.0, begin_ + done * share_));
}

Scene Context::scene(const std::string& name) const {
  return read_scene(name, {}, options_.mesh_folders);
}

Dataset Context::data(const std::string& folder, const Scene& scene) const {
  DataGenOptions make;
  make.progress = [this](double done) { part(done); };
  make.warn = options_.warn;
  make.stop = options_.stop;
  return make_dataset(scene, options_.work / folder, make);
}

Dataset Context::validation(const std::string& name) const {
  Scene scene = this->scene(name);
  scene.train = 0;
  scene.validation = trajectories();
  scene.frames = frames();
  return data(text(name, "-", scene.validation, "x", scene.frames), scene);
}

Dataset Context::training(const std::string& name) const {
  Scene scene = this->scene(name);
  scene.train = pick(2, 32, 32);
  scene.validation = trajectories();
  scene.frames = frames();
  return data(text(name, "-", scene.train, "+", scene.validation, "x", scene.frames), scene);
}

Path Context::model_path(const std::string& scene) const {
  return options_.models / (scene + ".safetensors");
}

Model<float> Context::model(const std::string& scene) const {
  return load_model<float>(model_path(scene));
}

Path Context::trained(const std::string& name, const TrainConfig& config, const Dataset& dataset,
                      const std::string& stage, const Path& start) const {
  TrainingRunOptions options;
  options.start = start;
  options.resume = true;
  options.train.stage = stage;
  options.train.stop = options_.stop;
  options.train.progress = [this](const TrainEvent& event) {
    part(static_cast<double>(event.iteration + 1) / static_cast<double>(event.iterations));
  };
  // Of another configuration, dataset or start it is another model, with a file of its own.
  std::string made_from = to_toml(config) + stage + hash_file(dataset.folder() / "manifest.json");
  if (!start.empty()) made_from += hash_file(start);
  const Path out =
      options_.work / text(dataset.manifest().scene_name, "-", name, "-",
                           hex(hash_bytes(made_from.data(), made_from.size())), ".safetensors");
  if (!run_training(config, dataset, out, options).result.complete) {
    part(1);
    throw std::runtime_error("stopped while " + out.string() + " was trained");
  }
  return out;
}

template <class Real>
Measured measure(const Context& context, const Simulation<Real>& simulation, const Dataset& dataset,
                 Index n_trajectories,
                 const std::function<void(Index, const Frame<Real>&)>& observe) {
  Measured result;
  std::vector<double> seconds;
  for (Index i = 0; i < n_trajectories; ++i) {
    const Trajectory& truth = dataset.validation()[static_cast<std::size_t>(i)];
    truth.verify();
    const auto begin = std::chrono::steady_clock::now();
    const auto each_frame = [&](const Frame<Real>& frame) {
      context.part((static_cast<double>(i) +
                    static_cast<double>(frame.t) / static_cast<double>(truth.frames() + 1)) /
                   static_cast<double>(n_trajectories));
      if (observe) observe(i, frame);
    };
    const RolloutError run = compare<Real>(simulation, truth, truth.frames(), each_frame);
    seconds.push_back(
        std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    result.diverged += run.end.diverged;
    for (const Index horizon : context.horizons())
      result.rmse[horizon].push_back(run.rmse[static_cast<std::size_t>(horizon)]);
    result.curves.push_back(run.rmse);
  }
  std::sort(seconds.begin(), seconds.end());
  if (!seconds.empty()) result.seconds = seconds[seconds.size() / 2];
  return result;
}
template Measured measure(const Context&, const Simulation<float>&, const Dataset&, Index,
                          const std::function<void(Index, const Frame<float>&)>&);
template Measured measure(const Context&, const Simulation<double>&, const Dataset&, Index,
                          const std::function<void(Index, const Frame<double>&)>&);

double mean(const std::vector<double>& values) { return mean_std(values).mean; }

std::string number(double value) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.3g", value);
  return digits;
}

std::string mean_and_spread(const std::vector<double>& values) {
  if (values.empty()) return "-";
  const MeanStd both = mean_std(values);
  if (values.size() == 1) return number(both.mean);
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.1g", both.std);
  return number(both.mean) + " +- " + digits;
}

Row header(const Context& context, Row first, const Row& last) {
  for (const Index t : context.horizons()) first.push_back(text("RMSE at ", t, " [m]"));
  first.insert(first.end(), last.begin(), last.end());
  return first;
}

Row row(Row first, const Errors& errors, const Row& last) {
  for (const auto& [horizon, each] : errors) first.push_back(mean_and_spread(each));
  first.insert(first.end(), last.begin(), last.end());
  return first;
}

std::string json_of(const Measured& measured) {
  Json json{
      {"rmse", Json::object()}, {"diverged", measured.diverged}, {"seconds", measured.seconds}};
  for (const auto& [horizon, errors] : measured.rmse) {
    const MeanStd both = mean_std(errors);
    json["rmse"][std::to_string(horizon)] = {
        {"mean", both.mean}, {"std", both.std}, {"each", errors}};
  }
  return json.dump();
}

fem::Surface surface_of(const Dataset& dataset) {
  return fem::extract_surface(dataset.mesh().tets());
}

template <class Real>
std::map<Index, Matrix<double>> snapshots(const Simulation<Real>& simulation,
                                          const fem::State<Real>& start,
                                          const std::vector<Index>& frames) {
  std::map<Index, Matrix<double>> result;
  Matrix<double> last = start.x.template cast<double>();
  roll_out<Real>(simulation, start, *std::max_element(frames.begin(), frames.end()),
                 [&](const Frame<Real>& frame) {
                   last = frame.x.template cast<double>();
                   if (std::find(frames.begin(), frames.end(), frame.t) != frames.end())
                     result[frame.t] = last;
                 });
  for (const Index t : frames) result.emplace(t, last);  // held where it diverged
  return result;
}
template std::map<Index, Matrix<double>> snapshots(const Simulation<float>&,
                                                   const fem::State<float>&,
                                                   const std::vector<Index>&);
template std::map<Index, Matrix<double>> snapshots(const Simulation<double>&,
                                                   const fem::State<double>&,
                                                   const std::vector<Index>&);

std::vector<double> error_values(const Matrix<double>& x, const Matrix<double>& x_true,
                                 double scale) {
  std::vector<double> values;
  for (Index i = 0; i < x.rows(); ++i)
    values.push_back(std::min(1.0, (x.row(i) - x_true.row(i)).norm() / scale));
  return values;
}

std::string panels(const std::vector<Panel>& all) {
  std::string html = "<div class=\"panels\">\n";
  for (const Panel& panel : all)
    html += "<figure><figcaption>" + escape_html(panel.caption) + "</figcaption>" + panel.svg +
            "</figure>\n";
  return html + "</div>\n";
}

std::string recorded_and_predicted(const std::string& name, const Simulation<float>& simulation,
                                   const Dataset& dataset, Index frame) {
  const Trajectory& first = dataset.validation().front();
  const Matrix<double> x = snapshots(simulation, first.state<float>(0), {frame})[frame];
  const Matrix<double> x_true = first.state<double>(frame).x;
  Camera camera(-60, 15);
  camera.include(x_true);
  camera.include(x);
  const fem::Surface surface = surface_of(dataset);
  const auto ground = dataset.manifest().physics.ground;
  const auto picture = [&](const std::string& what, const Matrix<double>& at,
                           const std::array<double, 3>& colour) {
    return Panel{what, draw(what, surface, {{at, colour, {}, false}}, camera, ground)};
  };
  return panels({picture(text(name, ", frame ", frame, ": recorded"), x_true, {0.45, 0.5, 0.55}),
                 picture("predicted", x, {0.1, 0.5, 0.75})});
}

std::string lines_figure(const std::string& name, const std::string& y_label, bool log_y,
                         const std::vector<Line>& lines) {
  LinePlot plot;
  plot.name = name;
  plot.x_label = "frame";
  plot.y_label = y_label;
  plot.log_y = log_y;
  plot.labels = false;
  std::vector<report::LegendItem> items;
  for (std::size_t k = 0; k < lines.size(); ++k) {
    const Line& line = lines[k];
    const Stroke stroke =
        line.stroke.value_or(Stroke{static_cast<int>(k % 8), k >= 8 ? "5 3" : "", 1.8, 1});
    Curve curve{line.label, stroke, {}, {}, {}, {}};
    for (const std::size_t t : report::thinned(line.y.size(), 250)) {
      curve.x.push_back(static_cast<double>(t));
      curve.y.push_back(line.y[t]);
    }
    plot.curves.push_back(curve);
    items.push_back({stroke, line.label});
  }
  return "<figure><figcaption>" + escape_html(name) + "</figcaption>" + report::both_widths(plot) +
         report::legend(items) + "</figure>\n";
}

std::string error_figure(const std::map<std::string, Measured>& all, const std::string& of) {
  std::vector<Line> lines;
  for (const auto& [label, measured] : all) {
    if (measured.curves.empty()) continue;
    Line line{label, std::vector<double>(measured.curves.front().size()), {}};
    for (const auto& each : measured.curves)
      for (std::size_t t = 0; t < line.y.size(); ++t)
        line.y[t] += each[t] / static_cast<double>(measured.curves.size());
    lines.push_back(line);
  }
  return lines_figure(of + (of.empty() ? "Error over time" : ": error over time"), "RMSE [m]", true,
                      lines);
}

}  // namespace nmp::study
