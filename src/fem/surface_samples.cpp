#include "fem/surface_samples.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "base/random.h"

namespace nmp::fem {

// One in each of n equal shares of the area, uniform in its triangle.
std::vector<SurfacePoint> sample_surface(const Matrix<double>& vertices, const Triangles& triangles,
                                         Index n) {
  const auto corner = [&](Index f, int a) { return load_vec3<double>(vertices, triangles(f, a)); };
  const auto twice_area = [&](Index f) {
    return (corner(f, 1) - corner(f, 0)).cross(corner(f, 2) - corner(f, 0)).eval();
  };
  std::vector<double> up_to;
  double sum = 0;
  for (Index f = 0; f < triangles.rows(); ++f) up_to.push_back(sum += twice_area(f).norm());
  std::vector<SurfacePoint> points;
  if (!(sum > 0)) return points;
  const Random random = Random(0).split("samples of a surface");
  for (Index k = 0; k < n; ++k) {
    const auto i = static_cast<std::uint64_t>(k);
    const double share = (static_cast<double>(k) + 0.5) / static_cast<double>(n) * sum;
    const Index f = std::min<Index>(
        std::lower_bound(up_to.begin(), up_to.end(), share) - up_to.begin(), triangles.rows() - 1);
    const double r = std::sqrt(random.uniform(2 * i)), s = random.uniform(2 * i + 1);
    points.push_back({f, (1 - r) * corner(f, 0) + r * (1 - s) * corner(f, 1) + r * s * corner(f, 2),
                      twice_area(f).normalized()});
  }
  return points;
}

}  // namespace nmp::fem
