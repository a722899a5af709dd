#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"
#include "base/random.h"
#include "fem/material.h"
#include "fem/simulator.h"
#include "fem/tet_mesh.h"

namespace nmp {

/// Which vertices are pinned, by where they are at rest [m].
struct PinRules {
  Matrix<double> boxes{0, 6};    // x_min, y_min, z_min, x_max, y_max, z_max; the faces belong to it
  Matrix<double> spheres{0, 4};  // centre and radius
  Matrix<double> planes{0, 4};   // n, d: vertices with n . x >= d
  bool any() const { return boxes.rows() + spheres.rows() + planes.rows() > 0; }
};

/// What a dataset is a recording of (design.md section 2). Read from a TOML file, every key
/// optional. The ground is the plane z = 0 unless the file says otherwise. A pinned body starts at
/// rest, so that it has no random orientation and no clearance.
struct Scene {
  Scene() { physics.ground = 0; }

  std::string name = "cube";

  // [mesh]
  std::string shape = "cube";    // the regular cube, or "file"
  Index vertices_per_edge = 10;  // of the cube
  double side = 1;               // of the cube [m]
  std::string mesh_file;         // Gmsh, TetGen, VTK or VTU; makes the shape "file"
  double mesh_scale = 1;         // metres in a unit of the file
  std::string mesh_up = "z";     // "y": turned by (x, y, z) -> (x, -z, y)
  std::string mesh_checksum;     // of the file; empty: any file will do
  /// Where a relative mesh_file is looked for, in this order; not part of the scene's text.
  std::vector<Path> mesh_folders;

  // [material] law, E [Pa], nu, density [kg/m3]   [contact] ground [m]   [pins] vertices, by number
  // The law "projective" is simulated by ProjectiveDynamics, the others by explicit steps; it alone
  // has [material] volume_weight and [contact] k_n, k_f, penalty_friction of the law "penalty".
  // [contact] law, friction   [air] drag [1/s], wind [m/s]   gravity [m/s2]
  fem::Physics physics;
  PinRules pins;  // more vertices, by rule; make_body (body.h) finds them

  // [initial]
  bool random_orientation = true;                  // uniform on SO(3)
  std::optional<double> clearance = 0.1;           // lowest vertex above the ground [m]
  Vec3<double> v_min{-2, -2, -3}, v_max{2, 2, 1};  // one velocity for the whole body [m/s]
  /// In place of v_min and v_max: any direction, a speed uniform between these [m/s].
  std::optional<double> speed_min, speed_max;
  bool settled = false;  // begins as it rests on the ground (fem/settle.h); "projective" only
  double spin = 0;       // about any axis through the centre of mass, uniform up to this [rad/s]

  // [time]
  double dt = 1e-5;     // substep [s]; 0: chosen for the mesh (recorded_scene), a file's default
  Index substeps = 50;  // per frame
  Index frames = 1000;

  // [dataset]
  Index train = 32, validation = 8;
  std::uint64_t seed = 1;

  bool has_pins() const { return !physics.pinned.empty() || pins.any(); }
  /// Step between frames, h = dt * substeps [s].
  double h() const { return dt * static_cast<double>(substeps); }
};

/// @param name  a file, or the name of a scene that ships ("cube")
/// mesh_folders become the folder of the scene's file; if mesh.file is an override or the scene
/// ships, the current folder comes before it.
/// @param mesh_folders  more of them, after those
/// @throws ConfigError listing the shipped scenes if there is no such file; IoError
Scene read_scene(const std::string& name, const std::vector<std::string>& overrides = {},
                 const std::vector<Path>& mesh_folders = {});
/// @param origin  stands in messages
Scene parse_scene(const std::string& text, const std::string& origin,
                  const std::vector<std::string>& overrides = {});
/// The scene with every default filled in, as TOML that parse_scene reads back.
std::string to_toml(const Scene& scene);

/// Names a trajectory's random choices: a pure function of the scene's seed, the split ("train",
/// "val") and the index. Below 2^53, so that every reader of JSON keeps it.
std::uint64_t trajectory_seed(const Scene& scene, const std::string& split, Index index);
/// The start of a trajectory: a pure function of the scene and trajectory_seed. The body is turned
/// about its centre of mass, then lifted or lowered to its clearance; all free vertices have one
/// velocity. Pins by rule must have become physics.pinned.
/// @param shape  positions of the body before that, #V x 3 [m]: start_shape(), which is the same
///        for all trajectories
fem::State<double> initial_state(const Scene& scene, const fem::TetMesh<double>& mesh,
                                 const Matrix<double>& shape, const std::string& split,
                                 Index index);
/// Its rest positions, or those of a body that has settled, which takes a while: go_on as of
/// fem::settle.
Matrix<double> start_shape(const Scene& scene, const fem::TetMesh<double>& mesh,
                           const std::function<bool()>& go_on = {});

}  // namespace nmp
