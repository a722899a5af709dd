#include "nmp/dataset_verify.h"

#include <algorithm>
#include <cmath>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>

#include "base/check.h"
#include "fem/guard.h"
#include "nmp/dataset.h"

namespace nmp {

namespace {

// First frame at which something is wrong, and how many there are.
struct Seen {
  Index n = 0;
  std::string first;
  void add(const std::string& what) {
    if (n++ == 0) first = what;
  }
};

class Verifier {
 public:
  Verifier(const Path& folder, const std::function<void(double)>& progress)
      : folder_(folder), progress_(progress) {}

  DatasetCheck run() {
    ++check_.n_files;
    try {
      manifest_ = read_manifest(dataset_file(folder_, "manifest.json"));
    } catch (const InputError& error) {
      add("manifest.json", error.what());
      return check_;
    }
    attempt("mesh.safetensors", [&] {
      const Path path = dataset_file(folder_, "mesh.safetensors");
      check_hash("mesh.safetensors", path, manifest_.mesh_checksum);
      mesh_ = read_mesh(TensorFile::open(path), manifest_.n_vertices, manifest_.n_tets);
      std::sort(mesh_->pinned.begin(), mesh_->pinned.end());
    });
    const double n = static_cast<double>(manifest_.train.size() + manifest_.validation.size());
    for (const auto* records : {&manifest_.train, &manifest_.validation}) {
      for (const RecordInfo& record : *records) {
        attempt(record.name, [&] {
          const Path path = dataset_file(folder_, record.name);
          check_hash(record.name, path, record.checksum);
          verify(Trajectory(path, record, manifest_.n_vertices, manifest_.h));
        });
        if (progress_) progress_(static_cast<double>(check_.n_files - 2) / n);
      }
    }
    return check_;
  }

 private:
  void add(const std::string& file, const std::string& what) {
    check_.problems.push_back({file, what});
  }

  // A file that cannot be read at all is one problem.
  template <class Read>
  void attempt(const std::string& file, const Read& read) {
    ++check_.n_files;
    try {
      read();
    } catch (const InputError& error) {
      add(file, error.what());
    } catch (const IoError& error) {
      add(file, error.what());
    }
  }

  void check_hash(const std::string& file, const Path& path, const std::string& expected) {
    if (expected.empty()) {
      ++check_.n_without_checksum;
      return;
    }
    const std::string found = hash_file(path);
    if (found != expected)
      add(file, text("expected the checksum ", expected, " of the manifest, found ", found));
  }

  void verify(const Trajectory& record) {
    const Index n_vertices = manifest_.n_vertices;
    Matrix<double> x(n_vertices, 3), v(n_vertices, 3), f_int(n_vertices, 3);
    Matrix<double> x_before = x, v_before = v;
    Seen not_finite, not_pinned, inverted, jumps;
    bool finite_before = false;
    for (Index t = 0; t <= record.frames(); ++t) {
      const std::string frame = text("frame ", t);
      record.read_x<double>(t, x);
      record.read_v<double>(t, v);
      bool finite = true;
      const auto check_finite = [&](const char* name, const Matrix<double>& values) {
        if (values.allFinite()) return;
        finite = false;
        for (Index i = 0; i < n_vertices; ++i)
          if (!values.row(i).allFinite())
            return not_finite.add(text(frame, ", ", name, " of vertex ", i,
                                       ": expected finite numbers, found others"));
      };
      check_finite("x", x);
      if (record.has_velocity()) check_finite("v", v);
      if (record.has_force()) {
        record.read_force<double>(t, f_int);
        check_finite("f_int", f_int);
      }
      if (finite && mesh_) {
        check_pins(frame, x, v, not_pinned);
        check_elements(frame, x, inverted);
        if (finite_before && record.has_velocity())
          check_motion(frame, x_before, v_before, x, v, jumps);
      }
      finite_before = finite;
      x_before = x;
      v_before = v;
    }
    for (const Seen* seen : {&not_finite, &not_pinned, &inverted, &jumps})
      if (seen->n > 0)
        add(record.name(),
            seen->first + (seen->n > 1 ? text("; and ", seen->n - 1, " more like it") : ""));
  }

