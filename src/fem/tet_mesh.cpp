#include "fem/tet_mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "base/check.h"

namespace nmp::fem {

namespace {

void check_mesh(const Matrix<double>& vertices, const Tets& tets) {
  NMP_CHECK(vertices.cols() == 3, "vertices must be #V x 3, got " + shape(vertices));
  NMP_CHECK(tets.rows() > 0, "a mesh needs at least one tet");
  NMP_CHECK(tets.rows() < Index(1) << 29, text("at most 2^29 - 1 tets, got ", tets.rows()));
  for (Index v = 0; v < vertices.rows(); ++v)
    NMP_CHECK(vertices.row(v).allFinite(),
              text("vertex ", v, " has a coordinate that is not finite"));
  std::vector<char> used(static_cast<std::size_t>(vertices.rows()), 0);
  for (Index e = 0; e < tets.rows(); ++e) {
    for (int a = 0; a < 4; ++a) {
      const Index v = tets(e, a);
      NMP_CHECK(v >= 0 && v < vertices.rows(), text("tet ", e, ", corner ", a, ": vertex ", v,
                                                    " is outside 0..", vertices.rows() - 1));
      used[static_cast<std::size_t>(v)] = 1;
    }
  }
  for (Index v = 0; v < vertices.rows(); ++v)
    NMP_CHECK(used[static_cast<std::size_t>(v)], text("vertex ", v, " belongs to no tet"));
}

double mean_edge(const Matrix<double>& vertices, const Tets& tets) {
  std::vector<std::pair<std::int32_t, std::int32_t>> edges;
  edges.reserve(static_cast<std::size_t>(6 * tets.rows()));
  for (Index e = 0; e < tets.rows(); ++e)
    for (int a = 0; a < 4; ++a)
      for (int b = a + 1; b < 4; ++b) edges.push_back(std::minmax(tets(e, a), tets(e, b)));
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  double sum = 0;
  for (const auto& [i, j] : edges) sum += (vertices.row(i) - vertices.row(j)).norm();
  return sum / static_cast<double>(edges.size());
}

}  // namespace

template <class Real>
TetMesh<Real>::TetMesh(const Matrix<double>& vertices, const Tets& tets) {
  check_mesh(vertices, tets);
  const auto data = std::make_shared<Data>();
  data->vertices = vertices;
  data->tets = tets;
  data->rest = vertices.cast<Real>();
  const Index n_tets = tets.rows(), n_vertices = vertices.rows();

  // D = [x1 - x0, x2 - x0, x3 - x0]:  V_e = det D / 6,  grad N_a = row a of D^-1 for a = 1, 2, 3,
  // by cross products, and the four gradients sum to zero.
  Matrix<double> volumes(n_tets, 1), grad_N(n_tets, 12);
  for (Index e = 0; e < n_tets; ++e) {
    Vec3<double> x[4];
    for (int a = 0; a < 4; ++a) x[a] = vertices.row(tets(e, a)).transpose();
    const Vec3<double> d1 = x[1] - x[0], d2 = x[2] - x[0], d3 = x[3] - x[0];
    const double det = d1.cross(d2).dot(d3);
    double longest = 0;
    for (int a = 0; a < 4; ++a)
      for (int b = a + 1; b < 4; ++b) longest = std::max(longest, (x[a] - x[b]).norm());
    NMP_CHECK(!std::isinf(det), text("tet ", e, " has a volume that is not finite"));
    NMP_CHECK(det > kFlat * longest * longest * longest,
              text("tet ", e, " is flat or inverted: volume ", det / 6, " m3"));
    volumes(e, 0) = det / 6;
    const Vec3<double> g1 = d2.cross(d3) / det, g2 = d3.cross(d1) / det, g3 = d1.cross(d2) / det;
    grad_N.row(e) << -(g1 + g2 + g3).transpose(), g1.transpose(), g2.transpose(), g3.transpose();
    data->total_volume += det / 6;
  }
  data->volumes = volumes.cast<Real>();
  data->grad_N = grad_N.cast<Real>();

  // Corners around each vertex: counted, then filled in ascending order.
  data->corner_begin.assign(static_cast<std::size_t>(n_vertices) + 1, 0);
  for (Index e = 0; e < n_tets; ++e)
    for (int a = 0; a < 4; ++a) ++data->corner_begin[static_cast<std::size_t>(tets(e, a)) + 1];
  for (std::size_t v = 1; v < data->corner_begin.size(); ++v)
    data->corner_begin[v] += data->corner_begin[v - 1];
  data->corners.resize(static_cast<std::size_t>(4 * n_tets));
  std::vector<std::int32_t> next(data->corner_begin.begin(), data->corner_begin.end() - 1);
  Matrix<double> vertex_volumes = Matrix<double>::Zero(n_vertices, 1);
  for (Index e = 0; e < n_tets; ++e) {
    for (int a = 0; a < 4; ++a) {
      const auto v = static_cast<std::size_t>(tets(e, a));
      data->corners[static_cast<std::size_t>(next[v]++)] = static_cast<std::int32_t>(4 * e + a);
      vertex_volumes(tets(e, a), 0) += volumes(e, 0) / 4;
    }
  }
  data->vertex_volumes = vertex_volumes.cast<Real>();
  data->reciprocal_vertex_volumes = vertex_volumes.cwiseInverse().cast<Real>();

  data->mean_edge_length = mean_edge(vertices, tets);
  data->diagonal = (vertices.colwise().maxCoeff() - vertices.colwise().minCoeff()).norm();
  data_ = data;
}

#define NMP_INSTANTIATE(Real) template class TetMesh<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::fem
