#include <map>
#include <set>

#include "autodiff/gradient_check.h"
#include "cases.h"
#include "fem/surface.h"
#include "fem/tet_mesh.h"

namespace nmp::fem {

TEST_SUITE("fem/tet_mesh") {
  TEST_CASE("gradients of the shape functions are those of the element: grad N_a . (x_b - x_0)") {
    const TetMesh<double> mesh = jittered_cube(4);
    double worst = 0;
    for (Index e = 0; e < mesh.n_tets(); ++e) {
      for (int a = 0; a < 4; ++a) {
        for (int b = 1; b < 4; ++b) {
          const Vec3<double> g(mesh.grad_N()(e, 3 * a), mesh.grad_N()(e, 3 * a + 1),
                               mesh.grad_N()(e, 3 * a + 2));
          const Vec3<double> edge =
              mesh.rest().row(mesh.tets()(e, b)) - mesh.rest().row(mesh.tets()(e, 0));
          const double wanted = a == b ? 1 : a == 0 ? -1 : 0;
          worst = std::max(worst, std::abs(g.dot(edge) - wanted));
        }
      }
    }
    CHECK(worst <= 1e-14);
  }

  TEST_CASE("volumes fill the box and lumped volumes add up to it (FE6)") {
    for (const Index n : {2, 3, 5, 10}) {
      const TetMesh<double> mesh = jittered_cube(n);
      CHECK(std::abs(mesh.total_volume() - 1) <= 1e-14);
      CHECK(std::abs(mesh.volumes().sum() - 1) <= 1e-14);
      CHECK(std::abs(mesh.vertex_volumes().sum() - 1) <= 1e-14);
      CHECK(mesh.vertex_volumes().minCoeff() > 0);
      CHECK(std::abs(mesh.diagonal() - std::sqrt(3.0)) <= 1e-15);
    }
  }

  TEST_CASE("corners around a vertex are all of its corners, ascending") {
    const TetMesh<double> mesh = jittered_cube(4);
    std::size_t seen = 0;
    for (Index v = 0; v < mesh.n_vertices(); ++v) {
      const auto begin = static_cast<std::size_t>(mesh.corner_begin()[std::size_t(v)]);
      const auto end = static_cast<std::size_t>(mesh.corner_begin()[std::size_t(v) + 1]);
      for (std::size_t k = begin; k < end; ++k, ++seen) {
        const auto corner = mesh.corners()[k];
        CHECK(mesh.tets()(corner / 4, corner % 4) == v);
        if (k > begin) CHECK(mesh.corners()[k - 1] < corner);
      }
    }
    CHECK(seen == static_cast<std::size_t>(4 * mesh.n_tets()));
  }

  TEST_CASE("a regular tet has the mean edge length of its edges") {
    Matrix<double> X(4, 3);
    X << 1, 1, 1, 1, -1, -1, -1, 1, -1, -1, -1, 1;
    Tets T(1, 4);
    T << 0, 1, 3, 2;
    if (Mat3<double>(
            (Mat3<double>() << X.row(1) - X.row(0), X.row(3) - X.row(0), X.row(2) - X.row(0))
                .finished())
            .determinant() < 0)
      T << 0, 1, 2, 3;
    CHECK(std::abs(TetMesh<double>(X, T).mean_edge_length() - std::sqrt(8.0)) <= 1e-15);
  }

  TEST_CASE("the float mesh is the double mesh, rounded") {
    const TetMesh<double> mesh = jittered_cube(4);
    const TetMesh<float> rounded = mesh.cast<float>();
    CHECK(same_bits(rounded.grad_N(), mesh.grad_N().cast<float>()));
    CHECK(same_bits(rounded.vertices(), mesh.vertices()));
  }

  TEST_CASE("refuses what is no mesh, with its number") {
    const TetMesh<double> cube = cube_mesh(2, 1);
    const auto error = [&](const Matrix<double>& X, const Tets& T) {
      return message<std::invalid_argument>([&] { TetMesh<double>(X, T); });
    };
    CHECK(error(cube.vertices(), cube.tets()).empty());
    CHECK(contains(error(cube.vertices(), Tets(0, 4)), "at least one tet"));
    for (const int v : {-1, 8}) {
      Tets T = cube.tets();
      T(3, 2) = v;
      CHECK(contains(error(cube.vertices(), T), "tet 3, corner 2: vertex " + std::to_string(v)));
    }
    Tets inverted = cube.tets();
    std::swap(inverted(2, 0), inverted(2, 1));
    CHECK(contains(error(cube.vertices(), inverted), "tet 2 is flat or inverted"));
    CHECK(contains(error(1.1e103 * cube.vertices(), cube.tets()),
                   "tet 0 has a volume that is not finite"));
    Matrix<double> flat = cube.vertices();
    flat.col(2) *= 1e-13;
    CHECK(contains(error(flat, cube.tets()), "tet 0 is flat or inverted"));
    Matrix<double> X = cube.vertices();
    X(5, 1) = std::nan("");
    CHECK(contains(error(X, cube.tets()), "vertex 5"));
    Matrix<double> more(9, 3);
    more << cube.vertices(), 7, 7, 7;
    CHECK(contains(error(more, cube.tets()), "vertex 8 belongs to no tet"));
  }
}

TEST_SUITE("fem/mesh_cube") {
  TEST_CASE("has the vertices and tets of CUBE, and faces match") {
    const TetMesh<double> mesh = cube_mesh(10, 1);
    CHECK(mesh.n_vertices() == 1000);
    CHECK(mesh.n_tets() == 3645);
    CHECK(mesh.vertices().colwise().sum().norm() <= 1e-12);
    CHECK(mesh.vertices()(1 + 10 * (2 + 10 * 3), 1) == doctest::Approx(2.0 / 9 - 0.5));
    // Every face belongs to two tets, or lies in the surface: 2 triangles on each of 6 x 81
    // squares.
    std::map<std::set<int>, int> faces;
    for (Index e = 0; e < mesh.n_tets(); ++e)
      for (int a = 0; a < 4; ++a) {
        std::set<int> face;
        for (int b = 0; b < 4; ++b)
          if (b != a) face.insert(mesh.tets()(e, b));
        ++faces[face];
      }
    int single = 0, more = 0;
    for (const auto& [face, n] : faces) {
      single += n == 1;
      more += n > 2;
    }
    CHECK(single == 2 * 6 * 81);
    CHECK(more == 0);
  }

  TEST_CASE("a box has its cells along each axis, its volume, and a surface without gaps") {
    const TetMesh<double> mesh = box_mesh({4, 3, 2}, {2, 1, 0.5});
    CHECK(mesh.n_vertices() == 5 * 4 * 3);
    CHECK(mesh.n_tets() == 5 * 24);
    CHECK(mesh.total_volume() == doctest::Approx(1));
    CHECK(mesh.vertices().colwise().maxCoeff() == Eigen::RowVector3d(1, 0.5, 0.25));
    CHECK(mesh.vertices().colwise().minCoeff() == Eigen::RowVector3d(-1, -0.5, -0.25));
    CHECK(surface_triangles(mesh.tets()).rows() == 2 * 2 * (12 + 8 + 6));
    const TetMesh<double> cube = cube_mesh(5, 0.7), same = box_mesh({4, 4, 4}, {0.7, 0.7, 0.7});
    CHECK(cube.vertices() == same.vertices());
    CHECK(cube.tets() == same.tets());
    CHECK_THROWS_AS(box_mesh({0, 1, 1}, {1, 1, 1}), std::invalid_argument);
    CHECK_THROWS_AS(box_mesh({1 << 10, 1 << 10, 1 << 10}, {1, 1, 1}), std::invalid_argument);
    CHECK_THROWS_AS(box_mesh({1, 1, 1}, {1, 0, 1}), std::invalid_argument);
  }

  TEST_CASE("refuses less than two vertices along an edge and a side that is not positive") {
    CHECK_THROWS_AS(cube_mesh(1, 1), std::invalid_argument);
    CHECK_THROWS_AS(cube_mesh(3, 0), std::invalid_argument);
    CHECK_THROWS_AS(cube_mesh(3, std::nan("")), std::invalid_argument);
  }
}

}  // namespace nmp::fem
