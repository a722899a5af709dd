#include "nmp/module_errors.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "autodiff/ops_basic.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/affine_fit.h"

namespace nmp {

namespace {

// sum |y - y*|^2, sum |y*|^2 and over how many vertices.
struct Sums {
  double difference = 0, size = 0, vertices = 0;
  void add(double y, double y_true) {
    difference += (y - y_true) * (y - y_true);
    size += y_true * y_true;
  }
  void add(const Sums& other) {
    difference += other.difference;
    size += other.size;
    vertices += other.vertices;
  }
  double relative() const {
    return size > 0 ? std::sqrt(difference / size) : std::numeric_limits<double>::quiet_NaN();
  }
  double rms() const { return vertices > 0 ? std::sqrt(difference / vertices) : 0; }
};

Sums compare(const Matrix<double>& y, const Matrix<double>& y_true) {
  return {(y - y_true).squaredNorm(), y_true.squaredNorm(), static_cast<double>(y.rows())};
}

// A recorded frame and the last frame at which each vertex touched the ground by then.
struct Recorded {
  Index t = 0;
  Matrix<double> x, v, f;
  std::vector<char> touching;
  std::vector<Index> last_touch;
};

// The windows of one integrator along one trajectory, all lengths at once.
template <class Real>
class WindowErrors {
 public:
  WindowErrors(const fem::Integrator<Real>& integrator, const fem::StepContext<Real>& context,
               double stagger, const std::vector<Index>& windows)
      : integrator_(integrator),
        context_(context),
        s_(stagger),
        windows_(windows),
        ring_(static_cast<std::size_t>(windows.empty() ? 1 : windows.back() + 1)),
        sum_(Matrix<double>::Zero(context.mesh.n_vertices(), 3)),
        is_pinned_(static_cast<std::size_t>(context.mesh.n_vertices()), 0),
        points_(windows.size()) {
    for (const int i : context.boundary.pinned) is_pinned_[static_cast<std::size_t>(i)] = 1;
  }

  // The next frame: ends one window of each length.
  void add(const Recorded& frame) {
    Moment& now = moment(frame.t);
    now.dv = increment(frame);
    now.dv_sum = sum_;  // over the frames before
    now.v = frame.v;
    sum_ += now.dv;
    for (std::size_t w = 0; w < windows_.size(); ++w) {
      const Index start = frame.t - windows_[w];
      if (start >= 0) point(w, start).add(window(moment(start), now, start, frame.last_touch));
    }
  }

  // Per window length, per point of the curve.
  const std::vector<std::vector<Sums>>& points() const { return points_; }

 private:
  struct Moment {
    Matrix<double> dv, dv_sum, v;
  };
  Moment& moment(Index t) { return ring_[static_cast<std::size_t>(t) % ring_.size()]; }
  Sums& point(std::size_t w, Index start) {
    const auto k = static_cast<std::size_t>(start / ModuleErrors::kStride);
    if (points_[w].size() <= k) points_[w].resize(k + 1);
    return points_[w][k];
  }

  // dv(x, v - s dv(x, v, f), f).
  Matrix<double> increment(const Recorded& frame) {
    tape_.clear();
    const auto x = tape_.constant(Matrix<Real>(frame.x.cast<Real>()));
    const auto v = tape_.constant(Matrix<Real>(frame.v.cast<Real>()));
    const auto f = tape_.constant(Matrix<Real>(frame.f.cast<Real>()));
    if (s_ == 0) return integrator_.dv(context_, x, v, f).value().template cast<double>();
    const auto dv = integrator_.dv(context_, x, v, f);
    const auto v_internal = fem::pin_velocities(
        context_.boundary, ad::subtract(v, ad::scale(dv, static_cast<Real>(s_))));
    return integrator_.dv(context_, x, v_internal, f).value().template cast<double>();
  }

