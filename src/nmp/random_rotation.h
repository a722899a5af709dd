#pragma once

#include <Eigen/Geometry>

#include "autodiff/types.h"
#include "base/random.h"

namespace nmp {

/// Uniform on SO(3), from the draws 0 to 3: four normals are a direction in 4 dimensions without
/// preference, a uniform unit quaternion.
inline Mat3<double> random_rotation(const Random& draw) {
  return Eigen::Quaterniond(draw.normal(0), draw.normal(1), draw.normal(2), draw.normal(3))
      .normalized()
      .toRotationMatrix();
}

/// Uniform on the unit sphere, from the draws 0 to 2.
inline Vec3<double> random_direction(const Random& draw) {
  return Vec3<double>(draw.normal(0), draw.normal(1), draw.normal(2)).normalized();
}

}  // namespace nmp
