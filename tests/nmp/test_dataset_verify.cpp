#include "nmp/dataset_verify.h"

#include <doctest/doctest.h>

#include <cstring>
#include <limits>

#include "base/parallel.h"
#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::get;
using test::put;
namespace fs = std::filesystem;

namespace {

// All problems, a line each.
std::string problems(const Path& folder) {
  std::string list;
  for (const DatasetProblem& problem : verify_dataset(folder).problems)
    list += problem.file + ": " + problem.what + "\n";
  return list;
}

std::size_t lines(const std::string& text) {
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

Scene scene_with(Index substeps, bool pins) {
  Scene scene = test::tiny_scene();
  scene.train = scene.validation = 1;
  scene.frames = 40;
  scene.dt = 1e-4;
  scene.substeps = substeps;
  scene.clearance = 0.02;
  if (pins) {
    scene.physics.pinned = {0, 26};
    scene.physics.ground.reset();
    scene.random_orientation = false;
    scene.clearance.reset();
  }
  return scene;
}

// What verify says after `change` was made to the first training record of a simulated dataset and
// its checksum was set right.
template <class Change>
std::string after(const Scene& scene, const Change& change) {
  const test::Folder folder;
  generate_dataset(scene, folder / "d");
  REQUIRE(problems(folder / "d").empty());
  Manifest manifest = Dataset::open(folder / "d").manifest();
  test::Record record = test::read_record(Dataset::open(folder / "d").train()[0]);
  change(record);
  manifest.train[0].checksum = test::write_record(folder / ("d/" + manifest.train[0].name), record);
  write_manifest(folder / "d/manifest.json", manifest);
  return problems(folder / "d");
}

}  // namespace

TEST_SUITE("nmp/dataset_verify") {
  TEST_CASE(
      "nothing is wrong with what the simulator writes, in flight, on the ground, with pins") {
    for (const bool pins : {false, true}) {
      for (const Index substeps : {1, 5}) {
        CAPTURE(pins);
        CAPTURE(substeps);
        const test::Folder folder;
        generate_dataset(scene_with(substeps, pins), folder / "d");
        const DatasetCheck check = verify_dataset(folder / "d");
        CHECK(check.n_files == 4);
        for (const DatasetProblem& problem : check.problems) FAIL_CHECK(problem.what);
        CHECK(contains(to_json(check), "\"ok\": true"));
      }
    }
  }

  TEST_CASE("positions without checksums are verified as far as that goes, and it is told") {
    const test::Folder folder;
    generate_dataset(scene_with(1, true), folder / "d");
    test::write_positions(folder / "p", Dataset::open(folder / "d"));
    const DatasetCheck check = verify_dataset(folder / "p");
    CHECK(check.n_files == 4);
    CHECK(check.n_without_checksum == 3);
    for (const DatasetProblem& problem : check.problems) FAIL_CHECK(problem.what);
    CHECK(contains(to_json(check), "\"without_checksum\": 3"));
    Dataset::open(folder / "p").verify();
    CHECK(verify_dataset(folder / "d").n_without_checksum == 0);
    // A value that is not finite is still seen.
    const Path file = folder / "p/train/000.safetensors";
    std::string bytes = get(file);
    bytes.replace(bytes.size() - 4, 4, "\xff\xff\xff\xff");
    put(file, bytes);
    CHECK(contains(problems(folder / "p"), "x of vertex 26: expected finite"));
  }

  TEST_CASE("all that is wrong is listed, not only the first") {
    const test::Folder folder;
    Scene scene = scene_with(5, false);
    scene.train = 3;
    generate_dataset(scene, folder / "d");
    const auto file = [&](const char* name) { return folder / ("d/" + std::string(name)); };
    std::string bytes = get(file("train/000.safetensors"));
    bytes.back() = static_cast<char>(bytes.back() ^ 1);
    put(file("train/000.safetensors"), bytes);
    put(file("train/001.safetensors"), bytes.substr(0, bytes.size() / 2));
    fs::remove(file("val/000.safetensors"));
    bytes = get(file("mesh.safetensors"));
    put(file("mesh.safetensors"), bytes + "x");
    double last = 0;
    const DatasetCheck check = verify_dataset(folder / "d", [&](double part) { last = part; });
    CHECK(last == 1);
    CHECK(check.n_files == 6);
    const std::string list = problems(folder / "d");
    CHECK(lines(list) == 6);  // a cut file has another checksum and another format
    CHECK(contains(list, "train/000.safetensors: expected the checksum "));
    CHECK(contains(list, "train/001.safetensors: expected the checksum "));
    CHECK(contains(list, "001.safetensors: tensor "));
    CHECK(contains(list, "val/000.safetensors: "));
    CHECK(contains(list, "mesh.safetensors: expected the checksum "));
    CHECK(contains(list, "mesh.safetensors: data section: expected "));
    CHECK(contains(to_json(check), "\"ok\": false"));
    generate_dataset(scene, folder / "d");
    CHECK(problems(folder / "d").empty());
    put(file("manifest.json"), "{");
    CHECK(contains(problems(folder / "d"), "manifest.json: line 1"));
    fs::remove(file("manifest.json"));
    CHECK_THROWS_AS(verify_dataset(folder / "d"), IoError);
  }

  TEST_CASE("an index in another order than its files") {
    const test::Folder folder;
    Scene scene = scene_with(5, false);
    scene.train = 2;
    generate_dataset(scene, folder / "d");
    Manifest manifest = read_manifest(folder / "d/manifest.json");
    std::swap(manifest.train[0].name, manifest.train[1].name);
    write_manifest(folder / "d/manifest.json", manifest);
    const std::string list = problems(folder / "d");
    CHECK(lines(list) == 2);
    CHECK(contains(list,
                   "train/000.safetensors: expected the checksum " + manifest.train[1].checksum));
    CHECK(contains(list,
                   "train/001.safetensors: expected the checksum " + manifest.train[0].checksum));
  }

  TEST_CASE("numbers that are not finite, with frame, quantity and vertex") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::string list = after(scene_with(5, false), [&](test::Record& record) {
      record.x[3](7, 1) = nan;
      record.v[5](2, 0) = std::numeric_limits<double>::infinity();
      record.f[9](4, 2) = nan;
    });
    CHECK(contains(list, "train/000.safetensors: frame 3, x of vertex 7: expected finite"));
    CHECK(contains(list, "; and 2 more like it"));
    CHECK(lines(list) == 1);
  }

