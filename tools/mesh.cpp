// nmp mesh info, check, convert: look at a tetrahedral mesh, say what is wrong with it or with a
// surface, and write it in another format.
//   nmp mesh info body.msh
//   nmp mesh check body.msh --scale 0.001 --fix body_fixed.msh
//   nmp mesh check scan.stl
//   nmp mesh convert body.node body.vtu --up y --fix

#include <memory>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "fem/material.h"
#include "fem/mesh_check.h"
#include "fem/mesh_file.h"
#include "fem/mesh_quality.h"
#include "fem/stability.h"
#include "fem/surface_check.h"
#include "mesh.h"

namespace nmp {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  mesh_tool::Input in;
  std::string out;       // check: "" for none
  std::size_t ids = 10;  // check: how many of each defect
  bool all = false;      // check: all of them
  bool fix = false;      // convert: repair before writing
  bool no_step = false;  // info: leave out the stable time step
  bool binary = false;   // convert
  bool gmsh2 = false;    // convert: version 2.2
  common::Flags flags;
};

fem::RawMesh read(const Options& o) {
  fem::RawMesh mesh = fem::read_mesh(o.in.file);
  o.in.place(mesh.vertices);
  return mesh;
}

void info(const Options& o) {
  const fem::RawMesh raw = read(o);
  const fem::RepairedMesh repaired = fem::repair(raw, printable(o.in.file));
  mesh_tool::warn(raw.notes);
  mesh_tool::warn(repaired.warnings);
  const fem::TetMesh<double> mesh(repaired.mesh.vertices, repaired.mesh.tets);
  const fem::MeshQuality q = fem::quality(mesh);
  const fem::Material material;
  const double dt = o.no_step ? 0 : fem::stable_time_step(mesh, material);
  if (o.flags.json) {
    const Json json = {
        {"file", o.in.file},
        {"n_vertices", mesh.n_vertices()},
        {"n_tets", mesh.n_tets()},
        {"volume", q.volume},
        {"low", {q.low(0), q.low(1), q.low(2)}},
        {"high", {q.high(0), q.high(1), q.high(2)}},
        {"edge", {{"min", q.edge_min}, {"mean", q.edge_mean}, {"max", q.edge_max}}},
        {"dihedral",
         {{"min", q.dihedral_min},
          {"min_tet", q.dihedral_min_tet},
          {"max", q.dihedral_max},
          {"max_tet", q.dihedral_max_tet}}},
        {"aspect", {{"max", q.aspect_max}, {"max_tet", q.aspect_max_tet}}},
        {"stable_time_step", o.no_step ? Json() : Json(dt)},
        {"material", {{"E", material.E}, {"nu", material.nu}, {"density", material.density}}},
        {"checksum", fem::mesh_checksum(o.in.file)}};
    return common::print(common::dump(json) + "\n");
  }
  const auto number = [](double value) { return common::number(value); };
  common::print(common::table(
      {{"vertices", text(mesh.n_vertices())},
       {"tetrahedra", text(mesh.n_tets())},
       {"volume", number(q.volume) + " m3"},
       {"x", number(q.low(0)) + " to " + number(q.high(0)) + " m"},
       {"y", number(q.low(1)) + " to " + number(q.high(1)) + " m"},
       {"z", number(q.low(2)) + " to " + number(q.high(2)) + " m"},
       {"edges, shortest, mean, longest",
        number(q.edge_min) + ", " + number(q.edge_mean) + ", " + number(q.edge_max) + " m"},
       {"smallest angle between faces",
        number(q.dihedral_min) + " degrees, tet " + text(q.dihedral_min_tet)},
       {"largest angle between faces",
        number(q.dihedral_max) + " degrees, tet " + text(q.dihedral_max_tet)},
       {"worst longest edge / height (regular: 1.22)",
        number(q.aspect_max) + ", tet " + text(q.aspect_max_tet)},
       {text("stable time step (E ", material.E, " Pa, nu ", material.nu, ")"),
        o.no_step ? "not asked for" : number(dt) + " s"}}));
}

