#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "autodiff/types.h"
#include "base/file.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

/// What a mesh file says. Only the format is checked: every index names a vertex and every
/// coordinate is finite. check_mesh and repair (mesh_check.h) look at the rest.
struct RawMesh {
  Matrix<double> vertices;         // #V x 3, in the file's units
  Tets tets;                       // #T x 4, rows of vertices
  std::vector<std::string> notes;  // what the reader left out, for people
};

/// Bounds on what a reader takes in. What it allocates grows with the bytes it has seen, never with
/// a count that a file claims; only compressed data can grow beyond its file, up to
/// `decoded_bytes`.
struct MeshLimits {
  std::uint64_t file_bytes = std::uint64_t{16} << 30;
  std::uint64_t decoded_bytes = std::uint64_t{16} << 30;  // all arrays of a file together
  Index vertices = (Index(1) << 31) - 1;
  Index tets = (Index(1) << 29) - 1;       // TetMesh numbers corners in 31 bits
  Index triangles = (Index(1) << 29) - 1;  // of a surface (surface_file.h)
};

/// Readers of untrusted bytes. Surface, line and point cells are left out and counted in `notes`;
/// any volume cell but the tetrahedron of 4 vertices is refused.
/// @param name  of the file, in messages
/// @throws InputError  with file:line, or the byte in binary parts, what was expected and found

/// Gmsh .msh 2.0 to 2.2 and 4.1, ASCII and binary of either byte order.
RawMesh read_gmsh(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});
/// TetGen's pair of files; vertices numbered from 0 or 1.
RawMesh read_tetgen(std::string_view node, const std::string& node_name, std::string_view ele,
                    const std::string& ele_name, const MeshLimits& limits = {});
/// Legacy VTK, an unstructured grid of versions 2.0 to 4.2 and 5.1, ASCII and BINARY.
RawMesh read_vtk(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});
/// VTK's XML unstructured grid with one piece: ascii, binary (base64), appended raw or base64,
/// either byte order, plain or zlib.
RawMesh read_vtu(std::string_view bytes, const std::string& name, const MeshLimits& limits = {});

enum class MeshFormat { gmsh, tetgen, vtk, vtu };
/// By the ending of the name: .msh; .node or .ele; .vtk; .vtu.
/// @throws ConfigError  listing the endings if it is none of them
MeshFormat mesh_format(const Path& path);
/// The files that hold a mesh: the path itself, or TetGen's .node and .ele beside each other.
std::vector<Path> mesh_files(const Path& path);
/// A checksum of the content of all of them (XXH3, 16 hexadecimal digits).
std::string mesh_checksum(const Path& path);

/// @throws ConfigError for an unknown ending, IoError, InputError
RawMesh read_mesh(const Path& path, const MeshLimits& limits = {});

/// To metres and z up.
/// @param vertices  #V x 3, changed
/// @param scale  metres in a unit of the file   @param y_up  turned by (x, y, z) -> (x, -z, y), a
///               quarter turn about x
void turn_and_scale(Matrix<double>& vertices, double scale, bool y_up);

struct MeshWriteOptions {
  bool binary = false;  // VTU: appended raw; TetGen has no binary form
  bool gmsh2 = false;   // Gmsh 2.2 instead of 4.1
};
/// Writes what read_mesh reads back to the bit, each file atomically.
/// @throws ConfigError for an unknown ending or binary TetGen, IoError
void write_mesh(const Path& path, const RawMesh& mesh, const MeshWriteOptions& options = {});

}  // namespace nmp::fem
