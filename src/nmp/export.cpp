#include "nmp/export.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "base/atomic_folder.h"
#include "base/check.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "fem/pvd.h"
#include "fem/surface_writer.h"
#include "fem/vtu_writer.h"
#include "nmp/config.h"
#include "nmp/vertex_measures.h"

namespace nmp {

namespace {

constexpr const char* kCollection = "frames.pvd";
constexpr const char* kRest = "rest.vtu";
constexpr const char* kTimes = "times.csv";

// "frame_0012.vtu"; wide enough that names are in the order of time.
std::string frame_name(Index t, Index last, const char* ending) {
  const std::string digits = std::to_string(t);
  const std::size_t width = std::max<std::size_t>(4, std::to_string(last).size());
  return "frame_" + std::string(width - digits.size(), '0') + digits + ending;
}

bool is_frame(const std::string& name) {
  const std::size_t dot = name.find('.');
  return name.compare(0, 6, "frame_") == 0 && dot != std::string::npos && dot > 6 &&
         name.find_first_not_of("0123456789", 6) == dot &&
         (name.substr(dot) == ".vtu" || name.substr(dot) == ".obj");
}

bool is_ours(const std::string& name) {
  return is_frame(name) || name == kCollection || name == kRest || name == kTimes;
}

// What is known of the elements of a state. #T x 1 each.
class Elements {
 public:
  explicit Elements(const ExportSource& source) : mesh_(source.mesh), material_(source.material) {}

  std::vector<fem::VtuField> fields(const Matrix<double>& x) const {
    const Index n = mesh_.n_tets();
    Matrix<double> F(n, 9), det(n, 1);
    fem::deformation_gradient<double>(mesh_, x, F);
    for (Index e = 0; e < n; ++e) det(e, 0) = load_mat3<double>(F, e).determinant();
    std::vector<fem::VtuField> fields{{"det_F", det.cast<float>()}};
    if (!material_) return fields;
    Matrix<double> Psi(n, 1);
    fem::energy_density<double>(*material_, right_side_out(F), Psi);
    for (Index e = 0; e < n; ++e)
      if (!(det(e, 0) > 0)) Psi(e, 0) = std::numeric_limits<double>::quiet_NaN();
    fields.push_back({"von_mises", von_mises(F, analytic_stress(*material_)).cast<float>()});
    fields.push_back({"energy", Psi.cast<float>()});
    return fields;
  }

 private:
  const fem::TetMesh<double>& mesh_;
  const std::optional<fem::Material>& material_;
};

// The frames that are exported, one after another.
class Frames {
 public:
  Frames(const ExportSource& source, const ExportOptions& options)
      : source_(source), options_(options), x_(source.mesh.n_vertices(), 3) {
    NMP_CHECK(options.every >= 1, text("every must be at least 1, got ", options.every));
  }

  Index n() const { return source_.frames->frames() / options_.every + 1; }
  Index last() const { return (n() - 1) * options_.every; }
  double time(Index t) const { return static_cast<double>(t) * source_.h; }

  /// show(t, x) for each.
  template <class Show>
  void for_each(const Show& show) {
    for (Index t = 0; t <= last(); t += options_.every) {
      source_.frames->read_x<double>(t, x_);
      show(t, x_);
      if (options_.progress)
        options_.progress(static_cast<double>(t / options_.every + 1) / static_cast<double>(n()));
    }
  }

  /// Of frame t, which is shown.
  std::vector<fem::VtuField> point_fields(Index t) const {
    std::vector<fem::VtuField> fields;
    Matrix<float> values(x_.rows(), 3);
    source_.frames->read_v<float>(t, values);
    fields.push_back({"v", values});
    if (source_.frames->has_force()) {
      source_.frames->read_force<float>(t, values);
      fields.push_back({"f_int", values});
    }
    if (source_.record && t <= source_.record->frames()) {
      Matrix<double> x_true(x_.rows(), 3);
      source_.record->read_x<double>(t, x_true);
      fields.push_back({"error", (x_ - x_true).cast<float>()});
    }
    return fields;
  }

