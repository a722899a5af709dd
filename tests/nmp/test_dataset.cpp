#include "nmp/dataset.h"

#include <doctest/doctest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <limits>

#include "base/check.h"
#include "base/random.h"
#include "fem/mesh_cube.h"
#include "nmp/folder.h"

using namespace nmp;
using test::contains;
using test::get;
using test::put;
using test::replaced;
namespace fs = std::filesystem;

namespace {

constexpr Index kFrames = 3;

Matrix<double> random_frame(Index n_vertices, std::uint64_t seed) {
  Matrix<double> frame(n_vertices, 3);
  for (Index i = 0; i < frame.size(); ++i) {
    frame.data()[i] = Random(seed).normal(static_cast<std::uint64_t>(i));
  }
  return frame;
}

std::string write_trajectory(const Path& path, Index n_vertices, std::uint64_t seed) {
  TrajectoryWriter writer(path, kFrames, n_vertices, seed, 5e-4, "abc");
  for (Index t = kFrames; t >= 0; --t) {
    const auto stream = 100 * seed + 10 * static_cast<std::uint64_t>(t);
    writer.write(t, random_frame(n_vertices, stream), random_frame(n_vertices, stream + 1),
                 random_frame(n_vertices, stream + 2));
  }
  return writer.commit();
}

// A small dataset of random numbers.
Manifest write_dataset(const Path& folder) {
  const fem::TetMesh<double> mesh = fem::cube_mesh(3, 1);
  fs::create_directories(folder / "train");
  fs::create_directories(folder / "val");
  Manifest manifest;
  manifest.scene_name = "odd \"name\"\n";
  manifest.scene_toml = "name = \"odd\"\n";
  manifest.physics.material = {"stvk", 1.0 / 3, 0.1, 7};
  manifest.physics.gravity = {0.1, -1e-300, -9.8};
  manifest.physics.ground = -0.1;
  manifest.dt = 1e-5;
  manifest.substeps = 50;
  manifest.h = 5e-4;
  manifest.frames = kFrames;
  manifest.n_vertices = mesh.n_vertices();
  manifest.n_tets = mesh.n_tets();
  manifest.seed = std::numeric_limits<std::uint64_t>::max();
  write_mesh(folder / "mesh.safetensors", mesh, {1, 5});
  manifest.mesh_checksum = hash_file(folder / "mesh.safetensors");
  const auto add = [&](std::vector<RecordInfo>& records, const std::string& name,
                       std::uint64_t seed) {
    records.push_back({name, seed, kFrames, ""});
    records.back().checksum = write_trajectory(folder / name, mesh.n_vertices(), seed);
  };
  add(manifest.train, "train/000.safetensors", 1);
  add(manifest.train, "train/001.safetensors", 2);
  add(manifest.validation, "val/000.safetensors", 3);
  write_manifest(folder / "manifest.json", manifest);
  return manifest;
}

// A manifest with null in place of its own checksum, as one that is written by hand.
std::string unsealed(const std::string& manifest) {
  const std::size_t at = manifest.rfind("\"checksum\": ") + 12;
  return manifest.substr(0, at) + "null\n}\n";
}

// What opening says after `from` in the manifest has become `to`.
std::string refusal(const std::string& from, const std::string& to) {
  const test::Folder folder;
  write_dataset(folder.path());
  const Path path = folder / "manifest.json";
  put(path, replaced(unsealed(get(path)), from, to));
  return test::message<InputError>([&] { Dataset::open(folder.path()); });
}

}  // namespace

