#include "nmp/scene.h"

#include <algorithm>
#include <limits>

#include "base/check.h"
#include "fem/settle.h"
#include "nmp/config.h"
#include "nmp/random_rotation.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

constexpr std::int64_t kMaxVerticesPerEdge = 400;  // 4 #T, the number of corners, stays below 2^31
constexpr std::int64_t kMaxSeed = std::numeric_limits<std::int64_t>::max();

// Every key of a scene, once, for both directions: Config is ConfigReader or ConfigWriter.
template <class Config>
void exchange(Config& config, Scene& s) {
  fem::Physics& physics = s.physics;
  s.name = config.word("name", s.name);
  physics.gravity = config.vector("gravity", physics.gravity);

  s.shape = config.choice("mesh.shape", s.shape, {"cube", "file"});
  std::int64_t n_vertices = std::numeric_limits<std::int32_t>::max();  // make_body knows better
  if (s.shape == "file") {
    s.mesh_file = config.word("mesh.file", s.mesh_file);
    s.mesh_scale = config.number("mesh.scale", s.mesh_scale, 1e-15, 1e15);
    s.mesh_up = config.choice("mesh.up", s.mesh_up, {"z", "y"});
    s.mesh_checksum = config.word("mesh.checksum", s.mesh_checksum);
  } else {
    s.vertices_per_edge =
        config.integer("mesh.vertices_per_edge", s.vertices_per_edge, 2, kMaxVerticesPerEdge);
    s.side = config.number("mesh.side", s.side, 1e-6, 1e6);
    n_vertices = s.vertices_per_edge * s.vertices_per_edge * s.vertices_per_edge;
  }

  fem::Material& material = physics.material;
  material.law = config.choice("material.law", material.law, fem::law_names());
  material.E = config.number("material.E", material.E, 1e-3, 1e15);
  material.nu = config.number("material.nu", material.nu, -0.99, 0.4999);
  material.density = config.number("material.density", material.density, 1e-6, 1e9);

  // What projective dynamics alone knows stands in its scenes alone.
  const bool projective = material.law == "projective";
  if (projective)
    material.volume_weight =
        config.number("material.volume_weight", material.volume_weight, 1e-6, 1e6);

  physics.ground = config.number_or_none("contact.ground", physics.ground, -1e6, 1e6);
  fem::GroundContact& contact = physics.contact;
  if (projective || contact.law != "frictionless" || asked(config, "contact.law") ||
      asked(config, "contact.friction")) {
    contact.law = config.choice("contact.law", contact.law, fem::contact_law_names());
    contact.friction = config.number("contact.friction", contact.friction, 0, 1e3);
  }
  if (projective) {
    contact.k_n = config.number("contact.k_n", contact.k_n, 0, 1e15);
    contact.k_f = config.number("contact.k_f", contact.k_f, 0, 1e15);
    contact.penalty_friction =
        config.number("contact.penalty_friction", contact.penalty_friction, 0, 1e15);
  }

  fem::Air& air = physics.air;
  if (air.drag > 0 || asked(config, "air.drag") || asked(config, "air.wind")) {
    air.drag = config.number("air.drag", air.drag, 0, 1e6);
    air.wind = config.vector("air.wind", air.wind);
  }

  const auto pinned = config.integers(
      "pins.vertices", std::vector<std::int64_t>(physics.pinned.begin(), physics.pinned.end()), 0,
      n_vertices - 1);
  physics.pinned.assign(pinned.begin(), pinned.end());
  std::sort(physics.pinned.begin(), physics.pinned.end());
  physics.pinned.erase(std::unique(physics.pinned.begin(), physics.pinned.end()),
                       physics.pinned.end());
  s.pins.boxes = config.rows("pins.boxes", s.pins.boxes, 6);
  s.pins.spheres = config.rows("pins.spheres", s.pins.spheres, 4);
  s.pins.planes = config.rows("pins.planes", s.pins.planes, 4);

  // What the defaults mean without a ground or with pins.
  if (s.has_pins()) s.random_orientation = false;
  if (s.has_pins() || !physics.ground) s.clearance.reset();
  s.random_orientation = config.boolean("initial.random_orientation", s.random_orientation);
  s.clearance = config.number_or_none("initial.clearance", s.clearance, 0, 1e6);
  s.v_min = config.vector("initial.v_min", s.v_min);
  s.v_max = config.vector("initial.v_max", s.v_max);
  s.speed_min = config.number_or_none("initial.speed_min", s.speed_min, 0, 1e6);
  s.speed_max = config.number_or_none("initial.speed_max", s.speed_max, 0, 1e6);
  s.spin = config.number("initial.spin", s.spin, 0, 1e6);
  if (projective) s.settled = config.boolean("initial.settled", s.settled);

  s.dt = config.number("time.dt", s.dt, s.shape == "file" ? 0 : 1e-12, 1);
  s.substeps = config.integer("time.substeps", s.substeps, 1, 1'000'000);
  s.frames = config.integer("time.frames", s.frames, 1, 10'000'000);

  s.train = config.integer("dataset.train", s.train, 0, 100'000);
  s.validation = config.integer("dataset.validation", s.validation, 0, 100'000);
  s.seed = static_cast<std::uint64_t>(
      config.integer("dataset.seed", static_cast<std::int64_t>(s.seed), 0, kMaxSeed));
}

constexpr const char* kCubeKeys[] = {"mesh.vertices_per_edge", "mesh.side"};
constexpr const char* kProjectiveKeys[] = {"material.volume_weight", "contact.k_n", "contact.k_f",
                                           "contact.penalty_friction", "initial.settled"};
constexpr const char* kFileKeys[] = {"mesh.file", "mesh.scale", "mesh.up", "mesh.checksum"};

// A mesh file given on the command line takes the place of the scene's own body.
void choose_shape(ConfigReader& config, Scene& scene) {
  if (!config.has("mesh.file")) return;
  if (config.is_override("mesh.file")) {
    for (const char* key : kCubeKeys) config.drop(key);
    for (const char* key : {"mesh.shape", "mesh.checksum"}) config.drop(key);
  }
  scene.shape = "file";
  scene.dt = 0;
}

void check_shape(const ConfigReader& config, const Scene& scene) {
  const bool is_file = scene.shape == "file";
  if (!is_file && config.has("mesh.file") && config.has("mesh.shape")) {
    config.fail("mesh.shape", "expected \"file\", or no shape, beside mesh.file");
  }
  for (const char* key : kCubeKeys) {
    if (is_file && config.has(key))
      config.fail(key, "is of the cube: leave it out beside mesh.file");
  }
  for (const char* key : kFileKeys) {
    if (!is_file && config.has(key)) config.fail(key, "needs mesh.file, the mesh it is about");
  }
  if (!is_file) return;
  if (scene.mesh_file.empty()) {
    config.fail(config.has("mesh.file") ? "mesh.file" : "mesh.shape",
                "expected the name of a mesh file in mesh.file, found none");
  }
  const std::string& sum = scene.mesh_checksum;
  if (!sum.empty() &&
      (sum.size() != 16 || sum.find_first_not_of("0123456789abcdef") != std::string::npos)) {
    config.fail("mesh.checksum", "expected 16 lower-case hexadecimal digits");
  }
}

void check_contact(const ConfigReader& config, const fem::Physics& physics) {
  if (physics.material.law != "projective") {
    for (const char* key : kProjectiveKeys) {
      if (config.has(key))
        config.fail(key, "needs material.law = \"projective\", the law of projective dynamics");
    }
    if (physics.contact.law == "penalty")
      config.fail("contact.law", "\"penalty\" needs material.law = \"projective\"");
  }
  const fem::GroundContact& contact = physics.contact;
  if (contact.law != "frictionless" && !physics.ground)
    config.fail("contact.law", "expected \"frictionless\" where contact.ground is \"none\"");
  if (contact.friction > 0 && contact.law != "coulomb")
    config.fail("contact.friction", "needs contact.law = \"coulomb\"");
  if (!physics.air.wind.isZero(0) && physics.air.drag == 0)
    config.fail("air.wind", "needs air.drag > 0, by which it pulls");
}

void check_rules(const ConfigReader& config, const PinRules& pins) {
  const auto fail = [&](const char* key, Index i, const char* expected) {
    config.fail(key, text("rule ", i, ", counted from 0: expected ", expected));
  };
  for (Index i = 0; i < pins.boxes.rows(); ++i) {
    if ((pins.boxes.row(i).head(3).array() > pins.boxes.row(i).tail(3).array()).any()) {
      fail("pins.boxes", i,
           "[x_min, y_min, z_min, x_max, y_max, z_max], no minimum above its maximum");
    }
  }
  for (Index i = 0; i < pins.spheres.rows(); ++i) {
    if (!(pins.spheres(i, 3) > 0))
      fail("pins.spheres", i, "[x, y, z, radius] with a radius above 0");
  }
  for (Index i = 0; i < pins.planes.rows(); ++i) {
    if (pins.planes.row(i).head(3).isZero(0)) {
      fail("pins.planes", i, "[nx, ny, nz, d] with a direction n that is not zero");
    }
  }
}

}  // namespace

Scene parse_scene(const std::string& text, const std::string& origin,
                  const std::vector<std::string>& overrides) {
  ConfigReader config = ConfigReader::parse(text, origin, overrides);
  Scene scene;
  choose_shape(config, scene);
  exchange(config, scene);
  check_shape(config, scene);
  check_contact(config, scene.physics);
  config.finish();
  check_rules(config, scene.pins);

  if (scene.name.empty()) config.fail("name", "expected a name, found none");
  if (config.is_override("mesh.file")) scene.mesh_folders.emplace_back();
  if (scene.has_pins()) {
    const std::string why = "of a body with pins, which starts where it is at rest";
    if (scene.random_orientation) {
      config.fail("initial.random_orientation", "expected false " + why + ", found true");
    }
    if (scene.clearance) config.fail("initial.clearance", "expected \"none\" " + why);
    if (scene.spin > 0) config.fail("initial.spin", "expected 0 " + why);
  }
  if (scene.clearance && !scene.physics.ground) {
    config.fail("initial.clearance", "expected \"none\" where contact.ground is \"none\"");
  }
  if (scene.settled && scene.random_orientation)
    config.fail("initial.settled",
                "expected random_orientation = false, a body settles as it lies");
  if (scene.settled && !scene.physics.ground && !scene.has_pins())
    config.fail("initial.settled", "expected a ground or pins to settle on");
  if ((scene.v_min.array() > scene.v_max.array()).any()) {
    config.fail(config.has("initial.v_min") ? "initial.v_min" : "initial.v_max",
                "expected v_min at most v_max in each component");
  }
  if (scene.speed_min.has_value() != scene.speed_max.has_value() ||
      (scene.speed_min && *scene.speed_min > *scene.speed_max)) {
    config.fail(config.has("initial.speed_min") ? "initial.speed_min" : "initial.speed_max",
                "expected both speed_min and speed_max, the former at most the latter");
  }
  if (scene.train + scene.validation == 0) {
    config.fail("dataset.train", "expected at least one trajectory in train and validation");
  }
  return scene;
}

Scene read_scene(const std::string& name, const std::vector<std::string>& overrides,
                 const std::vector<Path>& mesh_folders) {
  const char* shipped = find_shipped_scene(name);
  Scene scene = parse_scene(read_config_text(name, shipped, "scene", shipped_scene_names()),
                            shipped == nullptr ? name : name + ".toml", overrides);
  const Path folder = shipped == nullptr ? Path(name).parent_path() : Path();
  if (scene.mesh_folders.empty() || !folder.empty()) scene.mesh_folders.push_back(folder);
  scene.mesh_folders.insert(scene.mesh_folders.end(), mesh_folders.begin(), mesh_folders.end());
  return scene;
}

std::string to_toml(const Scene& scene) {
  NMP_CHECK(scene.seed <= static_cast<std::uint64_t>(kMaxSeed),
            text("a scene's seed must be below 2^63, got ", scene.seed));
  ConfigWriter config;
  Scene copy = scene;
  exchange(config, copy);
  return config.text();
}

std::uint64_t trajectory_seed(const Scene& scene, const std::string& split, Index index) {
  return Random(scene.seed).split(split).split(static_cast<std::uint64_t>(index)).bits(0) >> 11;
}

Matrix<double> start_shape(const Scene& scene, const fem::TetMesh<double>& mesh,
                           const std::function<bool()>& go_on) {
  return scene.settled ? fem::settle(mesh, scene.physics, go_on) : mesh.vertices();
}

fem::State<double> initial_state(const Scene& scene, const fem::TetMesh<double>& mesh,
                                 const Matrix<double>& shape, const std::string& split,
                                 Index index) {
  const Random random(trajectory_seed(scene, split, index));
  const std::vector<int>& pinned = scene.physics.pinned;
  fem::State<double> state{shape, Matrix<double>(mesh.n_vertices(), 3)};

  if (scene.random_orientation && pinned.empty()) {
    const Mat3<double> R = random_rotation(random.split("orientation"));
    // x = R (X - c) + c, with c the centre of mass.
    const Vec3<double> c = shape.transpose() * mesh.vertex_volumes() / mesh.total_volume();
    const Matrix<double> from_c = shape.rowwise() - c.transpose();
    state.x = (from_c * R.transpose()).rowwise() + c.transpose();
  }
  if (scene.clearance && scene.physics.ground && pinned.empty()) {
    const double lowest = state.x.col(2).minCoeff();
    state.x.col(2).array() += *scene.physics.ground + *scene.clearance - lowest;
  }

  const Random draw = random.split("velocity");
  Vec3<double> velocity;
  for (Index i = 0; i < 3; ++i)
    velocity[i] = draw.uniform(static_cast<std::uint64_t>(i), scene.v_min(i), scene.v_max(i));
  if (scene.speed_min)
    velocity = draw.uniform(3, *scene.speed_min, *scene.speed_max) *
               random_direction(random.split("direction"));
  state.v.rowwise() = velocity.transpose();
  if (scene.spin > 0) {
    const Random spin = random.split("spin");
    const Vec3<double> omega =
        spin.uniform(3, 0, scene.spin) * random_direction(spin.split("axis"));
    const Vec3<double> c = state.x.transpose() * mesh.vertex_volumes() / mesh.total_volume();
    for (Index i = 0; i < state.x.rows(); ++i)
      state.v.row(i) += omega.cross(Vec3<double>(state.x.row(i).transpose()) - c).transpose();
  }
  for (const int vertex : pinned) state.v.row(vertex).setZero();
  return state;
}

}  // namespace nmp
