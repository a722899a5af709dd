#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "base/random.h"
#include "fem/material.h"
#include "fem/simulator.h"
#include "fem/tet_mesh.h"

namespace nmp {

/// What a dataset is a recording of (design.md section 2). Read from a TOML file, every key
/// optional. The ground is the plane z = 0 unless the file says otherwise. A pinned body starts at
/// rest, so that it has no random orientation and no clearance.
struct Scene {
  Scene() { physics.ground = 0; }

  std::string name = "cube";

  // [mesh]
  std::string shape = "cube";  // the regular cube; files come with own meshes
  Index vertices_per_edge = 10;
  double side = 1;  // [m]

  // [material] law, E [Pa], nu, density [kg/m3]   [contact] ground [m]   [pins] vertices
  // gravity [m/s2]
  fem::Physics physics;

  // [initial]
  bool random_orientation = true;                  // uniform on SO(3)
  std::optional<double> clearance = 0.1;           // lowest vertex above the ground [m]
  Vec3<double> v_min{-2, -2, -3}, v_max{2, 2, 1};  // one velocity for the whole body [m/s]

  // [time]
  double dt = 1e-5;     // substep [s]
  Index substeps = 50;  // per frame
  Index frames = 1000;

  // [dataset]
  Index train = 32, validation = 8;
  std::uint64_t seed = 1;

  /// Step between frames, h = dt * substeps [s].
  double h() const { return dt * static_cast<double>(substeps); }
};

/// @param name  a file, or the name of a scene that ships ("cube")
/// @throws ConfigError listing the shipped scenes if there is no such file; IoError
Scene read_scene(const std::string& name, const std::vector<std::string>& overrides = {});
/// @param origin  stands in messages
Scene parse_scene(const std::string& text, const std::string& origin,
                  const std::vector<std::string>& overrides = {});
/// The scene with every default filled in, as TOML that parse_scene reads back.
std::string to_toml(const Scene& scene);

fem::TetMesh<double> make_mesh(const Scene& scene);
/// Names a trajectory's random choices: a pure function of the scene's seed, the split ("train",
/// "val") and the index. Below 2^53, so that every reader of JSON keeps it.
std::uint64_t trajectory_seed(const Scene& scene, const std::string& split, Index index);
/// The start of a trajectory: a pure function of the scene and trajectory_seed. The body is turned
/// about its centre of mass, then lifted or lowered to its clearance; all free vertices have one
/// velocity.
fem::State<double> initial_state(const Scene& scene, const fem::TetMesh<double>& mesh,
                                 const std::string& split, Index index);

}  // namespace nmp