TEST_SUITE("nmp/dataset") {
  TEST_CASE("reads back what was written") {
    const test::Folder folder;
    const Manifest written = write_dataset(folder.path());
    const Dataset data = Dataset::open(folder.path());
    const Manifest& manifest = data.manifest();
    CHECK(manifest.scene_name == written.scene_name);
    CHECK(manifest.scene_toml == written.scene_toml);
    CHECK(manifest.physics.material.law == "stvk");
    CHECK(manifest.physics.material.E == written.physics.material.E);
    CHECK(manifest.physics.material.nu == 0.1);
    CHECK(manifest.physics.material.density == 7);
    CHECK(manifest.physics.gravity == written.physics.gravity);
    CHECK(manifest.physics.ground == -0.1);
    CHECK(manifest.physics.pinned == std::vector<int>{1, 5});
    CHECK(manifest.law_known);
    CHECK(manifest.dt == 1e-5);
    CHECK(manifest.substeps == 50);
    CHECK(manifest.h == 5e-4);
    CHECK(manifest.frames == kFrames);
    CHECK(manifest.seed == written.seed);
    CHECK(manifest.validation[0].seed == 3);
    CHECK(manifest.validation[0].checksum == written.validation[0].checksum);
    CHECK(data.mesh().vertices() == fem::cube_mesh(3, 1).vertices());
    CHECK(data.mesh().tets() == fem::cube_mesh(3, 1).tets());
    CHECK(data.stagger() == doctest::Approx(0.49));
    CHECK_NOTHROW(data.verify());

    REQUIRE(data.train().size() == 2);
    REQUIRE(data.validation().size() == 1);
    const Trajectory& trajectory = data.train()[1];
    CHECK(trajectory.name() == "train/001.safetensors");
    CHECK(trajectory.frames() == kFrames);
    CHECK(trajectory.has_force());
    for (Index t = 0; t <= kFrames; ++t) {
      const auto stream = 200 + 10 * static_cast<std::uint64_t>(t);
      const fem::State<float> state = trajectory.state<float>(t);
      CHECK(state.x == random_frame(27, stream).cast<float>());
      CHECK(state.v == random_frame(27, stream + 1).cast<float>());
      Matrix<double> f_int(27, 3);
      trajectory.read_force<double>(t, f_int);
      CHECK(f_int.cast<float>() == random_frame(27, stream + 2).cast<float>());
    }
    Matrix<float> x(27, 3), wrong(26, 3);
    CHECK_THROWS_AS(trajectory.read_x<float>(-1, x), std::invalid_argument);
    CHECK_THROWS_AS(trajectory.read_x<float>(kFrames + 1, x), std::invalid_argument);
    CHECK_THROWS_AS(trajectory.read_v<float>(0, wrong), std::invalid_argument);
  }

  TEST_CASE("an unknown law, an unknown step and no ground stay unknown") {
    const test::Folder folder;
    Manifest manifest = write_dataset(folder.path());
    manifest.law_known = false;
    manifest.dt = 0;
    manifest.substeps = 0;
    manifest.physics.ground.reset();
    write_manifest(folder / "manifest.json", manifest);
    const Dataset data = Dataset::open(folder.path());
    CHECK_FALSE(data.manifest().law_known);
    CHECK_FALSE(data.manifest().physics.ground.has_value());
    CHECK(data.stagger() == 0.5);
  }

  TEST_CASE("what projective dynamics knows of a scene reads back, and is checked") {
    const test::Folder folder;
    Manifest manifest = write_dataset(folder.path());
    manifest.physics.material.law = "projective";
    manifest.physics.material.volume_weight = 2.5;
    manifest.physics.contact = {"coulomb", 0.25, 10, 20, 30};
    write_manifest(folder / "manifest.json", manifest);
    const fem::Physics read = Dataset::open(folder.path()).manifest().physics;
    CHECK(read.material.volume_weight == 2.5);
    CHECK(read.contact.law == "coulomb");
    CHECK(read.contact.friction == 0.25);
    CHECK(read.contact.k_n == 10);
    CHECK(read.contact.k_f == 20);
    CHECK(read.contact.penalty_friction == 30);
    manifest.physics.contact.law = "glue";
    write_manifest(folder / "manifest.json", manifest);
    CHECK(contains(test::message<InputError>([&] { Dataset::open(folder.path()); }),
                   "contact: the contact law must be"));
  }

  TEST_CASE("a trajectory from elsewhere may have no forces and any alignment") {
    const test::Folder folder;
    const Path path = folder / "a.safetensors";
    std::string header = R"({"x":{"dtype":"F32","shape":[2,4,3],"data_offsets":[1,97]},)"
                         R"("v":{"dtype":"F32","shape":[2,4,3],"data_offsets":[97,193]},)"
                         R"("pad":{"dtype":"U8","shape":[1],"data_offsets":[0,1]}})";
    const std::uint64_t length = header.size();
    std::string bytes(reinterpret_cast<const char*>(&length), 8);
    bytes += header + '\0';
    std::vector<float> values(48);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<float>(i);
    bytes.append(reinterpret_cast<const char*>(values.data()), 4 * values.size());
    put(path, bytes);

    const Trajectory trajectory(path, {"a.safetensors", 0, 1, ""}, 4);
    CHECK_FALSE(trajectory.has_force());
    const fem::State<double> state = trajectory.state<double>(1);
    CHECK(state.x(0, 0) == 12);
    CHECK(state.x(3, 2) == 23);
    CHECK(state.v(1, 1) == 40);
    Matrix<float> f_int(4, 3);
    CHECK_THROWS_AS(trajectory.read_force<float>(0, f_int), InputError);
    CHECK_THROWS_AS(Trajectory(path, {"a.safetensors", 0, 2, ""}, 4), InputError);
    CHECK_THROWS_AS(Trajectory(path, {"a.safetensors", 0, 1, ""}, 5), InputError);
    // 2^31 - 1 states of 2^62 numbers: no product is formed that could wrap.
    CHECK_THROWS_AS(Trajectory(path, {"a.safetensors", 0, 2147483646, ""}, Index(1) << 62),
                    InputError);
  }

  TEST_CASE("numbers beyond the 2^31st of a file are where they belong (LB6)") {
    const test::Folder folder;
    const Path path = folder / "x.safetensors";
    constexpr Index kVertices = 100000, kLast = 7200;  // 8.6 GB, all but a part of it a hole
    constexpr std::uint64_t kFrameBytes = 12 * kVertices;
    const std::string header = text(R"({"x":{"dtype":"F32","shape":[)", kLast + 1, ",", kVertices,
                                    R"(,3],"data_offsets":[0,)", kFrameBytes * (kLast + 1), "]}}");
    const std::uint64_t length = header.size();
    put(path, std::string(reinterpret_cast<const char*>(&length), 8) + header);
    fs::resize_file(path, 8 + length + kFrameBytes * (kLast + 1));
    Matrix<float> x = Matrix<float>::Random(kVertices, 3), read(kVertices, 3);
    const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> rows = x;
    std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(8 + length + kFrameBytes * kLast));
    file.write(reinterpret_cast<const char*>(rows.data()), kFrameBytes);
    file.close();
    const Trajectory trajectory(path, {"x.safetensors", 0, kLast, ""}, kVertices, 1e-3);
    trajectory.read_x<float>(kLast, read);
    CHECK(read == x);
    trajectory.read_x<float>(kLast - 1, read);
    CHECK(read.isZero(0));
  }

  TEST_CASE("velocities that are not recorded are differences, exact for a parabola") {
    const test::Folder folder;
    const Path path = folder / "x.safetensors";
    for (const Index frames : {0, 1, 2, 5}) {
      CAPTURE(frames);
      const double h = 0.25;
      const Matrix<double> p = random_frame(4, 1).cast<float>().cast<double>();
      {
        TrajectoryWriter writer(path, frames, 4, 0, h, "", {"x"});
        for (Index t = 0; t <= frames; ++t) {
          const double time = h * static_cast<double>(t);
          writer.write(t, "x", (1 + 2 * time + 4 * time * time) * p);
        }
        CHECK_THROWS_AS(writer.write(0, "v", p), std::invalid_argument);
        writer.commit();
      }
      const RecordInfo info{"x.safetensors", 0, frames, ""};
      CHECK(contains(test::message<InputError>([&] { Trajectory(path, info, 4); }), "tensor 'v'"));
      const Trajectory trajectory(path, info, 4, h);
      CHECK_FALSE(trajectory.has_velocity());
      CHECK_FALSE(trajectory.has_force());
      Matrix<double> v(4, 3), wrong(5, 3);
      for (Index t = 0; t <= frames; ++t) {
        trajectory.read_v<double>(t, v);
        const double slope = frames == 0   ? 0
                             : frames == 1 ? 2 + 4 * h
                                           : 2 + 8 * h * static_cast<double>(t);
        CHECK((v - slope * p).cwiseAbs().maxCoeff() < 1e-5);  // measured 3e-6: x is float
      }
      CHECK_THROWS_AS(trajectory.read_v<double>(frames + 1, v), std::invalid_argument);
      CHECK_THROWS_AS(trajectory.read_v<double>(0, wrong), std::invalid_argument);
    }
  }

  TEST_CASE("a manifest of another program needs no checksums, steps, seeds, law or scene") {
    const test::Folder folder;
    const Manifest written = write_dataset(folder.path());
    const auto put_manifest = [&](const std::string& more) {
      put(folder / "manifest.json",
          R"({"format": "nmp-dataset", "version": 1, "checksum": null, "gravity": [0, 0, -9.8],
              "ground": null, "h": 5e-4, "frames": 3, "n_vertices": 27, "n_tets": )" +
              std::to_string(written.n_tets) +
              R"(, "train": [{"name": "train/000.safetensors"}], "validation": [])" + more + "}");
    };
    put_manifest("");
    const Dataset data = Dataset::open(folder.path());
    const Manifest& manifest = data.manifest();
    CHECK(manifest.scene_name == folder.path().filename().string());
    CHECK_FALSE(manifest.law_known);
    CHECK(manifest.physics.material.density == 1000);
    CHECK(manifest.dt == 0);
    CHECK(data.train()[0].frames() == 3);
    CHECK_NOTHROW(data.verify());
    CHECK(data.stagger() == 0.5);
    put_manifest(R"(, "material": {"density": 7, "E": null}, "dt": null, "mesh": null)");
    CHECK(Dataset::open(folder.path()).manifest().physics.material.density == 7);
    for (const auto& each : std::vector<std::pair<const char*, const char*>>{
             {R"(, "material": {"law": "stvk"})", "material.E: expected a value, found none"},
             {R"(, "material": [])", "material: expected an object"},
             {R"(, "material": {"density": -7})", "material.density: expected a number"},
             {R"(, "mesh": {"checksum": null})", "mesh.name: expected a value"},
             {R"(, "mesh": {"name": "mesh.safetensors", "checksum": "1"})", "mesh.checksum"},
             {R"(, "seed": -1)", "seed: expected an integer"}}) {
      const char* const more = each.first;
      CAPTURE(more);
      put_manifest(more);
      CHECK(
          contains(test::message<InputError>([&] { Dataset::open(folder.path()); }), each.second));
    }
    // What it says of itself goes in and out unchanged.
    Manifest bare = manifest;
    bare.train[0].checksum = bare.mesh_checksum = "";
    write_manifest(folder / "manifest.json", bare);
    const Manifest again = read_manifest(folder / "manifest.json");
    CHECK_FALSE(again.law_known);
    CHECK(again.train[0].checksum.empty());
    CHECK(again.mesh_checksum.empty());
  }

  TEST_CASE("a file above 4 GB is read at its end") {
    const test::Folder folder;
    const Path path = folder / "big.safetensors";
    static constexpr std::uint64_t kStates = 200'000, kVertices = 1000;
    static constexpr std::uint64_t kBytes = kStates * kVertices * 12;
    const auto tensor = [](const char* name, std::uint64_t begin) {
      return text('"', name, R"(":{"dtype":"F32","shape":[)", kStates, ',', kVertices,
                  R"(,3],"data_offsets":[)", begin, ',', begin + kBytes, "]}");
    };
    std::string header =
        text('{', tensor("x", 0), ',', tensor("v", kBytes), ',', tensor("f_int", 2 * kBytes), '}');
    header.resize((header.size() + 63) / 64 * 64 - 8, ' ');
    if (header.size() % 64 != 56) header.append(64, ' ');
    const std::uint64_t length = header.size();
    put(path, std::string(reinterpret_cast<const char*>(&length), 8) + header);
    REQUIRE(::truncate(path.c_str(), static_cast<off_t>(8 + length + 3 * kBytes)) == 0);
    {
      const float mark = 2.5f;
      std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(static_cast<std::streamoff>(8 + length + 3 * kBytes - 4));
      file.write(reinterpret_cast<const char*>(&mark), 4);
      REQUIRE(file.good());
    }
    const Trajectory trajectory(path, {"big.safetensors", 0, kStates - 1, ""}, kVertices);
    Matrix<float> f_int(kVertices, 3);
    trajectory.read_force<float>(kStates - 1, f_int);
    CHECK(f_int(kVertices - 1, 2) == 2.5f);
    CHECK(f_int.sum() == 2.5f);
  }

  TEST_CASE("every bit flip and every truncation of a manifest is detected (CK5)") {
    const test::Folder folder;
    write_dataset(folder.path());
    const Path path = folder / "manifest.json";
    const std::string whole = get(path);
    REQUIRE(whole.size() < 4096);
    const auto accepted = [&](const std::string& content) {
      put(path, content);
      try {
        read_manifest(path);
        return true;
      } catch (const InputError& error) {
        CHECK(contains(error.what(), path.string()));
        return false;
      }
    };
    CHECK(accepted(whole));
    CHECK(accepted(unsealed(whole)));
    std::size_t missed = 0;
    for (std::size_t n = 0; n < whole.size(); ++n) missed += accepted(whole.substr(0, n));
    for (std::size_t i = 0; i < whole.size(); ++i) {
      std::string flipped = whole;
      flipped[i] = static_cast<char>(flipped[i] ^ (1 << i % 8));
      missed += accepted(flipped);
    }
    CHECK(missed == 0);
    CHECK_FALSE(accepted(replaced(whole, "\"seed\": ", "\"seed\": 1")));
    CHECK_FALSE(accepted(whole + " "));
  }

  TEST_CASE("endless and sparse files are refused without reading them") {
    const test::Folder folder;
    CHECK_THROWS_AS(read_manifest("/dev/zero"), IoError);
    CHECK_THROWS_AS(Trajectory("/dev/zero", {"zero", 0, 1, ""}, 4), IoError);
    const Path path = folder / "sparse";
    put(path, "");
    REQUIRE(::truncate(path.c_str(), off_t{5} << 30) == 0);
    CHECK(contains(test::message<InputError>([&] {
                     Trajectory(path, {"x", 0, 1, ""}, 4);
                   }),
                   "found a header length of 0"));
    CHECK(contains(test::message<InputError>([&] { read_manifest(path); }),
                   "expected at most 67108864 bytes"));
    // A header that claims the whole of it.
    const std::uint64_t length = (std::uint64_t{5} << 30) - 8;
    {
      std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
      file.write(reinterpret_cast<const char*>(&length), 8);
    }
    CHECK(contains(test::message<InputError>([&] {
                     Trajectory(path, {"x", 0, 1, ""}, 4);
                   }),
                   "expected a header of at most 16777216 bytes"));
  }

  TEST_CASE("a manifest that is not what it should be is refused with the place") {
    const std::string newer = refusal("\"version\": 1", "\"version\": 2");
    CHECK(contains(newer, "version 2, newer than version 1"));
    CHECK(contains(refusal("\"version\": 1", "\"version\": 0"), "version: expected an integer"));
    CHECK(contains(refusal("nmp-dataset", "other"), "format: expected \"nmp-dataset\""));
    CHECK(contains(refusal("\"h\": 0.0005", "\"h\": 0.0006"), "h: expected dt * substeps = 5e-04"));
    CHECK(contains(refusal("\"h\": 0.0005", "\"h\": \"x\""), "h: expected a number"));
    CHECK(contains(refusal("\"h\": 0.0005", "\"h\": 1e999"), "manifest.json"));
    CHECK(contains(refusal("\"h\": 0.0005", "\"h\": NaN"), "line 2"));
    CHECK(contains(refusal("\"h\": 0.0005", "\"hh\": 0.0005"), "h: expected a value, found none"));
    CHECK(contains(refusal("\"frames\": 3,\n  \"n_v", "\"frames\": 3.5,\n  \"n_v"),
                   "frames: expected an integer"));
    CHECK(contains(refusal("\"n_vertices\": 27", "\"n_vertices\": 99999999999999999999"),
                   "n_vertices: expected an integer from 4 to 2147483647"));
    CHECK(contains(refusal("\"n_vertices\": 27", "\"n_vertices\": -27"), "found -27"));
    CHECK(contains(refusal("\"n_vertices\": 27", "\"n_vertices\": 28"), "tensor 'vertices'"));
    CHECK(contains(refusal("\"nu\": 0.1", "\"nu\": 0.5"), "material: nu"));
    CHECK(contains(refusal("\"stvk\"", "\"mooney\""), "mooney"));
    CHECK(contains(refusal("\"seed\": 3", "\"seed\": -3"), "validation[0].seed"));
    CHECK(contains(refusal("\"gravity\": [", "\"gravity\": [1, "), "gravity: expected an array"));
    CHECK(contains(refusal("\"train\": [", "\"train\": [" + std::string(1000, '[')),
                   "nesting depth"));
    CHECK(contains(refusal("train/001.safetensors", "train/000.safetensors"), "every file once"));
    CHECK(contains(refusal("\"name\": \"mesh.safetensors\"", "\"name\": \"other\""), "mesh.name"));
    CHECK(contains(refusal("}\n", "}\n}"), "JSON"));
    // More states than the file has; shapes are compared, never multiplied.
    const test::Folder folder;
    const Manifest manifest = write_dataset(folder.path());
    Manifest longer = manifest;
    longer.frames = longer.train[0].frames = 2147483646;
    write_manifest(folder / "manifest.json", longer);
    CHECK(contains(test::message<InputError>([&] { Dataset::open(folder.path()); }),
                   "000.safetensors: tensor 'x'"));
  }

  TEST_CASE("names that leave the folder are refused") {
    for (const char* name :
         {"../val/000.safetensors", "train/../../x", "/etc/passwd", "", "train\\\\x", "./x", "x/",
          "a//../b", "C:x", "x\\u0000y", "x\\u001b[31my"}) {
      CAPTURE(name);
      const std::string why = refusal("train/001.safetensors", name);
      CHECK(contains(why, "train[1].name: expected the name of a file inside the folder"));
      CHECK(why.find('\x1b') == std::string::npos);
    }
  }

  TEST_CASE("links that leave the folder are refused, links inside are followed") {
    const test::Folder folder, outside;
    write_dataset(folder.path());
    fs::rename(folder / "train/001.safetensors", outside / "x.safetensors");
    fs::create_symlink(outside / "x.safetensors", folder / "train/001.safetensors");
    CHECK(contains(test::message<InputError>([&] { Dataset::open(folder.path()); }),
                   "found a link that leads out of it"));
    fs::remove(folder / "train/001.safetensors");
    fs::rename(outside / "x.safetensors", folder / "train/there.safetensors");
    fs::create_symlink("there.safetensors", folder / "train/001.safetensors");
    CHECK_NOTHROW(Dataset::open(folder.path()).verify());

    fs::rename(folder / "val", outside / "val");
    fs::create_symlink(outside / "val", folder / "val");
    CHECK_THROWS_AS(Dataset::open(folder.path()), InputError);
    // The folder as a whole may be reached by a link.
    fs::remove(folder / "val");
    fs::rename(outside / "val", folder / "val");
    fs::create_directory_symlink(folder.path(), outside / "link");
    CHECK_NOTHROW(Dataset::open(outside / "link"));
  }

  TEST_CASE("files that are missing, damaged or no files are refused") {
    const test::Folder folder;
    write_dataset(folder.path());
    const Path record = folder / "train/000.safetensors";
    const std::string whole = get(record);

    put(record, whole.substr(0, whole.size() - 1));
    CHECK_THROWS_AS(Dataset::open(folder.path()), InputError);
    put(record, "");
    CHECK_THROWS_AS(Dataset::open(folder.path()), InputError);
    fs::remove(record);
    CHECK_THROWS_AS(Dataset::open(folder.path()), IoError);
    fs::create_directory(record);
    CHECK_THROWS_AS(Dataset::open(folder.path()), IoError);
    fs::remove(record);
    REQUIRE(::mkfifo(record.c_str(), 0600) == 0);
    CHECK_THROWS_AS(Dataset::open(folder.path()), IoError);
    fs::remove(record);

    std::string flipped = whole;
    flipped.back() = static_cast<char>(flipped.back() ^ 1);
    put(record, flipped);
    const Dataset data = Dataset::open(folder.path());
    CHECK(contains(test::message<InputError>([&] { data.verify(); }), "000.safetensors: expected"));

    put(record, replaced(whole, R"("version":"1")", R"("version":"7")"));
    CHECK(contains(test::message<InputError>([&] { Dataset::open(folder.path()); }),
                   "version 7, newer than version 1"));
    put(record, whole);

    const Path mesh = folder / "mesh.safetensors";
    const std::string mesh_bytes = get(mesh);
    write_mesh(mesh, fem::cube_mesh(3, 2), {1, 5});
    CHECK(contains(test::message<InputError>([&] { Dataset::open(folder.path()); }),
                   "mesh.safetensors: expected the checksum"));
    put(mesh, mesh_bytes);
    CHECK_NOTHROW(Dataset::open(folder.path()).verify());

    fs::remove(folder / "manifest.json");
    CHECK_THROWS_AS(Dataset::open(folder.path()), IoError);
    CHECK_THROWS_AS(Dataset::open(folder / "nowhere"), IoError);
  }

  TEST_CASE("a mesh that is none is refused though its checksum fits") {
    const test::Folder folder;
    Manifest manifest = write_dataset(folder.path());
    const auto open_with = [&](auto&& change) {
      write_mesh(folder / "mesh.safetensors", fem::cube_mesh(3, 1), {1, 5});
      std::string bytes = get(folder / "mesh.safetensors");
      const TensorFile file = TensorFile::open(folder / "mesh.safetensors");
      const auto at = [&](const char* name) {
        return bytes.size() - file.tensors().at("tets").end + file.tensors().at(name).begin;
      };
      change(bytes, at);
      put(folder / "mesh.safetensors", bytes);
      manifest.mesh_checksum = hash_file(folder / "mesh.safetensors");
      write_manifest(folder / "manifest.json", manifest);
      return test::message<InputError>([&] { Dataset::open(folder.path()); });
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const std::int32_t large = 27, negative = -1;
    CHECK(contains(open_with([&](std::string& bytes, auto at) {
                     std::memcpy(&bytes[at("vertices")], &nan, 8);
                   }),
                   "vertices: expected finite numbers"));
    CHECK(contains(
        open_with([&](std::string& bytes, auto at) { std::memcpy(&bytes[at("tets")], &large, 4); }),
        "mesh.safetensors"));
    CHECK(contains(open_with([&](std::string& bytes, auto at) {
                     std::memcpy(&bytes[at("pinned")], &negative, 4);
                   }),
                   "pinned: expected vertices from 0 to 26, found -1"));
  }

  TEST_CASE("every part can be read from memory, without a folder") {
    const test::Folder folder;
    const Manifest written = write_dataset(folder.path());
    const std::string text = get(folder / "manifest.json");
    CHECK(parse_manifest(text, "m").mesh_checksum == written.mesh_checksum);
    CHECK(
        contains(test::message<InputError>([&] { parse_manifest(replaced(text, "27", "x"), "m"); }),
                 "m: line 24: expected JSON text"));
    CHECK(contains(
        test::message<InputError>([&] { parse_manifest(text + std::string(3'000'000, ','), "m"); }),
        "expected a count of values of at most 2400000, found more"));

    const std::string mesh_bytes = get(folder / "mesh.safetensors");
    const auto mesh_file = [&] {
      return TensorFile::parse(reinterpret_cast<const std::byte*>(mesh_bytes.data()),
                               mesh_bytes.size(), "mesh");
    };
    const DatasetMesh body = read_mesh(mesh_file());
    CHECK(body.mesh.vertices() == fem::cube_mesh(3, 1).vertices());
    CHECK(body.pinned == std::vector<int>{1, 5});
    CHECK(contains(test::message<InputError>([&] { read_mesh(mesh_file(), 28); }),
                   "mesh: tensor 'vertices': expected F64 of shape [28, 3]"));

    const std::string record = get(folder / "train/001.safetensors");
    const Trajectory trajectory(
        TensorFile::parse(reinterpret_cast<const std::byte*>(record.data()), record.size(), "t"),
        written.train[1], 27);
    CHECK(trajectory.state<float>(2).x == random_frame(27, 220).cast<float>());
  }

  TEST_CASE("a mesh without pins has an empty tensor for them") {
    const test::Folder folder;
    write_mesh(folder / "mesh.safetensors", fem::cube_mesh(2, 1), {});
    const TensorFile file = TensorFile::open(folder / "mesh.safetensors");
    CHECK(file.values<std::int32_t>("pinned", {0}).empty());
    CHECK(file.metadata("what") == "nmp-mesh");
  }

  TEST_CASE("a trajectory that is not whole does not appear") {
    const test::Folder folder;
    {
      TrajectoryWriter writer(folder / "a.safetensors", 2, 4, 1, 5e-4);
      const Matrix<double> frame = random_frame(4, 1), wrong = random_frame(5, 1);
      writer.write(0, frame, frame, frame);
      CHECK_THROWS_AS(writer.write(3, frame, frame, frame), std::invalid_argument);
      CHECK_THROWS_AS(writer.write(-1, frame, frame, frame), std::invalid_argument);
      CHECK_THROWS_AS(writer.write(1, frame, wrong, frame), std::invalid_argument);
      CHECK_THROWS(writer.commit());
    }
    CHECK(fs::is_empty(folder.path()));
  }
}
