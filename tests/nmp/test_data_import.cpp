#include "nmp/data_import.h"

#include <cmath>

#include "fem/pvd.h"
#include "fem/vtu_writer.h"
#include "nmp/export.h"
#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::get;
using test::put;
namespace fs = std::filesystem;

namespace {

ImportOptions options_of(const std::vector<Path>& train) {
  ImportOptions options;
  options.train = train;
  options.scene.physics.ground.reset();
  return options;
}

// Writes frames as points.
void write_series(const Path& folder, const fem::Tets& tets, const std::vector<Matrix<double>>& x,
                  const std::vector<double>& times) {
  fs::create_directories(folder / "frames");
  std::vector<fem::PvdEntry> entries;
  for (std::size_t k = 0; k < x.size(); ++k) {
    entries.push_back({times[k], "frames/" + std::to_string(k) + ".vtu"});
    put(folder / entries.back().file, fem::to_vtu({x[k], tets, {}, {}}, {true, false, false}));
  }
  put(folder / "run.pvd", fem::to_pvd(entries));
}

// A cube that is stretched and moves with a polynomial of time of degree 3.
Matrix<double> moved(const Matrix<double>& X, double t) {
  Matrix<double> x = (1 + 0.1 * t + 0.2 * t * t) * X;
  x.col(0).array() += 2 * t - t * t * t;
  return x;
}

double worst(const Trajectory& a, const std::function<Matrix<double>(Index)>& wanted) {
  double error = 0;
  for (Index t = 0; t <= a.frames(); ++t)
    error = std::max(error, (a.state<double>(t).x - wanted(t)).cwiseAbs().maxCoeff());
  return error;
}

}  // namespace