 private:
  const ExportSource& source_;
  const ExportOptions& options_;
  Matrix<double> x_;
};

std::string rest_file(const ExportSource& source, const fem::VtuStyle& style) {
  Matrix<float> pinned = Matrix<float>::Zero(source.mesh.n_vertices(), 1);
  for (const int i : source.pinned) pinned(i, 0) = 1;
  return fem::to_vtu({source.mesh.vertices(), source.mesh.tets(), {{"pinned", pinned}}, {}}, style);
}

Exported export_vtu(const ExportSource& source, const Path& out, const ExportOptions& options) {
  const bool beside = out.extension() == ".pvd";
  const Path folder_path = beside ? Path(out).replace_extension() : out;
  if (beside) refuse_to_overwrite(out, options.force);
  AtomicFolder folder(folder_path, options.force, is_ours);
  Frames frames(source, options);
  const Elements elements(source);
  std::vector<fem::PvdEntry> entries;
  const std::string prefix = beside ? folder_path.filename().string() + "/" : "";
  frames.for_each([&](Index t, const Matrix<double>& x) {
    const std::string name = frame_name(t, frames.last(), ".vtu");
    folder.write(name,
                 fem::to_vtu({x, source.mesh.tets(), frames.point_fields(t), elements.fields(x)},
                             {true, options.zlib, true}));
    entries.push_back({frames.time(t), prefix + name});
  });
  folder.write(kRest, rest_file(source, {true, options.zlib, false}));
  if (!beside) folder.write(kCollection, fem::to_pvd(entries));
  folder.commit();
  if (beside) write_text(out, fem::to_pvd(entries));  // until then the old one lists what is gone
  return {beside ? out : folder_path / kCollection, frames.n()};
}

Exported export_obj(const ExportSource& source, const Path& out, const ExportOptions& options) {
  AtomicFolder folder(out, options.force, is_ours);
  Frames frames(source, options);
  const fem::Surface surface = fem::extract_surface(source.mesh.tets());
  std::string times = "file,time [s]\n";
  frames.for_each([&](Index t, const Matrix<double>& x) {
    const std::string name = frame_name(t, frames.last(), ".obj");
    folder.write(name, fem::to_obj<float>(on_surface(x, surface).cast<float>(), surface.triangles));
    times += name + "," + decimal(frames.time(t)) + "\n";
  });
  folder.write(kTimes, times);
  folder.commit();
  return {out / frame_name(0, frames.last(), ".obj"), frames.n()};
}

Exported export_pc2(const ExportSource& source, const Path& out, const ExportOptions& options) {
  const Path body = Path(out).replace_extension(".obj");
  if (body == out) throw ConfigError(out.string() + ": expected a name that does not end in .obj");
  for (const Path& file : {out, body}) refuse_to_overwrite(file, options.force);
  Frames frames(source, options);
  const fem::Surface surface = fem::extract_surface(source.mesh.tets());
  fem::Pc2Writer writer(out, static_cast<Index>(surface.vertices.size()), frames.n());
  frames.for_each(
      [&](Index, const Matrix<double>& x) { writer.write(on_surface(x, surface).cast<float>()); });
  const std::string rest = fem::to_obj<float>(
      on_surface(source.mesh.vertices(), surface).cast<float>(), surface.triangles);
  AtomicFile body_file(body);
  body_file.append(rest.data(), rest.size());
  writer.commit();
  body_file.commit();
  return {out, frames.n()};
}

}  // namespace

Exported export_frames(const ExportSource& source, const Path& out, const ExportOptions& options) {
  NMP_CHECK(source.frames != nullptr && source.frames->n_vertices() == source.mesh.n_vertices() &&
                source.h > 0,
            "an export needs frames of its mesh and the time between them");
  if (options.format == "vtu") return export_vtu(source, out, options);
  if (options.format == "obj") return export_obj(source, out, options);
  if (options.format == "pc2") return export_pc2(source, out, options);
  throw ConfigError("there is no format " + in_quotes(options.format) +
                    "; there are vtu, obj, pc2");
}

}  // namespace nmp
