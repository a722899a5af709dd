#include "nmp/export.h"

#include <cmath>
#include <cstring>
#include <sstream>

#include "fem/pvd.h"
#include "fem/surface_writer.h"
#include "fem/vtu_grid.h"
#include "nmp/recorded.h"

using namespace nmp;
using test::contains;
using test::get;
namespace fs = std::filesystem;

namespace {

ExportSource source_of(const Dataset& data) {
  return {data.mesh(), {}, &data.validation()[0], data.manifest().h, nullptr, {}};
}

ExportOptions options_of(const std::string& format, Index every = 1) {
  ExportOptions options;
  options.format = format;
  options.every = every;
  return options;
}

std::size_t n_files(const Path& folder) {
  return static_cast<std::size_t>(
      std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

// An array of floats in cells; our reader takes those at points alone.
std::vector<double> cell_array(const std::string& vtu, const std::string& name, Index n) {
  const std::size_t at = vtu.find("Name=\"" + name + "\"");
  REQUIRE(at != std::string::npos);
  const std::size_t offset = std::stoul(vtu.substr(vtu.find("offset=\"", at) + 8));
  const std::size_t from = vtu.find("\n_") + 2 + offset + 8;
  std::vector<double> values;
  for (Index i = 0; i < n; ++i) {
    float value;
    std::memcpy(&value, vtu.data() + from + 4 * i, 4);
    values.push_back(static_cast<double>(value));
  }
  return values;
}

}  // namespace

TEST_SUITE("nmp/export") {
  TEST_CASE(
      "a collection holds every frame to the last bit, its time, and the error of a rollout") {
    const test::Folder folder;
    const Dataset& data = test::tiny_dataset(20);
    ExportSource source = source_of(data);
    source.record = &data.validation()[1];
    source.pinned = {2};
    std::vector<double> parts;
    ExportOptions options = options_of("vtu", 3);
    options.progress = [&](double part) { parts.push_back(part); };
    const Exported done = export_frames(source, folder / "run.pvd", options);
    CHECK(done.file == folder / "run.pvd");
    CHECK(done.n_frames == 7);
    CHECK(parts.size() == 7);
    CHECK(parts.back() == 1);
    CHECK(n_files(folder.path()) == 2);  // nothing temporary stays
    const auto entries = fem::read_pvd(get(folder / "run.pvd"), "run.pvd");
    REQUIRE(entries.size() == 7);
    CHECK(entries[6].file == "run/frame_0018.vtu");
    for (std::size_t k = 0; k < 7; ++k) {
      const auto t = static_cast<Index>(3 * k);
      CHECK(entries[k].time == static_cast<double>(t) * data.manifest().h);
      const fem::VtuGrid grid = fem::read_vtu_grid(get(folder / entries[k].file), entries[k].file,
                                                   {"v", "f_int", "error"});
      const fem::State<double> state = source.frames->state<double>(t);
      CHECK(grid.mesh.vertices == state.x);
      CHECK(grid.mesh.tets == data.mesh().tets());
      CHECK(grid.point_data.at("v") == state.v);
      Matrix<double> f(27, 3);
      source.frames->read_force<double>(t, f);
      CHECK(grid.point_data.at("f_int") == f);
      const Matrix<double> error = state.x - source.record->state<double>(t).x;
      CHECK(grid.point_data.at("error") == error.cast<float>().cast<double>());
    }
    const fem::VtuGrid rest =
        fem::read_vtu_grid(get(folder / "run/rest.vtu"), "rest.vtu", {"pinned"});
    CHECK(rest.mesh.vertices == data.mesh().vertices());
    CHECK(rest.point_data.at("pinned").sum() == 1);
    CHECK(rest.point_data.at("pinned")(2, 0) == 1);
  }

  TEST_CASE("von Mises stress and energy of a uniform stretch; none where the law is not defined") {
    const test::Folder folder;
    test::Recording recording;
    const double s = 1.1;
    Matrix<double> x = recording.mesh.vertices();
    const Matrix<double> zero = Matrix<double>::Zero(27, 3);
    test::Record record;
    x.col(0) *= s;
    record.add(x, zero, zero);
    x.col(0) *= -1;
    record.add(x, zero, zero);
    recording.train = {record};
    const Dataset data = test::write_dataset(folder / "d", recording);
    ExportSource source{data.mesh(), {}, &data.train()[0], 5e-4, nullptr, {}};
    source.material = data.manifest().physics.material;
    export_frames(source, folder / "f", options_of("vtu"));
    // P = mu F + (lambda log J - mu) F^-T, along x and across; sigma = P F^T / J.
    const fem::Lame c = fem::lame(5e5, 0.45);
    const double along = (c.mu * s + (c.lambda * std::log(s) - c.mu) / s) * s / s;
    const double across = (c.lambda * std::log(s)) / s;
    const std::string stretched = get(folder / "f/frame_0000.vtu");
    const Index n = data.mesh().n_tets();
    for (const double value : cell_array(stretched, "von_mises", n))
      CHECK(value == doctest::Approx(std::abs(along - across)).epsilon(1e-5));
    const double log_J = std::log(s);
    const double Psi = c.mu / 2 * (s * s + 2 - 3) - c.mu * log_J + c.lambda / 2 * log_J * log_J;
    for (const double value : cell_array(stretched, "energy", n))
      CHECK(value == doctest::Approx(Psi).epsilon(1e-5));
    for (const double value : cell_array(stretched, "det_F", n))
      CHECK(value == doctest::Approx(s).epsilon(1e-6));
    const std::string inverted = get(folder / "f/frame_0001.vtu");
    for (const double value : cell_array(inverted, "von_mises", n)) CHECK(std::isnan(value));
    for (const double value : cell_array(inverted, "det_F", n)) CHECK(value < -1);
  }

  TEST_CASE("surfaces and the point cache move the same vertices") {
    const test::Folder folder;
    const Dataset& data = test::tiny_dataset(20);
    const ExportSource source = source_of(data);
    const fem::Surface surface = fem::extract_surface(data.mesh().tets());
    const Exported obj = export_frames(source, folder / "s", options_of("obj", 10));
    CHECK(obj.file == folder / "s/frame_0000.obj");
    CHECK(get(folder / "s/times.csv") ==
          "file,time [s]\nframe_0000.obj,0\nframe_0010.obj,0.005\nframe_0020.obj,0.01\n");
    export_frames(source, folder / "c.pc2", options_of("pc2", 10));
    const std::string cache = get(folder / "c.pc2");
    REQUIRE(surface.vertices.size() == 26);
    REQUIRE(cache.size() == 32 + 3 * 26 * 12);
    for (Index k = 0; k < 3; ++k) {
      const Matrix<float> x = source.frames->state<float>(10 * k).x;
      std::istringstream lines(get(folder / ("s/frame_00" + std::to_string(k) + "0.obj")));
      for (std::size_t i = 0; i < 26; ++i) {
        std::string tag;
        lines >> tag;
        CHECK(tag == "v");
        for (Index c = 0; c < 3; ++c) {
          float in_obj, in_cache;
          lines >> in_obj;
          std::memcpy(&in_cache,
                      cache.data() + 32 + 4 * (static_cast<std::size_t>(3 * (26 * k) + c) + 3 * i),
                      4);
          CHECK(in_obj == x(surface.vertices[i], c));
          CHECK(in_cache == in_obj);
        }
      }
    }
    Matrix<float> rest(26, 3);
    for (std::size_t i = 0; i < 26; ++i)
      rest.row(static_cast<Index>(i)) =
          data.mesh().vertices().row(surface.vertices[i]).cast<float>();
    CHECK(get(folder / "c.obj") == fem::to_obj(rest, surface.triangles));
    CHECK_THROWS_AS(export_frames(source, folder / "c.obj", options_of("pc2")), ConfigError);
    CHECK_THROWS_AS(export_frames(source, folder / "x", options_of("usd")), ConfigError);
  }

  TEST_CASE("what is interrupted leaves nothing, and what was there stays") {
    for (const auto& each : std::vector<std::pair<const char*, const char*>>{
             {"vtu", "f"}, {"vtu", "f.pvd"}, {"obj", "f"}, {"pc2", "f.pc2"}}) {
      const char* const format = each.first;
      const char* const name = each.second;
      CAPTURE(name);
      const test::Folder folder;
      const ExportSource source = source_of(test::tiny_dataset(20));
      ExportOptions stopped = options_of(format);
      stopped.progress = [](double part) {
        if (part > 0.5) throw std::runtime_error("stop");
      };
      CHECK_THROWS_AS(export_frames(source, folder / name, stopped), std::runtime_error);
      CHECK(n_files(folder.path()) == 0);

      const Exported done = export_frames(source, folder / name, options_of(format));
      const std::string before = get(done.file);
      CHECK_THROWS_AS(export_frames(source, folder / name, options_of(format)), ConfigError);
      stopped.force = true;
      CHECK_THROWS_AS(export_frames(source, folder / name, stopped), std::runtime_error);
      CHECK(get(done.file) == before);
      ExportOptions again = options_of(format, 20);
      again.force = true;
      CHECK(export_frames(source, folder / name, again).n_frames == 2);
      CHECK_FALSE(fs::exists(folder / "f/frame_0001.vtu"));
      CHECK_FALSE(fs::exists(folder / "f/frame_0001.obj"));
    }
  }

  TEST_CASE("a folder with somebody's files is not replaced, an empty one is filled") {
    const test::Folder folder;
    const ExportSource source = source_of(test::tiny_dataset(20));
    ExportOptions options = options_of("vtu", 20);
    options.force = true;
    fs::create_directory(folder / "f");
    test::put(folder / "f/frame_0001.txt", "mine");
    CHECK(
        contains(test::message<ConfigError>([&] { export_frames(source, folder / "f", options); }),
                 "holds 'frame_0001.txt', which would be lost"));
    fs::remove(folder / "f/frame_0001.txt");
    options.force = false;
    export_frames(source, folder / "f/", options);
    CHECK(fs::exists(folder / "f/frames.pvd"));
    test::put(folder / "file", "mine");
    options.force = true;
    CHECK_THROWS_AS(export_frames(source, folder / "file", options), IoError);
    CHECK_THROWS_AS(export_frames(source, folder / "no/folder", options), IoError);
    CHECK(get(folder / "file") == "mine");
  }
}
