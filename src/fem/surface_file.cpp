#include "fem/surface_file.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <tuple>

#include "base/check.h"
#include "fem/mesh_output.h"
#include "fem/surface_reader.h"
#include "fem/surface_writer.h"

namespace nmp::fem {

namespace {

std::optional<SurfaceFormat> format_of(const Path& path) {
  const std::string ending = lower_ending(path);
  if (ending == ".obj") return SurfaceFormat::obj;
  if (ending == ".stl") return SurfaceFormat::stl;
  if (ending == ".ply") return SurfaceFormat::ply;
  return std::nullopt;
}

// Readers take the normal from the corners; zero says so.
std::string to_stl(const RawSurface& surface, bool binary) {
  const bool swap = !is_little_endian();  // the file is little-endian
  Output out;
  if (binary) {
    out << std::string(80, ' ');
    out.binary(static_cast<std::uint32_t>(surface.triangles.rows()), swap);
  } else {
    out << "solid surface\n";
  }
  for (Index f = 0; f < surface.triangles.rows(); ++f) {
    if (binary) {
      for (int k = 0; k < 3; ++k) out.binary(0.0f);
    } else {
      out << "facet normal 0 0 0\nouter loop\n";
    }
    for (int a = 0; a < 3; ++a) {
      const auto x = surface.vertices.row(surface.triangles(f, a));
      if (binary) {
        for (int k = 0; k < 3; ++k) out.binary(static_cast<float>(x(k)), swap);
      } else {
        (out << "vertex ").line(x);
      }
    }
    if (binary) {
      out.binary(std::uint16_t{0});
    } else {
      out << "endloop\nendfacet\n";
    }
  }
  if (!binary) out << "endsolid surface\n";
  return out.text();
}

std::string to_ply(const RawSurface& surface, bool binary) {
  const bool swap = !is_little_endian();
  Output out;
  out << "ply\nformat " << (binary ? "binary_little_endian" : "ascii") << " 1.0\nelement vertex "
      << surface.vertices.rows() << "\n";
  for (const char* axis : {"x", "y", "z"}) out << "property double " << axis << "\n";
  out << "element face " << surface.triangles.rows()
      << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (Index v = 0; v < surface.vertices.rows(); ++v) {
    if (!binary) out.line(surface.vertices.row(v));
    for (int k = 0; binary && k < 3; ++k) out.binary(surface.vertices(v, k), swap);
  }
  for (Index f = 0; f < surface.triangles.rows(); ++f) {
    if (!binary) (out << "3 ").line(surface.triangles.row(f));
    if (binary) out.binary(std::uint8_t{3});
    for (int a = 0; binary && a < 3; ++a) out.binary(surface.triangles(f, a), swap);
  }
  return out.text();
}

}  // namespace

bool is_surface_file(const Path& path) { return format_of(path).has_value(); }

SurfaceFormat surface_format(const Path& path) {
  if (const auto format = format_of(path)) return *format;
  const std::string ending = lower_ending(path);
  throw ConfigError(
      in_quotes(path.string()) +
      ": expected the name of a surface file that ends in .obj, .stl or .ply, found " +
      (ending.empty() ? "no ending" : in_quotes(ending)));
}

RawSurface read_surface(const Path& path, const MeshLimits& limits) {
  const SurfaceFormat format = surface_format(path);
  const MappedFile file(path);
  const std::string_view bytes = bytes_of(file, path, limits);
  const std::string name = printable(path.string());
  return format == SurfaceFormat::obj   ? read_obj(bytes, name, limits)
         : format == SurfaceFormat::stl ? read_stl(bytes, name, limits)
                                        : read_ply(bytes, name, limits);
}

void write_surface(const Path& path, const RawSurface& surface, bool binary) {
  NMP_CHECK(surface.vertices.cols() == 3,
            "vertices must be #V x 3, got " + shape(surface.vertices));
  const SurfaceFormat format = surface_format(path);
  if (format == SurfaceFormat::obj && binary) {
    throw ConfigError(path.string() +
                      ": .obj files are text only; leave out the binary option, or choose .stl or "
                      ".ply");
  }
  write_text(path, format == SurfaceFormat::obj   ? to_obj(surface.vertices, surface.triangles)
                   : format == SurfaceFormat::stl ? to_stl(surface, binary)
                                                  : to_ply(surface, binary));
}

std::vector<std::int32_t> number_places(const Matrix<double>& points) {
  std::vector<std::int32_t> order(static_cast<std::size_t>(points.rows()));
  std::iota(order.begin(), order.end(), 0);
  const auto key = [&](std::int32_t v) {
    return std::make_tuple(points(v, 0), points(v, 1), points(v, 2));
  };
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    return std::make_tuple(key(a), a) < std::make_tuple(key(b), b);
  });
  // The first point at each place, then numbers in the order of the first points.
  std::vector<std::int32_t> place(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) {
    const bool same = i > 0 && key(order[i]) == key(order[i - 1]);
    place[static_cast<std::size_t>(order[i])] =
        same ? place[static_cast<std::size_t>(order[i - 1])] : order[i];
  }
  std::int32_t n = 0;
  for (std::size_t v = 0; v < place.size(); ++v) {
    const auto first = static_cast<std::size_t>(place[v]);
    place[v] = first == v ? n++ : place[first];
  }
  return place;
}

void SurfaceBuilder::add_vertex(const MeshCursor& at, double x, double y, double z) {
  check_vertex(at, x, y, z, n_vertices(), limits_);
  xyz_.insert(xyz_.end(), {x, y, z});
}

void SurfaceBuilder::add_polygon(const MeshCursor& at, const std::vector<std::int64_t>& corners) {
  if (corners.size() < 3) at.fail("at least 3 corners of a face", text(corners.size()));
  n_polygons_ += corners.size() > 3;
  for (std::size_t k = 2; k < corners.size(); ++k) {
    if (static_cast<Index>(triangles_.size() / 3) >= limits_.triangles) {
      at.fail(text("at most ", limits_.triangles, " triangles"), "more");
    }
    for (const std::int64_t corner : {corners[0], corners[k - 1], corners[k]}) {
      triangles_.push_back(static_cast<std::int32_t>(corner));
    }
  }
}

RawSurface SurfaceBuilder::finish() const {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  using RowMajorTriangles = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
  RawSurface surface;
  surface.vertices = Eigen::Map<const RowMajor>(xyz_.data(), n_vertices(), 3);
  surface.triangles = Eigen::Map<const RowMajorTriangles>(
      triangles_.data(), static_cast<Index>(triangles_.size() / 3), 3);
  if (n_polygons_ > 0) {
    surface.notes.push_back(text(n_polygons_, n_polygons_ == 1 ? " polygon is" : " polygons are",
                                 " cut into triangles: these have their numbers"));
  }
  if (n_ignored_ > 0) {
    surface.notes.push_back(text(
        n_ignored_, n_ignored_ == 1 ? " line or point is" : " lines and points are", " left out"));
  }
  return surface;
}

}  // namespace nmp::fem
