#include "nmp/data_import.h"

#include <algorithm>
#include <cmath>

#include "base/atomic_folder.h"
#include "base/check.h"
#include "fem/mesh_check.h"
#include "fem/weld.h"
#include "nmp/body.h"
#include "nmp/frame_series.h"

namespace nmp {

namespace {

constexpr const char* kRest = "rest.vtu";

// The shape at rest, and where its vertices stand in the files.
struct ImportedBody {
  fem::TetMesh<double> mesh;
  std::vector<Index> rows;  // vertex -> row of a frame
  std::vector<int> pinned;  // by the array `pinned` of rest.vtu
};

struct Rest {
  fem::RawMesh mesh;
  std::string name;
  std::vector<char> pinned;  // of each vertex; empty: not told
};

Rest read_rest(FrameSeries& series, const fem::Tets& tets, const ImportOptions& o) {
  const Path beside = series.folder() / kRest;
  Path path = o.rest;
  if (path.empty() && std::filesystem::exists(beside)) path = beside;
  if (path.empty()) {
    if (o.displacement.empty() && o.warn)
      o.warn(series.name() +
             ": the first frame is taken for the shape at rest; --rest FILE names another");
    return {{series.frame(0, tets).points, tets, {}}, series.name() + ", frame 0", {}};
  }
  Rest rest{fem::read_mesh(path), printable(path.string()), {}};
  if (rest.mesh.tets.rows() != tets.rows() || rest.mesh.tets != tets)
    throw InputError(text(rest.name, ": expected the ", tets.rows(), " tetrahedra of ",
                          series.name(), ", found others (", rest.mesh.tets.rows(), ")"));
  if (path != beside) return rest;
  const MappedFile bytes(path);
  const fem::VtuGrid grid = fem::read_vtu_grid(
      {reinterpret_cast<const char*>(bytes.data()), bytes.size()}, rest.name, {"pinned"});
  for (const auto& [name, values] : grid.point_data)
    for (Index i = 0; i < values.rows(); ++i) rest.pinned.push_back(values(i, 0) != 0);
  return rest;
}

ImportedBody make_imported_body(Rest rest, const ImportOptions& o) {
  const Index n_before = rest.mesh.vertices.rows();
  std::vector<Index> welded(static_cast<std::size_t>(n_before));
  for (Index i = 0; i < n_before; ++i) welded[static_cast<std::size_t>(i)] = i;
  fem::turn_and_scale(rest.mesh.vertices, o.scale, o.y_up);
  if (o.weld) welded = fem::weld(rest.mesh);
  const bool all_apart =
      !o.weld && rest.mesh.tets.rows() > 1 && n_before == 4 * rest.mesh.tets.rows();
  if (all_apart && fem::check_mesh(rest.mesh).n_parts == rest.mesh.tets.rows())
    throw InputError(rest.name +
                     ": every tetrahedron has four vertices of its own: --weld joins "
                     "those at the same place");

  const fem::RepairedMesh repaired = fem::repair(rest.mesh, rest.name);
  if (o.warn)
    for (const std::string& warning : repaired.warnings) o.warn(rest.name + ": " + warning);
  ImportedBody body{{repaired.mesh.vertices, repaired.mesh.tets}, {}, {}};
  for (const std::int32_t i : repaired.given_vertices) {
    const Index row = welded[static_cast<std::size_t>(i)];
    if (!rest.pinned.empty() && rest.pinned[static_cast<std::size_t>(row)])
      body.pinned.push_back(static_cast<int>(body.rows.size()));
    body.rows.push_back(row);
  }
  return body;
}

// The time between frames that is the same throughout.
double uniform_h(const FrameSeries& series) {
  const std::vector<double>& times = series.times();
  const double h = (times.back() - times.front()) / static_cast<double>(series.n() - 1);
  for (std::size_t k = 1; k < times.size(); ++k) {
    const double step = times[k] - times[k - 1];
    if (std::abs(step - h) <= 0.01 * h) continue;
    throw InputError(text(series.name(), ": frame ", k, ": expected it ", h,
                          " s after the one before, as on average, found ", step,
                          " s; --resample S makes frames that are S seconds apart"));
  }
  return h;
}

// Frames of a series as those of the dataset: its vertices, metres, z up, at times k h.
class ImportedMotion {
 public:
  ImportedMotion(const Path& file, const ImportOptions& options)
      : options_(options), series_(file, options.displacement) {}

