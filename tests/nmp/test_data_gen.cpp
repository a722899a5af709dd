#include "nmp/data_gen.h"

#include <doctest/doctest.h>

#include <map>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/mesh_fixtures.h"
#include "fem/projective_dynamics.h"
#include "fem/simulator.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;
using test::get;
using test::put;
namespace fs = std::filesystem;

namespace {

Scene tiny_scene() {
  Scene scene;
  scene.name = "tiny";
  scene.vertices_per_edge = 3;
  scene.clearance = 1e-4;  // so that the ground is touched
  scene.v_min = scene.v_max = {1, 0, -2};
  scene.substeps = 20;
  scene.frames = 5;
  scene.train = 2;
  scene.validation = 1;
  return scene;
}

// Every file of a folder with its content.
std::map<std::string, std::string> content(const Path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) {
      files[fs::relative(entry.path(), folder).string()] = get(entry.path());
    }
  }
  return files;
}

}  // namespace

TEST_SUITE("nmp/data_gen") {
  TEST_CASE("records what the reference simulator computes") {
    const test::Folder folder;
    const Scene scene = tiny_scene();
    double last = 0;
    int calls = 0;
    DataGenOptions options;
    options.progress = [&](double part) {
      CHECK(part > last);
      last = part;
      ++calls;
    };
    options.warn = [](const std::string& message) { FAIL_CHECK(message); };
    const Manifest made = generate_dataset(scene, folder / "data", options);
    CHECK(calls == 5);
    CHECK(last == doctest::Approx(1));

    const Dataset data = Dataset::open(folder / "data");
    CHECK_NOTHROW(data.verify());
    CHECK(data.manifest().scene_name == "tiny");
    CHECK(to_toml(parse_scene(data.manifest().scene_toml, "manifest")) == to_toml(scene));
    CHECK(data.manifest().train[1].checksum == made.train[1].checksum);
    CHECK(data.manifest().train[1].seed == trajectory_seed(scene, "train", 1));
    REQUIRE(data.train().size() == 2);
    REQUIRE(data.validation().size() == 1);
    bool touched = false;
    const auto compare = [&](const Trajectory& trajectory, const char* split, Index index) {
      fem::State<double> state =
          initial_state(scene, data.mesh(), data.mesh().vertices(), split, index);
      const fem::State<float> first = trajectory.state<float>(0);
      CHECK(first.x == state.x.cast<float>());
      CHECK(first.v == state.v.cast<float>());
      fem::Simulator<double> simulator(data.mesh(), scene.physics, scene.dt);
      for (Index t = 0; t <= scene.frames; ++t) {
        if (t > 0) simulator.advance(state, scene.substeps);
        const fem::State<double> recorded = trajectory.state<double>(t);
        Matrix<double> f_int(27, 3);
        trajectory.read_force<double>(t, f_int);
        const Matrix<double> expected = simulator.internal_force(state.x);
        CHECK((recorded.x - state.x).cwiseAbs().maxCoeff() < 2e-7);  // half an ulp of 2
        CHECK((recorded.v - state.v).cwiseAbs().maxCoeff() < 1e-6);
        CHECK((f_int - expected).cwiseAbs().maxCoeff() <=
              1e-6 * (1e-3 + expected.cwiseAbs().maxCoeff()));
        touched = touched || expected.cwiseAbs().maxCoeff() > 1;
      }
    };
    compare(data.train()[0], "train", 0);
    compare(data.train()[1], "train", 1);
    compare(data.validation()[0], "val", 0);
    CHECK(touched);
  }

  TEST_CASE("a scene with friction is made by projective dynamics, for any number of threads") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    scene.physics.material.law = "projective";
    scene.physics.contact.law = "coulomb";
    scene.physics.contact.friction = 0.5;
    scene.dt = 1e-3;
    scene.substeps = 2;
    DataGenOptions options;
    std::string warnings;
    options.warn = [&](const std::string& message) { warnings += message; };
    generate_dataset(scene, folder / "data", options);
    set_threads(3);
    generate_dataset(scene, folder / "again", options);
    set_threads(0);
    CHECK(content(folder / "data") == content(folder / "again"));
    CHECK_FALSE(contains(warnings, "not solved"));

    const Dataset data = Dataset::open(folder / "data");
    CHECK(data.manifest().physics.contact.friction == 0.5);
    fem::ProjectiveDynamics simulator(data.mesh(), scene.physics, scene.dt);
    fem::State<double> state =
        initial_state(scene, data.mesh(), data.mesh().vertices(), "train", 1);
    const double v = state.v(0, 0);
    Matrix<double> f_int(27, 3);
    for (Index t = 0; t <= scene.frames; ++t) {
      if (t > 0) simulator.advance(state, scene.substeps);
      const fem::State<double> recorded = data.train()[1].state<double>(t);
      data.train()[1].read_force<double>(t, f_int);
      const Matrix<double> wanted = simulator.internal_force(state.x);
      CHECK((recorded.x - state.x).cwiseAbs().maxCoeff() < 2e-7);
      CHECK((f_int - wanted).cwiseAbs().maxCoeff() <= 1e-6 * (1 + wanted.cwiseAbs().maxCoeff()));
    }
    REQUIRE(data.train()[1].info().slide);
    CHECK(data.train()[1].info().slide->path > 0.5 * scene.h() * 5);
    CHECK_FALSE(data.train()[1].info().slide->at_rest);
    CHECK(v == 1);
    CHECK(state.v.col(0).mean() < 0.99);  // the ground has braked it
  }

  TEST_CASE("a run that is continued gives the same bytes") {
    const test::Folder folder;
    const Scene scene = tiny_scene();
    const Path data = folder / "data";
    generate_dataset(scene, data);
    const auto whole = content(data);
    CHECK(whole.size() == 6);

    fs::remove(data / "train/001.safetensors");
    fs::remove(data / "manifest.json");
    generate_dataset(scene, data);
    CHECK(content(data) == whole);

    // Damage is found by the manifest's checksum, a cut file without it.
    std::string flipped = whole.at("val/000.safetensors");
    flipped.back() = static_cast<char>(flipped.back() ^ 1);
    put(data / "val/000.safetensors", flipped);
    put(data / "train/000.safetensors", flipped.substr(0, 1000));
    std::vector<std::string> warnings;
    DataGenOptions options;
    options.warn = [&](const std::string& message) { warnings.push_back(message); };
    generate_dataset(scene, data, options);
    CHECK(content(data) == whole);
    CHECK(warnings.size() == 2);

    // Nothing to do: nothing is simulated.
    options.progress = [](double) { FAIL_CHECK("simulated again"); };
    generate_dataset(scene, data, options);
    CHECK(content(data) == whole);

    // A manifest that cannot be read is made again.
    put(data / "manifest.json", "{");
    generate_dataset(scene, data, options);
    CHECK(content(data) == whole);
  }

  TEST_CASE("the bytes of a trajectory do not depend on how many are made beside it") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    generate_dataset(scene, folder / "few");
    scene.train = 9;  // more than a group
    generate_dataset(scene, folder / "many");
    const Dataset few = Dataset::open(folder / "few"), many = Dataset::open(folder / "many");
    REQUIRE(many.train().size() == 9);
    for (Index t = 0; t <= scene.frames; ++t) {
      CHECK(few.train()[1].state<float>(t).x == many.train()[1].state<float>(t).x);
      CHECK(few.validation()[0].state<float>(t).v == many.validation()[0].state<float>(t).v);
    }
  }

  TEST_CASE("a run that is stopped keeps what is complete and has no manifest") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    scene.train = 9;
    generate_dataset(scene, folder / "whole");
    set_threads(1);  // groups of 8
    int frames = 0;
    DataGenOptions options;
    options.stop = [&] { return ++frames == 7; };  // in the second group
    const Manifest part = generate_dataset(scene, folder / "data", options);
    set_threads(0);
    CHECK(part.train.size() == 8);
    CHECK(part.validation.empty());
    CHECK_FALSE(fs::exists(folder / "data/manifest.json"));
    CHECK_FALSE(fs::exists(folder / "data/train/008.safetensors"));
    generate_dataset(scene, folder / "data");
    CHECK(content(folder / "data") == content(folder / "whole"));
  }

  TEST_CASE("two runs do not write the same folder (CK7)") {
    const test::Folder folder;
    const Scene scene = tiny_scene();
    std::string said;
    DataGenOptions options;
    options.progress = [&](double) {
      if (said.empty())
        said = test::message<IoError>([&] { generate_dataset(scene, folder / "data"); });
    };
    generate_dataset(scene, folder / "data", options);
    CHECK(contains(said, "another process is writing it"));
    CHECK_NOTHROW(Dataset::open(folder / "data").verify());
  }

  TEST_CASE("a folder of another scene is refused, and replaced by force") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    const Path data = folder / "data";
    generate_dataset(scene, data);
    const auto before = content(data);
    put(data / "notes.txt", "mine");
    scene.train = 1;
    scene.physics.material.E = 4e5;
    CHECK(contains(test::message<ConfigError>([&] { generate_dataset(scene, data); }),
                   "holds data of another scene"));
    CHECK(get(data / "manifest.json") == before.at("manifest.json"));

    DataGenOptions options;
    options.force = true;
    generate_dataset(scene, data, options);
    CHECK(Dataset::open(data).manifest().physics.material.E == 4e5);
    CHECK_FALSE(fs::exists(data / "train/001.safetensors"));
    CHECK(get(data / "notes.txt") == "mine");
    CHECK(get(data / "train/000.safetensors") != before.at("train/000.safetensors"));

    const test::Folder foreign;
    put(foreign / "thesis.txt", "years of work");
    CHECK(contains(test::message<ConfigError>([&] { generate_dataset(scene, foreign.path()); }),
                   "files that are no dataset"));
    CHECK(content(foreign.path()).size() == 1);
  }

  TEST_CASE("warns of a step near the stability limit before the first step") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    scene.dt = 1;
    scene.substeps = 1;
    bool started = false;
    std::vector<std::string> warnings;
    DataGenOptions options;
    options.progress = [&](double) { started = true; };
    options.warn = [&](const std::string& message) {
      CHECK_FALSE(started);
      warnings.push_back(message);
    };
    const std::string error =
        test::message<NumericalError>([&] { generate_dataset(scene, folder / "data", options); });
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "above 0.9 of the stability limit"));
    CHECK(contains(warnings[0], "; try --set time.dt="));
    CHECK(contains(error, "train/000.safetensors to val/000.safetensors"));
    CHECK_FALSE(fs::exists(folder / "data/manifest.json"));
    CHECK(fs::is_empty(folder / "data/train"));
  }

  TEST_CASE("says what the time between frames means for learned modules") {
    const test::Folder folder;
    const Path mesh = folder / "two.msh";
    put(mesh, test::kGmsh2);
    const auto warnings = [&](const std::string& more) {
      Scene scene =
          parse_scene("[contact]\nground = \"none\"\n[mesh]\nfile = \"" + mesh.string() +
                          "\"\n[dataset]\ntrain = 1\nvalidation = 1\n[time]\nframes = 2\n" + more,
                      "a.toml");
      std::vector<std::string> said;
      DataGenOptions options;
      options.warn = [&](const std::string& message) {
        if (message.rfind("time", 0) == 0) said.push_back(message);
      };
      options.force = true;
      generate_dataset(scene, folder / "data", options);
      return said;
    };
    CHECK(warnings("").empty());
    std::vector<std::string> said = warnings("[material]\nE = 5e8\n");
    REQUIRE(said.size() == 1);
    CHECK(contains(said[0], "half the stability limit of this mesh and material"));
    CHECK(contains(said[0], "the 2 frames cover"));
    said = warnings("dt = 1e-5\nsubsteps = 100\n[material]\nE = 5e8\n");
    REQUIRE(said.size() == 1);
    CHECK(contains(said[0], "the data will be fine"));
    CHECK(contains(said[0], "try --set time.dt="));
  }

  TEST_CASE("a mesh file: warnings, its checksum in the scene, no need of it afterwards") {
    const test::Folder folder;
    const Path mesh = folder / "two.msh", data = folder / "data";
    put(mesh, test::kGmsh2);
    Scene scene = tiny_scene();
    scene.shape = "file";
    scene.mesh_file = mesh.string();
    scene.physics.ground.reset();
    scene.clearance.reset();
    scene.random_orientation = false;
    scene.pins.planes.resize(1, 4);
    scene.pins.planes << 0, 0, -1, 0;  // z <= 0: vertices 0, 1, 2
    std::vector<std::string> warnings;
    DataGenOptions options;
    options.warn = [&](const std::string& message) { warnings.push_back(message); };
    generate_dataset(scene, data, options);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], "two.msh: 2 surface, line and point cells are left out"));
    const std::string toml = get(data / "scene.toml");
    CHECK(contains(toml, "file = \"two.msh\""));
    CHECK(contains(toml, "checksum = \"" + hash_file(mesh) + "\""));
    CHECK(contains(toml, "vertices = []"));
    const auto whole = content(data);

    // The same file elsewhere is the same mesh; a run goes on.
    fs::create_directory(folder / "other");
    fs::rename(mesh, folder / "other/two.msh");
    scene.mesh_file = "two.msh";
    scene.mesh_folders = {folder.path(), folder / "other"};
    fs::remove(data / "train/001.safetensors");
    generate_dataset(scene, data);
    CHECK(content(data) == whole);

    // Another mesh is not.
    put(mesh, std::string(test::kGmsh2) + "\n");
    const std::string why = test::message<ConfigError>([&] { generate_dataset(scene, data); });
    CHECK(contains(why, "holds data of another mesh: two.msh with the checksum"));
    CHECK(contains(why, "--force"));
    CHECK(content(data) == whole);

    // Reading needs no mesh file.
    fs::remove_all(folder / "other");
    fs::remove(mesh);
    const Dataset dataset = Dataset::open(data);
    CHECK_NOTHROW(dataset.verify());
    CHECK(dataset.mesh().n_tets() == 2);
    CHECK(dataset.manifest().physics.pinned == std::vector<int>{0, 1, 2});
    const Scene read = parse_scene(dataset.manifest().scene_toml, "manifest");
    CHECK(to_toml(read) == toml);
    CHECK(dataset.train()[0].state<float>(5).x.topRows(3) ==
          dataset.mesh().vertices().topRows(3).cast<float>());
    CHECK(
        contains(test::message<ConfigError>([&] { generate_dataset(read, data); }), "NMP_MESHES"));
  }

  TEST_CASE("elements inside out are warned of once, where the law lets them be") {
    const test::Folder folder;
    Scene scene = tiny_scene();  // so soft that it falls into itself
    scene.physics.material = {"stvk", 1e3, 0.4, 1000};
    scene.dt = 1e-4;
    scene.frames = 12;
    scene.v_min = {0, 0, -30};
    scene.v_max = {0, 0, -30};
    scene.random_orientation = false;
    std::vector<std::string> warnings;
    DataGenOptions options;
    options.warn = [&](const std::string& message) { warnings.push_back(message); };
    generate_dataset(scene, folder / "data", options);
    REQUIRE(warnings.size() == 1);
    CHECK(contains(warnings[0], ".safetensors, frame "));
    CHECK(contains(warnings[0], "elements are inside out, det F <= 0, the first is "));
  }

  TEST_CASE("pinned bodies keep their pins") {
    const test::Folder folder;
    Scene scene = tiny_scene();
    scene.physics.pinned = {0, 26};
    scene.physics.ground.reset();
    generate_dataset(scene, folder / "data");
    const Dataset data = Dataset::open(folder / "data");
    CHECK(data.manifest().physics.pinned == std::vector<int>{0, 26});
    const fem::State<float> last = data.train()[0].state<float>(scene.frames);
    for (const Index vertex : {0, 26}) {
      CHECK(last.x.row(vertex) == data.mesh().vertices().row(vertex).cast<float>());
      CHECK(last.v.row(vertex).isZero(0));
    }
    CHECK_FALSE(last.v.row(13).isZero(0));
  }
}
