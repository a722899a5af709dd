#include "fem/mesh_file.h"

#include <doctest/doctest.h>

#include <cmath>

#include "base/check.h"
#include "base/random.h"
#include "fem/mesh_cube.h"
#include "fem/mesh_fixtures.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::contains;
using test::same;
using test::two_tets;

namespace {

RawMesh read_pair(const std::string& node, const std::string& ele) {
  return read_tetgen(node, "m.node", ele, "m.ele");
}

// Coordinates that need all their digits, and extreme ones.
RawMesh rough_cube() {
  const TetMesh<double> cube = cube_mesh(4, 1.0);
  RawMesh mesh{cube.vertices(), cube.tets(), {}};
  const Random random(7);
  for (Index i = 0; i < mesh.vertices.size(); ++i) {
    mesh.vertices.data()[i] += 0.1 * random.normal(static_cast<std::uint64_t>(i));
  }
  mesh.vertices.row(0) << 5e-324, -0.0, 1.7976931348623157e308;
  return mesh;
}

}  // namespace

TEST_SUITE("fem/mesh_file") {
  TEST_CASE("reads Gmsh 2.2: tags in any order, surface cells left out, other sections skipped") {
    const RawMesh mesh = read_gmsh(test::kGmsh2, "m.msh");
    CHECK(same(mesh, two_tets()));
    REQUIRE(mesh.notes.size() == 1);
    CHECK(mesh.notes[0] == "2 surface, line and point cells are left out");
  }

  TEST_CASE("reads Gmsh 4.1: blocks, parametric nodes") {
    const RawMesh mesh = read_gmsh(test::kGmsh4, "m.msh");
    CHECK(same(mesh, two_tets()));
    CHECK(mesh.notes.size() == 1);
  }

  TEST_CASE("reads binary Gmsh files of either byte order") {
    for (const bool swap : {false, true}) {
      CHECK(same(read_gmsh(test::gmsh2_binary(swap), "m.msh"), two_tets()));
      CHECK(same(read_gmsh(test::gmsh4_binary<std::uint64_t>(swap), "m.msh"), two_tets()));
      CHECK(same(read_gmsh(test::gmsh4_binary<std::uint32_t>(swap), "m.msh"), two_tets()));
    }
  }

  TEST_CASE("reads TetGen files: from 0 or 1, attributes, markers, comments") {
    CHECK(same(read_pair(test::kNode, test::kEle), two_tets()));
    CHECK(same(read_pair("5 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 1 1 1.5",
                         "2 4\n0 0 1 2 3\n1 1 4 2 3"),
               two_tets()));
  }

  TEST_CASE("reads legacy VTK files, text and binary, before and after version 5") {
    const RawMesh old = read_vtk(test::kVtk3, "m.vtk");
    CHECK(same(old, two_tets()));
    CHECK(old.notes.size() == 1);
    CHECK(same(read_vtk(test::kVtk5, "m.vtk"), two_tets()));
    CHECK(same(read_vtk(test::vtk3_binary(), "m.vtk"), two_tets()));
    CHECK(same(read_vtk(test::vtk5_binary(), "m.vtk"), two_tets()));
  }

  TEST_CASE("reads VTU in every encoding") {
    const RawMesh ascii = read_vtu(test::kVtu, "m.vtu");
    CHECK(same(ascii, two_tets()));
    CHECK(ascii.notes.size() == 1);
    using Form = test::VtuForm;
    for (const Form form : {Form::inline_base64, Form::appended_raw, Form::appended_base64}) {
      for (int bits = 0; bits < 8; ++bits) {
        CAPTURE(static_cast<int>(form));
        CAPTURE(bits);
        const std::string file = test::vtu_binary(form, bits & 1, bits & 2, bits & 4);
        CHECK(same(read_vtu(file, "m.vtu"), two_tets()));
      }
    }
  }

  TEST_CASE("every format that is written reads back to the bit") {
    const test::Folder folder;
    const RawMesh mesh = rough_cube();
    const auto check = [&](const char* name, const MeshWriteOptions& options) {
      CAPTURE(name);
      CAPTURE(options.binary);
      CAPTURE(options.gmsh2);
      write_mesh(folder / name, mesh, options);
      const RawMesh read = read_mesh(folder / name);
      CHECK(same(read, mesh));
      CHECK(std::signbit(read.vertices(0, 1)));
      CHECK(read.notes.empty());
    };
    for (const bool binary : {false, true}) {
      for (const char* name : {"m.msh", "m.vtk", "m.vtu", "M.VTU"}) check(name, {binary, false});
      check("m.msh", {binary, true});
    }
    check("m.node", {});
    CHECK(same(read_mesh(folder / "m.ele"), mesh));
    CHECK_THROWS_AS(write_mesh(folder / "m.ele", mesh, {true, false}), ConfigError);
  }

  TEST_CASE("the checksum is that of all files of a mesh") {
    const test::Folder folder;
    write_mesh(folder / "m.node", two_tets());
    const std::string sum = mesh_checksum(folder / "m.node");
    CHECK(sum.size() == 16);
    CHECK(mesh_checksum(folder / "m.ele") == sum);
    test::put(folder / "m.ele", test::get(folder / "m.ele") + "#\n");
    CHECK(mesh_checksum(folder / "m.node") != sum);
  }

  TEST_CASE("an unknown ending is refused, with those that are known") {
    const std::string why = test::message<ConfigError>([] { read_mesh("body.stl"); });
    CHECK(contains(why, "body.stl"));
    CHECK(contains(why, ".msh (Gmsh), .node or .ele (TetGen), .vtk or .vtu"));
    CHECK_THROWS_AS(read_mesh("body"), ConfigError);
    CHECK_THROWS_AS(read_mesh("no_such_folder/body.vtu"), IoError);
    const test::Folder folder;
    test::put(folder / "m.node", test::kNode);
    CHECK(contains(test::message<IoError>([&] { read_mesh(folder / "m.node"); }), "m.ele"));
    test::put(folder / "m.vtk", test::kVtk3);
    MeshLimits limits;
    limits.file_bytes = 10;
    CHECK(contains(test::message<InputError>([&] { read_mesh(folder / "m.vtk", limits); }),
                   "at most 10 bytes"));
  }
}
