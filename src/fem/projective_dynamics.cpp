#include "fem/projective_dynamics.h"

#include <cmath>
#include <optional>

#include "base/check.h"
#include "fem/deformation_gradient.h"
#include "fem/frictional_contact.h"
#include "fem/guard.h"
#include "fem/internal_force.h"
#include "fem/projective_law.h"
#include "fem/scalar_system.h"

namespace nmp::fem {

namespace {

Matrix<double> lumped_mass(const TetMesh<double>& mesh, const Physics& physics) {
  check(physics);
  NMP_CHECK(
      physics.material.law == "projective",
      "projective dynamics needs the law \"projective\", got \"" + physics.material.law + "\"");
  return physics.material.density * mesh.vertex_volumes();
}

}  // namespace

struct ProjectiveDynamics::Impl {
  Impl(const TetMesh<double>& mesh_in, const Physics& physics_in, double h_in,
       const Options& options_in);

  void step(State<double>& state);
  void add_penalty(const State<double>& state);
  void elastic_impulse(const Matrix<double>& velocity);
  bool solve_contacts(const Matrix<double>& velocity);
  void split_contacts(const Matrix<double>& velocity);

  TetMesh<double> mesh;
  Physics physics;
  Options options;
  double h;
  Matrix<double> mass;
  Lame constants;
  double weight;  // w_c + w_v [Pa]
  Boundary<double> boundary;
  ScalarSystem system;
  std::optional<FrictionalContact> contact;
  double length;  // that a vertex may move in the last iteration [m]
  Work work;
  // momentum: M (v + h g) + h f_penalty.   b = A v'.
  Matrix<double> x0, F0, F, A, corners, momentum, b, b_contact, v, v_next, f_int;
};

ProjectiveDynamics::Impl::Impl(const TetMesh<double>& mesh_in, const Physics& physics_in,
                               double h_in, const Options& options_in)
    : mesh(mesh_in),
      physics(physics_in),
      options(options_in),
      h(h_in),
      mass(lumped_mass(mesh_in, physics_in)),
      constants(lame(physics_in.material)),
      weight(2 * constants.mu + 3 * constants.lambda),
      boundary(make_boundary<double>(mesh, physics.pinned, physics.ground)),
      system(mesh, mass, weight, h, boundary.pinned),
      length(options.tolerance * mesh.mean_edge_length()) {
  NMP_CHECK(options.tolerance > 0 && options.max_iterations > 0 && options.max_sweeps > 0,
            "tolerance, max_iterations and max_sweeps must be > 0");
  const bool penalty = physics.contact.law == "penalty";
  if (physics.ground && !penalty)
    contact.emplace(physics.contact.normal, *physics.ground,
                    physics.contact.law == "coulomb" ? physics.contact.friction : 0);
  F0.resize(mesh.n_tets(), 9);
  F.resize(mesh.n_tets(), 9);
  A.resize(mesh.n_tets(), 9);
  corners.resize(16, mesh.n_tets());
  for (Matrix<double>* m : {&momentum, &b, &b_contact, &v, &v_next, &f_int})
    m->resize(mesh.n_vertices(), 3);
}

// momentum += h f of DiffPD's penalty ground, at the state before the step.
void ProjectiveDynamics::Impl::add_penalty(const State<double>& state) {
  const GroundContact& ground = physics.contact;
  for (Index i = 0; i < mesh.n_vertices(); ++i) {
    const double depth = *physics.ground - load_vec3<double>(state.x, i).dot(ground.normal);
    if (!(depth > 0)) continue;
    const Vec3<double> u = load_vec3<double>(state.v, i);
    const Vec3<double> u_T = u - u.dot(ground.normal) * ground.normal;
    const double f_N = ground.k_n * depth * depth, speed = u_T.norm();
    const double slip = speed > 0 ? ground.penalty_friction * f_N / speed : ground.k_f;
    momentum.row(i) += h * (f_N * ground.normal - std::min(ground.k_f, slip) * u_T).transpose();
  }
}

// b = momentum + h sum_e V_e (w_c R + w_v Q - (w_c + w_v) F_e(x)) grad N_a, with R and Q at x + h
// velocity.
void ProjectiveDynamics::Impl::elastic_impulse(const Matrix<double>& velocity) {
  x0.noalias() = h * velocity;
  deformation_gradient<double>(mesh, x0, F);
  F += F0;
  projective_target<double>(F, constants.mu, constants.lambda, A);
  A -= weight * F0;
  b = momentum;
  add_transposed_gradient<double>(mesh, A, &mesh.volumes(), h, corners, b);
}

// v_next = A^-1 (b + r) with the impulses r of the contacts. False if they are not solved.
bool ProjectiveDynamics::Impl::solve_contacts(const Matrix<double>& velocity) {
  system.solve(b, v_next);
  if (!contact) return true;
  if (options.splitting) {
    split_contacts(velocity);
    return true;
  }
  bool found = contact->find(v_next, system);
  if (contact->n_contacts() == 0) return true;
  const bool solved = contact->solve(v_next, 0.1 * length / h, options.max_sweeps);
  b_contact = b;
  contact->add_impulses(b_contact);
  system.solve(b_contact, v_next);
  found = contact->find(v_next, system) || found;
  return solved && !found;
}

// With C = A - M, the impulse that each vertex needs by itself at the present velocity: d = b - C
// v.
void ProjectiveDynamics::Impl::split_contacts(const Matrix<double>& velocity) {
  deformation_gradient<double>(mesh, velocity, A);
  b_contact = b;
  add_transposed_gradient<double>(mesh, A, &mesh.volumes(), -h * h * weight, corners, b_contact);
  for (Index i = 0; i < mesh.n_vertices(); ++i) {
    const Vec3<double> d =
        load_vec3<double>(b_contact, i) + mass(i, 0) * contact->gap(i) / h * contact->normal();
    b.row(i) += contact->admissible(-d).transpose();
  }
  system.solve(b, v_next);
}

void ProjectiveDynamics::Impl::step(State<double>& state) {
  for (const int i : boundary.pinned) state.v.row(i).setZero();
  check_state<double>(mesh, state.x, state.v, h, work.steps + 1);
  momentum =
      (state.v.rowwise() + h * physics.gravity.transpose()).array().colwise() * mass.col(0).array();
  if (physics.air.drag > 0) {
    const Matrix<double> wind = physics.air.wind.transpose().replicate(state.v.rows(), 1);
    momentum.array() +=
        (h * physics.air.drag * (wind - state.v)).array().colwise() * mass.col(0).array();
  }
  if (physics.ground && !contact) add_penalty(state);
  deformation_gradient<double>(mesh, state.x, F0);
  if (contact) contact->begin_step(state.x, h);

  v = state.v;
  bool solved = false;
  for (Index k = 0; k < options.max_iterations && !solved; ++k) {
    elastic_impulse(v);
    solved = solve_contacts(v);
    const double moved = h * (v_next - v).cwiseAbs().maxCoeff();
    solved = solved && moved <= length;
    v.swap(v_next);
    ++work.iterations;
  }
  if (!solved) ++work.unsolved;
  check_increment<double>(mesh, state.x, state.v, v - state.v, h, work.steps + 1);
  state.x += h * v;
  state.v = v;
  ++work.steps;
  work.n_contacts = contact ? contact->n_contacts() : 0;
}

ProjectiveDynamics::ProjectiveDynamics(const TetMesh<double>& mesh, const Physics& physics,
                                       double h)
    : ProjectiveDynamics(mesh, physics, h, Options()) {}

ProjectiveDynamics::ProjectiveDynamics(const TetMesh<double>& mesh, const Physics& physics,
                                       double h, const Options& options) {
  NMP_CHECK(std::isfinite(h) && h > 0, text("h must be > 0 s and finite, got ", h));
  impl_ = std::make_unique<Impl>(mesh, physics, h, options);
}

ProjectiveDynamics::~ProjectiveDynamics() = default;

void ProjectiveDynamics::advance(State<double>& state, Index n_steps) {
  if (impl_->contact) {
    const Eigen::VectorXd gaps = impl_->contact->gaps(state.x);
    Index lowest = 0;
    const double gap = gaps.minCoeff(&lowest);
    NMP_CHECK(
        !(gap < -std::max(1e-6, 10 * impl_->options.tolerance) * impl_->mesh.mean_edge_length()),
        text("vertex ", lowest, " begins ", -gap, " m below the ground: lift the body"));
  }
  for (Index k = 0; k < n_steps; ++k) impl_->step(state);
}

const Matrix<double>& ProjectiveDynamics::internal_force(const ConstView<double>& x) {
  Impl& s = *impl_;
  deformation_gradient<double>(s.mesh, x, s.F);
  projective_stress<double>(s.F, s.constants.mu, s.constants.lambda, s.A);
  fem::internal_force<double>(s.mesh, s.A, s.corners, s.f_int);
  return s.f_int;
}

const ProjectiveDynamics::Work& ProjectiveDynamics::work() const { return impl_->work; }

}  // namespace nmp::fem
