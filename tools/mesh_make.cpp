// nmp mesh tet, box, surface: tetrahedra from a surface or from nothing, and the surface of a mesh.
//   nmp mesh tet body.stl -o body.msh
//   nmp mesh box -o beam.msh --size 1,0.1,0.1 --cells 40,4,4
//   nmp mesh surface body.msh -o body.ply

#include <memory>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "fem/external_mesher.h"
#include "fem/fill.h"
#include "fem/mesh_check.h"
#include "fem/mesh_cube.h"
#include "fem/mesh_quality.h"
#include "fem/surface_check.h"
#include "mesh.h"

namespace nmp::mesh_tool {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  Input in;
  std::string out;
  std::string mesher = "builtin";
  fem::FillOptions fill;
  bool largest = false;      // tet: the largest part alone
  bool binary = false;       // surface
  std::vector<double> size;  // box [m]
  std::vector<Index> cells;  // box
  common::Flags flags;
};

void refuse_to_overwrite_mesh(const Options& o) {
  if (fem::is_surface_file(o.out))
    throw ConfigError(in_quotes(o.out) +
                      ": the output is a mesh of tetrahedra: expected .msh, .node or .ele, .vtk or "
                      ".vtu, found the ending of a surface");
  for (const Path& file : fem::mesh_files(o.out)) refuse_to_overwrite(file, o.flags.force);
}

bool holds_tets(const Path& file) {
  const std::string ending = file.extension().string();
  for (const char* mesh : {".msh", ".node", ".ele", ".vtk", ".vtu"})
    if (ending == mesh) return true;
  return false;
}

Json quality_json(const fem::MeshQuality& q) {
  return {{"volume", q.volume},
          {"low", {q.low(0), q.low(1), q.low(2)}},
          {"high", {q.high(0), q.high(1), q.high(2)}},
          {"edge", {{"min", q.edge_min}, {"mean", q.edge_mean}, {"max", q.edge_max}}},
          {"dihedral", {{"min", q.dihedral_min}, {"max", q.dihedral_max}}}};
}

// Writes the mesh, unless something is wrong with it, and says what it is like.
void deliver(const Options& o, const fem::RawMesh& raw, Json json) {
  const fem::RepairedMesh repaired = fem::repair(raw, printable(o.out));
  warn(repaired.warnings);
  const fem::TetMesh<double> mesh(repaired.mesh.vertices, repaired.mesh.tets);
  const fem::MeshQuality q = fem::quality(mesh);
  fem::write_mesh(o.out, repaired.mesh);
  const auto number = [](double value) { return common::number(value); };
  json["mesh"] = o.out;
  json["n_vertices"] = mesh.n_vertices();
  json["n_tets"] = mesh.n_tets();
  json.update(quality_json(q));
  for (const std::string& warning : repaired.warnings) json["warnings"].push_back(warning);
  common::print(o.flags.json
                    ? common::dump(json) + "\n"
                    : text(o.out, ": ", mesh.n_vertices(), " vertices, ", mesh.n_tets(),
                           " tetrahedra, ", number(q.volume), " m3; angles between faces ",
                           number(q.dihedral_min), " to ", number(q.dihedral_max), " degrees\n"));
}

void tet(Options o) {
  refuse_to_overwrite_mesh(o);
  if (holds_tets(o.in.file))
    throw ConfigError(in_quotes(o.in.file) +
                      ": expected a surface, .obj, .stl or .ply, found a mesh file: a mesh of "
                      "tetrahedra goes to 'nmp data gen --mesh' as it is");
  if (o.mesher != "builtin") fem::find_mesher(o.mesher);  // before the work
  fem::RawSurface raw = fem::read_surface(o.in.file);
  o.in.place(raw.vertices);
  const fem::RepairedSurface surface = fem::repair(raw, printable(o.in.file));
  std::vector<std::string> warnings = raw.notes;
  warnings.insert(warnings.end(), surface.warnings.begin(), surface.warnings.end());
  Json json = {{"surface",
                {{"file", o.in.file},
                 {"n_vertices", raw.vertices.rows()},
                 {"n_triangles", raw.triangles.rows()},
                 {"n_parts", surface.findings.n_parts},
                 {"area", surface.findings.area},
                 {"volume", surface.findings.volume},
                 {"openness", surface.findings.openness}}},
               {"mesher", o.mesher}};
  o.fill.size *= o.in.scale;
  o.fill.poll = common::stop_if_requested;
  if (o.largest) o.fill.crumb = 1;
  fem::RawMesh mesh;
  if (o.mesher == "builtin") {
    fem::FilledSurface filled = fem::fill(surface, o.fill, printable(o.in.file));
    warnings.insert(warnings.end(), filled.warnings.begin(), filled.warnings.end());
    const auto& n = filled.lattice.cells;
    json["cell"] = filled.lattice.cell;
    json["resolution"] = std::max({n[0], n[1], n[2]}) - 2;  // without the margin
    json["n_parts"] = filled.parts.n_parts;
    json["n_parts_dropped"] = filled.parts.n_crumbs;
    json["distance_in_cells"] = filled.distance;
    json["lost_area"] = filled.lost_area;
    mesh = std::move(filled.mesh);
  } else {
    try {
      mesh = fem::fill_by(o.mesher, surface, o.fill, common::stop_requested);
    } catch (const InputError&) {
      common::stop_if_requested();  // a signal that ended the mesher too
      throw;
    }
  }
  warn(warnings);
  json["warnings"] = warnings;
  deliver(o, mesh, std::move(json));
}

