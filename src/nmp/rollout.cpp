#include "nmp/rollout.h"

#include "autodiff/ops_basic.h"
#include "fem/guard.h"
#include "fem/step.h"
#include "nmp/metrics.h"

namespace nmp {

using ad::Var;

template <class Real>
Var<Real> internal_velocity(const Simulation<Real>& simulation, Var<Real> x, Var<Real> v) {
  if (simulation.stagger == Real(0)) return v;
  const fem::StepContext<Real> context{simulation.mesh, simulation.h, simulation.boundary};
  const Var<Real> f_int = simulation.law.internal_force(simulation.mesh, x);
  const Var<Real> dv = simulation.integrator.dv(context, x, v, f_int);
  return fem::pin_velocities(simulation.boundary,
                             ad::subtract(v, ad::scale(dv, simulation.stagger)));
}

template <class Real>
RolloutEnd roll_out(const Simulation<Real>& simulation, const fem::State<Real>& start,
                    Index n_frames, const std::function<void(const Frame<Real>&)>& show) {
  NMP_CHECK(simulation.substeps >= 1, "a rollout needs at least one step per frame");
  const fem::TetMesh<Real>& mesh = simulation.mesh;
  NMP_CHECK(start.x.rows() == mesh.n_vertices() && start.x.cols() == 3 &&
                start.v.rows() == mesh.n_vertices() && start.v.cols() == 3,
            text("the start must be ", mesh.n_vertices(), " x 3, got x ", shape(start.x), ", v ",
                 shape(start.v)));
  const fem::StepContext<Real> context{mesh, simulation.h, simulation.boundary};
  ad::Tape<Real> tape(ad::Tape<Real>::Mode::inference);
  fem::State<Real> state = start;
  Matrix<Real> v_reported = start.v;
  RolloutEnd end;
  Index now = 0;  // step that is being made, from 1
  const auto count_inverted = [&](const Matrix<Real>& x) {
    const fem::Inverted inverted = fem::count_inverted<Real>(mesh, x);
    if (inverted.count == 0) return;
    if (end.n_inverted == 0)
      end.first_inverted = text(fem::step_and_time(now, static_cast<double>(simulation.h)),
                                ": element ", inverted.first);
    end.n_inverted += inverted.count;
    if (!simulation.strict) return;
    NumericalError error(text("element ", inverted.first,
                              " has det F = ", fem::det_F<Real>(mesh, x, inverted.first)));
    error.element = inverted.first;
    throw error;
  };
  try {
    fem::check_state<Real>(mesh, start.x, start.v, simulation.h, now);
    state.v = internal_velocity(simulation, tape.constant(start.x), tape.constant(start.v)).value();
    for (Index t = 0;; ++t) {
      for (Index k = 0; k < simulation.substeps; ++k) {
        now = t * simulation.substeps + k + 1;
        tape.clear();
        fem::check_state<Real>(mesh, state.x, state.v, simulation.h, now);
        if (!simulation.law.refuses_inverted()) count_inverted(state.x);
        const Var<Real> x = tape.constant(state.x), v = tape.constant(state.v);
        const fem::Step<Real> step =
            fem::step(simulation.law, simulation.integrator, context, x, v);
        const auto check_increment = [&] {
          fem::check_increment<Real>(mesh, state.x, state.v, step.dv.value(), simulation.h, now);
        };
        fem::check_force<Real>(mesh, state.x, state.v, step.f_int.value(), simulation.h, now);
        if (k == 0) {
          v_reported = t > 0 ? state.v : start.v;
          if (t > 0 && simulation.stagger != Real(0)) {
            check_increment();  // what is reported needs dv
            v_reported += simulation.stagger * step.dv.value();
            for (const int v_pinned : simulation.boundary.pinned)
              v_reported.row(v_pinned).setZero();
          }
          show({t, state.x, v_reported, step.f_int.value()});
          end.frames = t;
          if (t == n_frames) return end;
        }
        check_increment();
        state.x = step.x.value();
        state.v = step.v.value();
      }
    }
  } catch (const NumericalError& error) {
    end.diverged = true;
    const NumericalError located =
        error.step >= 0 ? error : fem::at_step<Real>(error, mesh, state.v, simulation.h, now);
    end.reason = text("after frame ", end.frames, ": ", located.what());
  }
  return end;
}

template <class Real>
Matrix<Real> velocity_from_positions(const Trajectory& truth, Index t, double h, Index substeps,
                                     bool staggered) {
  NMP_CHECK(t >= 1 && t < truth.frames(),
            text("frame ", t, " has no neighbours within 0 ... ", truth.frames()));
  const Index n_vertices = truth.n_vertices();
  Matrix<double> before(n_vertices, 3), now(n_vertices, 3), after(n_vertices, 3);
  truth.read_x<double>(t - 1, before);
  truth.read_x<double>(t, now);
  truth.read_x<double>(t + 1, after);
  Matrix<double> v = (after - before) / (2 * h);
  if (staggered) v -= (after - 2 * now + before) / (2 * h * static_cast<double>(substeps));
  return v.template cast<Real>();
}

template <class Real>
RolloutError compare(const Simulation<Real>& simulation, const Trajectory& truth, Index n_frames,
                     const std::function<void(const Frame<Real>&)>& each_frame) {
  const Index n_vertices = simulation.mesh.n_vertices();
  RolloutError error;
  Matrix<double> x(n_vertices, 3), x_true(n_vertices, 3);
  truth.read_x<double>(0, x);  // held there if not even the first step can be made
  const auto add = [&](Index t) {
    truth.read_x<double>(t, x_true);
    error.rmse.push_back(rmse(x, x_true));
  };
  error.end =
      roll_out<Real>(simulation, truth.state<Real>(0), n_frames, [&](const Frame<Real>& frame) {
        x = frame.x.template cast<double>();
        add(frame.t);
        if (each_frame) each_frame(frame);
      });
  for (auto t = static_cast<Index>(error.rmse.size()); t <= n_frames; ++t) add(t);
  return error;
}

#define NMP_INSTANTIATE(Real)                                                                   \
  template Var<Real> internal_velocity(const Simulation<Real>&, Var<Real>, Var<Real>);          \
  template RolloutEnd roll_out(const Simulation<Real>&, const fem::State<Real>&, Index,         \
                               const std::function<void(const Frame<Real>&)>&);                 \
  template Matrix<Real> velocity_from_positions(const Trajectory&, Index, double, Index, bool); \
  template RolloutError compare(const Simulation<Real>&, const Trajectory&, Index,              \
                                const std::function<void(const Frame<Real>&)>&);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)

}  // namespace nmp
