#include "capi/mesh.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <utility>

#include "capi/handles.h"
#include "capi/rows.h"
#include "fem/mesh_check.h"
#include "fem/mesh_file.h"

using namespace nmp;
using namespace nmp::capi;

namespace {

// Row by row into a buffer of exactly that many numbers.
template <class Batch, class T>
void copy_rows(const Batch& batch, T* out, size_t n, const char* name) {
  need_buffer(out, n, static_cast<size_t>(batch.size()), name);
  for (Index i = 0; i < batch.rows(); ++i)
    for (Index j = 0; j < batch.cols(); ++j) *out++ = static_cast<T>(batch(i, j));
}

}  // namespace

extern "C" {

nmp_mesh_options nmp_mesh_options_default(void) {
  nmp_mesh_options options{};
  options.struct_size = sizeof options;
  options.scale = 1;
  return options;
}

nmp_status nmp_mesh_load(const char* path, const nmp_mesh_options* options, nmp_mesh** mesh) {
  return guarded(__func__, [&] {
    need(path, "path");
    need(mesh, "mesh");
    const nmp_mesh_options o = options ? *options : nmp_mesh_options_default();
    need_struct(o.struct_size, sizeof o, "options", "nmp_mesh_options_default()");
    if (!(std::isfinite(o.scale) && o.scale > 0))
      throw std::invalid_argument(text("options->scale must be > 0 and finite, got ", o.scale));
    fem::RawMesh raw = fem::read_mesh(path);
    fem::turn_and_scale(raw.vertices, o.scale, o.y_up != 0);
    fem::RepairedMesh repaired = fem::repair(raw, printable(path));
    Mesh made(fem::TetMesh<double>(repaired.mesh.vertices, repaired.mesh.tets));
    const auto report = [&](const std::vector<std::string>& lines) {
      for (const std::string& line : lines) made.report += line + "\n";
    };
    report(raw.notes);
    report(repaired.warnings);
    made.file_vertices = std::move(repaired.given_vertices);
    *mesh = add_handle(std::make_shared<const Mesh>(std::move(made)));
  });
}

nmp_status nmp_mesh_from_arrays(const double* vertices, size_t n_vertices, const int32_t* tets,
                                size_t n_tets, nmp_mesh** mesh) {
  return guarded(__func__, [&] {
    need(vertices, "vertices");
    need(tets, "tets");
    need(mesh, "mesh");
    constexpr size_t kMost = std::numeric_limits<int32_t>::max();
    if (n_vertices > kMost || n_tets > kMost)
      throw std::invalid_argument(text("n_vertices and n_tets are ", n_vertices, " and ", n_tets,
                                       ", expected at most ", kMost, " of each"));
    using Corners = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
    const fem::TetMesh<double> made(read_rows<double>(vertices, static_cast<Index>(n_vertices), 3),
                                    Eigen::Map<const Corners>(tets, static_cast<Index>(n_tets), 4));
    *mesh = add_handle(std::make_shared<const Mesh>(made));
  });
}

nmp_status nmp_mesh_save(const nmp_mesh* mesh, const char* path) {
  return guarded(__func__, [&] {
    const auto m = find(mesh);
    need(path, "path");
    fem::RawMesh raw;
    raw.vertices = m->double_precision.vertices();
    raw.tets = m->double_precision.tets();
    fem::write_mesh(path, raw);
  });
}

nmp_status nmp_mesh_free(nmp_mesh* mesh) {
  return guarded(__func__, [&] { remove_handle(mesh); });
}

nmp_status nmp_mesh_counts(const nmp_mesh* mesh, size_t* n_vertices, size_t* n_tets,
                           size_t* n_triangles) {
  return guarded(__func__, [&] {
    const auto m = find(mesh);
    if (n_vertices) *n_vertices = static_cast<size_t>(m->double_precision.n_vertices());
    if (n_tets) *n_tets = static_cast<size_t>(m->double_precision.n_tets());
    if (n_triangles) *n_triangles = static_cast<size_t>(m->triangles.rows());
  });
}

nmp_status nmp_mesh_vertices(const nmp_mesh* mesh, double* vertices, size_t n) {
  return guarded(__func__, [&] {
    copy_rows(find(mesh)->double_precision.vertices(), vertices, n, "vertices");
  });
}

nmp_status nmp_mesh_tets(const nmp_mesh* mesh, int32_t* corners, size_t n) {
  return guarded(__func__,
                 [&] { copy_rows(find(mesh)->double_precision.tets(), corners, n, "corners"); });
}

nmp_status nmp_mesh_triangles(const nmp_mesh* mesh, int32_t* corners, size_t n) {
  return guarded(__func__, [&] { copy_rows(find(mesh)->triangles, corners, n, "corners"); });
}

nmp_status nmp_mesh_vertex_volumes(const nmp_mesh* mesh, double* volumes, size_t n) {
  return guarded(__func__, [&] {
    copy_rows(find(mesh)->double_precision.vertex_volumes(), volumes, n, "volumes");
  });
}

nmp_status nmp_mesh_file_vertices(const nmp_mesh* mesh, int32_t* vertices, size_t n) {
  return guarded(__func__, [&] {
    const auto m = find(mesh);
    const auto n_vertices = static_cast<size_t>(m->double_precision.n_vertices());
    need_buffer(vertices, n, n_vertices, "vertices");
    if (m->file_vertices.empty())
      std::iota(vertices, vertices + n, 0);
    else
      std::copy(m->file_vertices.begin(), m->file_vertices.end(), vertices);
  });
}

nmp_status nmp_mesh_report(const nmp_mesh* mesh, char* text, size_t capacity, size_t* size) {
  return guarded(__func__, [&] {
    const auto m = find(mesh);
    need(size, "size");
    const size_t bytes = m->report.size() + 1;
    if (capacity >= bytes) {
      need(text, "text");
      std::memcpy(text, m->report.c_str(), bytes);
    }
    *size = bytes;
  });
}
}
