#include "nmp/trainer.h"

#include <Eigen/SVD>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/parallel.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "nmp/nets.h"
#include "nmp/recorded.h"
#include "nmp/rollout.h"
#include "nmp/training_loss.h"
#include "nn/schedule.h"

using namespace nmp;
using fem::same_bits;
using test::contains;
using Json = nlohmann::json;

namespace {

TrainConfig tiny_config() {
  TrainConfig config;
  config.stress.hidden = {16, 24};
  config.integration.embedding = 4;
  config.integration.hidden = 8;
  config.integration.alignment_widths = {8, 12, 8};
  config.constitutive.iterations = 20;
  config.constitutive.batch = 1024;
  config.constitutive.frames = 20;
  config.integrate.iterations = 20;
  config.integrate.batch = 1024;
  config.integrate.window_start = 5;
  config.integrate.window_end = 10;
  config.integrate.fit_window = 10;
  config.joint.iterations = 4;
  config.joint.lr = 1e-4;
  config.joint.clip = 0.1;
  config.joint.reset_start = 5;
  config.joint.reset_end = 8;
  return config;
}

// Made once.
using Weights = std::vector<Matrix<float>>;

bool same(const Weights& a, const Weights& b) {
  bool equal = a.size() == b.size();
  for (std::size_t k = 0; equal && k < a.size(); ++k) equal = same_bits(a[k], b[k]);
  return equal;
}

// A training run, with what it shows and the weights after every step.
struct Traced {
  Model<float> model;
  Weights before;
  std::vector<TrainEvent> events;
  std::vector<Weights> weights;
  std::vector<std::string> said;
  std::ostringstream metrics;
  TrainOptions options;

  Traced(const TrainConfig& config, const Dataset& data, const std::string& stage = "all")
      : model(make_model(config, data)), before(nn::values(model.parameters())) {
    options.stage = stage;
    options.log = [this](const std::string& line) { metrics << line << "\n"; };
    options.progress = [this](const TrainEvent& event) {
      events.push_back(event);
      weights.push_back(nn::values(model.parameters()));
    };
    options.say = [this](const std::string& sentence) { said.push_back(sentence); };
  }
  Weights now() { return nn::values(model.parameters()); }
};

// Every 10th state of every training trajectory, in long double.
using Long = long double;
using LongMatrix = Eigen::Matrix<Long, Eigen::Dynamic, Eigen::Dynamic>;
struct Statistics {
  Long x = 0, v = 0, f = 0, f_raw = 0, a = 0, P = 0, z = 0;
};

Statistics statistics(const Dataset& data) {
  const auto& mesh = data.mesh();
  const Long E = data.manifest().physics.material.E, nu = data.manifest().physics.material.nu;
  const Long mu = E / (2 * (1 + nu)), lambda = E * nu / ((1 + nu) * (1 - 2 * nu));
  Statistics sum;
  Long n = 0, n_elements = 0;
  const auto add_elements = [&](const LongMatrix& x) {
    for (Index e = 0; e < mesh.n_tets(); ++e) {
      using Mat3 = Eigen::Matrix<Long, 3, 3>;
      Mat3 D, D_rest;
      for (int a = 0; a < 3; ++a) {
        const auto edge = [&](const auto& m) {
          return (m.row(mesh.tets()(e, a + 1)) - m.row(mesh.tets()(e, 0))).transpose().eval();
        };
        D.col(a) = edge(x);
        D_rest.col(a) = edge(mesh.vertices()).cast<Long>();
      }
      const Mat3 F = D * D_rest.inverse(), I = Mat3::Identity(), F_inv_T = F.inverse().transpose();
      const Long J = F.determinant();
      const Mat3 P = mu * (F - F_inv_T) + lambda * std::log(J) * F_inv_T;
      const auto sigma = Eigen::JacobiSVD<Mat3>(F).singularValues();
      sum.P += P.squaredNorm();
      sum.z += (sigma.array() - 1).matrix().squaredNorm() + (F.transpose() * F - I).squaredNorm() +
               (J - 1) * (J - 1);
      ++n_elements;
    }
  };
  for (const Trajectory& trajectory : data.train()) {
    const auto record = test::read_record(trajectory);
    for (Index t = 0; t <= trajectory.frames(); t += 10) {
      const auto k = static_cast<std::size_t>(t);
      const LongMatrix x = record.x[k].cast<Long>();
      add_elements(x);
      if (t == trajectory.frames()) continue;
      const Eigen::Matrix<Long, 1, 3> centroid = x.colwise().mean();
      sum.x += (x.rowwise() - centroid).squaredNorm();
      sum.v += record.v[k].cast<Long>().squaredNorm();
      sum.a += (record.v[k + 1] - record.v[k]).cast<Long>().squaredNorm();
      sum.f_raw += record.f[k].cast<Long>().squaredNorm();
      for (Index i = 0; i < x.rows(); ++i)
        sum.f +=
            (record.f[k].row(i).cast<Long>() / Long(mesh.vertex_volumes()(i, 0))).squaredNorm();
      n += Long(x.rows());
    }
  }
  for (Long* each : {&sum.x, &sum.v, &sum.f, &sum.f_raw, &sum.a}) *each = std::sqrt(*each / n);
  sum.a /= Long(data.manifest().h);
  sum.P = std::sqrt(sum.P / (9 * n_elements));
  sum.z = std::sqrt(sum.z / (13 * n_elements));
  return sum;
}

double relative(double a, Long b) { return static_cast<double>(std::abs(a - b) / b); }

// Twelve frames of a cube at rest at `offset`, all vertices moving by `step` a frame.
Dataset rigid(const test::Folder& folder, const Vec3<double>& offset, const Vec3<double>& step) {
  test::Recording recording;
  test::Record record;
  for (int t = 0; t <= 12; ++t) {
    const Vec3<double> at = offset + t * step;
    const Matrix<double> x = recording.mesh.vertices().rowwise() + at.transpose();
    record.add(x, (step / recording.h()).transpose().replicate(27, 1), 0 * x);
  }
  recording.train = {record};
  return test::write_dataset(folder.path(), recording);
}

std::vector<Json> parse_lines(const std::string& lines) {
  std::vector<Json> parsed;
  std::istringstream in(lines);
  for (std::string line; std::getline(in, line);) parsed.push_back(Json::parse(line));
  return parsed;
}

}  // namespace

