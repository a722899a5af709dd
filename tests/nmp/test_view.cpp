#include "nmp/view.h"

#include <algorithm>
#include <cmath>

#include "fem/cases.h"
#include "nmp/folder.h"
#include "nmp/motion_recorder.h"
#include "nmp/recorded.h"
#include "nmp/replay.h"
#include "nmp/trainer.h"
#include "nmp/trajectory_file.h"
#include "nmp/view_sources.h"

using namespace nmp;
using test::contains;
using test::message;

namespace {

// A dataset of two and two trajectories, a model that falls but has no stress, a rollout.
struct Project {
  test::Folder folder;
  Path data = folder / "data", model = folder / "m.safetensors", run = folder / "run.safetensors";
  Project() {
    generate_dataset(test::tiny_scene(), data);
    TrainConfig config;
    config.stress.hidden = {8, 8};
    config.integration.embedding = config.integration.hidden = 4;
    config.integration.alignment_widths = {4, 4};
    Model<float> made = make_model(config, Dataset::open(data));
    made.integration.set_affine(1e-3, {0, 0, -9.8});
    made.stress.set_scales(1e-3, 0.1);
    save_model(model, made);
    ReplayOptions options = analytic();
    options.output = run;
    replay(options);
  }
  ReplayOptions analytic() const {
    ReplayOptions options;
    options.dataset = data;
    options.constitutive = "neo-hookean";
    options.integrator = "semi-implicit";
    return options;
  }
  ViewOptions view_of(const std::vector<std::string>& sources,
                      const std::vector<std::string>& methods = {}) const {
    ViewOptions options;
    options.data = data;
    options.sources = sources;
    options.methods = methods;
    return options;
  }
};

std::vector<std::string> labels(const PlayerTrack& track) {
  std::vector<std::string> names;
  for (const PlayerMotion& motion : track.motions) names.push_back(motion.label);
  return names;
}

}  // namespace

TEST_SUITE("nmp/view_sources") {
  TEST_CASE("a source is a file, a dataset or a record, with a label or without") {
    test::Folder folder;
    const std::string file = folder / "run.safetensors", data = folder / "data";
    test::put(file, "");
    std::filesystem::create_directory(data);
    test::put(folder / "a=b", "");
    const ViewSource plain = parse_view_source(file);
    CHECK_FALSE(plain.dataset);
    CHECK(plain.label == "run");
    CHECK(plain.path == file);
    CHECK(parse_view_source("mine=" + file).label == "mine");
    CHECK(parse_view_source("mine=" + file).path == file);
    CHECK(parse_view_source(folder / "a=b").label == "a=b");  // a path that exists has no label
    CHECK(parse_view_source(data + "/").label == "data");
    CHECK(parse_view_source(data + "/").record.empty());
    const ViewSource record = parse_view_source(data + ":val/001");
    CHECK(record.dataset);
    CHECK(record.path == data);
    CHECK(record.record == "val/001");
    CHECK(record.label == "data val/001");
    CHECK(contains(message<IoError>([&] { parse_view_source(folder / "none"); }), "no such"));
    CHECK_THROWS_AS(parse_view_source(file + ":val/000"), IoError);
    CHECK_THROWS_AS(parse_view_source("=" + file), ConfigError);
    CHECK_THROWS_AS(parse_view_source(std::string(61, 'x') + "=" + file), ConfigError);
  }

  TEST_CASE("a method is a law and an integrator, each learned or analytic") {
    test::Folder folder;
    const std::string other = folder / "old.safetensors";
    test::put(other, "");
    const ViewMethod both = parse_view_method("neural", "m");
    CHECK(both.constitutive == "neural");
    CHECK(both.integrator == "neural");
    CHECK(both.model == "m");
    CHECK(both.label == "neural");
    const ViewMethod law = parse_view_method("stvk", "m");
    CHECK(law.constitutive == "stvk");
    CHECK(law.integrator == "semi-implicit");
    CHECK(law.model.empty());
    const ViewMethod pair = parse_view_method("soft=stvk+neural", "m");
    CHECK(pair.label == "soft");
    CHECK(pair.constitutive == "stvk");
    CHECK(pair.integrator == "neural");
    CHECK(pair.model == "m");
    CHECK(parse_view_method("stvk+neural", "m").label == "stvk + neural");
    const ViewMethod from_file = parse_view_method(other, "m");
    CHECK(from_file.model == other);
    CHECK(from_file.label == "old");
    CHECK(from_file.integrator == "neural");
    CHECK(parse_view_method("neo-hookean+" + other, "").model == other);
    CHECK(contains(message<ConfigError>([] { parse_view_method("neural", ""); }), "--model"));
    CHECK(contains(message<ConfigError>([] { parse_view_method("nerual", "m"); }), "stvk"));
    CHECK(contains(message<ConfigError>([] { parse_view_method("stvk+euler", "m"); }),
                   "semi-implicit"));
    CHECK(contains(message<ConfigError>([&] { parse_view_method("neural+" + other, "m"); }),
                   "one model"));
  }
}