const char* word(fem::MeshRule rule) {
  return rule == fem::MeshRule::refuse   ? "refused"
         : rule == fem::MeshRule::repair ? "repaired"
                                         : "warning";
}

// What was found, as lines for people and as a list for programs.
// @param repaired  a repaired file is written
template <class Findings>
Json list_findings(const Findings& findings, const std::vector<std::string>& notes, bool repaired,
                   std::string& lines) {
  Json list = Json::array();
  for (const auto& finding : findings.all) {
    const char* rule = word(fem::rule(finding.defect));
    list.push_back({{"defect", fem::name(finding.defect)},
                    {"rule", rule},
                    {"count", finding.count},
                    {"first", finding.first},
                    {"text", fem::describe(finding)}});
    const bool could_be = fem::rule(finding.defect) == fem::MeshRule::repair && !repaired;
    lines += std::string(could_be ? "can be repaired (--fix OUT)" : rule) + ": " +
             fem::describe(finding) + "\n";
  }
  for (const std::string& note : notes) lines += "note: " + note + "\n";
  if (findings.all.empty()) lines += "nothing wrong\n";
  return list;
}

void tell_written(const std::string& file, Json& json, std::string& lines) {
  json["output"] = file;
  lines += file + ": written\n";
}

void check_surface(const Options& o, std::size_t ids) {
  if (!o.out.empty()) {
    fem::surface_format(o.out);
    refuse_to_overwrite(o.out, o.flags.force);
  }
  fem::RawSurface raw = fem::read_surface(o.in.file);
  o.in.place(raw.vertices);
  const fem::SurfaceFindings findings = fem::check_surface(raw, ids);
  std::vector<std::string> notes = raw.notes;
  notes.insert(notes.end(), findings.notes.begin(), findings.notes.end());
  std::string lines;
  const bool fix = !o.out.empty() && !findings.refused();
  const Json list = list_findings(findings, notes, fix, lines);
  Json json = {{"file", o.in.file},
               {"n_vertices", raw.vertices.rows()},
               {"n_triangles", raw.triangles.rows()},
               {"n_parts", findings.n_parts},
               {"area", findings.area},
               {"volume", findings.volume},
               {"openness", findings.openness},
               {"closed", !findings.refused() && findings.closed()},
               {"usable", !findings.refused()},
               {"findings", list},
               {"notes", notes}};
  if (!findings.refused()) {
    const Vec3<double> size =
        (raw.vertices.colwise().maxCoeff() - raw.vertices.colwise().minCoeff()).transpose();
    lines += text("a surface that 'nmp mesh tet' can fill: ", raw.triangles.rows(), " triangles",
                  findings.closed() ? " around " + common::number(findings.volume) + " m3" : "",
                  ", ", common::number(size(0)), " x ", common::number(size(1)), " x ",
                  common::number(size(2)), " m\n");
    if (!(size.maxCoeff() <= 100 && size.maxCoeff() >= 1e-3))
      lines += "warning: if the file is not in metres set the scale (--scale S)\n";
  }
  if (fix) {
    fem::write_surface(o.out, fem::repair(raw, o.in.file).surface, o.binary);
    tell_written(o.out, json, lines);
  }
  common::print(o.flags.json ? common::dump(json) + "\n" : lines);
  if (findings.refused()) throw InputError(printable(o.in.file) + ": cannot be filled as it is");
}

