#include "nmp/export.h"

#include <Eigen/LU>
#include <algorithm>
#include <charconv>
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

// Stress and energy of the elements of a state.
class Elements {
 public:
  explicit Elements(const ExportSource& source)
      : mesh_(source.mesh),
        material_(source.material),
        F_(mesh_.n_tets(), 9),
        P_(mesh_.n_tets(), 9) {}

  std::vector<fem::VtuField> fields(const Matrix<double>& x) {
    fem::deformation_gradient<double>(mesh_, x, F_);
    Matrix<float> det(mesh_.n_tets(), 1);
    for (Index e = 0; e < mesh_.n_tets(); ++e)
      det(e, 0) = static_cast<float>(load_mat3<double>(F_, e).determinant());
    std::vector<fem::VtuField> fields{{"det_F", det}};
    if (material_) add_stress(fields);
    return fields;
  }

 private:
  // The neo-Hookean law is not defined inside out.
  void add_stress(std::vector<fem::VtuField>& fields) {
    const Index n = mesh_.n_tets();
    const bool needs_volume = material_->law == "neo-hookean";
    std::vector<char> defined(static_cast<std::size_t>(n), 1);
    for (Index e = 0; needs_volume && e < n; ++e) {
      if (load_mat3<double>(F_, e).determinant() > 0) continue;
      defined[static_cast<std::size_t>(e)] = 0;
      store_mat3<double>(F_, e, Mat3<double>::Identity());
    }
    Matrix<double> Psi(n, 1);
    fem::stress<double>(*material_, fem::lame(material_->E, material_->nu), F_, P_);
    fem::energy_density<double>(*material_, F_, Psi);
    Matrix<float> von_mises(n, 1), energy = Psi.cast<float>();
    for (Index e = 0; e < n; ++e) {
      const Mat3<double> F = load_mat3<double>(F_, e);
      // sigma = P F^T / det F,   sqrt(3/2 s : s) with s the deviator of sigma.
      const Mat3<double> sigma = load_mat3<double>(P_, e) * F.transpose() / F.determinant();
      const Mat3<double> s = sigma - sigma.trace() / 3 * Mat3<double>::Identity();
      von_mises(e, 0) = static_cast<float>(std::sqrt(1.5) * s.norm());
      if (defined[static_cast<std::size_t>(e)]) continue;
      von_mises(e, 0) = energy(e, 0) = std::numeric_limits<float>::quiet_NaN();
    }
    fields.push_back({"von_mises", von_mises});
    fields.push_back({"energy", energy});
  }

  const fem::TetMesh<double>& mesh_;
  const std::optional<fem::Material>& material_;
  Matrix<double> F_, P_;
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

Matrix<float> on_surface(const Matrix<double>& x, const fem::Surface& surface) {
  Matrix<float> rows(static_cast<Index>(surface.vertices.size()), 3);
  for (Index i = 0; i < rows.rows(); ++i)
    rows.row(i) = x.row(surface.vertices[static_cast<std::size_t>(i)]).cast<float>();
  return rows;
}

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
  Elements elements(source);
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
    folder.write(name, fem::to_obj(on_surface(x, surface), surface.triangles));
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
  frames.for_each([&](Index, const Matrix<double>& x) { writer.write(on_surface(x, surface)); });
  writer.commit();
  write_text(body, fem::to_obj(on_surface(source.mesh.vertices(), surface), surface.triangles));
  return {out, frames.n()};
}

}  // namespace

TrajectoryFile open_trajectory(const Path& path, Index n_vertices, std::optional<double> h) {
  TensorFile file = TensorFile::open(path);
  const std::int64_t n_states = file.require("x", DType::f32, {-1, n_vertices, 3}).shape[0];
  const auto& metadata = file.metadata();
  if (metadata.count("checksum") > 0) file.verify();
  if (const auto found = metadata.find("h"); found != metadata.end()) {
    double value = 0;
    const std::string& word = found->second;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    if (error != std::errc() || end != word.data() + word.size() || !(value > 0 && value < 1e6))
      throw InputError(
          text(path.string(), ": metadata h: expected seconds, found ", in_quotes(word)));
    if (h && std::abs(*h - value) > 1e-6 * value)
      throw ConfigError(text(path.string(), ": says that its frames are ", value,
                             " s apart: --h is for files that do not tell"));
    h = value;
  }
  if (!h) throw ConfigError(path.string() + ": does not tell the time between its frames: --h S");
  const RecordInfo info{path.filename().string(), 0, n_states - 1, ""};
  if (info.frames < 0)
    throw InputError(path.string() + ": expected at least one frame, found none");
  return {Trajectory(std::move(file), info, n_vertices, *h), *h};
}

const Trajectory* find_record(const Dataset& dataset, const Trajectory& trajectory) {
  const fem::State<float> start = trajectory.state<float>(0);
  for (const auto* records : {&dataset.validation(), &dataset.train()}) {
    for (const Trajectory& record : *records) {
      const fem::State<float> other = record.state<float>(0);
      if (other.x == start.x && other.v == start.v) return &record;
    }
  }
  return nullptr;
}

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