TEST_SUITE("nmp/motion_recorder") {
  TEST_CASE("a reference is exact at its frames and smooth between them") {
    const auto mesh = fem::cube_mesh(3, 1.0);
    test::Folder folder;
    test::Record record;
    const double h = 5e-4;
    const Matrix<double> x0 = mesh.vertices(), v0 = fem::random_matrix(27, 3, 1),
                         a = 1e3 * fem::random_matrix(27, 3, 2);
    const auto x_at = [&](double t) { return Matrix<double>(x0 + t * v0 + t * t / 2 * a); };
    for (int k = 0; k <= 3; ++k) record.add(x_at(k * h), v0 + k * h * a, 0 * x0);
    test::write_record(folder / "r", record);
    const TrajectoryFile file = open_trajectory(folder / "r", 27);
    CHECK(file.h == h);
    CHECK(file.trajectory.frames() == 3);
    const Reference reference(file.trajectory, h);
    Matrix<double> x(27, 3);
    REQUIRE(reference.at(2 * h * (1 + 1e-9), x));
    CHECK(x == file.trajectory.state<double>(2).x);
    for (const double t : {0.3 * h, 1.5 * h, 2.9 * h}) {  // a parabola: the cubic is exact
      REQUIRE(reference.at(t, x));
      CHECK((x - x_at(t)).cwiseAbs().maxCoeff() < 2e-7);  // of float; straight lines: 3e-5
    }
    CHECK_FALSE(reference.at(3.1 * h, x));
    CHECK_FALSE(reference.at(-0.1 * h, x));
  }

  TEST_CASE("keeps every so many frames and the last; refuses what is not finite") {
    const auto mesh = fem::cube_mesh(3, 1.0);
    PlayerBody body;
    body.surface = fem::extract_surface(mesh.tets());
    const auto recorder = [&](Index stride) {
      return MotionRecorder({"run", 0, &body, &mesh, 1e-3, stride, {}, nullptr});
    };
    MotionRecorder some = recorder(3);
    CHECK_THROWS_AS(recorder(3).finish(), std::invalid_argument);
    CHECK_THROWS_AS(recorder(0), std::invalid_argument);
    Matrix<double> x = mesh.vertices();
    for (Index t = 0; t <= 4; ++t) {
      x.array() += 1;
      some.add(t, x, x);
    }
    CHECK_THROWS_AS(some.add(7, x, x), std::invalid_argument);
    x(2, 1) = std::nan("");
    CHECK(contains(message<InputError>([&] { some.add(5, x, mesh.vertices()); }), "run: frame 5"));
    const PlayerMotion motion = some.finish(true);
    CHECK(motion.diverged);
    REQUIRE(motion.frames.size() == 3);
    CHECK(motion.frames[1].t == 3);
    CHECK(motion.frames[2].t == 4);
    CHECK(motion.frames[2].x(0, 0) == mesh.vertices()(0, 0) + 5);
    CHECK(motion.frames[2].error.size() == 0);
  }
}

