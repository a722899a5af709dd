#include "nmp/playback.h"

#include <optional>

#include "base/check.h"
#include "nmp/metrics.h"
#include "nmp/setting.h"

namespace nmp {

Playback play_back(const Model<float>& model, const Dataset& dataset, const Trajectory& truth,
                   const PlaybackOptions& options) {
  truth.verify();
  const Manifest& manifest = dataset.manifest();
  const fem::Physics& physics = manifest.physics;
  const Index n_vertices = dataset.mesh().n_vertices(), n_frames = truth.frames();
  const Setting<float> setting(dataset);
  const Simulation<float> simulation = setting.simulation(model);
  Playback result;
  result.trajectory = truth.name();
  result.h = manifest.h;
  result.law_known = manifest.law_known;

  const Reference reference(truth, manifest.h);
  std::optional<MotionRecorder> recorded, predicted;
  if (options.body) {
    const auto recorder = [&](const char* label, const Reference* against) {
      return MotionRecorder({label, 0, options.body, &dataset.mesh(), manifest.h, options.stride,
                             options.law, against});
    };
    recorded.emplace(recorder("recorded", nullptr));
    predicted.emplace(recorder("predicted", &reference));
  }

  StateMeter meter(dataset.mesh(), physics, manifest.law_known);
  const double height = physics.ground.value_or(0) + 1e-6 * dataset.mesh().diagonal();
  Matrix<double> x_true(n_vertices, 3), v_true(n_vertices, 3), x(n_vertices, 3), v(n_vertices, 3);
  // Frame t of the record, and the prediction's error there.
  const auto add = [&](Index t) {
    truth.read_x<double>(t, x_true);
    truth.read_v<double>(t, v_true);
    result.truth.push_back(meter.measure(x_true, v_true));
    result.rmse.push_back(rmse(x, x_true));
    const double n_touching =
        physics.ground ? static_cast<double>((x_true.col(2).array() <= height).count()) : 0;
    result.touching.push_back(n_touching / static_cast<double>(n_vertices));
    if (recorded) recorded->add(t, x_true, v_true);
    if (options.progress) options.progress(static_cast<double>(t) / static_cast<double>(n_frames));
  };
  const auto predict = [&](Index t, const ConstView<float>& x_t, const ConstView<float>& v_t) {
    x = x_t.cast<double>();
    v = v_t.cast<double>();
    result.prediction.push_back(meter.measure(x, v));
    if (predicted) predicted->add(t, x, v);
    add(t);
  };
  const fem::State<float> start = truth.state<float>(0);
  result.end = roll_out<float>(simulation, start, n_frames, [&](const Frame<float>& frame) {
    predict(frame.t, frame.x, frame.v);
  });
  if (result.prediction.empty()) predict(0, start.x, start.v);  // no step at all could be made
  for (auto t = static_cast<Index>(result.rmse.size()); t <= n_frames; ++t) add(t);

  result.track.name = truth.name();
  if (recorded) result.track.motions = {recorded->finish(), predicted->finish(result.end.diverged)};
  return result;
}

}  // namespace nmp
