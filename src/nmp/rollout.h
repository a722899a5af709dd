#pragma once

#include <functional>
#include <string>
#include <vector>

#include "fem/boundary.h"
#include "fem/constitutive_law.h"
#include "fem/integrator.h"
#include "fem/simulator.h"
#include "fem/tet_mesh.h"
#include "nmp/dataset.h"

namespace nmp {

/// A body, the two modules that move it, and how.
template <class Real>
struct Simulation {
  const fem::TetMesh<Real>& mesh;
  const fem::ConstitutiveLaw<Real>& law;
  const fem::Integrator<Real>& integrator;
  const fem::Boundary<Real>& boundary;
  Real h;              // step [s]
  Index substeps = 1;  // steps per frame
  /// Stagger s of the velocity convention: velocities inside stand s of a step early, v_in = v - s
  /// dv at a start, v = v_in + s dv when reported; 0 is the paper's literal loop (design.md section
  /// 2).
  Real stagger = 0;
  bool strict = false;  // an element with det F <= 0 ends a rollout
};

/// What a rollout shows of a frame; the matrices live until the next one.
template <class Real>
struct Frame {
  Index t;
  ConstView<Real> x, v, f_int;  // #V x 3: v as reported
};

/// How a rollout ended.
struct RolloutEnd {
  Index frames = 0;       // frames shown after frame 0
  bool diverged = false;  // stopped before all were
  std::string reason;
  Index n_inverted = 0;        // elements with det F <= 0, summed over the steps
  std::string first_inverted;  // "step 12, time 0.006 s: element 7"; empty if there was none
};

/// Rolls a simulation out from `start` for n_frames frames and shows frames 0 ... n_frames, the
/// start included. A state, force or increment that is no longer finite (fem/guard.h), or a law
/// that is not defined, ends it before it is shown: `diverged`, with the step, element and vertex
/// in `reason`. Elements with det F <= 0, where the law lets them be, are counted. After the first
/// frame nothing is allocated.
template <class Real>
RolloutEnd roll_out(const Simulation<Real>& simulation, const fem::State<Real>& start,
                    Index n_frames, const std::function<void(const Frame<Real>&)>& show);

/// RMSE [m] of a rollout against the record it starts from, at every frame 0 ... n_frames; after a
/// divergence the body is held at its last finite frame (design.md section 2).
/// @param each_frame  shown every frame; may throw to end the rollout
struct RolloutError {
  std::vector<double> rmse;
  RolloutEnd end;
};
template <class Real>
RolloutError compare(const Simulation<Real>& simulation, const Trajectory& truth, Index n_frames,
                     const std::function<void(const Frame<Real>&)>& each_frame = {});

/// Velocities inside at frame t of a record, from positions alone: (x+ - x-) / 2h, and where the
/// convention is staggered half a step of h / substeps earlier, by the acceleration
/// (x+ - 2 x + x-) / h^2. In a single step per frame that is (x - x-) / h.   #V x 3 [m/s]
/// @param h  between frames [s]   @param t  in 1 ... frames - 1
template <class Real>
Matrix<Real> velocity_from_positions(const Trajectory& truth, Index t, double h, Index substeps,
                                     bool staggered);

/// v_in at a start or a reset to the truth: v - s dv(x, v, f(x) + f_ext).   #V x 3
/// @param f_ext  #V x 3 [N]; 0 x 0: none
template <class Real>
ad::Var<Real> internal_velocity(const Simulation<Real>& simulation, ad::Var<Real> x,
                                ad::Var<Real> v, const Matrix<Real>& f_ext = {});

}  // namespace nmp
