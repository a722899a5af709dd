#include "nmp/affine_fit.h"

#include "nmp/nets.h"
#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::random_matrix;
using test::Record;

namespace {

constexpr Index kFrames = 30;
constexpr double kAlpha = 1.0 / 970;
const Vec3<double> kB(0.4, -0.3, -9.75);

// Accelerations of some thousand m/s2, as in a body with waves.
test::Recording make_recording() {
  test::Recording recording;
  const Matrix<double> V = recording.mesh.vertex_volumes();
  const double h = recording.h(), s = (1 - recording.dt / h) / 2;
  for (std::uint64_t seed : {1, 2}) {
    Record record;
    Matrix<double> x = recording.mesh.vertices(), v = random_matrix(27, 3, seed);  // s dv early
    for (Index t = 0; t <= kFrames; ++t) {
      Matrix<double> f = 3e6 * random_matrix(27, 3, 100 * seed + static_cast<std::uint64_t>(t));
      f.array().colwise() *= V.col(0).array();
      // As the file holds it.
      f = f.cast<float>().cast<double>();
      Matrix<double> dv = kAlpha * h * (f.array().colwise() / V.col(0).array()).matrix();
      dv.rowwise() += h * kB.transpose();
      record.add(x, v + s * dv, f);
      v += dv;
      x += h * v;
    }
    recording.train.push_back(record);
  }
  return recording;
}

AffineFit fit(const test::Recording& recording, Index window, double stagger = -1) {
  const test::Folder folder;
  const Dataset data = test::write_dataset(folder.path(), recording);
  std::vector<const Trajectory*> all;
  for (const auto& trajectory : data.train()) all.push_back(&trajectory);
  return fit_affine(data, all, window, stagger < 0 ? data.stagger() : stagger);
}

// rel; of b, in units of g.
double error(const AffineFit& fit) {
  return std::max(std::abs(fit.alpha / kAlpha - 1), (fit.b - kB).norm() / 9.8);
}

}  // namespace

TEST_SUITE("nmp/affine_fit") {
  TEST_CASE("gives back the numbers that made the data, for any window") {
    const auto recording = make_recording();
    double worst = 0;
    for (const Index window : {Index(1), Index(5), Index(10), kFrames}) {
      CAPTURE(window);
      const AffineFit result = fit(recording, window);
      worst = std::max(worst, error(result));
      CHECK(error(result) <= (window == 1 ? 2e-5 : 5e-6));
      CHECK(result.n_equations == 2 * (kFrames + 1 - window) * 81);
      CHECK(result.residual < 5e-3);  // floats: 1e-7 m/s over h
    }
    const AffineFit result = fit(recording, 10);
    CHECK(std::abs(result.alpha / kAlpha - 1) <= 1e-6);
    MESSAGE("worst ", worst, ", window of 10: alpha ", std::abs(result.alpha / kAlpha - 1), ", b ",
            (result.b - kB).norm());
    // A wrong convention shows.
    CHECK(error(fit(recording, 10, 0)) > 1e-3);
    CHECK(fit(recording, 10, 0).residual > 1);
  }

  TEST_CASE("pinned vertices are left out") {
    auto recording = make_recording();
    for (Record& record : recording.train)
      for (auto& v : record.v) v.row(3) = v.row(20) = Eigen::RowVector3d::Zero();
    CHECK(error(fit(recording, 10)) > 1e-3);
    recording.physics.pinned = {3, 20};
    const AffineFit result = fit(recording, 10);
    CHECK(error(result) <= 5e-6);
    CHECK(result.n_equations == 2 * 21 * 75);
  }

  TEST_CASE("touching vertices are left out: the ground may stop and drag them") {
    auto recording = make_recording();
    // Vertex 5 of the second trajectory is on the ground at frames 12 to 14, stopped.
    Record& record = recording.train[1];
    for (std::size_t t = 12; t <= 14; ++t) {
      record.x[t](5, 2) = -40;
      record.v[t].row(5).setZero();
    }
    CHECK(error(fit(recording, 10)) > 1e-5);
    recording.physics.ground = -40;
    const AffineFit result = fit(recording, 10);
    CHECK(error(result) <= 5e-6);
    // Windows from t to t + 10 with 12 <= t + 10 and t <= 14: 13 of them.
    CHECK(result.n_equations == 2 * 21 * 81 - 3 * 13);
  }

  TEST_CASE("what touches is on the ground, or may be within two frames") {
    Manifest manifest;
    manifest.h = 0.01;
    Matrix<double> x = Matrix<double>::Zero(5, 3), v = Matrix<double>::Zero(5, 3);
    x.col(2) << 1, 1.1, 1.1, 1.1, 0.9;
    v.col(2) << 0, -4.9, -5.1, 5.1, 0;
    CHECK(touching(manifest, x, v) == std::vector<char>{0, 0, 0, 0, 0});
    manifest.physics.ground = 1;
    CHECK(touching(manifest, x, v) == std::vector<char>{1, 0, 1, 1, 1});
  }

  TEST_CASE("refuses windows that do not fit, and data that do not tell") {
    auto recording = make_recording();
    const std::string what = test::message<InputError>([&] { fit(recording, kFrames + 1); });
    CHECK(contains(what, "train/0.safetensors has 30 frames, fewer than the fit's window of 31"));
    CHECK(contains(what, "train.integration.fit_window"));
    CHECK_THROWS_AS(fit(recording, 0), std::invalid_argument);
    recording.with_force = false;
    CHECK(contains(test::message<InputError>([&] { fit(recording, 5); }), "f_int"));
    recording.with_force = true;
    for (Record& record : recording.train)
      for (auto& f : record.f) f.setZero();
    CHECK(contains(test::message<NumericalError>([&] { fit(recording, 5); }),
                   "do not determine the affine part of the integrator (4212 equations); record"));
  }

  TEST_CASE("refuses a body that falls freely: its forces are rounding errors") {
    auto recording = make_recording();
    const auto fall = [&](double force) {
      for (Record& record : recording.train) {
        Vec3<double> v(0, 0, 3);
        for (std::size_t t = 0; t < record.v.size(); ++t) {
          const Matrix<double> f = force * random_matrix(27, 3, t);
          record.f[t] = f.cast<float>().cast<double>();
          record.v[t].rowwise() = v.transpose();
          record.v[t] += 1e-7 * random_matrix(27, 3, 1000 + t);  // floats
          v += recording.h() * kB;
        }
      }
      return test::message<NumericalError>([&] { fit(recording, 5); });
    };
    for (const double force : {1e-9, 1e-3}) {
      CAPTURE(force);
      CHECK(contains(fall(force), "m3/kg, expected a tenth of it at most; record motions"));
    }
  }
}