void box(const Options& o) {
  refuse_to_overwrite_mesh(o);
  try {
    const fem::TetMesh<double> mesh =
        fem::box_mesh({o.cells[0], o.cells[1], o.cells[2]}, {o.size[0], o.size[1], o.size[2]});
    deliver(o, {mesh.vertices(), mesh.tets(), {}}, Json::object());
  } catch (const std::invalid_argument& error) {
    throw ConfigError(error.what());
  }
}

void surface(const Options& o) {
  fem::surface_format(o.out);
  refuse_to_overwrite(o.out, o.flags.force);
  fem::RawMesh raw = fem::read_mesh(o.in.file);
  o.in.place(raw.vertices);
  warn(raw.notes);
  const fem::RepairedMesh repaired = fem::repair(raw, printable(o.in.file));
  warn(repaired.warnings);
  const fem::Surface skin = fem::extract_surface(repaired.mesh.tets);
  fem::RawSurface surface;
  surface.triangles = skin.triangles;
  surface.vertices = on_surface(repaired.mesh.vertices, skin);
  fem::write_surface(o.out, surface, o.binary);
  print_surface(o.out, surface, o.flags);
}

void add_output(CLI::App& app, Options& o, const char* what) {
  app.add_option("-o,--output", o.out, what)->required()->type_name("FILE");
  common::add_force(app, o.flags);
  common::add_json(app, o.flags);
}

constexpr const char* kMeshOut = "The mesh to write: .msh, .node or .ele, .vtk or .vtu";

}  // namespace

void add_tet(CLI::App& mesh) {
  const auto o = std::make_shared<Options>();
  CLI::App& app =
      common::add_command(mesh, "tet", "Fill a surface with tetrahedra",
                          "Holes, crossings and flipped triangles are handled and reported. A "
                          "surface that encloses no\n"
                          "body is refused with exit code 3.",
                          {"nmp mesh tet body.stl -o body.msh",
                           "nmp mesh tet scan.ply -o scan.vtu --resolution 32 --scale 0.001 --up y",
                           "nmp mesh tet body.obj -o body.msh --mesher tetgen --size 0.05"});
  add_input(app, o->in, "IN", "Surface: .obj, .stl or .ply");
  auto* size = app.add_option("--size", o->fill.size, "Length of edges in units of the file")
                   ->type_name("H")
                   ->check(common::real_number(1e-100, 1e100))
                   ->default_str("");
  auto* resolution =
      app.add_option("--resolution", o->fill.resolution, "Cells along the longest side")
          ->type_name("N")
          ->check(common::whole_number(1, 1 << 20))
          ->default_str("");
  app.add_option("--vertices", o->fill.vertices,
                 "About so many vertices, in place of the two above")
      ->type_name("N")
      ->check(common::whole_number(10, 10000000))
      ->excludes(size)
      ->excludes(resolution);
  size->excludes(resolution);
  app.add_flag("--largest", o->largest,
               "Keep the largest part alone; otherwise all of at least 1 % of its volume");
  common::one_of(app.add_option("--mesher", o->mesher,
                                "What fills it: nmp itself, or another program that is installed; "
                                "those keep the triangles of the surface, but take no holes or "
                                "crossings"),
                 {"builtin", "tetgen", "gmsh"});
  common::add_threads(app);
  add_output(app, *o, kMeshOut);
  app.callback([o] { tet(*o); });
}

void add_box(CLI::App& mesh) {
  const auto o = std::make_shared<Options>();
  CLI::App& app =
      common::add_command(mesh, "box", "Make a box of tetrahedra, centred at the origin",
                          "Each cell is five tetrahedra, as in the scene 'cube'.",
                          {"nmp mesh box -o beam.msh --size 1,0.1,0.1 --cells 40,4,4"});
  app.add_option("--size", o->size, "Lengths of the box's edges in metres")
      ->type_name("X,Y,Z")
      ->delimiter(',')
      ->expected(3)
      ->required()
      ->check(common::real_number(1e-100, 1e100));
  app.add_option("--cells", o->cells, "Numbers of cells along them")
      ->type_name("NX,NY,NZ")
      ->delimiter(',')
      ->expected(3)
      ->required()
      ->check(common::whole_number(1, 1000000));
  add_output(app, *o, kMeshOut);
  app.callback([o] { box(*o); });
}

void add_surface(CLI::App& mesh) {
  const auto o = std::make_shared<Options>();
  CLI::App& app = common::add_command(
      mesh, "surface", "Write the surface of a mesh",
      "The triangles are counter-clockwise seen from outside.",
      {"nmp mesh surface body.msh -o body.ply", "nmp mesh surface body.msh -o body.stl --binary"});
  add_input(app, o->in, "IN", "Mesh: .msh (Gmsh), .node or .ele (TetGen), .vtk or .vtu");
  app.add_flag("--binary", o->binary, "Write the binary form of .stl or .ply");
  add_output(app, *o, "The surface to write: .obj, .stl or .ply");
  app.callback([o] { surface(*o); });
}

}  // namespace nmp::mesh_tool