  FrameSeries& series() { return series_; }
  bool has_force(const fem::Tets& tets) { return series_.frame(0, tets).f.has_value(); }
  /// Steps between frames of the dataset.
  Index frames(double h) const {
    if (!options_.resample) return series_.n() - 1;
    const double span = series_.times().back() - series_.times().front();
    return static_cast<Index>(std::floor(span / h + 1e-6));
  }

  struct State {
    Matrix<double> x;
    std::optional<Matrix<double>> v, f;
  };
  State state(Index t, double h, const ImportedBody& body, const fem::Tets& tets) {
    if (!options_.resample) return recorded(t, body, tets);
    const std::vector<double>& times = series_.times();
    const double time = times.front() + static_cast<double>(t) * h;
    const auto after = std::upper_bound(times.begin() + 1, times.end() - 1, time);
    const Index k = after - times.begin() - 1;
    // A cubic with the positions and slopes of both frames around.
    const double step = times[static_cast<std::size_t>(k) + 1] - times[static_cast<std::size_t>(k)];
    const double s = std::min(1.0, (time - times[static_cast<std::size_t>(k)]) / step);
    const State a = recorded(k, body, tets), b = recorded(k + 1, body, tets);
    const Matrix<double> va = step * slope(k, a, body, tets),
                         vb = step * slope(k + 1, b, body, tets);
    State state;
    state.x = (1 + 2 * s) * (1 - s) * (1 - s) * a.x + s * (1 - s) * (1 - s) * va +
              s * s * (3 - 2 * s) * b.x + s * s * (s - 1) * vb;
    if (a.v && b.v)
      state.v =
          (6 * s * (s - 1) * (a.x - b.x) + (1 - s) * (1 - 3 * s) * va + s * (3 * s - 2) * vb) /
          step;
    return state;
  }

 private:
  State recorded(Index k, const ImportedBody& body, const fem::Tets& tets) {
    const FrameSeries::Frame& frame = series_.frame(k, tets);
    const auto chosen = [&](const Matrix<double>& all, double scale) {
      Matrix<double> rows(static_cast<Index>(body.rows.size()), 3);
      for (Index i = 0; i < rows.rows(); ++i)
        rows.row(i) = all.row(body.rows[static_cast<std::size_t>(i)]);
      fem::turn_and_scale(rows, scale, options_.y_up);
      return rows;
    };
    State state{chosen(frame.x, options_.scale), {}, {}};
    if (frame.v) state.v = chosen(*frame.v, options_.scale);
    if (frame.f) state.f = chosen(*frame.f, 1);
    return state;
  }

  // As recorded, else of the parabola through a frame and its neighbours.
  Matrix<double> slope(Index k, const State& state, const ImportedBody& body,
                       const fem::Tets& tets) {
    if (state.v) return *state.v;
    const Index n = series_.n();
    if (n == 2) return (recorded(1, body, tets).x - recorded(0, body, tets).x) / span(0, 1);
    const Index m = std::clamp<Index>(k, 1, n - 2);
    const double before = span(m - 1, m), after = span(m, m + 1);
    const Matrix<double> x0 = recorded(m - 1, body, tets).x, x1 = recorded(m, body, tets).x,
                         x2 = recorded(m + 1, body, tets).x;
    const Matrix<double> left = (x1 - x0) / before, right = (x2 - x1) / after;
    const Matrix<double> curvature = (right - left) / (before + after);  // half of it
    const Matrix<double> middle = left + before * curvature;
    return middle + 2 * (k < m ? -before : k > m ? after : 0) * curvature;
  }
  double span(Index a, Index b) const {
    return series_.times()[static_cast<std::size_t>(b)] -
           series_.times()[static_cast<std::size_t>(a)];
  }

