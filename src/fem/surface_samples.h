#pragma once

#include <vector>

#include "autodiff/types.h"
#include "fem/surface.h"

namespace nmp::fem {

/// A place on a surface.
struct SurfacePoint {
  Index triangle = 0;
  Vec3<double> x, normal;
};

/// Places spread evenly over the area, the same for the same surface; none if it has no area.
std::vector<SurfacePoint> sample_surface(const Matrix<double>& vertices, const Triangles& triangles,
                                         Index n);

}  // namespace nmp::fem
