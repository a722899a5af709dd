#include "fem/vtu_writer.h"

#include <doctest/doctest.h>

#include "base/check.h"
#include "fem/mesh_cube.h"
#include "fem/mesh_file.h"
#include "fem/vtu_grid.h"

namespace nmp::fem {
namespace {

// A vector at every vertex and a number in every tet, floats that no short decimal writes.
VtuContent content_of(const TetMesh<double>& mesh) {
  Matrix<float> v(mesh.n_vertices(), 3), det(mesh.n_tets(), 1);
  for (Index i = 0; i < v.size(); ++i) v.data()[i] = 1.0f / static_cast<float>(3 + i);
  for (Index i = 0; i < det.size(); ++i) det(i, 0) = 1.0f + 1.0f / static_cast<float>(7 + i);
  return {mesh.vertices(), mesh.tets(), {{"v", v}}, {{"det_F", det}}};
}

const VtuStyle kStyles[] = {{},
                            {false, false, true},
                            {true, false, false},
                            {true, false, true},
                            {true, true, false},
                            {true, true, true}};

}  // namespace

TEST_SUITE("fem/vtu_writer") {
  TEST_CASE("what is written is read back, in every style") {
    const TetMesh<double> mesh = cube_mesh(3, 0.7);
    const VtuContent content = content_of(mesh);
    for (const VtuStyle& style : kStyles) {
      CAPTURE(style.binary);
      CAPTURE(style.zlib);
      CAPTURE(style.single);
      const VtuGrid grid = read_vtu_grid(to_vtu(content, style), "x.vtu", {"v", "absent"});
      // Text is read as double, so that the decimals of a float become it only after rounding.
      CHECK(grid.mesh.vertices.cast<float>() == mesh.vertices().cast<float>());
      if (!style.single) CHECK(grid.mesh.vertices == mesh.vertices());
      CHECK(grid.mesh.tets == mesh.tets());
      REQUIRE(grid.point_data.size() == 1);
      CHECK(grid.point_data.at("v").cast<float>() == content.point_data[0].values);
    }
  }

  TEST_CASE("arrays of more than one compressed block, and of whole blocks, are read back") {
    // 32^3 vertices have 32768 values of 4 bytes in a column: one block of 2^17 bytes exactly.
    const TetMesh<double> mesh = cube_mesh(32, 1);
    Matrix<float> one(mesh.n_vertices(), 1);
    for (Index i = 0; i < one.size(); ++i) one(i, 0) = static_cast<float>(i * i % 1013);
    Matrix<float> three(mesh.n_vertices(), 3);
    three << one, 2 * one, 3 * one;
    const VtuContent content{mesh.vertices(), mesh.tets(), {{"one", one}, {"three", three}}, {}};
    const std::string file = to_vtu(content, {true, true, true});
    CHECK(file.size() < to_vtu(content, {true, false, true}).size() / 3);
    const VtuGrid grid = read_vtu_grid(file, "x.vtu", {"one", "three"});
    CHECK(grid.point_data.at("one") == one.cast<double>());
    CHECK(grid.point_data.at("three") == three.cast<double>());
    CHECK(grid.mesh.tets == mesh.tets());
  }

  TEST_CASE("a field of another length is refused") {
    const TetMesh<double> mesh = cube_mesh(2, 1);
    VtuContent content = content_of(mesh);
    content.cell_data[0].values.resize(1, 1);
    CHECK_THROWS_AS(to_vtu(content, {}), std::invalid_argument);
    CHECK_THROWS_AS(to_vtu(content_of(mesh), {false, true, false}), std::invalid_argument);
  }

  TEST_CASE("point data of a wrong length or that are not finite are refused, if they are wanted") {
    const TetMesh<double> mesh = cube_mesh(2, 1);
    const std::string good = to_vtu(content_of(mesh), {});
    const auto with = [&](const std::string& from, const std::string& to) {
      std::string file = good;
      return file.replace(file.find(from), from.size(), to);
    };
    const auto read = [](const std::string& file, const std::string& wanted) {
      return read_vtu_grid(file, "x.vtu", {wanted});
    };
    CHECK(read(good, "v").point_data.size() == 1);
    for (const std::string& file :
         {with("0.33333334", "nan"), with("0.33333334", "inf"), with("0.33333334", "1 2"),
          with("0.33333334", ""), with("Name=\"v\" NumberOfComponents=\"3\"", "Name=\"v\""),
          with("Name=\"v\" NumberOfComponents=\"3\"", "Name=\"v\" NumberOfComponents=\"0\""),
          with("Name=\"v\" NumberOfComponents=\"3\"",
               "Name=\"v\" NumberOfComponents=\"999999999999\""),
          with("type=\"Float32\" Name=\"v\"", "type=\"Int32\" Name=\"v\"")}) {
      CHECK_THROWS_AS(read(file, "v"), InputError);
      CHECK(read(file, "w").point_data.empty());
    }
  }
}

}  // namespace nmp::fem
