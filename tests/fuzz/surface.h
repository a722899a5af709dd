#pragma once

#include "fem/surface_file.h"
#include "fuzz/fuzz.h"

namespace nmp::fuzz {

inline fem::MeshLimits surface_limits() {
  fem::MeshLimits limits;
  limits.triangles = 1 << 12;
  return limits;
}

inline void use(const fem::RawSurface& raw) {
  for (Index k = 0; k < raw.triangles.size(); ++k) {
    const std::int32_t v = raw.triangles.data()[k];
    require(v >= 0 && v < raw.vertices.rows());
  }
  require(raw.vertices.allFinite());
}

}  // namespace nmp::fuzz