  TEST_CASE("pinned vertices that move, and elements inside out") {
    CHECK(contains(after(scene_with(5, true), [](test::Record& r) { r.x[4](26, 0) += 1e-3; }),
                   "frame 4, pinned vertex 26: expected it at rest, found it "));
    CHECK(contains(after(scene_with(5, true), [](test::Record& r) { r.v[4](0, 2) = 1e-3; }),
                   "frame 4, pinned vertex 0: expected it at rest"));
    CHECK(contains(after(scene_with(5, true), [](test::Record& r) { r.x[6](13, 0) += 2; }),
                   "expected det F > 0, which the neo-Hookean law keeps, found -"));
  }

  TEST_CASE("frames that do not follow each other") {
    // In flight the mass centre gives away a shift of 1e-4 m and frames in another order.
    const Scene flight = scene_with(5, false);
    CHECK(contains(after(flight, [](test::Record& r) { r.x[5].col(0).array() += 1e-4; }),
                   "frame 5: expected the mass centre to have moved by"));
    CHECK(contains(after(flight,
                         [](test::Record& r) {
                           std::swap(r.x[3], r.x[4]);
                           std::swap(r.v[3], r.v[4]);
                         }),
                   "frame 3: expected the mass centre"));
    // Of frames that are one substep each vertex must have moved by h v; with pins too.
    for (const bool pins : {false, true}) {
      CHECK(contains(after(scene_with(1, pins), [](test::Record& r) { r.x[5](13, 0) += 1e-4; }),
                     "frame 5, vertex 13: expected x to have moved by h v"));
      CHECK(contains(after(scene_with(1, pins), [](test::Record& r) { r.v[5](13, 2) += 0.2; }),
                     "frame 5, vertex 13: expected x to have moved by h v"));
    }
  }
}
