#include "fem/mesh_file.h"

#include "base/check.h"
#include "fem/mesh_reader.h"

namespace nmp::fem {

MeshFormat mesh_format(const Path& path) {
  const std::string ending = lower_ending(path);
  if (ending == ".msh") return MeshFormat::gmsh;
  if (ending == ".node" || ending == ".ele") return MeshFormat::tetgen;
  if (ending == ".vtk") return MeshFormat::vtk;
  if (ending == ".vtu") return MeshFormat::vtu;
  const bool is_surface = ending == ".obj" || ending == ".stl" || ending == ".ply";
  throw ConfigError(
      in_quotes(path.string()) +
      ": expected the name of a mesh file that ends in .msh (Gmsh), .node or .ele "
      "(TetGen), .vtk or .vtu, found " +
      (ending.empty() ? "no ending" : in_quotes(ending)) +
      (is_surface ? "; that is a surface: 'nmp mesh tet' fills it with tetrahedra" : ""));
}

std::vector<Path> mesh_files(const Path& path) {
  if (mesh_format(path) != MeshFormat::tetgen) return {path};
  Path node = path, ele = path;
  node.replace_extension(".node");
  ele.replace_extension(".ele");
  return {node, ele};
}

std::string mesh_checksum(const Path& path) {
  const std::vector<Path> files = mesh_files(path);
  std::string sums;
  for (const Path& file : files) sums += hash_file(file);
  return files.size() == 1 ? sums : hex(hash_bytes(sums.data(), sums.size()));
}

void turn_and_scale(Matrix<double>& vertices, double scale, bool y_up) {
  if (y_up) {
    vertices.col(1).swap(vertices.col(2));
    vertices.col(1) *= -1;
  }
  vertices *= scale;
}

RawMesh read_mesh(const Path& path, const MeshLimits& limits) {
  const MeshFormat format = mesh_format(path);
  const std::vector<Path> files = mesh_files(path);
  const MappedFile file(files[0]);
  const std::string_view bytes = bytes_of(file, files[0], limits);
  const std::string name = printable(files[0].string());
  switch (format) {
    case MeshFormat::gmsh:
      return read_gmsh(bytes, name, limits);
    case MeshFormat::vtk:
      return read_vtk(bytes, name, limits);
    case MeshFormat::vtu:
      return read_vtu(bytes, name, limits);
    case MeshFormat::tetgen:
      break;
  }
  const MappedFile ele(files[1]);
  return read_tetgen(bytes, name, bytes_of(ele, files[1], limits), printable(files[1].string()),
                     limits);
}

}  // namespace nmp::fem
