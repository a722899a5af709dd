#pragma once

#include <string>
#include <vector>

#include "fem/finding.h"
#include "fem/surface_file.h"

namespace nmp::fem {

/// What can be wrong with a surface that is to be filled, worst first. Each is told of triangles by
/// their numbers, unless it is the surface's or says something else.
enum class SurfaceDefect {
  no_triangle,     // none, or only degenerate ones
  bad_index,       // a corner that names no vertex
  not_finite,      // a vertex
  scale,           // a bounding box that is a point, beyond 1e+-100, or 1e9 sizes from the origin
  sheet,           // it encloses nothing, or hardly anything: see SurfaceFindings::openness
  degenerate,      // two corners at one place
  repeated,        // the three places of an earlier triangle
  two_sided,       // of a wall or sheet that is there in both senses: see SurfaceTopology
  joined,          // a vertex at the very place of an earlier one
  turned,          // against those that it hangs together with
  inside_out,      // a part whose inside would be outside of everything: by its first triangle
  open,            // an edge that no other triangle has: a hole or a crack
  non_manifold,    // an edge of more than two triangles
  not_orientable,  // as of a Moebius strip
  crossing,        // passes through another triangle
  parts,           // parts that share no vertex, if there is more than one: by the first triangle
};

MeshRule rule(SurfaceDefect defect);
/// "open_edges": for programs.
const char* name(SurfaceDefect defect);
using SurfaceFinding = Finding<SurfaceDefect>;
std::string describe(const SurfaceFinding& finding);

struct SurfaceFindings : Findings<SurfaceDefect> {
  Index n_parts = 0;
  double area = 0;
  /// Enclosed by the triangles after repair; counts twice what is enclosed twice.
  double volume = 0;
  /// Mean over the area of how far the winding number beside it is from an integer: 0 for a closed
  /// surface, about 0.01 with a small hole, 0.1 for a box without its lid, 0.2 for half a sphere,
  /// 0.5 for a sheet.
  double openness = 0;
  std::vector<std::string> notes;  // what was not looked for, for people
  bool closed() const {
    return count(SurfaceDefect::open) == 0 && count(SurfaceDefect::not_orientable) == 0;
  }
};

/// Looks for every defect, naming the first `n_shown` of each.
SurfaceFindings check_surface(const RawSurface& surface, std::size_t n_shown = 10);

struct RepairedSurface {
  RawSurface surface;
  SurfaceFindings findings;           // of the surface before
  std::vector<std::string> warnings;  // the same in words, with what was done
};

/// A surface whose vertices stand at places of their own, whose triangles are in the same sense and
/// seen counter-clockwise from outside; degenerate and repeated ones dropped. Holes, crossings and
/// edges of many triangles stay.
/// @throws InputError  with all that is refused
/// @param name  of the surface, in the error
RepairedSurface repair(const RawSurface& surface, const std::string& name);

}  // namespace nmp::fem
