#include <initializer_list>

#include "fem/mesh_output.h"
#include "fem/mesh_reader.h"
#include "fem/vtu_writer.h"

namespace nmp::fem {

namespace {

void write_vertex(Output& out, const RawMesh& mesh, Index v) { out.line(mesh.vertices.row(v)); }

void write_tet(Output& out, const RawMesh& mesh, Index e, std::int32_t first) {
  out.line((mesh.tets.row(e).array() + first).eval());
}

std::string to_gmsh2(const RawMesh& mesh, bool binary) {
  const Index n_vertices = mesh.vertices.rows(), n_tets = mesh.tets.rows();
  Output out;
  out << "$MeshFormat\n2.2 " << int{binary} << " 8\n";
  if (binary) out.binary(std::int32_t{1});
  out << (binary ? "\n" : "") << "$EndMeshFormat\n$Nodes\n" << n_vertices << "\n";
  for (Index v = 0; v < n_vertices; ++v) {
    if (binary) {
      out.binary(static_cast<std::int32_t>(v + 1));
      for (int k = 0; k < 3; ++k) out.binary(mesh.vertices(v, k));
    } else {
      out << v + 1 << " ";
      write_vertex(out, mesh, v);
    }
  }
  out << (binary ? "\n" : "") << "$EndNodes\n$Elements\n" << n_tets << "\n";
  // Two tags: physical group and part of the geometry, both 1.
  if (binary && n_tets > 0) {
    for (const std::int32_t head : {std::int32_t{4}, static_cast<std::int32_t>(n_tets), 2}) {
      out.binary(head);
    }
  }
  for (Index e = 0; e < n_tets; ++e) {
    if (binary) {
      out.binary(static_cast<std::int32_t>(e + 1));
      for (int tag = 0; tag < 2; ++tag) out.binary(std::int32_t{1});
      for (int a = 0; a < 4; ++a) out.binary(mesh.tets(e, a) + 1);
    } else {
      out << e + 1 << " 4 2 1 1 ";
      write_tet(out, mesh, e, 1);
    }
  }
  out << (binary ? "\n" : "") << "$EndElements\n";
  return out.text();
}

// Everything in one block: some programs read no more.
std::string to_gmsh4(const RawMesh& mesh, bool binary) {
  const Index n_vertices = mesh.vertices.rows(), n_tets = mesh.tets.rows();
  Output out;
  const auto sizes = [&](std::initializer_list<Index> values) {
    for (const Index value : values) {
      if (binary) {
        out.binary(static_cast<std::uint64_t>(value));
      } else {
        out << value << " ";
      }
    }
    if (!binary) out << "\n";
  };
  const auto block_head = [&](std::int32_t last, Index n) {
    for (const std::int32_t value : {std::int32_t{3}, std::int32_t{1}, last}) {
      if (binary) {
        out.binary(value);
      } else {
        out << value << " ";
      }
    }
    sizes({n});
  };
  out << "$MeshFormat\n4.1 " << int{binary} << " 8\n";
  if (binary) out.binary(std::int32_t{1});
  out << (binary ? "\n" : "") << "$EndMeshFormat\n$Nodes\n";
  sizes({n_vertices > 0, n_vertices, 1, n_vertices});
  if (n_vertices > 0) block_head(0, n_vertices);
  for (Index v = 0; v < n_vertices; ++v) sizes({v + 1});
  for (Index v = 0; v < n_vertices; ++v) {
    if (binary) {
      for (int k = 0; k < 3; ++k) out.binary(mesh.vertices(v, k));
    } else {
      write_vertex(out, mesh, v);
    }
  }
  out << (binary ? "\n" : "") << "$EndNodes\n$Elements\n";
  sizes({n_tets > 0, n_tets, 1, n_tets});
  if (n_tets > 0) block_head(4, n_tets);
  for (Index e = 0; e < n_tets; ++e) {
    sizes({e + 1, mesh.tets(e, 0) + 1, mesh.tets(e, 1) + 1, mesh.tets(e, 2) + 1,
           mesh.tets(e, 3) + 1});
  }
  out << (binary ? "\n" : "") << "$EndElements\n";
  return out.text();
}

std::string to_node(const RawMesh& mesh) {
  Output out;
  out << mesh.vertices.rows() << " 3 0 0\n";
  for (Index v = 0; v < mesh.vertices.rows(); ++v) {
    out << v + 1 << " ";
    write_vertex(out, mesh, v);
  }
  return out.text();
}

std::string to_ele(const RawMesh& mesh) {
  Output out;
  out << mesh.tets.rows() << " 4 0\n";
  for (Index e = 0; e < mesh.tets.rows(); ++e) {
    out << e + 1 << " ";
    write_tet(out, mesh, e, 1);
  }
  return out.text();
}

// Version 3.0: everything reads it.
std::string to_vtk(const RawMesh& mesh, bool binary) {
  const Index n_vertices = mesh.vertices.rows(), n_tets = mesh.tets.rows();
  const bool swap = is_little_endian();  // the file is big-endian
  Output out;
  out << "# vtk DataFile Version 3.0\ntetrahedra\n"
      << (binary ? "BINARY" : "ASCII") << "\nDATASET UNSTRUCTURED_GRID\nPOINTS " << n_vertices
      << " double\n";
  for (Index v = 0; v < n_vertices; ++v) {
    if (binary) {
      for (int k = 0; k < 3; ++k) out.binary(mesh.vertices(v, k), swap);
    } else {
      write_vertex(out, mesh, v);
    }
  }
  out << (binary ? "\n" : "") << "CELLS " << n_tets << " " << 5 * n_tets << "\n";
  for (Index e = 0; e < n_tets; ++e) {
    if (binary) {
      out.binary(std::int32_t{4}, swap);
      for (int a = 0; a < 4; ++a) out.binary(mesh.tets(e, a), swap);
    } else {
      out << "4 ";
      write_tet(out, mesh, e, 0);
    }
  }
  out << (binary ? "\n" : "") << "CELL_TYPES " << n_tets << "\n";
  for (Index e = 0; e < n_tets; ++e) {
    if (binary) {
      out.binary(std::int32_t{10}, swap);
    } else {
      out << "10\n";
    }
  }
  if (binary) out << "\n";
  return out.text();
}

}  // namespace

void write_mesh(const Path& path, const RawMesh& mesh, const MeshWriteOptions& options) {
  NMP_CHECK(mesh.vertices.cols() == 3, "vertices must be #V x 3, got " + shape(mesh.vertices));
  const std::vector<Path> files = mesh_files(path);
  switch (mesh_format(path)) {
    case MeshFormat::gmsh:
      return write_text(files[0], options.gmsh2 ? to_gmsh2(mesh, options.binary)
                                                : to_gmsh4(mesh, options.binary));
    case MeshFormat::vtk:
      return write_text(files[0], to_vtk(mesh, options.binary));
    case MeshFormat::vtu:
      return write_text(files[0], to_vtu({mesh.vertices, mesh.tets, {}, {}}, {options.binary}));
    case MeshFormat::tetgen:
      if (options.binary) {
        throw ConfigError(path.string() +
                          ": TetGen's files are text only; leave out the binary "
                          "option, or choose another format");
      }
      write_text(files[0], to_node(mesh));
      write_text(files[1], to_ele(mesh));
  }
}

}  // namespace nmp::fem
