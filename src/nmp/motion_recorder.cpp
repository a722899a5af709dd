#include "nmp/motion_recorder.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "nmp/metrics.h"

namespace nmp {

PlayerBody player_body(const Dataset& dataset, const std::string& stress_law) {
  PlayerBody body;
  body.surface = fem::extract_surface(dataset.mesh().tets());
  const std::vector<std::int32_t>& vertices = body.surface.vertices;
  for (const int v : dataset.manifest().physics.pinned) {
    const auto place = std::lower_bound(vertices.begin(), vertices.end(), v);
    if (place != vertices.end() && *place == v)
      body.pinned.push_back(static_cast<std::int32_t>(place - vertices.begin()));
  }
  body.ground = dataset.manifest().physics.ground;
  body.stress_law = stress_law;
  return body;
}

bool Reference::at(double time, Matrix<double>& x) const {
  constexpr double kSame = 1e-6;  // of a frame: two clocks that mean the same time
  const double place = time / h_;
  if (!(place >= -kSame && place <= static_cast<double>(record_.frames()) + kSame)) return false;
  const auto t = static_cast<Index>(std::lround(place));
  if (std::abs(place - static_cast<double>(t)) <= kSame) {
    record_.read_x<double>(t, x);
    return true;
  }
  const auto begin = static_cast<Index>(std::floor(place));
  const double s = place - static_cast<double>(begin), r = 1 - s;
  const fem::State<double> a = record_.state<double>(begin), b = record_.state<double>(begin + 1);
  x = r * r * (1 + 2 * s) * a.x + s * s * (3 - 2 * s) * b.x + h_ * s * r * (r * a.v - s * b.v);
  return true;
}

MotionRecorder::MotionRecorder(Options options) : options_(std::move(options)) {
  NMP_CHECK(options_.shape && options_.mesh && options_.h > 0 && options_.stride >= 1,
            text("a motion needs a body, h > 0 and a stride of at least 1, got ", options_.h,
                 " and ", options_.stride));
  motion_.label = options_.label;
  motion_.body = options_.body;
  motion_.h = options_.h;
}

void MotionRecorder::add(Index t, const ConstView<double>& x, const ConstView<double>& v) {
  NMP_CHECK(t == last_ + 1, text("frame ", last_ + 1, " comes next, got ", t));
  if (!x.allFinite() || !v.allFinite())
    throw InputError(text(options_.label, ": frame ", t,
                          ": expected finite positions and velocities, found others"));
  last_ = t;
  x_ = x;
  v_ = v;
  if (t % options_.stride == 0) keep(t, x_, v_);
}

PlayerMotion MotionRecorder::finish(bool diverged) {
  NMP_CHECK(last_ >= 0, "a motion has at least one frame");
  if (motion_.frames.back().t != last_) keep(last_, x_, v_);
  motion_.diverged = diverged;
  return std::move(motion_);
}

void MotionRecorder::keep(Index t, const Matrix<double>& x, const Matrix<double>& v) {
  const fem::Surface& surface = options_.shape->surface;
  const VertexMeasures measures = measure_vertices(*options_.mesh, x, options_.law);
  PlayerFrame frame;
  frame.t = t;
  frame.x = on_surface(x, surface);
  frame.det = on_surface(measures.det, surface);
  frame.stress = on_surface(measures.stress, surface);
  frame.speed = on_surface(v.rowwise().norm(), surface);
  Matrix<double> x_true(x.rows(), 3);
  if (options_.reference && options_.reference->at(static_cast<double>(t) * options_.h, x_true)) {
    frame.error = on_surface((x - x_true).rowwise().norm(), surface);
    frame.rmse = rmse(x, x_true);
  }
  motion_.frames.push_back(std::move(frame));
}

}  // namespace nmp
