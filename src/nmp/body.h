#pragma once

#include <string>
#include <vector>

#include "base/file.h"
#include "fem/tet_mesh.h"
#include "nmp/scene.h"

namespace nmp {

/// The body of a scene: its mesh in metres, z up, and which vertices are held.
struct Body {
  fem::TetMesh<double> mesh;
  std::vector<int> pinned;            // vertices of `mesh`, by number and by rule; ascending
  std::string mesh_checksum;          // of the mesh file; empty for the cube
  std::vector<std::string> warnings;  // what was repaired or looks odd, for people
};

/// The cube, or the mesh file: read, turned and scaled, repaired (mesh_check.h), its pins found.
/// Vertex numbers in pins.vertices count what the repair has left.
/// @throws ConfigError if the file is not found (with the places that were looked in), a rule pins
///         nothing or everything is pinned; InputError if the mesh is refused or has another
///         checksum than the scene says; IoError
Body make_body(const Scene& scene);
/// Its mesh alone.
fem::TetMesh<double> make_mesh(const Scene& scene);

/// The vertices that a scene holds, by number and by rule, ascending.
/// @throws ConfigError  if a number is no vertex, a rule pins nothing, or everything is pinned
std::vector<int> find_pins(const Scene& scene, const fem::TetMesh<double>& mesh);

/// Where the scene's mesh file is. @throws ConfigError  with the places that were looked in
Path find_mesh(const Scene& scene);

/// The paper's time between two frames [s].
inline constexpr double kFrameStep = 5e-4;
/// Time between two frames [s] for a body with this stability limit [s]: half of it and at most
/// kFrameStep. Learned modules step from frame to frame, and the limit falls under compression.
double frame_step(double limit);

/// The scene as a dataset keeps it: with the checksum of the mesh, and its file without the folder,
/// which says nothing on another machine. A substep of 0 becomes the one that makes frame_step().
Scene recorded_scene(const Scene& scene, const Body& body);

}  // namespace nmp