TEST_SUITE("nmp/trainer") {
  TEST_CASE("input statistics are those of long double (NN8)") {
    const Dataset& data = test::tiny_dataset();
    const Statistics wanted = statistics(data);
    TrainConfig config = tiny_config();
    for (const std::string form : {"affine", "paper"}) {
      config.integration.form = form;
      const Model<float> model = make_model(config, data);
      const IntegrationScales& scales = model.integration.scales();
      CHECK(relative(scales.x, wanted.x) <= 1e-10);
      CHECK(relative(scales.v, wanted.v) <= 1e-10);
      CHECK(relative(scales.f, form == "paper" ? wanted.f_raw : wanted.f) <= 1e-10);
      CHECK(relative(scales.a, wanted.a) <= 1e-10);
      CHECK(scales.positions == "height");
      CHECK(relative(model.stress.scale(), wanted.P) <= 1e-10);
      CHECK(relative(model.stress.z_scale(), wanted.z) <= 1e-10);
      CHECK(relative(model.stress.scale() * (1 + 1e-4), wanted.P) > 1e-10);
      CHECK(model.info.h == data.manifest().h);
      CHECK(model.info.stagger == data.stagger());
      CHECK(model.info.scene == "tiny");
    }
    config.staggered = false;
    CHECK(make_model(config, data).info.stagger == 0);
  }

  TEST_CASE("constant features and large offsets have finite scales (NN8)") {
    for (const double offset : {0.0, 3e4}) {
      const test::Folder folder;
      const Dataset data = rigid(folder, {offset, -offset, offset}, {0, 0, 0});
      const Model<float> model = make_model(tiny_config(), data);
      const IntegrationScales& scales = model.integration.scales();
      // The cube's own size, whatever the offset; nothing to scale elsewhere.
      const Long size = statistics(data).x;
      CHECK(relative(scales.x, size) <= 1e-10);
      CHECK(scales.x == doctest::Approx(std::sqrt(0.5)).epsilon(offset > 0 ? 1e-2 : 1e-6));
      CHECK(scales.v == 1);
      CHECK(scales.f == 1);
      CHECK(scales.a == doctest::Approx(1 / data.manifest().h));
      CHECK(std::isfinite(model.stress.scale()));
      CHECK(model.stress.scale() > 0);
      CHECK(model.stress.z_scale() > 0);
      if (offset == 0) CHECK(model.stress.z_scale() == 1);
      CHECK(scales.positions == "centred");
    }
  }

  TEST_CASE("recordings that are not finite are refused when scales are made from them") {
    const auto damaged = [](const test::Folder& folder, auto what) {
      auto recording = test::read_recording(test::tiny_dataset());
      (recording.train[0].*what)[20](5, 1) = std::nan("");
      return test::write_dataset(folder.path(), recording);
    };
    const test::Folder v, f, x;
    const Dataset bad_v = damaged(v, &test::Record::v), bad_f = damaged(f, &test::Record::f);
    CHECK(contains(test::message<InputError>([&] { make_model(tiny_config(), bad_v); }),
                   "not finite: v"));
    CHECK(contains(test::message<InputError>([&] { make_model(tiny_config(), bad_f); }),
                   "not finite: f_int"));
    const Dataset bad_x = damaged(x, &test::Record::x);
    CHECK(contains(test::message<NumericalError>([&] { make_model(tiny_config(), bad_x); }),
                   "det F = nan"));
  }

  TEST_CASE("overfits one trajectory: the law's loss falls 1000 times in 500 steps (NN9)") {
    const test::Folder folder;
    Scene scene = test::tiny_scene();
    scene.train = 1;
    generate_dataset(scene, folder / "data");
    const Dataset data = Dataset::open(folder / "data");
    TrainConfig config;
    config.select = 0;
    config.constitutive.iterations = 500;
    config.constitutive.batch = 512;
    config.constitutive.lr = 5e-3;
    Traced run(config, data, "constitutive");
    train(run.model, data, config, run.options);
    REQUIRE(run.events.size() == 500);
    double last = 0;
    for (std::size_t k = 450; k < 500; ++k) last += run.events[k].loss / 50;
    CHECK(last <= run.events[0].loss / 1000);
    MESSAGE("loss ", run.events[0].loss, " -> ", last);
  }

  TEST_CASE("pairs hold the rare extremes of a trajectory, seen from turned reference frames") {
    // At rest but for a state in the middle, where one corner is pulled out.
    test::Recording recording;
    test::Record record;
    const Matrix<double> rest = recording.mesh.vertices(), zero = 0 * rest;
    for (Index t = 0; t <= 40; ++t) {
      Matrix<double> x = rest;
      if (t == 21) x.row(0) *= 1.5;
      if (t == 21) x.row(0) -= Eigen::RowVector3d(0.2, 0.1, 0);
      record.add(x, zero, zero);
    }
    recording.train = {record};
    const test::Folder folder;
    const Dataset data = test::write_dataset(folder / "data", recording);
    TrainConfig config = tiny_config();
    StageConfig stage = config.constitutive;
    stage.pool = 4000;
    stage.frames = 2;
    Model<float> model = make_model(config, data);
    const auto loss_at = [&](double extreme, double turned) {
      stage.extreme = extreme;
      stage.turned = turned;
      const auto loss = make_pairs_loss(model, data, {&data.train()[0]}, stage, 5);
      ad::Tape<float> tape;
      return (*loss)(tape, 0).value()(0, 0);
    };
    test::shake(model.stress.parameters(), 9, 0.5);
    const double other = loss_at(0.5, 1), same = loss_at(0.5, 0);
    CHECK(std::abs(other - same) > 1e-8);  // the net is not isotropic
    for (auto* p : model.stress.parameters()) p->mutable_value().setZero();
    CHECK(loss_at(0, 0) == 0);
    const double unturned = loss_at(0.5, 0);
    CHECK(unturned > 1e-3);
    CHECK(loss_at(0.5, 1) == doctest::Approx(unturned).epsilon(1e-4));  // the law is
  }

  TEST_CASE("a joint stage can do without forces, and keep its last weights") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    config.constitutive.iterations = config.integrate.iterations = 0;
    config.joint.keep = "last";
    config.joint.lr = 1e-2;  // far too much
    const auto weights_after = [&](double force_weight, Index substeps) {
      config.joint.force_weight = force_weight;
      config.substeps = substeps;
      Traced run(config, data);
      const TrainResult result = train(run.model, data, config, run.options);
      CHECK(result.stages.back().kept == config.joint.iterations);
      CHECK(run.model.info.substeps == substeps);
      return nn::values(run.model.parameters());
    };
    const Weights with = weights_after(1, 1), without = weights_after(0, 1),
                  in_two_steps = weights_after(1, 2);
    CHECK_FALSE(same(with, without));
    CHECK_FALSE(same(with, in_two_steps));
  }

  TEST_CASE("a stage that observes positions reads neither velocities nor forces") {
    const Dataset& data = test::tiny_dataset();
    test::Recording recording;
    recording.mesh = data.mesh();
    recording.physics = data.manifest().physics;
    test::Record record = test::read_record(data.train()[0]);
    const test::Folder folder;
    recording.train = recording.validation = {record};
    const Dataset whole = test::write_dataset(folder / "whole", recording);
    for (std::size_t t = 0; t < record.x.size(); ++t)
      record.v[t] = record.f[t] = test::random_matrix(27, 3, t);
    recording.train = {record};
    const Dataset wrong = test::write_dataset(folder / "wrong", recording);

    TrainConfig config = tiny_config();
    Model<float> model = make_model(config, whole);
    test::shake(model.parameters(), 3, 0.1);
    model.integration.set_affine(1e-3, {0, 0, -9.8});
    const auto loss = [&](const Dataset& from, const char* observed, Learned learned) {
      StageConfig stage = config.joint;
      stage.observed = observed;
      stage.reset_start = stage.reset_end = 100;  // the whole of it, from frame 0 or 1
      ad::Tape<float> tape;
      const auto made = make_rollout_loss(model, from, {&from.train()[0]}, stage, learned, 1);
      return (*made)(tape, 0).value()(0, 0);
    };
    for (const Learned learned : {Learned::law, Learned::both}) {
      CHECK(loss(whole, "positions", learned) > 0);
      CHECK(loss(whole, "positions", learned) == loss(wrong, "positions", learned));
      CHECK(loss(whole, "all", learned) != loss(wrong, "all", learned));
      CHECK(loss(whole, "positions", learned) != loss(whole, "all", learned));
    }
    CHECK_THROWS_AS(velocity_from_positions<double>(whole.train()[0], 0, 5e-4, 1, true),
                    std::invalid_argument);
  }

  TEST_CASE("a record of positions alone, of an unknown law, trains both modules") {
    const test::Folder folder;
    const Dataset data = test::write_positions(folder.path(), test::tiny_dataset());
    TrainConfig config = tiny_config();
    config.constitutive.method = "rollout";
    config.constitutive.observed = config.joint.observed = "positions";
    config.constitutive.iterations = 60;
    config.constitutive.lr = 2e-2;
    config.constitutive.clip = 0.1;
    config.constitutive.reset_start = config.constitutive.reset_end = 20;
    config.integrate.iterations = 0;
    config.joint.volume_weight = 0;
    Traced run(config, data);
    // The scale of stresses and forces comes from accelerations: that of recorded forces within 2.
    const auto forces = test::read_recording(test::tiny_dataset());
    auto unknown = forces;
    unknown.law_known = false;
    const test::Folder with_forces;
    const Model<float> model = make_model(config, test::write_dataset(with_forces.path(), unknown));
    CHECK(run.model.stress.scale() / model.stress.scale() == doctest::Approx(1).epsilon(0.5));
    CHECK(run.model.integration.scales().f / model.integration.scales().f ==
          doctest::Approx(1).epsilon(0.5));
    const TrainResult result = train(run.model, data, config, run.options);
    REQUIRE(result.stages.size() == 2);
    CHECK(result.stages[0].rmse_kept < 0.8 * result.stages[0].rmse_before);  // measured 0.71
    CHECK(run.model.info.affine_alpha == 1e-3);
    CHECK(run.model.info.affine_b == Vec3<double>(0, 0, -9.8));
    CHECK(contains(run.said[0], "no forces are recorded"));
    // What needs more says so, and what to do.
    const auto refusal = [&](const std::string& stage, const TrainConfig& c) {
      TrainOptions options;
      options.stage = stage;
      try {
        train(run.model, data, c, options);
      } catch (const std::exception& error) {
        return std::string(error.what());
      }
      return std::string();
    };
    CHECK(contains(refusal("constitutive", tiny_config()), "nmp train positions"));
    CHECK(contains(refusal("integration", tiny_config()), "nmp train positions"));
    config.constitutive.observed = "all";
    CHECK(contains(refusal("constitutive", config), "observed = \"positions\""));
  }

  TEST_CASE("windows may draw their vertices from those on the ground") {
    // The bottom of a cube lies still, the rest is shaken by forces that nobody tells.
    test::Recording recording;
    recording.physics.ground = 0;
    recording.physics.gravity.setZero();
    Matrix<double> x = recording.mesh.rest();
    x.col(2).array() += 0.5;
    test::Record record;
    for (Index t = 0; t <= 30; ++t) {
      Matrix<double> v = test::random_matrix(27, 3, static_cast<std::uint64_t>(t));
      for (Index i = 0; i < 27; ++i)
        if (x(i, 2) < 1e-9) v.row(i).setZero();
      record.add(x, v, Matrix<double>::Zero(27, 3));
    }
    recording.train = recording.validation = {record};
    const test::Folder folder;
    const Dataset data = test::write_dataset(folder / "data", recording);
    TrainConfig config = tiny_config();
    const Model<float> model = [&] {
      Model<float> made(config.stress, config.integration, 1);
      made.integration.set_affine(1e-3, {0, 0, 0});
      return made;
    }();
    const auto loss = [&](double contact) {
      config.integrate.contact = contact;
      ad::Tape<float> tape;
      const auto made = make_windows_loss(model, data, {&data.train()[0]}, config.integrate, 1);
      return static_cast<double>((*made)(tape, 0).value()(0, 0));
    };
    CHECK(loss(1) == 0);
    CHECK(loss(0) > 0.1);
    CHECK(loss(0.5) > 0.1);
    CHECK(loss(0.5) < loss(0));
  }

  TEST_CASE("the joint loss measures the elastic energy against the true law's") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    config.stress.form = "energy";
    config.joint.iterations = 0;
    config.joint.epochs = 1;
    config.joint.reset_start = config.joint.reset_end = 1000;  // one segment: the trajectory
    Model<float> model = make_model(config, data);
    const Trajectory trajectory = data.train()[0];
    const auto loss = [&](double weight) {
      config.joint.energy_weight = weight;
      ad::Tape<float> tape;
      const auto made =
          make_rollout_loss(model, data, {&trajectory}, config.joint, Learned::both, 1);
      return static_cast<double>((*made)(tape, 0).value()(0, 0));
    };
    CHECK(loss(2) > loss(1));
    // Without an energy of its own, the error is the true one of every state.
    for (auto* p : model.stress.parameters()) p->mutable_value().setZero();
    const auto energy = [&](Index t) {
      Matrix<double> x(data.mesh().n_vertices(), 3), Psi(data.mesh().n_tets(), 1);
      trajectory.read_x<double>(t, x);
      ad::Tape<double> tape(ad::Tape<double>::Mode::inference);
      const auto F = fem::deformation_gradient<double>(data.mesh(), tape.constant(x));
      fem::energy_density<double>(data.manifest().physics.material, F.value(), Psi);
      return (data.mesh().volumes().array() * Psi.array()).sum();
    };
    double all = 0, sampled = 0, n = 0;
    for (Index t = 0; t <= trajectory.frames(); ++t) all += std::pow(energy(t), 2);
    for (Index t = 0; t < trajectory.frames(); t += 10, ++n) sampled += std::pow(energy(t), 2);
    const double expected = all / (sampled / n) / static_cast<double>(trajectory.frames());
    CHECK(expected > 0.1);
    CHECK(loss(1) - loss(0) == doctest::Approx(expected).epsilon(1e-4));
    CHECK(loss(3) - loss(0) == doctest::Approx(3 * expected).epsilon(1e-4));

    config.joint.energy_weight = 1;
    config.stress.form = "stress";
    const Model<float> other = make_model(config, data);
    CHECK(contains(test::message<ConfigError>([&] {
                     make_rollout_loss(other, data, {&trajectory}, config.joint, Learned::both, 1);
                   }),
                   "model.stress.form"));
  }

  TEST_CASE("the three stages bring the error down, and keep to their own weights") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    config.constitutive.iterations = 600;
    config.constitutive.lr = 5e-3;
    Traced run(config, data);
    const TrainResult result = train(run.model, data, config, run.options);
    CHECK(result.complete);
    REQUIRE(result.stages.size() == 3);
    CHECK(result.stages[0].stage == "constitutive");
    CHECK(result.stages[1].stage == "integration");
    CHECK(result.stages[2].stage == "joint");
    for (const StageReport& report : result.stages) {
      CHECK(report.iterations == report.planned);
      CHECK(report.change_end > 0);
      CHECK(report.rmse_kept <= report.rmse_before);
      CHECK(report.rmse_kept == std::min(report.rmse_before, report.rmse_after));
      CHECK((report.kept == 0) == (report.change == 0));
    }
    CHECK(result.stages[0].rmse_after < 0.5 * result.stages[0].rmse_before);
    CHECK(run.model.info.state == "joint");
    CHECK(run.model.info.affine_alpha == doctest::Approx(1e-3).epsilon(0.02));
    CHECK(run.model.info.affine_b[2] == doctest::Approx(-9.8).epsilon(0.02));

    // Which weights moved while.
    const auto parameters = run.model.parameters();
    const std::size_t n_stress = run.model.stress.parameters().size();
    const auto moved = [&](std::size_t step_before, std::size_t step, bool law) {
      bool any = false;
      for (std::size_t k = law ? 0 : n_stress; k < (law ? n_stress : parameters.size()); ++k)
        any |= !same_bits(run.weights[step_before][k], run.weights[step][k]);
      return any;
    };
    CHECK(moved(0, 599, true));
    CHECK_FALSE(moved(0, 599, false));
    CHECK(moved(600, 619, false));
    CHECK_FALSE(moved(600, 619, true));
    CHECK(moved(620, 623, true));
    CHECK(moved(620, 623, false));
  }

  TEST_CASE("a loss that is not finite changes nothing and is told (NN10)") {
    // Forces of frames 31 to 34 are NaN: whether a step meets them, its window decides.
    const test::Folder folder;
    auto recording = test::read_recording(test::tiny_dataset());
    for (std::size_t t = 31; t < 35; ++t) recording.train[0].f[t].setConstant(std::nan(""));
    const Dataset damaged = test::write_dataset(folder.path(), recording);
    TrainConfig config = tiny_config();
    config.integration.form = "density";
    config.integrate.iterations = 30;

    // What the steps do without the damage.
    Traced clean(config, test::tiny_dataset(), "integration");
    train(clean.model, test::tiny_dataset(), config, clean.options);

    // Stops by default.
    Traced stopped(config, damaged, "integration");
    const std::string what = test::message<NumericalError>(
        [&] { train(stopped.model, damaged, config, stopped.options); });
    const std::size_t step = stopped.events.size();
    REQUIRE(step > 0);
    CHECK(contains(what, text("integration, step ", step, ": the loss is not finite")));
    CHECK(contains(what, "the weights were left as they were"));
    CHECK(same(stopped.now(), clean.weights[step - 1]));
    CHECK_FALSE(same(stopped.now(), stopped.before));

    // Goes on if asked to, and leaves the weights alone at those steps.
    config.skip_non_finite = 1000;
    Traced skipping(config, damaged, "integration");
    CHECK(train(skipping.model, damaged, config, skipping.options).complete);
    REQUIRE(skipping.events.size() == 30);
    std::vector<std::size_t> bad;
    Index in_a_row = 0, longest = 0;
    std::size_t end_of_first_pair = 0;
    for (std::size_t k = 0; k < 30; ++k) {
      const bool finite = std::isfinite(skipping.events[k].loss);
      const Weights& before = k == 0 ? skipping.before : skipping.weights[k - 1];
      CHECK(same(skipping.weights[k], before) == !finite);
      in_a_row = finite ? 0 : in_a_row + 1;
      longest = std::max(longest, in_a_row);
      if (in_a_row == 2 && end_of_first_pair == 0) end_of_first_pair = k;
      if (!finite) bad.push_back(k);
    }
    REQUIRE(bad.size() >= 3);
    CHECK(bad.front() == step);
    CHECK(bad.size() < 20);
    std::size_t n_said = 0;
    for (const std::string& sentence : skipping.said)
      n_said += sentence.find("is not finite") != std::string::npos;
    CHECK(n_said == bad.size());
    for (const Json& line : parse_lines(skipping.metrics.str()))  // NaN is null there
      if (line["event"] == "step") CHECK(line.contains("loss"));

    // At most N in a row.
    REQUIRE(longest >= 2);
    config.skip_non_finite = 1;
    Traced once(config, damaged, "integration");
    CHECK(contains(
        test::message<NumericalError>([&] { train(once.model, damaged, config, once.options); }),
        text("step ", end_of_first_pair, ":")));
    CHECK(same(once.now(), skipping.weights[end_of_first_pair]));
    config.skip_non_finite = longest;
    Traced enough(config, damaged, "integration");
    CHECK(train(enough.model, damaged, config, enough.options).complete);
    CHECK(same(enough.now(), skipping.now()));
  }

  TEST_CASE("a gradient that is not finite names its tensor (NN10)") {
    const Dataset& data = test::tiny_dataset();
    const TrainConfig config = tiny_config();
    Traced run(config, data, "constitutive");
    // A hidden layer of 1e28 and a last one of 1e-14: the loss is finite, the last gradient is not.
    const auto parameters = run.model.stress.parameters();
    parameters[1]->mutable_value() *= 1e28f;
    parameters[2]->mutable_value() *= 1e-14f;
    run.before = run.now();
    const std::string what =
        test::message<NumericalError>([&] { train(run.model, data, config, run.options); });
    CHECK(contains(what, "constitutive, step 0: the gradient of stress.mlp.2.W is not finite"));
    CHECK(same(run.now(), run.before));
  }

  TEST_CASE("a run is repeated bit for bit, with 1, 2 and 3 threads, and another seed is another") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    std::vector<Weights> first;
    for (const int n_threads : {1, 1, 2, 3}) {
      set_threads(n_threads);
      Traced run(config, data);
      train(run.model, data, config, run.options);
      run.weights.push_back(run.now());
      if (first.empty()) first = run.weights;
      REQUIRE(run.weights.size() == 45);
      bool equal = true;
      for (std::size_t k = 0; k < first.size(); ++k) equal &= same(run.weights[k], first[k]);
      CHECK(equal);
    }
    set_threads(0);
    config.seed = 2;
    Traced other(config, data, "constitutive");
    train(other.model, data, config, other.options);
    CHECK_FALSE(same(other.weights[0], first[0]));
  }

  TEST_CASE("a joint stage that changes no weight is an error") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    config.joint.lr = config.joint.lr_end = 0;
    Traced run(config, data, "joint");
    CHECK(contains(
        test::message<NumericalError>([&] { train(run.model, data, config, run.options); }),
        "changed no weight in 4 steps"));
    config.joint.lr = 1e-4;
    CHECK_NOTHROW(train(run.model, data, config, run.options));
  }

  TEST_CASE("the better weights are kept: those before, in between or after") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    {
      config.integrate.lr = config.integrate.lr_end = 10;  // breaks what the closed form gave
      Traced run(config, data, "integration");
      const auto report = train(run.model, data, config, run.options).stages.at(0);
      CHECK(report.rmse_after > report.rmse_before);
      CHECK(report.kept == 0);
      CHECK(report.rmse_kept == report.rmse_before);
      CHECK(report.change == 0);
      CHECK(report.change_end > 0.1);
      const auto now = run.now();
      for (std::size_t k = 0; k + 2 < now.size(); ++k) CHECK(same_bits(now[k], run.before[k]));
    }
    {
      config.constitutive.iterations = 300;
      config.constitutive.lr = config.constitutive.lr_end = 3e-3;
      Traced run(config, data, "constitutive");
      const auto report = train(run.model, data, config, run.options).stages.at(0);
      CHECK(report.kept == 300);
      CHECK(report.rmse_kept == report.rmse_after);
      CHECK(report.rmse_after < report.rmse_before);
      CHECK(report.change == report.change_end);
      CHECK(same(run.now(), run.weights.back()));
    }
    {
      config.constitutive.lr_end = 5;  // good at first, then broken
      config.constitutive.select_every = 50;
      Traced run(config, data, "constitutive");
      const auto report = train(run.model, data, config, run.options).stages.at(0);
      CHECK(report.kept > 0);
      CHECK(report.kept < 300);
      CHECK(report.kept % 50 == 0);
      CHECK(report.rmse_kept < std::min(report.rmse_before, report.rmse_after));
      CHECK(same(run.now(), run.weights[static_cast<std::size_t>(report.kept) - 1]));
    }
  }

  TEST_CASE("metrics are JSON lines: the fit, every step, every stage") {
    const Dataset& data = test::tiny_dataset();
    const TrainConfig config = tiny_config();
    Traced run(config, data);
    train(run.model, data, config, run.options);
    std::map<std::string, int> count;
    std::size_t step = 0;
    for (const Json& line : parse_lines(run.metrics.str())) {
      const std::string event = line.at("event");
      ++count[event];
      if (event == "fit") {
        CHECK(line.at("alpha") == run.model.info.affine_alpha);
        CHECK(line.at("b").at(2) == run.model.info.affine_b[2]);
      } else if (event == "step") {
        const TrainEvent& shown = run.events.at(step++);
        CHECK(line.at("stage") == shown.stage);
        CHECK(line.at("iteration") == shown.iteration);
        CHECK(line.at("iterations") == shown.iterations);
        CHECK(line.at("loss") == shown.loss);
        CHECK(line.at("lr") == shown.learning_rate);
        CHECK(line.at("grad_norm") == shown.gradient_norm);
      } else {
        for (const char* key : {"stage", "pairing", "iterations", "planned", "rmse_before",
                                "rmse_after", "kept", "rmse_kept", "change", "change_end"})
          CHECK(line.contains(key));
      }
    }
    CHECK(count == std::map<std::string, int>{{"fit", 1}, {"step", 44}, {"stage", 3}});
    CHECK(run.events[0].learning_rate == config.constitutive.lr);
    CHECK(run.events[19].learning_rate == config.constitutive.lr_end);
  }

  TEST_CASE("stops when asked to, with the schedule of the whole run") {
    const Dataset& data = test::tiny_dataset();
    const TrainConfig config = tiny_config();
    Traced whole(config, data), run(config, data);
    train(whole.model, data, config, whole.options);
    run.options.stop = [&] { return run.events.size() >= 27; };
    const TrainResult result = train(run.model, data, config, run.options);
    CHECK_FALSE(result.complete);
    REQUIRE(result.stages.size() == 2);
    CHECK(result.stages[1].iterations == 7);
    CHECK(result.stages[1].planned == 20);
    CHECK(run.model.info.state == "integration (stopped early)");
    for (std::size_t k = 0; k < 27; ++k) {
      CHECK(run.events[k].learning_rate == whole.events[k].learning_rate);
      CHECK(same(run.weights[k], whole.weights[k]));
    }
    Traced no_time(config, data);
    no_time.options.max_minutes = 1e-9;
    CHECK_FALSE(train(no_time.model, data, config, no_time.options).complete);
    CHECK(no_time.events.empty());
  }

  TEST_CASE("refuses what it cannot train, with the reason") {
    const Dataset& data = test::tiny_dataset();
    TrainConfig config = tiny_config();
    Traced run(config, data);
    TrainOptions options;
    options.stage = "both";
    CHECK_THROWS_AS(train(run.model, data, config, options), std::invalid_argument);

    config.select = 2;
    CHECK(contains(test::message<ConfigError>([&] { train(run.model, data, config); }),
                   "select = 2 sets aside all 2"));
    config = tiny_config();
    config.integrate.window_end = 61;
    options.stage = "integration";
    CHECK(contains(test::message<InputError>([&] { train(run.model, data, config, options); }),
                   "fewer than the longest window of 61"));

    const test::Folder folder, empty;
    auto recording = test::read_recording(data);
    recording.law_known = false;
    const Dataset unknown = test::write_dataset(folder.path(), recording);
    config = tiny_config();
    for (const std::string stage : {"constitutive", "integration"}) {
      options.stage = stage;
      CHECK(
          contains(test::message<ConfigError>([&] { train(run.model, unknown, config, options); }),
                   "known"));
    }
    options.stage = "joint";
    CHECK_NOTHROW(train(run.model, unknown, config, options));
    recording.train.clear();
    CHECK(contains(test::message<InputError>(
                       [&] { make_model(config, test::write_dataset(empty.path(), recording)); }),
                   "no training trajectory"));
  }
}
