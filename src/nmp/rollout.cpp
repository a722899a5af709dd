#include "nmp/rollout.h"

#include <optional>

#include "autodiff/ops_basic.h"
#include "fem/step.h"
#include "nmp/metrics.h"
#include "nmp/motion.h"

namespace nmp {

using ad::Var;

template <class Real>
Var<Real> internal_velocity(const Simulation<Real>& simulation, Var<Real> x, Var<Real> v,
                            const Matrix<Real>& f_ext) {
  if (simulation.stagger == Real(0)) return v;
  const fem::StepContext<Real> context{simulation.mesh, simulation.h, simulation.boundary};
  Var<Real> f = simulation.law.internal_force(simulation.mesh, x);
  if (f_ext.size() > 0) f = ad::add(f, x.tape().constant(f_ext));
  const Var<Real> dv = simulation.integrator.dv(context, x, v, f);
  return fem::pin_velocities(simulation.boundary,
                             ad::subtract(v, ad::scale(dv, simulation.stagger)));
}

template <class Real>
RolloutEnd roll_out(const Simulation<Real>& simulation, const fem::State<Real>& start,
                    Index n_frames, const std::function<void(const Frame<Real>&)>& show) {
  RolloutEnd end;
  std::optional<Motion<Real>> motion;
  try {
    motion.emplace(simulation, start);
    for (;; motion->advance()) {
      const Index t = motion->frame();
      show({t, motion->x(), motion->v(), motion->f_int()});
      end.frames = t;
      if (t == n_frames) break;
    }
  } catch (const NumericalError& error) {
    end.diverged = true;
    end.reason = text("after frame ", end.frames, ": ", error.what());
  }
  if (!motion) return end;
  end.n_inverted = motion->n_inverted();
  end.first_inverted = motion->first_inverted();
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
  template Var<Real> internal_velocity(const Simulation<Real>&, Var<Real>, Var<Real>,           \
                                       const Matrix<Real>&);                                    \
  template RolloutEnd roll_out(const Simulation<Real>&, const fem::State<Real>&, Index,         \
                               const std::function<void(const Frame<Real>&)>&);                 \
  template Matrix<Real> velocity_from_positions(const Trajectory&, Index, double, Index, bool); \
  template RolloutError compare(const Simulation<Real>&, const Trajectory&, Index,              \
                                const std::function<void(const Frame<Real>&)>&);

NMP_INSTANTIATE(float)
NMP_INSTANTIATE(double)
#undef NMP_INSTANTIATE

}  // namespace nmp
