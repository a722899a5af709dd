#include "nmp/scene.h"
#include "nmp/shipped.h"

#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <cmath>

#include "base/check.h"
#include "nmp/body.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;

namespace {

std::string refusal(const std::string& text, const std::vector<std::string>& overrides = {}) {
  return test::message<ConfigError>([&] { parse_scene(text, "a.toml", overrides); });
}

// The linear map that takes the rest positions to x, from the centre of mass on.
Mat3<double> turn(const fem::TetMesh<double>& mesh, const Matrix<double>& x) {
  const Matrix<double> X = mesh.vertices().rowwise() - mesh.vertices().colwise().mean();
  const Matrix<double> Y = x.rowwise() - x.colwise().mean();
  return (X.transpose() * X).ldlt().solve(X.transpose() * Y).transpose();
}

}  // namespace

TEST_SUITE("nmp/scene") {
  TEST_CASE("the paper's scenes ship") {
    CHECK(shipped_scene_names() ==
          std::vector<std::string>{"bob", "cube", "cubexl", "friction", "spot"});
    Scene cubexl = read_scene("cubexl");
    CHECK(cubexl.vertices_per_edge == 22);
    cubexl.name = "cube";
    cubexl.vertices_per_edge = 10;
    CHECK(to_toml(cubexl) == to_toml(read_scene("cube")));
    for (const char* name : {"bob", "spot"}) {
      const Scene held = read_scene(name);
      CHECK(held.name == name);
      CHECK(held.mesh_file == std::string(name) + ".msh");
      CHECK(held.mesh_up == "y");
      CHECK(held.physics.material.E == 1e5);
      CHECK(held.physics.material.nu == 0.45);
      CHECK_FALSE(held.physics.ground);
      CHECK(held.has_pins());
      CHECK(held.v_min == Vec3<double>(-2, -2, -2));
      CHECK(held.v_max == Vec3<double>(2, 2, 2));
      CHECK(held.h() == doctest::Approx(5e-4));
      CHECK(held.substeps == 50);
      CHECK(held.frames == 1000);
      CHECK(held.train == 32);
      CHECK(held.validation == 8);
    }
  }

  TEST_CASE("CUBE ships with every default") {
    const Scene cube = read_scene("cube");
    CHECK(cube.name == "cube");
    CHECK(cube.vertices_per_edge == 10);
    CHECK(cube.side == 1);
    CHECK(cube.physics.material.law == "neo-hookean");
    CHECK(cube.physics.material.E == 5e5);
    CHECK(cube.physics.material.nu == 0.45);
    CHECK(cube.physics.material.density == 1000);
    CHECK(cube.physics.gravity == Vec3<double>(0, 0, -9.8));
    CHECK(cube.physics.ground == 0.0);
    CHECK(cube.physics.pinned.empty());
    CHECK(cube.clearance == 0.1);
    CHECK(cube.v_min == Vec3<double>(-2, -2, -3));
    CHECK(cube.v_max == Vec3<double>(2, 2, 1));
    CHECK(cube.h() == doctest::Approx(5e-4));
    CHECK(cube.frames == 1000);
    CHECK(cube.train == 32);
    CHECK(cube.validation == 8);
    CHECK(to_toml(cube) == to_toml(parse_scene("", "empty")));
    CHECK(to_toml(cube) == to_toml(Scene()));
  }

  TEST_CASE("the text of a scene reads back exactly") {
    Scene scene;
    scene.name = "odd \"name\"";
    scene.side = 1.0 / 3;
    scene.physics.material = {"stvk", 123456.789012345, 0.1, 1.0 / 7};
    scene.physics.gravity = {1e-300, -0.1, 0};
    scene.physics.ground = -1.25;
    scene.clearance = 2.0 / 3;
    scene.dt = 1.1e-5;
    scene.seed = 9'223'372'036'854'775'807u;
    const Scene read = parse_scene(to_toml(scene), "a.toml");
    CHECK(to_toml(read) == to_toml(scene));
    CHECK(read.name == scene.name);
    CHECK(read.side == scene.side);
    CHECK(read.physics.material.E == scene.physics.material.E);
    CHECK(read.physics.material.density == scene.physics.material.density);
    CHECK(read.physics.gravity == scene.physics.gravity);
    CHECK(read.physics.ground == scene.physics.ground);
    CHECK(read.clearance == scene.clearance);
    CHECK(read.dt == scene.dt);
    CHECK(read.seed == scene.seed);
    scene.seed += 1;
    CHECK_THROWS_AS(to_toml(scene), std::invalid_argument);
  }

  TEST_CASE("without a ground or with pins there is no clearance") {
    const Scene floating = parse_scene("[contact]\nground = \"none\"\n", "a.toml");
    CHECK_FALSE(floating.physics.ground.has_value());
    CHECK_FALSE(floating.clearance.has_value());
    CHECK(floating.random_orientation);
    CHECK(to_toml(parse_scene(to_toml(floating), "a.toml")) == to_toml(floating));

    const Scene pinned = parse_scene("[pins]\nvertices = [7, 3, 7]\n", "a.toml");
    CHECK(pinned.physics.pinned == std::vector<int>{3, 7});
    CHECK_FALSE(pinned.random_orientation);
    CHECK_FALSE(pinned.clearance.has_value());
    CHECK(to_toml(parse_scene(to_toml(pinned), "a.toml")) == to_toml(pinned));
  }

  TEST_CASE("overrides go before the file") {
    const Scene scene = read_scene("cube", {"time.frames=5", "material.law=stvk", "name=quick"});
    CHECK(scene.frames == 5);
    CHECK(scene.physics.material.law == "stvk");
    CHECK(scene.name == "quick");
  }

  TEST_CASE("scenes are found by file and by name") {
    const test::Folder folder;
    test::put(folder / "mine.toml", "name = \"mine\"\n[mesh]\nsid = 2\n");
    const std::string path = (folder / "mine.toml").string();
    CHECK(test::message<ConfigError>([&] { read_scene(path); }) ==
          path + ":3:1: unknown key 'mesh.sid'; did you mean 'mesh.side'?");
    test::put(folder / "mine.toml", "name = \"mine\"\n");
    CHECK(read_scene(path).name == "mine");
    const std::string unknown = test::message<ConfigError>([] { read_scene("cubes"); });
    CHECK(contains(unknown, "that ships (bob, cube, cubexl, friction, spot"));
    CHECK(contains(unknown, "did you mean 'cube'?"));
    CHECK_THROWS_AS(read_scene(folder.path().string()), IoError);
    CHECK(contains(test::message<ConfigError>([] { read_scene("cube", {"mesh.sid=2"}); }),
                   "--set mesh.sid=2: unknown key"));
    CHECK(contains(test::message<ConfigError>([] { read_scene("cube", {"time.dt=2"}); }),
                   "--set time.dt=2: expected a number"));
  }

  TEST_CASE("start states have the stated ranges") {
    Scene scene = parse_scene("[mesh]\nvertices_per_edge = 3\n[contact]\nground = 0.5\n", "a.toml");
    const fem::TetMesh<double> mesh = make_mesh(scene);
    Vec3<double> v_low = Vec3<double>::Constant(1e9), v_high = -v_low;
    Mat3<double> sum = Mat3<double>::Zero();
    double trace_squared = 0;
    constexpr int kDraws = 4000;
    for (int i = 0; i < kDraws; ++i) {
      const fem::State<double> state = initial_state(scene, mesh, mesh.vertices(), "train", i);
      const Mat3<double> R = turn(mesh, state.x);
      REQUIRE((R * R.transpose()).isApprox(Mat3<double>::Identity(), 1e-12));
      REQUIRE(R.determinant() > 0);
      REQUIRE(state.x.col(2).minCoeff() == doctest::Approx(0.6).epsilon(1e-12));
      const Vec3<double> v = state.v.row(0).transpose();
      REQUIRE((state.v.rowwise() - v.transpose()).isZero(0));
      v_low = v_low.cwiseMin(v);
      v_high = v_high.cwiseMax(v);
      sum += R;
      trace_squared += R.trace() * R.trace();
    }
    CHECK((v_low.array() >= scene.v_min.array()).all());
    CHECK((v_high.array() <= scene.v_max.array()).all());
    CHECK(v_low.isApprox(scene.v_min, 1e-2));
    CHECK(v_high.isApprox(scene.v_max, 1e-2));
    // Over SO(3) the mean of R is 0 and that of tr(R)^2 is 1 (orthogonality of characters).
    CHECK((sum / kDraws).cwiseAbs().maxCoeff() < 0.04);
    CHECK(trace_squared / kDraws == doctest::Approx(1).epsilon(0.1));
  }

  TEST_CASE("a speed in any direction, and a spin about the centre of mass") {
    Scene scene = parse_scene(
        "[mesh]\nvertices_per_edge = 3\n[initial]\nspeed_min = 3\nspeed_max = 4\nspin = 5\n",
        "a.toml");
    CHECK(to_toml(parse_scene(to_toml(scene), "b.toml")) == to_toml(scene));
    const fem::TetMesh<double> mesh = make_mesh(scene);
    double slowest = 9, fastest = 0, most_spin = 0;
    Vec3<double> mean = Vec3<double>::Zero();
    constexpr int kDraws = 2000;
    for (int i = 0; i < kDraws; ++i) {
      const fem::State<double> state = initial_state(scene, mesh, mesh.vertices(), "val", i);
      const Vec3<double> c = state.x.transpose() * mesh.vertex_volumes() / mesh.total_volume();
      const Vec3<double> v = state.v.transpose() * mesh.vertex_volumes() / mesh.total_volume();
      slowest = std::min(slowest, v.norm());
      fastest = std::max(fastest, v.norm());
      mean += v / kDraws;
      // The corner 0 and the far corner move about c as one rigid body does.
      const Vec3<double> r = Vec3<double>(state.x.row(0).transpose()) - c,
                         u = Vec3<double>(state.v.row(0).transpose()) - v;
      REQUIRE(std::abs(r.dot(u)) < 1e-12);
      const Index far = mesh.n_vertices() - 1;
      REQUIRE((state.v.row(far).transpose() - v).isApprox(-u, 1e-9));
      most_spin = std::max(most_spin, u.norm() / r.norm());
    }
    CHECK(slowest == doctest::Approx(3).epsilon(1e-2));
    CHECK(fastest == doctest::Approx(4).epsilon(1e-2));
    CHECK(mean.norm() < 0.2);
    CHECK(most_spin <= 5);
    CHECK(most_spin > 4.5);
    const auto refusal = [](const std::string& lines) {
      try {
        parse_scene("[mesh]\nvertices_per_edge = 3\n[initial]\n" + lines, "a.toml");
      } catch (const ConfigError& error) {
        return std::string(error.what());
      }
      return std::string();
    };
    CHECK(contains(refusal("speed_min = 3\n"), "initial.speed_min"));
    CHECK(contains(refusal("speed_min = 3\nspeed_max = 2\n"), "speed_max"));
    CHECK(contains(refusal("random_orientation = false\nclearance = \"none\"\nspin = 1\n"
                           "[pins]\nvertices = [1]\n"),
                   "initial.spin"));
  }

  TEST_CASE("a start state is a function of seed, split and index") {
    Scene scene = parse_scene("[mesh]\nvertices_per_edge = 3\n", "a.toml");
    const fem::TetMesh<double> mesh = make_mesh(scene);
    const auto start = [&](const char* split, Index i) {
      return initial_state(scene, mesh, mesh.vertices(), split, i);
    };
    CHECK(start("train", 3).x == start("train", 3).x);
    CHECK(start("train", 3).v != start("train", 4).v);
    CHECK(start("train", 3).v != start("val", 3).v);
    const std::uint64_t seed = trajectory_seed(scene, "train", 3);
    CHECK(seed < std::uint64_t{1} << 53);
    const Matrix<double> x = start("train", 3).x;
    scene.seed = 2;
    CHECK(start("train", 3).x != x);
    CHECK(trajectory_seed(scene, "train", 3) != seed);
  }

  TEST_CASE("a pinned body starts at rest, its pins without velocity") {
    const Scene scene = parse_scene(
        "[mesh]\nvertices_per_edge = 3\n[pins]\nvertices = [0, 26]\n"
        "[contact]\nground = \"none\"\n",
        "a.toml");
    const fem::TetMesh<double> mesh = make_mesh(scene);
    const fem::State<double> state = initial_state(scene, mesh, mesh.vertices(), "val", 0);
    CHECK(state.x == mesh.vertices());
    CHECK(state.v.row(0).isZero(0));
    CHECK(state.v.row(26).isZero(0));
    CHECK_FALSE(state.v.row(1).isZero(0));
    CHECK(state.v.row(1) == state.v.row(25));
  }

  TEST_CASE("a mesh file makes the shape, and reads back with its pins") {
    const Scene scene = parse_scene(
        "[mesh]\nfile = \"a b.msh\"\nscale = 1e-3\nup = \"y\"\nchecksum = \"0123456789abcdef\"\n"
        "[contact]\nground = \"none\"\n[pins]\nvertices = [900, 7]\nboxes = [[0, 0, 0, 1, 1, 1]]\n"
        "spheres = [[0, 0, 0, 0.5], [1, 1, 1, 2]]\nplanes = [[0, 0, 1, 0.25]]\n",
        "a.toml");
    CHECK(scene.shape == "file");
    CHECK(scene.mesh_file == "a b.msh");
    CHECK(scene.mesh_scale == 1e-3);
    CHECK(scene.mesh_up == "y");
    CHECK(scene.pins.spheres.rows() == 2);
    CHECK(scene.pins.planes(0, 3) == 0.25);
    CHECK(scene.has_pins());
    CHECK_FALSE(scene.random_orientation);
    CHECK_FALSE(scene.clearance.has_value());
    CHECK(to_toml(parse_scene(to_toml(scene), "a.toml")) == to_toml(scene));
    CHECK(scene.mesh_folders.empty());

    const Scene by_rule = parse_scene("[pins]\nplanes = [[0, 0, -1, 0]]\n", "a.toml");
    CHECK(by_rule.physics.pinned.empty());
    CHECK_FALSE(by_rule.random_orientation);
  }

  TEST_CASE("a mesh file on the command line takes the place of the scene's body") {
    const Scene scene = read_scene("cube", {"mesh.file=a.msh", "mesh.scale=2"});
    CHECK(scene.shape == "file");
    CHECK(scene.name == "cube");
    CHECK(scene.random_orientation);
    CHECK(scene.mesh_folders == std::vector<Path>{Path()});
    const test::Folder folder;
    const std::string path = (folder / "mine.toml").string();
    test::put(path, "[mesh]\nfile = \"b.msh\"\nchecksum = \"0123456789abcdef\"\n");
    CHECK(read_scene(path).mesh_folders == std::vector<Path>{folder.path()});
    const Scene other = read_scene(path, {"mesh.file=a.msh"});
    CHECK(other.mesh_folders == std::vector<Path>{Path(), folder.path()});
    CHECK(other.mesh_checksum.empty());
  }

  TEST_CASE("keys of a mesh file and of the cube exclude each other") {
    CHECK(contains(refusal("[mesh]\nfile = \"a.msh\"\nside = 2\n"),
                   "a.toml:3:8: mesh.side: is of the cube"));
    CHECK(contains(refusal("[mesh]\nfile = \"a.msh\"\nshape = \"cube\"\n"),
                   "a.toml:3:9: mesh.shape: expected \"file\""));
    CHECK(contains(refusal("[mesh]\nscale = 2\n"), "a.toml:2:9: mesh.scale: needs mesh.file"));
    CHECK(contains(refusal("[mesh]\nshape = \"file\"\n"), "expected the name of a mesh file"));
    CHECK(contains(refusal("[mesh]\nfile = \"\"\n"), "a.toml:2:8: mesh.file"));
    CHECK(contains(refusal("[mesh]\nfile = \"a.msh\"\nup = \"x\"\n"), "one of the strings z, y"));
    CHECK(contains(refusal("[mesh]\nfile = \"a.msh\"\nscale = 0\n"), "a.toml:3:9: mesh.scale"));
    CHECK(contains(refusal("[mesh]\nfile = \"a.msh\"\nchecksum = \"12\"\n"), "16 lower-case"));
    CHECK(contains(refusal("[mesh]\nfiel = \"a.msh\"\n"), "did you mean 'mesh.file'?"));
  }

  TEST_CASE("pin rules that can hold nothing are refused") {
    CHECK(contains(refusal("[pins]\nboxes = [[0, 0, 0, 1, -1, 1]]\n"),
                   "a.toml:2:9: pins.boxes: rule 0, counted from 0: expected"));
    CHECK(contains(refusal("[pins]\nspheres = [[0, 0, 0, 1], [0, 0, 0, 0]]\n"), "rule 1"));
    CHECK(contains(refusal("[pins]\nplanes = [[0, 0, 0, 1]]\n"), "not zero"));
    CHECK(contains(refusal("[pins]\nplanes = [[0, 0, 1]]\n"), "arrays of 4 numbers (one has 3)"));
    CHECK(contains(refusal("[pins]\nplanes = [[0, 0, 1, 0]]\n[initial]\nclearance = 1\n"),
                   "a.toml:4:13"));
  }

  TEST_CASE("FRICTION ships, and what projective dynamics alone knows stands in its text") {
    const Scene scene = read_scene("friction");
    CHECK(scene.physics.material.law == "projective");
    CHECK(scene.physics.material.volume_weight == 1);
    CHECK(scene.physics.contact.law == "coulomb");
    CHECK(scene.physics.contact.friction > 0);
    CHECK(*scene.clearance <= 0.005);
    CHECK(scene.h() == doctest::Approx(2.5e-4));
    const std::string toml = to_toml(scene);
    CHECK(to_toml(parse_scene(toml, "again")) == toml);
    CHECK(contains(toml, "friction = 0.5"));
    CHECK_FALSE(contains(to_toml(read_scene("cube")), "friction"));

    CHECK(contains(refusal("[contact]\nfriction = 0.5\n"),
                   "a.toml:2:12: contact.friction: needs contact.law = \"coulomb\""));
    CHECK(contains(refusal("[contact]\nk_n = 0.5\n"),
                   "a.toml:2:7: contact.k_n: needs material.law = \"projective\""));
    const std::string projective = "[material]\nlaw = \"projective\"\n[contact]\n";
    CHECK(contains(refusal(projective + "friction = 0.5\n"), "needs contact.law = \"coulomb\""));
    CHECK(contains(refusal("[contact]\nlaw = \"penalty\"\n"),
                   "a.toml:2:7: contact.law: \"penalty\" needs material.law = \"projective\""));
    CHECK(contains(refusal(projective + "law = \"coulomb\"\nfriction = -0.5\n"),
                   "a.toml:5:12: contact.friction: expected a number from 0"));
    CHECK(scene.settled);
    CHECK(contains(refusal("[material]\nlaw = \"projective\"\n[initial]\nsettled = true\n"),
                   "expected random_orientation = false"));
    CHECK(contains(refusal(projective + "law = \"glue\"\n"), "frictionless, coulomb, penalty"));
    CHECK(contains(refusal(projective + "law = \"coulomb\"\nground = \"none\"\n"),
                   "expected \"frictionless\""));
  }

  TEST_CASE("explicit scenes may have friction and wind, which others do not name") {
    const Scene scene = parse_scene(
        "[contact]\nlaw = \"coulomb\"\nfriction = 0.3\n[air]\ndrag = 0.5\nwind = [3, 0, 1]\n", "a");
    CHECK(scene.physics.contact.law == "coulomb");
    CHECK(scene.physics.air.drag == 0.5);
    CHECK(scene.physics.air.wind == Vec3<double>(3, 0, 1));
    const std::string toml = to_toml(scene);
    CHECK(contains(toml, "wind = [3.0, 0.0, 1.0]"));
    CHECK(contains(toml, "friction = 0.3"));
    CHECK(to_toml(parse_scene(toml, "again")) == toml);
    const std::string plain = to_toml(read_scene("cube"));
    CHECK_FALSE(contains(plain, "air"));
    CHECK_FALSE(contains(plain, "coulomb"));
    CHECK(contains(refusal("[air]\ndrag = -1\n"), "air.drag: expected a number from 0"));
    CHECK(
        contains(refusal("[air]\nwind = [1, 0, 0]\n"), "a.toml:2:8: air.wind: needs air.drag > 0"));
  }

  TEST_CASE("what makes no sense is refused at its place") {
    CHECK(contains(refusal("[mesh]\nshape = \"ball\"\n"), "a.toml:2:9: mesh.shape"));
    CHECK(contains(refusal("[mesh]\nvertices_per_edge = 1\n"), "from 2 to 400, found 1"));
    CHECK(contains(refusal("[material]\nnu = 0.5\n"), "a.toml:2:6: material.nu"));
    CHECK(contains(refusal("[material]\nE = 0\n"), "a.toml:2:5: material.E"));
    CHECK(contains(refusal("[time]\ndt = 0\n"), "a.toml:2:6: time.dt"));
    CHECK(contains(refusal("[dataset]\nseed = -1\n"), "a.toml:2:8: dataset.seed"));
    CHECK(contains(refusal("[initial]\nv_min = [3, 0, 0]\n"), "a.toml:2:9: initial.v_min"));
    CHECK(contains(refusal("", {"initial.v_max=[-9, 0, 0]"}), "--set initial.v_max"));
    CHECK(contains(refusal("[dataset]\ntrain = 0\nvalidation = 0\n"), "at least one trajectory"));
    CHECK(contains(refusal("[mesh]\nvertices_per_edge = 2\n[pins]\nvertices = [8]\n"),
                   "a.toml:4:13: pins.vertices: expected an integer from 0 to 7, found 8"));
    CHECK(contains(refusal("[pins]\nvertices = [1]\n[initial]\nclearance = 1\n"), "a.toml:4:13"));
    CHECK(contains(refusal("[pins]\nvertices = [1]\n[initial]\nrandom_orientation = true\n"),
                   "a.toml:4:22"));
    CHECK(contains(refusal("[contact]\nground = \"none\"\n[initial]\nclearance = 1\n"),
                   "a.toml:4:13: initial.clearance: expected \"none\""));
    CHECK(contains(refusal("name = \"\"\n"), "a.toml:1:8: name"));
  }
}