void check(const Options& o) {
  const std::size_t ids = o.all ? std::size_t{1} << 31 : o.ids;
  if (fem::is_surface_file(o.in.file)) return check_surface(o, ids);
  if (!o.out.empty()) {
    for (const Path& file : fem::mesh_files(o.out)) refuse_to_overwrite(file, o.flags.force);
  }
  const fem::RawMesh raw = read(o);
  const fem::MeshFindings findings = fem::check_mesh(raw, ids);
  std::string lines;
  const bool fix = !o.out.empty() && !findings.refused();
  const Json list = list_findings(findings, raw.notes, fix, lines);
  Json json = {{"file", o.in.file},
               {"n_vertices", raw.vertices.rows()},
               {"n_tets", raw.tets.rows()},
               {"n_parts", findings.n_parts},
               {"usable", !findings.refused()},
               {"findings", list},
               {"notes", raw.notes}};
  if (fix) {
    fem::write_mesh(o.out, fem::repair(raw, o.in.file).mesh, {o.binary, false});
    tell_written(o.out, json, lines);
  }
  common::print(o.flags.json ? common::dump(json) + "\n" : lines);
  if (findings.refused()) {
    throw InputError(printable(o.in.file) + ": cannot be simulated as it is");
  }
}

void convert_surface(const Options& o) {
  if (!fem::is_surface_file(o.out))
    throw ConfigError(text(in_quotes(o.out),
                           ": a surface is written as .obj, .stl or .ply; 'nmp "
                           "mesh tet' fills it with tetrahedra"));
  if (o.gmsh2) throw ConfigError("--gmsh2 goes with a mesh, not with a surface");
  refuse_to_overwrite(o.out, o.flags.force);
  fem::RawSurface surface = fem::read_surface(o.in.file);
  o.in.place(surface.vertices);
  mesh_tool::warn(surface.notes);
  if (o.fix) {
    const fem::RepairedSurface repaired = fem::repair(surface, printable(o.in.file));
    mesh_tool::warn(repaired.warnings);
    surface = repaired.surface;
  }
  fem::write_surface(o.out, surface, o.binary);
  mesh_tool::print_surface(o.out, surface, o.flags);
}

void convert(const Options& o) {
  if (fem::is_surface_file(o.in.file)) return convert_surface(o);
  if (fem::is_surface_file(o.out))
    throw ConfigError(in_quotes(o.out) + ": 'nmp mesh surface' writes the surface of a mesh");
  for (const Path& file : fem::mesh_files(o.out)) refuse_to_overwrite(file, o.flags.force);
  fem::RawMesh mesh = read(o);
  mesh_tool::warn(mesh.notes);
  if (o.fix) {
    const fem::RepairedMesh repaired = fem::repair(mesh, printable(o.in.file));
    mesh_tool::warn(repaired.warnings);
    mesh = repaired.mesh;
  }
  fem::write_mesh(o.out, mesh, {o.binary, o.gmsh2});
  const Json json = {
      {"mesh", o.out}, {"n_vertices", mesh.vertices.rows()}, {"n_tets", mesh.tets.rows()}};
  common::print(o.flags.json ? common::dump(json) + "\n"
                             : text(o.out, ": ", mesh.vertices.rows(), " vertices, ",
                                    mesh.tets.rows(), " tetrahedra\n"));
}

constexpr const char* kMesh = "Mesh: .msh (Gmsh), .node or .ele (TetGen), .vtk or .vtu";
constexpr const char* kMeshOrSurface =
    "Mesh: .msh, .node or .ele, .vtk or .vtu; or surface: .obj, .stl or .ply";

}  // namespace

namespace mesh_tool {

void warn(const std::vector<std::string>& warnings) {
  for (const std::string& warning : warnings) common::note("warning: " + warning);
}

void print_surface(const std::string& file, const fem::RawSurface& surface,
                   const common::Flags& flags) {
  const Json json = {{"surface", file},
                     {"n_vertices", surface.vertices.rows()},
                     {"n_triangles", surface.triangles.rows()}};
  common::print(flags.json ? common::dump(json) + "\n"
                           : text(file, ": ", surface.vertices.rows(), " vertices, ",
                                  surface.triangles.rows(), " triangles\n"));
}

void add_input(CLI::App& app, Input& input, const char* name, const char* what) {
  app.add_option(name, input.file, what)->required();
  app.add_option("--scale", input.scale, "Metres in a unit of the file, 0.001 for millimetres")
      ->type_name("S")
      ->check(CLI::Range(1e-15, 1e15).description(""));
  common::one_of(
      app.add_option("--up", input.up, "Axis of the file that points up; y is turned to z"),
      {"y", "z"});
}

}  // namespace mesh_tool