  Sums window(const Moment& then, const Moment& now, Index start,
              const std::vector<Index>& last_touch) const {
    Sums sums;
    for (Index i = 0; i < now.v.rows(); ++i) {
      if (is_pinned_[static_cast<std::size_t>(i)]) continue;
      const Index n_axes = last_touch[static_cast<std::size_t>(i)] >= start ? 2 : 3;
      for (Index c = 0; c < n_axes; ++c)
        sums.add(now.dv_sum(i, c) - then.dv_sum(i, c) + s_ * (now.dv(i, c) - then.dv(i, c)),
                 now.v(i, c) - then.v(i, c));
      sums.vertices += 1;
    }
    return sums;
  }

  const fem::Integrator<Real>& integrator_;
  const fem::StepContext<Real>& context_;
  double s_;
  std::vector<Index> windows_;
  std::vector<Moment> ring_;
  Matrix<double> sum_;
  std::vector<char> is_pinned_;
  std::vector<std::vector<Sums>> points_;
  ad::Tape<Real> tape_{ad::Tape<Real>::Mode::inference};
};

// Everything that the errors are measured with.
class Bench {
 public:
  Bench(Model<float>& model, const Dataset& dataset, const std::vector<Index>& windows)
      : model_(model),
        dataset_(dataset),
        lengths_(windows),
        physics_(dataset.manifest().physics),
        mesh_f_(dataset.mesh().cast<float>()),
        boundary_(fem::make_boundary<double>(dataset.mesh(), physics_.pinned, physics_.ground)),
        boundary_f_(fem::make_boundary<float>(mesh_f_, physics_.pinned, ground_as_float())),
        euler_(physics_.material.density, physics_.gravity),
        windows_(windows.size()),
        window_references_(windows.size()) {
    if (dataset.manifest().law_known) law_ = fem::make_law<double>(physics_.material);
  }

  // Adds one trajectory to the totals and returns its curves.
  ModuleErrors::Curves run(const Trajectory& truth, Index n_frames) {
    const double h = dataset_.manifest().h;
    const fem::StepContext<float> context_f{mesh_f_, static_cast<float>(h), boundary_f_};
    const fem::StepContext<double> context{dataset_.mesh(), h, boundary_};
    WindowErrors<float> learned(model_.integration, context_f, model_.info.stagger, lengths_);
    WindowErrors<double> true_one(euler_, context, dataset_.stagger(), lengths_);
    ModuleErrors::Curves curves;
    curves.trajectory = truth.name();

    const Index n_vertices = dataset_.mesh().n_vertices();
    Recorded frame;
    frame.x.resize(n_vertices, 3);
    frame.v.resize(n_vertices, 3);
    frame.f.resize(n_vertices, 3);
    frame.last_touch.assign(static_cast<std::size_t>(n_vertices), -1);
    for (Index t = 0; t <= n_frames; ++t) {
      frame.t = t;
      truth.read_x<double>(t, frame.x);
      truth.read_v<double>(t, frame.v);
      truth.read_force<double>(t, frame.f);
      frame.touching = touching(dataset_.manifest(), frame.x, frame.v);
      for (std::size_t i = 0; i < frame.touching.size(); ++i)
        if (frame.touching[i]) frame.last_touch[i] = t;
      learned.add(frame);
      if (law_) true_one.add(frame);
      if (t % ModuleErrors::kStride == 0) add_point(frame, curves);
    }
    leave_out_faint(curves);
    for (std::size_t w = 0; w < lengths_.size(); ++w) {
      curves.windows.push_back({relative(learned.points()[w], curves.frame.size()),
                                relative(true_one.points()[w], law_ ? curves.frame.size() : 0)});
      for (const Sums& sums : learned.points()[w]) windows_[w].add(sums);
      for (const Sums& sums : true_one.points()[w]) window_references_[w].add(sums);
    }
    return curves;
  }

  ModuleErrors::Value stress() const { return value(stress_, stress_reference_); }
  ModuleErrors::Value window(std::size_t w) const {
    return value(windows_[w], window_references_[w]);
  }

 private:
  std::optional<float> ground_as_float() const {
    if (!physics_.ground) return std::nullopt;
    return static_cast<float>(*physics_.ground);
  }

