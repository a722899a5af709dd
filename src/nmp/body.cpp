#include "nmp/body.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <utility>

#include "base/check.h"
#include "fem/mesh_check.h"
#include "fem/mesh_cube.h"
#include "fem/stability.h"
#include "nmp/config.h"

namespace nmp {
namespace {

namespace fs = std::filesystem;

std::string extent(const fem::TetMesh<double>& mesh) {
  std::string words;
  for (Index k = 0; k < 3; ++k) {
    words += (k > 0 ? std::string(", ") : "") + "xyz"[k];
    words +=
        text(" ", mesh.vertices().col(k).minCoeff(), " to ", mesh.vertices().col(k).maxCoeff());
  }
  return words + " m";
}

// To two significant digits.
double rounded_down(double value) {
  const double digit = std::pow(10, std::floor(std::log10(value)) - 1);
  return std::floor(value / digit) * digit;
}

// A pinned body is not lifted above the ground: it must not begin below it.
void check_ground(const Scene& scene, const Body& body) {
  if (body.pinned.empty() || !scene.physics.ground) return;
  const double lowest = body.mesh.vertices().col(2).minCoeff(), ground = *scene.physics.ground;
  if (lowest >= ground - 1e-9 * body.mesh.diagonal()) return;
  throw ConfigError(text("contact.ground: the pinned body reaches down to z = ", lowest,
                         " m, below the ground at ", ground,
                         " m; set contact.ground to \"none\" (--set contact.ground=none) or to at "
                         "most ",
                         lowest));
}

}  // namespace

std::vector<int> find_pins(const Scene& scene, const fem::TetMesh<double>& mesh) {
  const Index n = mesh.n_vertices();
  std::vector<char> held(static_cast<std::size_t>(n), 0);
  for (const int v : scene.physics.pinned) {
    if (v < 0 || v >= n) {
      throw ConfigError(text("pins.vertices: expected vertices from 0 to ", n - 1, ", found ", v));
    }
    held[static_cast<std::size_t>(v)] = 1;
  }
  const auto apply = [&](const char* key, const Matrix<double>& rules,
                         const std::function<bool(const Vec3<double>&, Index)>& holds) {
    for (Index i = 0; i < rules.rows(); ++i) {
      Index count = 0;
      for (Index v = 0; v < n; ++v) {
        if (!holds(mesh.vertices().row(v).transpose(), i)) continue;
        held[static_cast<std::size_t>(v)] = 1;
        ++count;
      }
      if (count > 0) continue;
      throw ConfigError(text(key, ": rule ", i, ", counted from 0, pins no vertex; the body spans ",
                             extent(mesh), " (turned and scaled)"));
    }
  };
  const PinRules& pins = scene.pins;
  apply("pins.boxes", pins.boxes, [&](const Vec3<double>& x, Index i) {
    const auto box = pins.boxes.row(i).transpose();
    return (x.array() >= box.head(3).array()).all() && (x.array() <= box.tail(3).array()).all();
  });
  apply("pins.spheres", pins.spheres, [&](const Vec3<double>& x, Index i) {
    return (x - pins.spheres.row(i).head(3).transpose()).norm() <= pins.spheres(i, 3);
  });
  apply("pins.planes", pins.planes, [&](const Vec3<double>& x, Index i) {
    return pins.planes.row(i).head(3).dot(x) >= pins.planes(i, 3);
  });

  std::vector<int> pinned;
  for (Index v = 0; v < n; ++v)
    if (held[static_cast<std::size_t>(v)]) pinned.push_back(static_cast<int>(v));
  if (scene.has_pins() && static_cast<Index>(pinned.size()) == n) {
    throw ConfigError(text("pins: all ", n,
                           " vertices are pinned, nothing would move; the body spans ",
                           extent(mesh)));
  }
  return pinned;
}

Path find_mesh(const Scene& scene) {
  const Path file(scene.mesh_file);
  std::vector<Path> folders = file.is_absolute() ? std::vector<Path>{Path()} : scene.mesh_folders;
  if (folders.empty()) folders.emplace_back();
  std::string places;
  for (const Path& folder : folders) {
    const Path path = folder / file;
    std::error_code ignored;
    if (fs::exists(path, ignored)) return path;
    places += (places.empty() ? "" : ", ") + in_quotes(path.string());
  }
  throw ConfigError("mesh.file: found no mesh, looked for " + places +
                    "; give its path (--mesh FILE or --set mesh.file=FILE), or its folder by "
                    "--meshes DIR or the environment variable NMP_MESHES");
}

Body make_body(const Scene& scene) {
  if (scene.shape == "cube") {
    Body body{fem::cube_mesh(scene.vertices_per_edge, scene.side), {}, "", {}};
    body.pinned = find_pins(scene, body.mesh);
    check_ground(scene, body);
    return body;
  }
  NMP_CHECK(scene.shape == "file", "the shape of a scene must be cube or file, got " + scene.shape);
  const Path path = find_mesh(scene);
  const std::string name = printable(path.string());
  const std::string checksum = fem::mesh_checksum(path);
  if (!scene.mesh_checksum.empty() && scene.mesh_checksum != checksum) {
    throw InputError(text(name, ": expected the mesh with the checksum ", scene.mesh_checksum,
                          " (mesh.checksum of the scene), found ", checksum,
                          ": the file has changed or is another; without mesh.checksum any is "
                          "taken"));
  }
  fem::RawMesh raw = fem::read_mesh(path);
  fem::turn_and_scale(raw.vertices, scene.mesh_scale, scene.mesh_up == "y");
  const fem::RepairedMesh repaired = fem::repair(raw, name);
  Body body{fem::TetMesh<double>(repaired.mesh.vertices, repaired.mesh.tets), {}, checksum, {}};
  for (const std::string& note : raw.notes) body.warnings.push_back(name + ": " + note);
  for (const std::string& warning : repaired.warnings) {
    body.warnings.push_back(name + ": " + warning);
  }
  body.pinned = find_pins(scene, body.mesh);
  check_ground(scene, body);
  return body;
}

fem::TetMesh<double> make_mesh(const Scene& scene) { return make_body(scene).mesh; }

double frame_step(double limit) { return std::min(kFrameStep, rounded_down(limit / 2)); }

Scene recorded_scene(const Scene& scene, const Body& body) {
  Scene recorded = scene;
  if (scene.dt == 0) {
    const auto substeps = static_cast<double>(scene.substeps);
    const double limit = fem::stable_time_step(body.mesh, scene.physics.material, body.pinned);
    recorded.dt = frame_step(limit) / substeps;
  }
  if (scene.shape == "file") {
    recorded.mesh_file = Path(scene.mesh_file).filename().string();
    recorded.mesh_checksum = body.mesh_checksum;
  }
  return recorded;
}

}  // namespace nmp
