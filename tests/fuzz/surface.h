#pragma once

#include "fem/fill.h"
#include "fem/mesh_check.h"
#include "fuzz/fuzz.h"

namespace nmp::fuzz {

inline fem::MeshLimits surface_limits() {
  fem::MeshLimits limits;
  limits.triangles = 1 << 12;
  return limits;
}

/// Looks for defects, repairs, and fills it coarsely: the mesh must be one that can be simulated.
inline void use(const fem::RawSurface& raw) {
  for (Index k = 0; k < raw.triangles.size(); ++k) {
    const std::int32_t v = raw.triangles.data()[k];
    require(v >= 0 && v < raw.vertices.rows());
  }
  require(raw.vertices.allFinite());
  // Sanitized this takes a good part of a second: small ones alone, and one in eight of them.
  if (raw.triangles.rows() > 100 || raw.vertices.rows() % 8 != 0) return;
  fem::FillOptions options;
  options.resolution = 5;
  const fem::FilledSurface filled = fem::fill(fem::repair(raw, "fuzz"), options, "fuzz");
  const fem::MeshFindings findings = fem::check_mesh(filled.mesh);
  for (const fem::MeshFinding& finding : findings.all) {
    // The size is the file's; parts may lie far from each other.
    require(fem::rule(finding.defect) == fem::MeshRule::warn ||
            finding.defect == fem::MeshDefect::scale);
  }
}

}  // namespace nmp::fuzz
