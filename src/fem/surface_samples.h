#pragma once

#include <vector>

#include "autodiff/types.h"
#include "fem/surface.h"

namespace nmp::fem {

/// How many samples tell a surface's properties, and how far beside it they look, in diagonals.
constexpr Index kSurfaceSamples = 1024;
constexpr double kBesideSurface = 1e-6;

/// A place on a surface.
struct SurfacePoint {
  Index triangle = 0;
  Vec3<double> x, normal;
};

/// Places spread evenly over the area, the same for the same surface; none if it has no area.
std::vector<SurfacePoint> sample_surface(const Matrix<double>& vertices, const Triangles& triangles,
                                         Index n);

}  // namespace nmp::fem
