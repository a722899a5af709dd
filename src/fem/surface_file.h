#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "base/file.h"
#include "fem/mesh_file.h"
#include "fem/surface.h"

namespace nmp::fem {

/// What a surface file says. Only the format is checked: every index names a vertex and every
/// coordinate is finite. check_surface and repair (surface_check.h) look at the rest.
struct RawSurface {
  Matrix<double> vertices;         // #V x 3, in the file's units
  Triangles triangles;             // #F x 3, rows of vertices; polygons become fans of them
  std::vector<std::string> notes;  // what the reader left out, for people
};

/// Readers of untrusted bytes, as those in mesh_file.h. A polygon becomes a fan of triangles around
/// its first corner.
/// @param name  of the file, in messages
/// @throws InputError  with file:line, or the byte in binary parts, what was expected and found

/// Wavefront .obj: v and f, corners as v, v/vt, v//vn or v/vt/vn, counted from 1 or back from the
/// end. Everything else is left out.
RawSurface read_obj(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});
/// .stl, ASCII and binary. Corners at the very same place become one vertex, in the order of their
/// first appearance.
RawSurface read_stl(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});
/// .ply 1.0, ASCII and binary of either byte order, with any elements and properties: x, y, z of
/// `vertex` and the list vertex_indices or vertex_index of `face` are read.
RawSurface read_ply(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});

enum class SurfaceFormat { obj, stl, ply };
/// Whether the name ends in .obj, .stl or .ply.
bool is_surface_file(const Path& path);
/// @throws ConfigError  listing the endings if it is none of them
SurfaceFormat surface_format(const Path& path);

/// @throws ConfigError for an unknown ending, IoError, InputError
RawSurface read_surface(const Path& path, const MeshLimits& limits = {});
/// Writes it atomically: text that reads back to the bit, or binary: PLY little-endian with double
/// coordinates, STL with float ones.
/// @throws ConfigError for an unknown ending or binary OBJ, IoError
void write_surface(const Path& path, const RawSurface& surface, bool binary = false);

/// For every row of `points` (#P x 3) the number of its place, places numbered by first appearance;
/// 0 and -0 are the same. Time n log n, whatever the points.
std::vector<std::int32_t> number_places(const Matrix<double>& points);

}  // namespace nmp::fem
