#include "nmp/body.h"

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>

#include "base/check.h"
#include "fem/mesh_fixtures.h"
#include "fem/stability.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;

namespace {

Scene scene_of(const Path& mesh, const std::string& more = "") {
  Scene scene = parse_scene(
      "[contact]\nground = \"none\"\n[mesh]\nfile = \"" + mesh.string() + "\"\n" + more, "a.toml");
  return scene;
}

std::string refusal(const Scene& scene) {
  return test::message<ConfigError>([&] { make_body(scene); });
}

}  // namespace

TEST_SUITE("nmp/body") {
  TEST_CASE("a mesh file is turned by a quarter about x, then scaled") {
    const test::Folder folder;
    test::put(folder / "m.msh", test::kGmsh2);
    const Body body = make_body(scene_of(folder / "m.msh", "up = \"y\"\nscale = 0.5\n"));
    const Mat3<double> R =
        Eigen::AngleAxisd(std::acos(0.0), Vec3<double>::UnitX()).toRotationMatrix();
    CHECK((R * Vec3<double>::UnitY()).isApprox(Vec3<double>::UnitZ(), 1e-15));
    CHECK(body.mesh.vertices().isApprox(0.5 * test::two_tets().vertices * R.transpose(), 1e-15));
    CHECK(body.mesh_checksum == hash_file(folder / "m.msh"));
    CHECK(body.pinned.empty());
    CHECK(make_mesh(scene_of(folder / "m.msh")).vertices() == test::two_tets().vertices);
  }

  TEST_CASE("what was repaired is said, and pins count what is left") {
    const test::Folder folder;
    fem::RawMesh mesh = test::two_tets();
    Matrix<double> vertices(6, 3);
    vertices << 9, 9, 9, mesh.vertices;
    fem::Tets tets = mesh.tets.array() + 1;
    std::swap(tets(1, 0), tets(1, 1));
    fem::write_mesh(folder / "m.vtu", {vertices, tets, {}});
    Scene scene = scene_of(folder / "m.vtu");
    scene.physics.pinned = {0};
    const Body body = make_body(scene);
    REQUIRE(body.warnings.size() == 2);
    CHECK(contains(body.warnings[0], "m.vtu: 1 tet is inverted (1)"));
    CHECK(contains(body.warnings[1], "m.vtu: 1 vertex belongs to no tet (0): dropped"));
    CHECK(body.mesh.vertices() == mesh.vertices);
    CHECK(body.pinned == std::vector<int>{0});
    scene.physics.pinned = {5};
    CHECK(contains(refusal(scene), "pins.vertices: expected vertices from 0 to 4, found 5"));
  }

  TEST_CASE("pins by rule: boxes and spheres with their boundary, planes above") {
    const test::Folder folder;
    test::put(folder / "m.msh", test::kGmsh2);
    const auto pins = [&](const std::string& rules) {
      return make_body(scene_of(folder / "m.msh", "[pins]\n" + rules)).pinned;
    };
    using Ids = std::vector<int>;
    CHECK(pins("boxes = [[0, 0, 0, 1, 0.5, 0]]\n") == Ids{0, 1});
    CHECK(pins("boxes = [[0, 0, 0, 0, 0, 0], [1, 1, 1, 2, 2, 2]]\n") == Ids{0, 4});
    CHECK(pins("spheres = [[0, 0, 2, 1]]\n") == Ids{3});
    CHECK(pins("planes = [[0, 0, 2, 2]]\n") == Ids{3, 4});
    CHECK(pins("planes = [[0, 0, -1, 0]]\nvertices = [4, 0]\n") == Ids{0, 1, 2, 4});
    CHECK(pins("").empty());
    // In metres of the turned and scaled mesh.
    CHECK(make_body(scene_of(folder / "m.msh",
                             "scale = 10\nup = \"y\"\n[pins]\nplanes = [[0, 0, 1, 10]]\n"))
              .pinned == Ids{2, 4});
    const std::string nothing =
        refusal(scene_of(folder / "m.msh", "[pins]\nspheres = [[0, 0, 0, 1], [9, 9, 9, 1]]\n"));
    CHECK(contains(nothing,
                   "pins.spheres: rule 1, counted from 0, pins no vertex; the body spans x 0 "
                   "to 1, y 0 to 1, z 0 to 1.5 m"));
    CHECK(contains(refusal(scene_of(folder / "m.msh", "[pins]\nplanes = [[0, 0, 1, -1]]\n")),
                   "all 5 vertices are pinned"));
    // The cube has rules too.
    CHECK(make_body(parse_scene("[mesh]\nvertices_per_edge = 3\n[pins]\nplanes = [[0, 0, 1, 0.5]]\n"
                                "[contact]\nground = \"none\"\n",
                                "a.toml"))
              .pinned.size() == 9);
  }

  TEST_CASE("a pinned body must not begin below the ground") {
    const test::Folder folder;
    test::put(folder / "m.msh", test::kGmsh2);
    Scene scene = scene_of(folder / "m.msh", "[pins]\nvertices = [3]\n");
    scene.physics.ground = 0.5;
    CHECK(contains(refusal(scene),
                   "contact.ground: the pinned body reaches down to z = 0 m, below the "
                   "ground at 0.5 m; set contact.ground to \"none\""));
    scene.physics.ground = 0;
    CHECK_NOTHROW(make_body(scene));
  }

  TEST_CASE("a mesh file is looked for in every folder, and the error names them") {
    const test::Folder folder;
    Scene scene = scene_of("m.msh");
    scene.mesh_folders = {folder / "a", folder / "b"};
    const std::string why = refusal(scene);
    CHECK(contains(why, "mesh.file: found no mesh, looked for '" + (folder / "a/m.msh").string() +
                            "', '" + (folder / "b/m.msh").string() + "'"));
    CHECK(contains(why, "--mesh FILE or --set mesh.file=FILE"));
    CHECK(contains(why, "--meshes DIR or the environment variable NMP_MESHES"));
    std::filesystem::create_directory(folder / "b");
    test::put(folder / "b/m.msh", test::kGmsh2);
    CHECK(find_mesh(scene) == folder / "b/m.msh");
    std::filesystem::create_directory(folder / "a");
    test::put(folder / "a/m.msh", "$MeshFormat\n");
    CHECK(contains(test::message<InputError>([&] { make_body(scene); }), "a/m.msh:2: expected"));
  }

  TEST_CASE("a checksum in the scene must be that of the file") {
    const test::Folder folder;
    test::put(folder / "m.msh", test::kGmsh2);
    Scene scene = scene_of(folder / "m.msh");
    const Body body = make_body(scene);
    const Scene recorded = recorded_scene(scene, body);
    CHECK(recorded.mesh_file == "m.msh");
    CHECK(recorded.mesh_checksum == body.mesh_checksum);
    scene.mesh_checksum = body.mesh_checksum;
    CHECK_NOTHROW(make_body(scene));
    scene.mesh_checksum = "0123456789abcdef";
    CHECK(contains(
        test::message<InputError>([&] { make_body(scene); }),
        "expected the mesh with the checksum 0123456789abcdef (mesh.checksum of the scene)"));
  }

  TEST_CASE("a file's frames are half the stability limit apart, at most those of the paper") {
    const test::Folder folder;
    test::put(folder / "m.msh", test::kGmsh2);
    const auto recorded = [&](const std::string& more) {
      const Scene scene = scene_of(folder / "m.msh", more);
      return recorded_scene(scene, make_body(scene));
    };
    Scene scene = recorded("[time]\nsubsteps = 20\n");
    CHECK(scene.h() == doctest::Approx(5e-4));
    scene = recorded("[material]\nE = 5e9\n");
    const fem::TetMesh<double> body = make_mesh(scene_of(folder / "m.msh"));
    const double limit = fem::stable_time_step(body, scene.physics.material);
    CHECK(scene.h() <= limit / 2);
    CHECK(scene.h() >= limit / 2 / 1.1);
    CHECK(std::abs(scene.h() * 1e7 - std::round(scene.h() * 1e7)) <= 1e-6);  // two digits
    // What is said is kept, and what was chosen is said.
    CHECK(recorded("[time]\ndt = 1\n").dt == 1);
    CHECK(parse_scene(to_toml(scene), "a.toml").dt == scene.dt);
    CHECK(contains(test::message<ConfigError>([] { parse_scene("[time]\ndt = 0\n", "a.toml"); }),
                   "time.dt"));
  }

  TEST_CASE("BOB and SPOT, where NMP_MESHES has them: every format, the pins of head and tail") {
    const char* meshes = std::getenv("NMP_MESHES");
    if (meshes == nullptr || !std::filesystem::exists(Path(meshes) / "bob.msh")) {
      MESSAGE("SKIPPED: set NMP_MESHES to a folder with bob.msh and spot.msh to run this");
      return;
    }
    const auto body = [&](const char* file, const char* more) {
      Scene scene = scene_of(file, std::string("up = \"y\"\n[pins]\n") + more);
      scene.mesh_folders = {meshes};
      return make_body(scene);
    };
    // y up in the file: z here.
    const Body bob = body("bob.msh", "planes = [[0, 0, 1, 0.3]]\n");
    CHECK(bob.mesh.n_vertices() == 849);
    CHECK(bob.mesh.n_tets() == 3162);
    CHECK(bob.mesh.total_volume() == doctest::Approx(0.67200).epsilon(1e-5));
    CHECK(bob.pinned.size() == 28);
    CHECK(bob.warnings.empty());
    CHECK(body("bob.node", "planes = [[0, 0, 1, 0.25]]\n").pinned.size() == 43);
    CHECK(body("bob.ele", "planes = [[0, 0, 1, 0.2]]\n").pinned.size() == 59);
    // z of the file is -y here: the tail at z > 0.93, the head at z < -0.27 and y > 0.1.
    const Body spot = body("spot.msh", "planes = [[0, -1, 0, 0.93]]\n");
    CHECK(spot.mesh.total_volume() == doctest::Approx(0.70541).epsilon(1e-5));
    CHECK(spot.pinned.size() == 22);
    const Body both =
        body("spot.msh", "planes = [[0, -1, 0, 0.93]]\nboxes = [[-9, 0.27, 0.1, 9, 9, 9]]\n");
    CHECK(both.pinned.size() > 100);
    // As the scenes that ship have them.
    const auto shipped = [&](const char* name) {
      Scene scene = read_scene(name);
      scene.mesh_folders = {meshes};
      return make_body(scene);
    };
    CHECK(shipped("spot").pinned == both.pinned);
    CHECK(shipped("bob").pinned.size() == 59);
  }
}
