// Surfaces in files: every form that .obj, .stl and .ply have, the same after writing and reading,
// and errors that name the place.
#include "fem/surface_file.h"

#include <doctest/doctest.h>

#include "base/check.h"
#include "fem/mesh_fixtures.h"
#include "nmp/folder.h"

using namespace nmp;
using namespace nmp::fem;
using test::Binary;
using test::contains;
using test::message;

namespace {

// A square of two triangles.
RawSurface square() {
  RawSurface surface;
  surface.vertices.resize(4, 3);
  surface.vertices << 0, 0, 0, 1, 0, 0, 1, 1, 0.1, 0, 1, 0;
  surface.triangles.resize(2, 3);
  surface.triangles << 0, 1, 2, 0, 2, 3;
  return surface;
}

bool same(const RawSurface& a, const RawSurface& b) {
  return a.vertices.rows() == b.vertices.rows() && a.triangles.rows() == b.triangles.rows() &&
         a.vertices == b.vertices && a.triangles == b.triangles;
}

std::string refusal(RawSurface (*read)(std::string_view, const std::string&, const MeshLimits&),
                    const std::string& bytes, const MeshLimits& limits = {}) {
  return message<InputError>([&] { read(bytes, "file", limits); });
}

std::string stl_binary(bool with_solid = false) {
  Binary out(!test::little_endian());
  out.put(with_solid ? "solid" + std::string(75, ' ') : std::string(80, '\0'));
  out.put<std::uint32_t>({2});
  for (const auto& corners : {std::vector<float>{0, 0, 0, 1, 0, 0, 1, 1, 0.5f},
                              std::vector<float>{0, 0, -0.0f, 1, 1, 0.5f, 0, 1, 0}}) {
    out.put<float>({0, 0, 1});
    for (const float x : corners) out.put<float>({x});
    out.put<std::uint16_t>({0});
  }
  return out.text;
}

std::string ply_binary(bool big) {
  Binary out(big == test::little_endian());
  out.put(std::string("ply\nformat binary_") + (big ? "big" : "little") +
          "_endian 1.0\ncomment made by hand\nelement vertex 4\nproperty uchar red\n"
          "property double x\nproperty float y\nproperty short z\nelement face 1\n"
          "property list ushort uchar flags\nproperty list uchar uint vertex_index\n"
          "element edge 1\nproperty int a\nend_header\n");
  for (const auto& x : {std::vector<int>{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}) {
    out.put<std::uint8_t>({200}).put<double>({double(x[0])}).put<float>({float(x[1])});
    out.put<std::int16_t>({std::int16_t(x[2])});
  }
  out.put<std::uint16_t>({3}).put<std::uint8_t>({1, 2, 3});
  out.put<std::uint8_t>({4}).put<std::uint32_t>({0, 1, 2, 3}).put<std::int32_t>({-1});
  return out.text;
}

}  // namespace

TEST_SUITE("fem/surface_file") {
  TEST_CASE("OBJ: every form of a corner, negative numbers, polygons, what is left out") {
    const RawSurface read = read_obj(
        "\xEF\xBB\xBF# made by hand\r\nmtllib a.mtl\no thing\nv 0 0 0\nv 1 0 0 1.0\n"
        "v 1 1 .1 0.5 0.5 0.5\nv 0 1 0 # a corner\nvt 0 0\nvn 0 0 1\nusemtl m\ns off\n"
        "f 1/1/1 2//1 3/1\nf -4 \\\n -2 -1\nl 1 2\nf 1 2 3 4\np 1\n",
        "file");
    REQUIRE(read.triangles.rows() == 4);
    CHECK(read.triangles.topRows(2) == square().triangles);
    CHECK(read.triangles.bottomRows(2) == square().triangles);
    CHECK(read.vertices == square().vertices);
    REQUIRE(read.notes.size() == 2);
    CHECK(contains(read.notes[0], "1 polygon is cut into triangles"));
    CHECK(contains(read.notes[1], "2 lines and points are left out"));
  }

  TEST_CASE("OBJ: a face may come before its vertices, if they come") {
    CHECK(read_obj("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\n", "f").triangles.rows() == 1);
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 1 1 2\nf 1 4 1\nf 1 1 1\nv 0 0 0\n"),
                   "file:3: expected a vertex from 1 to 2, found 4"));
  }

  TEST_CASE("OBJ: what is no polygon mesh is refused with its line") {
    CHECK(contains(refusal(read_obj, "v 0 0\n"), "file:1: expected a finite decimal number"));
    CHECK(contains(refusal(read_obj, "v 0 0 nan\n"), "file:1"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 1 1\n"), "at least 3 corners of a face, found 2"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 0 1 1\n"), "counted from 1"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf -2 1 1\n"), "integer from -1"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 1/x 1 1\n"), "v//vn"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 1/1/1/1 1 1\n"), "v//vn"));
    CHECK(contains(refusal(read_obj, "\nsurf 0 1 0 1\n"), "file:2: expected a line of a polygon"));
    CHECK(contains(refusal(read_obj, std::string("\0\1\2", 3)), "file:1"));
  }

  TEST_CASE("STL: text, in any case, of several solids; equal places become one vertex") {
    const std::string facet =
        "  facet normal 0 0 nan\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 1 1 .1\n"
        " endloop\n endfacet\n";
    const std::string other =
        "FACET NORMAL 0 0 1\nOUTER LOOP\nVERTEX -0 0 0\nVERTEX 1 1 0.1\nVERTEX 0 1 0\nENDLOOP\n"
        "ENDFACET\n";
    CHECK(same(read_stl("solid my part\n" + facet + other + "endsolid my part\n", "f"), square()));
    CHECK(same(read_stl("solid\n" + facet + "endsolid\nSOLID b\n" + other + "ENDSOLID b", "f"),
               square()));
    CHECK(read_stl("solid\nendsolid\n", "f").triangles.rows() == 0);
    CHECK(contains(refusal(read_stl, "solid\n" + facet), "expected facet or endsolid"));
    CHECK(contains(refusal(read_stl, "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0\nendloop"),
                   "file:5: expected a finite decimal number as z"));
  }

  TEST_CASE("STL: binary, also when it begins like text") {
    for (const bool with_solid : {false, true}) {
      const RawSurface read = read_stl(stl_binary(with_solid), "f");
      CHECK(read.triangles == square().triangles);
      CHECK(read.vertices(2, 2) == 0.5);
    }
    const std::string bytes = stl_binary();
    CHECK(contains(refusal(read_stl, bytes.substr(0, 150)), "number of triangles that the rest"));
    CHECK(contains(refusal(read_stl, bytes + "x"), "1 bytes more"));
    CHECK(contains(refusal(read_stl, bytes.substr(0, 50)), "80 bytes of the head"));
    CHECK(contains(refusal(read_stl, ""), "80 bytes of the head"));
    std::string nan = bytes;
    nan.replace(96, 4, "\xFF\xFF\xFF\xFF");
    CHECK(contains(refusal(read_stl, nan), "finite coordinates"));
  }

  TEST_CASE("PLY: text and binary of either byte order, with more than is needed") {
    const std::string header =
        "ply\r\nformat ascii 1.0\r\ncomment x\r\nelement vertex 4\r\nproperty float x\r\n"
        "property float y\r\nproperty float z\r\nproperty uchar red\r\nelement face 2\r\n"
        "property list uchar int vertex_indices\r\nend_header\r\n";
    CHECK(same(read_ply(header + "0 0 0 1\n1 0 0 2\n1 1 .1 3\n0 1 0 4\n3 0 1 2\n3 0 2 3\n", "f"),
               square()));
    for (const bool big : {false, true}) {
      const RawSurface read = read_ply(ply_binary(big), "f");
      CHECK(read.triangles == square().triangles);
      CHECK(read.vertices.leftCols(2) == square().vertices.leftCols(2));
    }
  }

  TEST_CASE("PLY: what is missing or impossible is refused") {
    const std::string bytes = ply_binary(false);
    CHECK(contains(refusal(read_ply, bytes.substr(0, bytes.size() - 5)),
                   "4 bytes of vertex, found 3"));
    const auto header = [](const std::string& more) { return "ply\nformat ascii 1.0\n" + more; };
    CHECK(contains(refusal(read_ply, header("end_header\n")), "an element 'vertex', found none"));
    CHECK(contains(refusal(read_ply, "ply\nformat ascii 2.0\n"), "version 1.0"));
    CHECK(contains(refusal(read_ply, header("property int x\n")), "file:3"));
    CHECK(contains(refusal(read_ply, header("element vertex 1\nproperty float x\nend_header\n1\n")),
                   "x, y and z"));
    const std::string vertex = "element vertex 1\nproperty int x\nproperty int y\nproperty int z\n";
    CHECK(
        contains(refusal(read_ply, header(vertex + "end_header\n1 2 3\n")), "'face', found none"));
    CHECK(contains(refusal(read_ply, header(vertex + vertex + "end_header\n1 2 3\n1 2 3\n")),
                   "once each"));
    const std::string face = "element face 1\nproperty list uchar int vertex_index\nend_header\n";
    CHECK(contains(refusal(read_ply, header(vertex + face + "1 2 3\n3 0 0 1\n")), "from 0 to 0"));
    CHECK(contains(refusal(read_ply, header(vertex + face + "1 2 3\n2 0 0\n")), "at least 3"));
    CHECK(contains(refusal(read_ply, header(vertex + face + "1 2 3\n3 0 0 -1\n")), "found -1"));
    CHECK(contains(refusal(read_ply, header(vertex + face + "1 2 3\n99999 0 0 0\n")), "length"));
    CHECK(contains(refusal(read_ply, header("element vertex 99999999999\nproperty float x\n"
                                            "property float y\nproperty float z\nend_header\n")),
                   "that the rest of the file can hold"));
  }

  TEST_CASE("what is written reads back to the bit, binary STL as float") {
    const test::Folder folder;
    RawSurface surface = square();
    surface.vertices(2, 2) = 0.1 + 1e-17;
    for (const char* name : {"a.obj", "a.stl", "a.ply", "b.STL", "b.ply"}) {
      CAPTURE(name);
      const bool binary = name[0] == 'b';
      write_surface(folder / name, surface, binary);
      RawSurface read = read_surface(folder / name);
      if (std::string(name) == "b.STL") {
        CHECK(read.vertices(2, 2) == double{0.1f});
        read.vertices(2, 2) = surface.vertices(2, 2);
      }
      CHECK(same(read, surface));
      CHECK(read.notes.empty());
    }
    CHECK_THROWS_AS(write_surface(folder / "a.obj", surface, true), ConfigError);
    CHECK_THROWS_AS(write_surface(folder / "a.msh", surface), ConfigError);
    CHECK_THROWS_AS(read_surface(folder / "none.stl"), IoError);
    CHECK(contains(message<ConfigError>([] { surface_format("a.step"); }), ".obj, .stl or .ply"));
  }

  TEST_CASE("limits on vertices and triangles are kept") {
    MeshLimits limits;
    limits.vertices = 3;
    CHECK(contains(refusal(read_stl, stl_binary(), limits), "at most 3 vertices"));
    limits = {};
    limits.triangles = 1;
    CHECK(contains(refusal(read_ply, ply_binary(true), limits), "at most 1 triangles"));
    CHECK(contains(refusal(read_obj, "v 0 0 0\nf 1 1 1 1\n", limits), "at most 1 triangles"));
  }
}