  // Forces at one frame.
  void add_point(const Recorded& frame, ModuleErrors::Curves& curves) {
    curves.frame.push_back(frame.t);
    double n_touching = 0;
    for (const char touches : frame.touching) n_touching += touches;
    curves.touching.push_back(n_touching / static_cast<double>(frame.touching.size()));
    tape_f_.clear();
    const Matrix<float> x = frame.x.cast<float>();
    const Matrix<double> f =
        model_.stress.internal_force(mesh_f_, tape_f_.constant(x)).value().cast<double>();
    const Sums sums = compare(f, frame.f);
    curves.stress.push_back(sums.relative());
    sizes_.push_back(sums.size);
    stress_.add(sums);
    if (!law_) return;
    tape_.clear();
    const Sums reference =
        compare(law_->internal_force(dataset_.mesh(), tape_.constant(frame.x)).value(), frame.f);
    curves.stress_reference.push_back(reference.relative());
    stress_reference_.add(reference);
  }

  // Free flight: forces that are the rounding of positions have no meaningful relative error.
  void leave_out_faint(ModuleErrors::Curves& curves) {
    const double largest = *std::max_element(sizes_.begin(), sizes_.end());
    for (std::size_t k = 0; k < sizes_.size(); ++k) {
      if (sizes_[k] >= ModuleErrors::kFaint * ModuleErrors::kFaint * largest) continue;
      curves.stress[k] = std::numeric_limits<double>::quiet_NaN();
      if (law_) curves.stress_reference[k] = curves.stress[k];
    }
    sizes_.clear();
  }

  static std::vector<double> relative(const std::vector<Sums>& points, std::size_t n) {
    std::vector<double> values(n, std::numeric_limits<double>::quiet_NaN());
    for (std::size_t k = 0; k < std::min(n, points.size()); ++k) values[k] = points[k].relative();
    return values;
  }

  ModuleErrors::Value value(const Sums& sums, const Sums& reference) const {
    // Nothing to compare with, or a truth of zero: the difference itself, as RelativeError does.
    const auto ratio = [](const Sums& each) {
      return each.size > 0 ? each.relative() : std::sqrt(each.difference);
    };
    ModuleErrors::Value result{ratio(sums), sums.rms(), std::nullopt};
    if (law_) result.reference = ratio(reference);
    return result;
  }

  Model<float>& model_;
  const Dataset& dataset_;
  std::vector<Index> lengths_;
  fem::Physics physics_;
  fem::TetMesh<float> mesh_f_;
  fem::Boundary<double> boundary_;
  fem::Boundary<float> boundary_f_;
  fem::SemiImplicitEuler<double> euler_;
  std::unique_ptr<fem::ConstitutiveLaw<double>> law_;
  ad::Tape<double> tape_{ad::Tape<double>::Mode::inference};
  ad::Tape<float> tape_f_{ad::Tape<float>::Mode::inference};
  Sums stress_, stress_reference_;
  std::vector<double> sizes_;  // sum |f*|^2 of each point of the present trajectory
  std::vector<Sums> windows_, window_references_;  // per window length
};

}  // namespace

ModuleErrors module_errors(Model<float>& model, const Dataset& dataset,
                           const std::vector<const Trajectory*>& trajectories, Index n_frames,
                           const std::vector<Index>& windows,
                           const std::function<void()>& one_done) {
  std::vector<Index> lengths;
  for (const Index n : windows) {
    NMP_CHECK(n >= 1, text("a window has at least one frame, got ", n));
    if (n <= n_frames) lengths.push_back(n);
  }
  std::sort(lengths.begin(), lengths.end());
  Bench bench(model, dataset, lengths);
  ModuleErrors errors;
  for (const Trajectory* truth : trajectories) {
    if (truth->has_force())
      errors.trajectories.push_back(bench.run(*truth, std::min(n_frames, truth->frames())));
    if (one_done) one_done();
  }
  if (errors.trajectories.empty()) return errors;
  errors.stress = bench.stress();
  for (std::size_t w = 0; w < lengths.size(); ++w)
    errors.windows.push_back({lengths[w], bench.window(w)});
  return errors;
}

}  // namespace nmp