void add_mesh(CLI::App& app) {
  CLI::App& mesh = common::add_command(
      app, "mesh", "Make a mesh, look at it, check it, or write it in another format", "",
      {"nmp mesh tet body.stl -o body.msh", "nmp mesh info body.msh", "nmp mesh check body.msh",
       "nmp mesh convert body.node body.vtu --fix"});
  mesh.require_subcommand(1);
  mesh_tool::add_tet(mesh);
  mesh_tool::add_box(mesh);
  mesh_tool::add_surface(mesh);
  const auto o = std::make_shared<Options>();

  CLI::App& look = common::add_command(
      mesh, "info", "Print counts, size, quality and the stable time step of a mesh",
      "The time step is that of the default material, unpinned; it is proportional to 1/sqrt(E).",
      {"nmp mesh info body.msh", "nmp mesh info body.vtu --scale 0.001 --up y --json"});
  mesh_tool::add_input(look, o->in, "FILE", kMesh);
  look.add_flag("--no-step", o->no_step,
                "Leave out the stable time step, which takes minutes for a million tetrahedra");
  common::add_threads(look);
  common::add_json(look, o->flags);
  look.callback([o] { info(*o); });

  CLI::App& look_closer =
      common::add_command(mesh, "check", "Say what is wrong with a mesh, or with a surface",
                          "A mesh that 'can be repaired' is taken by 'nmp data gen', and such a "
                          "surface by 'nmp mesh\n"
                          "tet', which repair it themselves; so are those with a 'warning'. With "
                          "'refused' the exit\n"
                          "code is 3.",
                          {"nmp mesh check body.msh", "nmp mesh check body.vtk --all --json",
                           "nmp mesh check scan.stl --fix scan_fixed.ply"});
  mesh_tool::add_input(look_closer, o->in, "FILE", kMeshOrSurface);
  look_closer
      .add_option("--ids", o->ids, "How many vertices, tets or triangles to list for each defect")
      ->type_name("N")
      ->check(CLI::Range(std::size_t{1}, std::size_t{1} << 31).description(""));
  look_closer.add_flag("--all", o->all, "List all of them");
  look_closer.add_option("--fix", o->out, "Write the repaired mesh or surface to this file")
      ->type_name("OUT");
  look_closer.add_flag("--binary", o->binary, "Write the binary form of the format");
  common::add_force(look_closer, o->flags);
  common::add_json(look_closer, o->flags);
  look_closer.callback([o] { check(*o); });

  CLI::App& change = common::add_command(
      mesh, "convert", "Write a mesh or a surface in another format, turned, scaled or repaired",
      "The formats follow from the endings of the names.",
      {"nmp mesh convert body.vtu body.msh", "nmp mesh convert scan.obj scan.stl",
       "nmp mesh convert body.node body.vtu --up y --fix",
       "nmp mesh convert body.msh body_m.msh --scale 0.001 --binary"});
  mesh_tool::add_input(change, o->in, "IN", kMeshOrSurface);
  change
      .add_option("OUT,-o,--output", o->out,
                  "The file to write; for TetGen's pair either of the two")
      ->type_name("FILE")
      ->required();
  change.add_flag("--fix", o->fix, "Repair what 'nmp mesh check' says can be repaired");
  change.add_flag("--binary", o->binary, "Write the binary form of the format");
  change.add_flag("--gmsh2", o->gmsh2, "Write version 2.2 of Gmsh's format instead of 4.1");
  common::add_force(change, o->flags);
  common::add_json(change, o->flags);
  change.callback([o] { convert(*o); });
}

}  // namespace nmp