  void check_pins(const std::string& frame, const Matrix<double>& x, const Matrix<double>& v,
                  Seen& seen) const {
    for (const int i : mesh_->pinned) {
      const double away = (x.row(i) - mesh_->mesh.vertices().row(i)).norm();
      if (away > position_error(x) || !v.row(i).isZero(0))
        return seen.add(text(frame, ", pinned vertex ", i, ": expected it at rest, found it ", away,
                             " m away at ", v.row(i).norm(), " m/s"));
    }
  }

  void check_elements(const std::string& frame, const Matrix<double>& x, Seen& seen) const {
    if (!manifest_.law_known || manifest_.physics.material.law != "neo-hookean") return;
    const fem::Inverted inverted = fem::count_inverted<double>(mesh_->mesh, x);
    if (inverted.count > 0)
      seen.add(text(frame, ", element ", inverted.first,
                    ": expected det F > 0, which the neo-Hookean law keeps, found ",
                    fem::det_F<double>(mesh_->mesh, x, inverted.first)));
  }

  // Positions and velocities are stored as float.
  static double position_error(const Matrix<double>& x) {
    return 4 * 6e-8 * (x.cwiseAbs().maxCoeff() + 1e-6);
  }

  void check_motion(const std::string& frame, const Matrix<double>& x0, const Matrix<double>& v0,
                    const Matrix<double>& x1, const Matrix<double>& v1, Seen& seen) const {
    const fem::Physics& physics = manifest_.physics;
    const double h = manifest_.h, speed = std::max(largest(v0), largest(v1));
    const double error = position_error(x0) + position_error(x1) + 1e-6 * h * speed;
    if (manifest_.substeps == 1) {
      for (Index i = 0; i < x1.rows(); ++i) {
        const bool held =
            std::binary_search(mesh_->pinned.begin(), mesh_->pinned.end(), static_cast<int>(i)) ||
            (physics.ground && x1(i, 2) <= *physics.ground + error);
        const double jump = (x1.row(i) - x0.row(i) - h * v1.row(i)).norm();
        if (!held && jump > error)
          return seen.add(text(frame, ", vertex ", i,
                               ": expected x to have moved by h v, found it ", jump,
                               " m from there"));
      }
      return;
    }
    if (manifest_.substeps < 1 || !mesh_->pinned.empty()) return;
    const auto n = static_cast<double>(manifest_.substeps);
    const double lowest = std::min(x0.col(2).minCoeff(), x1.col(2).minCoeff());
    if (physics.ground && lowest <= *physics.ground + 2 * h * speed + error) return;
    const Vec3<double> moved = centre(x1) - centre(x0);
    const Vec3<double> expected =
        h * centre(v0) + n * (n + 1) / 2 * manifest_.dt * manifest_.dt * physics.gravity;
    const double jump = (moved - expected).norm();
    if (jump > error)
      seen.add(text(frame, ": expected the mass centre to have moved by ", expected.norm(),
                    " m in free flight, found it ", jump, " m from there"));
  }

  static double largest(const Matrix<double>& v) { return v.rowwise().norm().maxCoeff(); }

  // Weighted by mass.
  Vec3<double> centre(const Matrix<double>& values) const {
    return values.transpose() * mesh_->mesh.vertex_volumes() / mesh_->mesh.total_volume();
  }

  Path folder_;
  const std::function<void(double)>& progress_;
  Manifest manifest_;
  std::optional<DatasetMesh> mesh_;
  DatasetCheck check_;
};

}  // namespace

DatasetCheck verify_dataset(const Path& folder, const std::function<void(double)>& progress) {
  return Verifier(folder, progress).run();
}

std::string to_json(const DatasetCheck& check) {
  using Json = nlohmann::ordered_json;
  Json json{{"files", check.n_files},
            {"without_checksum", check.n_without_checksum},
            {"ok", check.problems.empty()},
            {"problems", Json::array()}};
  for (const DatasetProblem& problem : check.problems)
    json["problems"].push_back({{"file", problem.file}, {"what", problem.what}});
  return json.dump(1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace nmp
