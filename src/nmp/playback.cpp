#include "nmp/playback.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "nmp/metrics.h"
#include "nmp/setting.h"

namespace nmp {

namespace {

// The rows of `values` that lie on the surface.
Matrix<double> on_surface(const Matrix<double>& values, const fem::Surface& surface) {
  Matrix<double> rows(static_cast<Index>(surface.vertices.size()), values.cols());
  for (Index i = 0; i < rows.rows(); ++i)
    rows.row(i) = values.row(surface.vertices[static_cast<std::size_t>(i)]);
  return rows;
}

}  // namespace

PlayerBody player_body(const Dataset& dataset) {
  PlayerBody body;
  body.surface = fem::extract_surface(dataset.mesh().tets());
  const std::vector<std::int32_t>& vertices = body.surface.vertices;
  for (const int v : dataset.manifest().physics.pinned) {
    const auto place = std::lower_bound(vertices.begin(), vertices.end(), v);
    if (place != vertices.end() && *place == v)
      body.pinned.push_back(static_cast<std::int32_t>(place - vertices.begin()));
  }
  body.ground = dataset.manifest().physics.ground;
  return body;
}

Playback play_back(const Model<float>& model, const Dataset& dataset, const Trajectory& truth,
                   const PlayerBody* body, Index stride,
                   const std::function<void(double)>& progress) {
  NMP_CHECK(stride >= 1, text("a stride is at least 1, got ", stride));
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
  PlayerTrack& track = result.track;
  track.name = truth.name();
  track.h = manifest.h;
  track.stride = stride;

  StateMeter meter(dataset.mesh(), physics, manifest.law_known);
  const double height = physics.ground.value_or(0) + 1e-6 * dataset.mesh().diagonal();
  Matrix<double> x_true(n_vertices, 3), v_true(n_vertices, 3), x(n_vertices, 3), v(n_vertices, 3);
  Matrix<double> det = Matrix<double>::Ones(n_vertices, 1);
  // Frame t, with the prediction in x, v, det.
  const auto add = [&](Index t) {
    truth.read_x<double>(t, x_true);
    truth.read_v<double>(t, v_true);
    result.truth.push_back(meter.measure(x_true, v_true));
    result.rmse.push_back(rmse(x, x_true));
    const double n_touching =
        physics.ground ? static_cast<double>((x_true.col(2).array() <= height).count()) : 0;
    result.touching.push_back(n_touching / static_cast<double>(n_vertices));
    if (body && (t % stride == 0 || t == n_frames)) {
      const fem::Surface& surface = body->surface;
      track.frames.push_back({t, on_surface(x_true, surface), on_surface(x, surface),
                              on_surface(meter.vertex_det(), surface), on_surface(det, surface),
                              on_surface(v_true.rowwise().norm(), surface),
                              on_surface(v.rowwise().norm(), surface)});
      track.rmse.push_back(result.rmse.back());
    }
    if (progress) progress(static_cast<double>(t) / static_cast<double>(n_frames));
  };

  const auto predict = [&](const ConstView<float>& x_t, const ConstView<float>& v_t) {
    x = x_t.cast<double>();
    v = v_t.cast<double>();
    result.prediction.push_back(meter.measure(x, v));
    det = meter.vertex_det();
  };
  const fem::State<float> start = truth.state<float>(0);
  result.end = roll_out<float>(simulation, start, n_frames, [&](const Frame<float>& frame) {
    predict(frame.x, frame.v);
    add(frame.t);
  });
  if (result.prediction.empty()) {  // not even the first step can be made: held at the start
    predict(start.x, start.v);
    add(0);
  }
  v.setZero();
  for (auto t = static_cast<Index>(result.rmse.size()); t <= n_frames; ++t) add(t);
  if (result.end.diverged) track.held = result.end.frames;
  return result;
}

}  // namespace nmp