  const ImportOptions& options_;
  FrameSeries series_;
};

bool is_dataset_file(const std::string& name) {
  const Path path(name);
  const Path split = path.parent_path();
  return name == "manifest.json" || name == "mesh.safetensors" || name == "scene.toml" ||
         ((split == "train" || split == "val") && path.extension() == ".safetensors");
}

void write_motion(ImportedMotion& motion, const Path& folder, RecordInfo& record, double h,
                  const ImportedBody& body, const fem::Tets& tets, const ImportOptions& o,
                  const std::function<void()>& frame_done) {
  const ImportedMotion::State first = motion.state(0, h, body, tets);
  if (o.warn && o.resample && motion.has_force(tets))
    o.warn(motion.series().name() + ": f_int is not resampled: it is left out");
  std::vector<std::string> tensors{"x"};
  if (first.v) tensors.emplace_back("v");
  if (first.f) tensors.emplace_back("f_int");
  TrajectoryWriter writer(folder / record.name, record.frames, body.mesh.n_vertices(), 0, h, "",
                          tensors);
  for (Index t = 0; t <= record.frames; ++t) {
    const ImportedMotion::State state = motion.state(t, h, body, tets);
    const auto write = [&](const char* name, const std::optional<Matrix<double>>& values) {
      if (!values)
        throw InputError(text(motion.series().name(), ": frame ", t, ": expected the array ", name,
                              " of the first frame, found none"));
      writer.write(t, name, *values);
    };
    writer.write(t, "x", state.x);
    if (first.v) write("v", state.v);
    if (first.f) write("f_int", state.f);
    frame_done();
  }
  record.checksum = writer.commit();
}

}  // namespace

Manifest import_dataset(const Path& folder, const ImportOptions& o) {
  // 1. The motions, the body they have in common, and the time between frames.
  std::vector<ImportedMotion> motions;
  for (const auto* files : {&o.train, &o.validation})
    for (const Path& file : *files) motions.emplace_back(file, o);
  if (motions.empty()) throw ConfigError("expected at least one collection to import");
  FrameSeries& first = motions.front().series();
  const fem::Tets tets = first.tets();
  const ImportedBody body = make_imported_body(read_rest(first, tets, o), o);
  double h = o.resample ? *o.resample : uniform_h(first);
  for (ImportedMotion& motion : motions) {
    const double other = o.resample ? h : uniform_h(motion.series());
    if (std::abs(other - h) > 1e-4 * h)
      throw InputError(text(motion.series().name(), ": expected frames ", h, " s apart, as in ",
                            first.name(), ", found ", other, "; --resample S makes them equal"));
    if (motion.frames(h) < 1)
      throw InputError(
          text(motion.series().name(), ": expected more than one frame, ", h, " s apart"));
  }

  // 2. What is known besides.
  Manifest manifest;
  manifest.scene_name = o.scene.name;
  manifest.physics = o.scene.physics;
  manifest.physics.pinned = find_pins(o.scene, body.mesh);
  std::vector<int>& pinned = manifest.physics.pinned;
  pinned.insert(pinned.end(), body.pinned.begin(), body.pinned.end());
  std::sort(pinned.begin(), pinned.end());
  pinned.erase(std::unique(pinned.begin(), pinned.end()), pinned.end());
  manifest.law_known = o.law_known;
  if (o.law_known && o.scene.dt > 0 && std::abs(o.scene.h() - h) <= 1e-4 * h) {
    manifest.dt = o.scene.dt;
    manifest.substeps = o.scene.substeps;
    h = o.scene.h();
  }
  manifest.h = h;
  manifest.n_vertices = body.mesh.n_vertices();
  manifest.n_tets = body.mesh.n_tets();

  // 3. The dataset, the manifest last.
  AtomicFolder made(folder, o.force, is_dataset_file);
  for (const char* split : {"train", "val"}) std::filesystem::create_directory(made.path() / split);
  write_mesh(made.path() / "mesh.safetensors", body.mesh, pinned);
  manifest.mesh_checksum = hash_file(made.path() / "mesh.safetensors");
  double all = 0, done = 0;
  for (const ImportedMotion& motion : motions) all += static_cast<double>(motion.frames(h) + 1);
  const auto frame_done = [&] {
    ++done;
    if (o.progress) o.progress(done / all);
  };
  for (std::size_t i = 0; i < motions.size(); ++i) {
    const bool train = i < o.train.size();
    const auto k = static_cast<Index>(train ? i : i - o.train.size());
    RecordInfo record{record_name(train ? "train" : "val", k), 0, motions[i].frames(h), ""};
    write_motion(motions[i], made.path(), record, h, body, tets, o, frame_done);
    manifest.frames = std::max(manifest.frames, record.frames);
    (train ? manifest.train : manifest.validation).push_back(record);
  }
  write_manifest(made.path() / "manifest.json", manifest);
  made.commit();
  return manifest;
}

}  // namespace nmp
