#include "fem/external_mesher.h"

#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "base/process.h"

namespace nmp::fem {

namespace {

// The last lines of what a program said, on one line.
std::string last_words(std::string output) {
  constexpr std::size_t kLast = 400;
  if (output.size() > kLast) output.erase(0, output.size() - kLast);
  std::replace(output.begin(), output.end(), '\n', ' ');
  return output.empty() ? "nothing" : in_quotes(output);
}

// TetGen keeps the triangles; -a bounds the volumes: that of a regular tet is h^3 / (6 sqrt 2).
RawMesh by_tetgen(const Path& program, const Path& folder, double size, ProcessResult& result,
                  const std::function<bool()>& stop) {
  const std::string volume = text(size * size * size / (6 * std::sqrt(2.0)));
  result = run_process(program, {"-pqa" + volume, "in.ply"}, folder, stop);
  return result.status == 0 && std::filesystem::exists(folder / "in.1.ele")
             ? read_mesh(folder / "in.1.node")
             : RawMesh();
}

RawMesh by_gmsh(const Path& program, const Path& folder, double size, ProcessResult& result,
                const std::function<bool()>& stop) {
  write_text(folder / "in.geo", text("Merge \"in.stl\";\nSurface Loop(1) = {1};\nVolume(1) = {1};\n"
                                     "Mesh.MeshSizeMax = ",
                                     size, ";\n"));
  result =
      run_process(program, {"-3", "-format", "msh41", "-o", "out.msh", "in.geo"}, folder, stop);
  return result.status == 0 && std::filesystem::exists(folder / "out.msh")
             ? read_mesh(folder / "out.msh")
             : RawMesh();
}

}  // namespace

Path find_mesher(const std::string& mesher) {
  if (const auto program = find_program(mesher)) return *program;
  throw ConfigError("--mesher " + mesher + ": the program '" + mesher +
                    "' is not installed; on Debian the package is called " + mesher +
                    ", or leave the option out");
}

RawMesh fill_by(const std::string& mesher, const RepairedSurface& surface,
                const FillOptions& options, const std::function<bool()>& stop) {
  const Path program = find_mesher(mesher);
  const TemporaryFolder folder;
  const double size = cell_of(surface, options);
  ProcessResult result;
  RawMesh mesh;
  if (mesher == "tetgen") {
    write_surface(folder.path() / "in.ply", surface.surface);
    mesh = by_tetgen(program, folder.path(), size, result, stop);
  } else {
    write_surface(folder.path() / "in.stl", surface.surface);
    mesh = by_gmsh(program, folder.path(), size, result, stop);
  }
  if (mesh.tets.rows() == 0) {
    throw InputError(text(program.string(), ": expected a mesh of the surface, found exit status ",
                          result.status, " and ", last_words(result.output),
                          "; what 'nmp mesh check' says of the surface may be the cause, which the "
                          "built-in mesher copes with"));
  }
  mesh.notes.clear();
  return mesh;
}

}  // namespace nmp::fem