TEST_SUITE("nmp/view") {
  TEST_CASE("shows the record, files and methods in that order, with errors from the record") {
    const Project project;
    ViewOptions options =
        project.view_of({"mine=" + project.run.string()}, {"neo-hookean", "neural", "stvk+neural"});
    options.model = project.model;
    std::vector<std::string> warnings;
    options.warn = [&](const std::string& what) { warnings.push_back(what); };
    double part = 0;
    options.progress = [&](double p, const std::string&) {
      CHECK(p >= part);
      part = p;
    };
    const PlayerDocument document = view(options);
    CHECK(part == doctest::Approx(1));
    CHECK(document.name == "tiny");
    CHECK(document.bodies.size() == 1);
    CHECK(contains(document.bodies[0].stress_law, "neo-hookean"));
    REQUIRE(document.tracks.size() == 1);
    const PlayerTrack& track = document.tracks[0];
    CHECK(track.name == "val/000.safetensors");
    CHECK(labels(track) ==
          std::vector<std::string>{"recorded", "mine", "neo-hookean", "neural", "stvk + neural"});
    CHECK(track.motions[0].frames.size() == 61);
    CHECK(track.motions[0].frames[60].error.size() == 0);
    CHECK(track.motions[0].frames[60].stress.maxCoeff() > 1e2);
    // The file is that rollout: the same frames but for its floats.
    const Replay replayed = replay(project.analytic());
    const PlayerMotion &file = track.motions[1], &method = track.motions[2];
    CHECK(method.frames[60].rmse == replayed.rmse[60]);
    CHECK((file.frames[60].x - method.frames[60].x).cwiseAbs().maxCoeff() < 1e-6);
    CHECK(file.frames[60].rmse == doctest::Approx(replayed.rmse[60]).epsilon(1e-2));
    CHECK(file.h == doctest::Approx(5e-4));
    // Without stress the body falls through what holds the others up.
    CHECK(track.motions[3].frames[60].rmse > 1.5 * method.frames[60].rmse);
    CHECK_FALSE(to_json(document).empty());
  }

  TEST_CASE("without sources and methods: the record, and what the model makes of it") {
    const Project project;
    ViewOptions options = project.view_of({});
    CHECK(labels(view(options).tracks[0]) == std::vector<std::string>{"recorded"});
    options.model = project.model;
    options.trajectories = {1, 0};
    options.train_split = true;
    options.frames = 25;
    const PlayerDocument document = view(options);
    REQUIRE(document.tracks.size() == 2);
    CHECK(document.tracks[0].name == "train/001.safetensors");
    CHECK(labels(document.tracks[1]) == std::vector<std::string>{"recorded", "neural"});
    for (const PlayerMotion& motion : document.tracks[1].motions)
      CHECK(motion.frames.back().t == 25);
  }

  TEST_CASE("records of several datasets are synchronised by time; other meshes have no errors") {
    const Project project;
    Scene scene = test::tiny_scene();  // the same throws, frames twice as far apart, for longer
    scene.substeps = 40;
    scene.frames = 40;
    generate_dataset(scene, project.folder / "slow");
    scene.vertices_per_edge = 4;
    generate_dataset(scene, project.folder / "fine");
    ViewOptions options;
    options.sources = {project.data.string(), "slow=" + (project.folder / "slow").string(),
                       (project.folder / "fine").string() + ":train/001"};
    PlayerDocument document = view(options);
    REQUIRE(document.bodies.size() == 3);
    const std::vector<PlayerMotion>& motions = document.tracks[0].motions;
    REQUIRE(motions.size() == 3);
    CHECK(motions[2].label == "fine train/001");
    CHECK(motions[1].h == doctest::Approx(1e-3));
    // The slow one's frame 15 is the first one's frame 30, made with the same small steps.
    CHECK(motions[1].frames[15].rmse < 1e-6);
    CHECK(motions[1].frames[30].error.size() > 0);
    CHECK(motions[1].frames[31].error.size() == 0);  // the first one has ended
    for (const PlayerFrame& frame : motions[2].frames) CHECK(frame.error.size() == 0);
    options.frames = 20;  // of the first
    document = view(options);
    CHECK(document.tracks[0].motions[0].frames.back().t == 20);
    CHECK(document.tracks[0].motions[1].frames.back().t == 10);
    CHECK_FALSE(to_json(document).empty());
  }

  TEST_CASE("the budget spreads frames evenly over all motions") {
    const Project project;
    ViewOptions options = project.view_of({}, {"neo-hookean"});
    options.budget = 30e3;
    const PlayerDocument document = view(options);
    const std::vector<PlayerMotion>& motions = document.tracks[0].motions;
    CHECK(to_json(document).size() <= 30000);
    CHECK(motions[0].frames[1].t > 1);
    CHECK(motions[0].frames[1].t == motions[1].frames[1].t);
    CHECK(motions[1].frames.back().t == 60);
    options.budget = 1000;
    CHECK_THROWS_AS(view(options), ConfigError);
  }

  TEST_CASE("stresses are those of the law that is asked for") {
    const Project project;
    ViewOptions options = project.view_of({});
    const auto largest = [&](const std::string& law) {
      options.stress = law;
      const PlayerFrame frame = view(options).tracks[0].motions[0].frames[60];
      return frame.stress.size() > 0 ? frame.stress.maxCoeff() : -1;
    };
    CHECK(largest("none") == -1);
    CHECK(largest("dataset") == largest("neo-hookean"));
    CHECK(largest("stvk") != largest("neo-hookean"));
    CHECK(contains(message<ConfigError>([&] { largest("neural"); }), "--model"));
    options.model = project.model;
    CHECK(largest("neural") < 1e-2 * largest("stvk"));
  }

  TEST_CASE("a method that diverges ends there, and says so") {
    const Project project;
    Model<float> model = load_model<float>(project.model);
    model.stress.set_scales(1e39, 0.1);
    model.integration.set_affine(1e-3, {0, 0, -9.8});
    save_model(project.folder / "wild", model);
    ViewOptions options = project.view_of({}, {"wild=" + (project.folder / "wild").string()});
    std::string warning;
    options.warn = [&](const std::string& what) { warning = what; };
    const PlayerMotion motion = view(options).tracks[0].motions[1];
    CHECK(motion.diverged);
    CHECK(motion.frames.back().t < 60);
    CHECK(contains(warning, "wild: diverged after frame"));
  }

  TEST_CASE("warns of a file that starts elsewhere") {
    const Project project;
    ViewOptions options = project.view_of({project.run.string()});
    std::string warning;
    options.warn = [&](const std::string& what) { warning = what; };
    view(options);
    CHECK(warning.empty());
    options.sources.push_back(project.data.string() + ":val/001");  // another one, of course
    view(options);
    CHECK(warning.empty());
    options.trajectories = {1};
    view(options);
    CHECK(contains(warning, "run does not start where recorded does"));
  }

  TEST_CASE("refuses what does not fit together") {
    const Project project;
    const auto refusal = [](const ViewOptions& options) {
      return message<ConfigError>([&] { view(options); });
    };
    ViewOptions nothing;
    CHECK(contains(refusal(nothing), "nothing to show"));
    ViewOptions file;
    file.sources = {project.run.string()};
    CHECK(contains(refusal(file), "--data"));
    ViewOptions method;
    method.sources = {project.data.string()};
    method.methods = {"stvk"};
    CHECK(contains(refusal(method), "--data"));
    ViewOptions several = project.view_of({project.run.string()});
    several.trajectories = {0, 1};
    CHECK(contains(refusal(several), "--trajectory takes one"));
    ViewOptions beyond = project.view_of({});
    beyond.trajectories = {2};
    CHECK(contains(refusal(beyond), "counted from 0"));
    CHECK(contains(refusal(project.view_of({project.data.string() + ":val/9"})),
                   "no record 'val/9'"));

    Scene scene = test::tiny_scene();
    scene.vertices_per_edge = 4;
    generate_dataset(scene, project.folder / "fine");
    ViewOptions wrong = project.view_of({project.run.string()});
    wrong.data = project.folder / "fine";
    CHECK(contains(message<InputError>([&] { view(wrong); }), "run.safetensors"));
  }
}