TEST_SUITE("nmp/data_import") {
  TEST_CASE("what was exported comes back to the last bit") {
    const Dataset& data = test::tiny_dataset(12);
    const test::Folder folder;
    for (const bool zlib : {false, true}) {
      CAPTURE(zlib);
      ExportOptions to;
      to.zlib = zlib;
      to.force = true;
      ImportOptions options = options_of({});
      options.force = true;
      for (const bool train : {true, false}) {
        const auto& records = train ? data.train() : data.validation();
        for (std::size_t i = 0; i < records.size(); ++i) {
          const Path out = folder / ((train ? "t" : "v") + std::to_string(i));
          export_frames({data.mesh(), {1, 5}, &records[i], data.manifest().h, nullptr, {}}, out,
                        to);
          (train ? options.train : options.validation).push_back(out / "frames.pvd");
        }
      }
      options.scene = test::tiny_scene();
      options.scene.name = "again";
      options.scene.physics.pinned = {5, 7};
      options.law_known = true;
      import_dataset(folder / "d", options);
      const Dataset again = Dataset::open(folder / "d");
      CHECK_NOTHROW(again.verify());
      const Manifest& manifest = again.manifest();
      CHECK(manifest.scene_name == "again");
      CHECK(manifest.h == data.manifest().h);
      CHECK(manifest.dt == data.manifest().dt);
      CHECK(manifest.physics.pinned == std::vector<int>{1, 5, 7});
      CHECK(manifest.physics.material.E == 5e4);
      CHECK(again.mesh().vertices() == data.mesh().vertices());
      CHECK(again.mesh().tets() == data.mesh().tets());
      REQUIRE(again.train().size() == 2);
      REQUIRE(again.validation().size() == 2);
      for (std::size_t i = 0; i < 2; ++i) {
        const test::Record a = test::read_record(data.train()[i]);
        const test::Record b = test::read_record(again.train()[i]);
        CHECK(a.x == b.x);
        CHECK(a.v == b.v);
        CHECK(a.f == b.f);
      }
    }
  }

  TEST_CASE("tets with vertices of their own, a displacement and blocks, as PolyFEM writes") {
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    const Index n_tets = mesh.n_tets();
    const test::Folder folder;
    fem::Tets tets(n_tets, 4);
    Matrix<double> X(4 * n_tets, 3);
    std::vector<Index> corner(static_cast<std::size_t>(4 * n_tets));
    for (Index e = 0; e < n_tets; ++e) {
      for (Index a = 0; a < 4; ++a) {
        tets(e, a) = static_cast<std::int32_t>(4 * e + a);
        corner[static_cast<std::size_t>(4 * e + a)] = mesh.tets()(e, a);
        X.row(4 * e + a) = mesh.vertices().row(mesh.tets()(e, a));
        X(4 * e + a, 0) += 1e-13 * static_cast<double>(e % 3);  // as their mappings round
      }
    }
    std::vector<fem::PvdEntry> entries;
    for (int k = 0; k < 4; ++k) {
      const std::string step = "step_" + std::to_string(k);
      entries.push_back({0.01 * k, step + ".vtm"});
      put(folder / entries.back().file,
          "<VTKFile type=\"vtkMultiBlockDataSet\"><vtkMultiBlockDataSet><Block name=\"Volume\">"
          "<DataSet file=\"" +
              step + ".vtu\"/></Block></vtkMultiBlockDataSet></VTKFile>");
      const Matrix<float> u = (moved(X, 0.01 * k) - X).cast<float>();
      put(folder / (step + ".vtu"), fem::to_vtu({X, tets, {{"solution", u}}, {}}, {}));
    }
    put(folder / "sim.pvd", fem::to_pvd(entries));
    ImportOptions options = options_of({folder / "sim.pvd"});
    options.displacement = "solution";
    CHECK(contains(test::message<InputError>([&] { import_dataset(folder / "d", options); }),
                   "--weld"));
    options.weld = true;
    import_dataset(folder / "d", options);
    const Dataset data = Dataset::open(folder / "d");
    CHECK(data.manifest().n_vertices == 27);
    CHECK(data.manifest().n_tets == n_tets);
    CHECK(data.mesh().total_volume() == doctest::Approx(1));
    CHECK_FALSE(data.train()[0].has_velocity());
    CHECK(worst(data.train()[0], [&](Index t) {
            return moved(data.mesh().vertices(), 0.01 * static_cast<double>(t));
          }) < 1e-6);
    options.force = true;
    options.displacement = "velocity";
    CHECK(contains(test::message<InputError>([&] { import_dataset(folder / "d", options); }),
                   "expected the array 'velocity' in PointData"));
  }

  TEST_CASE("units, axes, vertices of no tet and inverted tets are put right") {
    const test::Folder folder;
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    // y up and in millimetres, one more vertex in front, one tet inside out.
    Matrix<double> X(28, 3);
    X.row(0).setConstant(7e4);
    X.col(0).tail(27) = 1000 * mesh.vertices().col(0);
    X.col(1).tail(27) = 1000 * mesh.vertices().col(2);
    X.col(2).tail(27) = -1000 * mesh.vertices().col(1);
    fem::Tets tets = mesh.tets().array() + 1;
    std::swap(tets(3, 2), tets(3, 3));
    Matrix<double> later = X;
    later.col(1).array() += 500;
    write_series(folder.path(), tets, {X, later}, {0, 0.1});
    ImportOptions options = options_of({folder / "run.pvd"});
    options.scale = 1e-3;
    options.y_up = true;
    options.scene.pins.planes.resize(1, 4);
    options.scene.pins.planes << 0, 0, 1, mesh.vertices().col(2).maxCoeff();
    std::vector<std::string> warnings;
    options.warn = [&](const std::string& what) { warnings.push_back(what); };
    import_dataset(folder / "d", options);
    REQUIRE(warnings.size() >= 3);
    CHECK(contains(warnings[0], "the first frame is taken for the shape at rest"));
    const Dataset data = Dataset::open(folder / "d");
    CHECK(data.manifest().h == 0.1);
    CHECK(data.manifest().physics.pinned.size() == 9);
    CHECK((data.mesh().vertices() - mesh.vertices()).cwiseAbs().maxCoeff() < 1e-12);
    Matrix<double> wanted = mesh.vertices();
    wanted.col(2).array() += 0.5;
    CHECK((data.train()[0].state<double>(1).x - wanted).cwiseAbs().maxCoeff() < 1e-6);
    // Another shape at rest, with the same tets.
    options.rest = folder / "frames/1.vtu";
    options.force = true;
    import_dataset(folder / "d", options);
    CHECK((Dataset::open(folder / "d").mesh().vertices() - wanted).cwiseAbs().maxCoeff() < 1e-12);
  }

  TEST_CASE("times that are not equally far apart are refused, or resampled by cubics") {
    const test::Folder folder;
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    std::vector<Matrix<double>> x;
    std::vector<double> times;
    for (int k = 0; k <= 20; ++k) {
      times.push_back(3 + 0.05 * k + 0.01 * std::sin(2.0 * k));
      x.push_back(moved(mesh.vertices(), times.back() - 3));
    }
    write_series(folder.path(), mesh.tets(), x, times);
    ImportOptions options = options_of({folder / "run.pvd"});
    CHECK(contains(test::message<InputError>([&] { import_dataset(folder / "d", options); }),
                   "--resample S"));
    CHECK_FALSE(fs::exists(folder / "d"));
    options.resample = 0.03;
    import_dataset(folder / "d", options);
    const Dataset data = Dataset::open(folder / "d");
    CHECK(data.manifest().frames == 33);
    // Slopes are those of parabolas, the motion is a cubic: h^3 / 10 or so.
    CHECK(worst(data.train()[0], [&](Index t) {
            return moved(mesh.vertices(), times[0] - 3 + 0.03 * static_cast<double>(t));
          }) < 1e-4);  // measured 6.5e-5
    // Digits that a writer leaves out are no reason to refuse.
    for (std::size_t k = 0; k < times.size(); ++k)
      times[k] = std::round(1e4 * (0.03333 * static_cast<double>(k))) / 1e4;
    write_series(folder.path(), mesh.tets(), x, times);
    options.resample.reset();
    options.force = true;
    CHECK(import_dataset(folder / "d", options).h == doctest::Approx(0.03333));
  }

  TEST_CASE("what does not belong together is refused, naming the file") {
    const test::Folder folder;
    const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
    const std::vector<Matrix<double>> x{mesh.vertices(), moved(mesh.vertices(), 0.1),
                                        moved(mesh.vertices(), 0.2)};
    const auto refusal = [&] {
      const std::string why = test::message<InputError>(
          [&] { import_dataset(folder / "d", options_of({folder / "run.pvd"})); });
      CHECK_FALSE(fs::exists(folder / "d"));
      return why;
    };
    write_series(folder.path(), mesh.tets(), x, {0, 0.1, 0.2});
    put(folder / "frames/1.vtu", fem::to_vtu({x[1], mesh.tets().topRows(5).eval(), {}, {}}, {}));
    CHECK(contains(refusal(), "frames/1.vtu: expected the 40 tetrahedra of the first frame"));
    put(folder / "frames/1.vtu", "<VTKFile");
    CHECK(contains(refusal(), "frames/1.vtu:1: expected a VTU file"));
    write_series(folder.path(), mesh.tets(), x, {0, 0.2, 0.1});
    CHECK(contains(refusal(), "expected a time after 0.2 s"));
    for (const char* name : {"../x.vtu", "/etc/passwd", "a/../../b.vtu"}) {
      put(folder / "run.pvd", fem::to_pvd({{0, name}, {1, "frames/1.vtu"}}));
      CHECK(contains(refusal(), "expected names of files in its folder"));
    }
    put(folder / "run.pvd", fem::to_pvd({{0, "frames/0.vtu"}}));
    CHECK(contains(refusal(), "at least two frames"));
    CHECK_THROWS_AS(import_dataset(folder / "d", options_of({folder / "frames/0.vtu"})),
                    ConfigError);
    CHECK_THROWS_AS(import_dataset(folder / "d", options_of({})), ConfigError);
    // Two motions with other times between frames, or other tets.
    write_series(folder.path(), mesh.tets(), x, {0, 0.1, 0.2});
    const test::Folder other;
    write_series(other.path(), mesh.tets(), x, {0, 0.2, 0.4});
    CHECK(contains(
        test::message<InputError>([&] {
          import_dataset(folder / "d", options_of({folder / "run.pvd", other / "run.pvd"}));
        }),
        "--resample S makes them equal"));
  }

  TEST_CASE("an import that is stopped leaves nothing; a folder of somebody else's stays") {
    const test::Folder folder;
    const fem::TetMesh<double> mesh = fem::cube_mesh(2, 1);
    write_series(folder.path(), mesh.tets(),
                 {mesh.vertices(), moved(mesh.vertices(), 0.1), moved(mesh.vertices(), 0.2)},
                 {0, 0.1, 0.2});
    ImportOptions options = options_of({folder / "run.pvd"});
    options.progress = [](double part) {
      if (part > 0.5) throw std::runtime_error("stop");
    };
    CHECK_THROWS_AS(import_dataset(folder / "d", options), std::runtime_error);
    CHECK_FALSE(fs::exists(folder / "d"));
    options.progress = {};
    import_dataset(folder / "d", options);
    CHECK_THROWS_AS(import_dataset(folder / "d", options), ConfigError);
    options.force = true;
    import_dataset(folder / "d", options);
    put(folder / "d/train/notes.txt", "mine");
    CHECK(contains(test::message<ConfigError>([&] { import_dataset(folder / "d", options); }),
                   "'train/notes.txt', which would be lost"));
  }
}
