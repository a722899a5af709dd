#include "nmp/motion.h"

#include <utility>

#include "autodiff/ops_basic.h"
#include "fem/guard.h"
#include "fem/step.h"

namespace nmp {

using ad::Var;

template <class Real>
Motion<Real>::Motion(const Simulation<Real>& simulation, const fem::State<Real>& start)
    : simulation_{simulation.mesh, simulation.law,      simulation.integrator, boundary_,
                  simulation.h,    simulation.substeps, simulation.stagger,    simulation.strict},
      boundary_(simulation.boundary) {
  NMP_CHECK(simulation.substeps >= 1, "a rollout needs at least one step per frame");
  set_state(start);
}

template <class Real>
Index Motion<Real>::step_number() const {
  return frame_ * simulation_.substeps + substep_ + 1;
}

template <class Real>
void Motion<Real>::change_state() {
  evaluated_ = has_reported_ = was_given_ = false;
}

template <class Real>
void Motion<Real>::set_state(const fem::State<Real>& state, Matrix<Real> f_ext) {
  const fem::TetMesh<Real>& mesh = simulation_.mesh;
  NMP_CHECK(state.x.rows() == mesh.n_vertices() && state.x.cols() == 3 &&
                state.v.rows() == mesh.n_vertices() && state.v.cols() == 3,
            text("the start must be ", mesh.n_vertices(), " x 3, got x ", shape(state.x), ", v ",
                 shape(state.v)));
  const Index now = step_number() - 1;
  fem::check_state<Real>(mesh, state.x, state.v, simulation_.h, now);
  tape_.clear();
  evaluated_ = false;
  const Matrix<Real> v_inside = fem::located<Real>(mesh, state.v, simulation_.h, now, [&] {
    return Matrix<Real>(
        internal_velocity(simulation_, tape_.constant(state.x), tape_.constant(state.v), f_ext)
            .value());
  });
  fem::State<Real> inside{state.x, v_inside};
  Matrix<Real> reported = state.v;
  state_ = std::move(inside);
  change_state();
  v_reported_ = std::move(reported);
  has_reported_ = was_given_ = true;
  f_acted_ = std::move(f_ext);
}

template <class Real>
void Motion<Real>::set_boundary(fem::Boundary<Real> boundary) {
  boundary_ = std::move(boundary);
  pin_target_.resize(0, 0);
  evaluated_ = false;  // nets see the ground
}

template <class Real>
void Motion<Real>::set_planes(std::vector<fem::Plane<Real>> planes) {
  boundary_.planes = std::move(planes);
  evaluated_ = false;
}

template <class Real>
void Motion<Real>::move_pins(Matrix<Real> x) {
  const auto n = static_cast<Index>(boundary_.pinned.size());
  NMP_CHECK(x.rows() == n && x.cols() == 3,
            text("pins must be moved to ", n, " x 3 positions, got ", shape(x)));
  if (boundary_.pin_x.rows() == 0) {
    Matrix<Real> rest(n, 3);
    for (Index i = 0; i < n; ++i)
      rest.row(i) = simulation_.mesh.rest().row(boundary_.pinned[static_cast<std::size_t>(i)]);
    fem::move_pins<Real>(boundary_, rest, Matrix<Real>::Zero(n, 3));
  }
  pin_target_ = std::move(x);
}

template <class Real>
void Motion<Real>::set_external_force(Matrix<Real> f_ext) {
  NMP_CHECK(f_ext.size() == 0 || (f_ext.rows() == state_.x.rows() && f_ext.cols() == 3),
            text("external forces must be ", state_.x.rows(), " x 3, got ", shape(f_ext)));
  f_ext_ = std::move(f_ext);
  evaluated_ = false;
}

template <class Real>
fem::Boundary<Real> Motion<Real>::boundary_of_step(Index k) const {
  fem::Boundary<Real> boundary = boundary_;
  if (pin_target_.rows() == 0) return boundary;
  const auto n = static_cast<Real>(simulation_.substeps);
  const Matrix<Real>& from = boundary_.pin_x;
  const Matrix<Real> way = pin_target_ - from;
  const Matrix<Real> x = k + 1 == simulation_.substeps
                             ? pin_target_
                             : Matrix<Real>(from + (static_cast<Real>(k + 1) / n) * way);
  fem::move_pins<Real>(boundary, x, way / (n * simulation_.h));
  return boundary;
}

// f_int and dv at the present state.
template <class Real>
void Motion<Real>::evaluate() {
  if (evaluated_) return;
  const fem::TetMesh<Real>& mesh = simulation_.mesh;
  const Index now = step_number();
  tape_.clear();
  fem::located<Real>(mesh, state_.v, simulation_.h, now, [&] {
    if (!simulation_.law.refuses_inverted()) count_inverted(state_.x, now);
    x_ = tape_.constant(state_.x);
    v_ = tape_.constant(state_.v);
    f_int_ = simulation_.law.internal_force(mesh, x_);
    dv_ = increment(f_ext_);
  });
  fem::check_force<Real>(mesh, state_.x, state_.v, f_int_.value(), simulation_.h, now);
  evaluated_ = true;
}

template <class Real>
Var<Real> Motion<Real>::increment(const Matrix<Real>& f_ext) {
  const fem::StepContext<Real> context{simulation_.mesh, simulation_.h, boundary_};
  const Var<Real> f = f_ext.size() > 0 ? ad::add(f_int_, tape_.constant(f_ext)) : f_int_;
  return simulation_.integrator.dv(context, x_, v_, f);
}

template <class Real>
void Motion<Real>::count_inverted(const ConstView<Real>& x, Index step) {
  const fem::Inverted inverted = fem::count_inverted<Real>(simulation_.mesh, x);
  if (inverted.count == 0) return;
  if (n_inverted_ == 0)
    first_inverted_ = text(fem::step_and_time(step, static_cast<double>(simulation_.h)),
                           ": element ", inverted.first);
  n_inverted_ += inverted.count;
  if (!simulation_.strict) return;
  NumericalError error(text("element ", inverted.first, " has det F = ",
                            fem::det_F<Real>(simulation_.mesh, x, inverted.first)));
  error.element = inverted.first;
  throw error;
}

template <class Real>
ConstMatrixMap<Real> Motion<Real>::f_int() {
  evaluate();
  return f_int_.value();
}

template <class Real>
const Matrix<Real>& Motion<Real>::v() {
  if (has_reported_) return v_reported_;
  if (simulation_.stagger == Real(0)) return state_.v;
  evaluate();
  const bool same_force = f_ext_.size() == f_acted_.size() && f_ext_ == f_acted_;
  const Var<Real> dv = same_force ? dv_ : increment(f_acted_);
  fem::check_increment<Real>(simulation_.mesh, state_.x, state_.v, dv.value(), simulation_.h,
                             step_number());
  v_reported_ = state_.v;
  v_reported_ += simulation_.stagger * dv.value();
  for (const int i : boundary_.pinned) v_reported_.row(i) = state_.v.row(i);
  has_reported_ = true;
  return v_reported_;
}

template <class Real>
void Motion<Real>::step() {
  evaluate();
  fem::check_increment<Real>(simulation_.mesh, state_.x, state_.v, dv_.value(), simulation_.h,
                             step_number());
  const auto finish = [&](const fem::Boundary<Real>& boundary) {
    const fem::StepContext<Real> context{simulation_.mesh, simulation_.h, boundary};
    const fem::Contact<Real> next = fem::advance(context, x_, v_, dv_);
    state_.x = next.x.value();
    state_.v = next.v.value();
  };
  if (pin_target_.rows() == 0)
    finish(boundary_);
  else
    finish(boundary_of_step(substep_));
  change_state();
  fem::check_state<Real>(simulation_.mesh, state_.x, state_.v, simulation_.h, step_number() + 1);
}

// What the end of a frame needs memory for.
template <class Real>
struct Motion<Real>::FrameEnd {
  Matrix<Real> f_acted, pin_v;
};

template <class Real>
typename Motion<Real>::FrameEnd Motion<Real>::prepare_end() const {
  return {f_ext_, Matrix<Real>::Zero(pin_target_.rows(), pin_target_.cols())};
}

template <class Real>
void Motion<Real>::end_frame(FrameEnd end) {
  ++frame_;
  f_acted_ = std::move(end.f_acted);
  if (pin_target_.rows() == 0) return;
  // They stay where they have been moved to.
  boundary_.pin_x = std::move(pin_target_);
  boundary_.pin_v = std::move(end.pin_v);
  pin_target_.resize(0, 0);
}

template <class Real>
void Motion<Real>::advance() {
  FrameEnd end = prepare_end();
  frame_state_ = state_;
  const bool had_reported = has_reported_, was_given = was_given_;
  try {
    for (substep_ = 0; substep_ < simulation_.substeps; ++substep_) step();
  } catch (...) {
    std::swap(state_, frame_state_);
    change_state();
    has_reported_ = had_reported;
    was_given_ = was_given;
    substep_ = 0;
    throw;
  }
  substep_ = 0;
  end_frame(std::move(end));
}

template <class Real>
void Motion<Real>::advance_to(fem::State<Real> next) {
  FrameEnd end = prepare_end();
  state_ = std::move(next);
  change_state();
  end_frame(std::move(end));
}

template <class Real>
typename Motion<Real>::Snapshot Motion<Real>::snapshot() const {
  return {frame_,    state_.x,    state_.v, was_given_ ? v_reported_ : Matrix<Real>(),
          boundary_, pin_target_, f_ext_,   f_acted_};
}

template <class Real>
void Motion<Real>::restore(Snapshot snapshot) {
  frame_ = snapshot.frame;
  substep_ = 0;
  state_ = {std::move(snapshot.x), std::move(snapshot.v)};
  change_state();
  has_reported_ = was_given_ = snapshot.v_reported.size() > 0;
  v_reported_ = std::move(snapshot.v_reported);
  boundary_ = std::move(snapshot.boundary);
  pin_target_ = std::move(snapshot.pin_target);
  f_ext_ = std::move(snapshot.f_ext);
  f_acted_ = std::move(snapshot.f_acted);
}

template class Motion<float>;
template class Motion<double>;

}  // namespace nmp
