#include "nmp/recording.h"

#include <algorithm>
#include <memory>
#include <utility>

#include "autodiff/checkpoint.h"
#include "autodiff/ops_basic.h"
#include "fem/guard.h"
#include "fem/step.h"

namespace nmp {

using ad::Var;

namespace {

// Boundary at the end of each step of a frame; one for all if they are the same.
template <class Real>
std::shared_ptr<const std::vector<fem::Boundary<Real>>> boundaries(const Motion<Real>& motion) {
  auto all = std::make_shared<std::vector<fem::Boundary<Real>>>();
  const Index n = motion.pins_move() ? motion.simulation().substeps : 1;
  for (Index k = 0; k < n; ++k) all->push_back(motion.boundary_of_step(k));
  return all;
}

}  // namespace

template <class Real>
Recording<Real>::Recording(Motion<Real>& motion, bool with_forces)
    : motion_(motion), with_forces_(with_forces) {
  x_ = x0_ = tape_.input(motion_.x());
  v0_ = tape_.input(motion_.v());
  v_ = internal_velocity(motion_.simulation(), x_, v0_, motion_.acted_force());
  motion_.set_state({x0_.value(), v0_.value()}, motion_.acted_force());
}

template <class Real>
Var<Real> Recording<Real>::external_force() {
  const Matrix<Real>& f = motion_.external_force();
  const Matrix<Real> value = f.size() > 0 ? f : Matrix<Real>::Zero(x_.rows(), 3);
  return with_forces_ ? tape_.input(value) : tape_.constant(value);
}

template <class Real>
void Recording<Real>::advance() {
  const Simulation<Real>& s = motion_.simulation();
  const Var<Real> f_ext = external_force();
  ad::Vars<Real> inputs{x_, v_, f_ext};
  const Index first = motion_.frame() * s.substeps + 1;
  const auto in_step = [&s](Index step, const Var<Real>& v, const auto& evaluate) {
    return fem::located<Real>(s.mesh, v.value(), s.h, step, evaluate);
  };
  if (s.law.keeps_nothing())
    inputs.push_back(in_step(first, v_, [&] { return s.law.internal_force(s.mesh, x_); }));
  const bool forced = with_forces_ || motion_.external_force().size() > 0;
  // What Motion::advance looks at, before the frame is computed again: then it has been seen.
  const auto forward = std::make_shared<bool>(true);
  const ad::Piece<Real> frame = [&s, &motion = motion_, in_step, first, forward, forced,
                                 all = boundaries(motion_)](ad::Tape<Real>&,
                                                            const ad::Vars<Real>& in) {
    Var<Real> x = in[0], v = in[1];
    for (Index k = 0; k < s.substeps; ++k) {
      const auto of_step = std::min(static_cast<std::size_t>(k), all->size() - 1);
      const fem::StepContext<Real> context{s.mesh, s.h, (*all)[of_step]};
      const fem::Contact<Real> next = in_step(first + k, v, [&] {
        if (*forward && !s.law.refuses_inverted()) motion.count_inverted(x.value(), first + k);
        Var<Real> f = k == 0 && in.size() > 3 ? in[3] : s.law.internal_force(s.mesh, x);
        if (*forward)
          fem::check_force<Real>(s.mesh, x.value(), v.value(), f.value(), s.h, first + k);
        if (forced) f = ad::add(f, in[2]);
        const Var<Real> dv = s.integrator.dv(context, x, v, f);
        if (*forward)
          fem::check_increment<Real>(s.mesh, x.value(), v.value(), dv.value(), s.h, first + k);
        return fem::advance(context, x, v, dv);
      });
      x = next.x;
      v = next.v;
    }
    return ad::Vars<Real>{x, v};
  };
  const ad::Vars<Real> out = ad::checkpoint<Real>(frame, inputs);
  *forward = false;
  fem::check_state<Real>(s.mesh, out[0].value(), out[1].value(), s.h,
                         (motion_.frame() + 1) * s.substeps + 1);
  fem::State<Real> next{out[0].value(), out[1].value()};
  f_ext_.reserve(f_ext_.size() + 1);
  motion_.advance_to(std::move(next));
  f_ext_.push_back(f_ext);
  forced_ = forced;
  x_ = out[0];
  v_ = out[1];
}

// v + s dv, as Motion reports it.
template <class Real>
Var<Real> Recording<Real>::reported_velocity() {
  const Simulation<Real>& s = motion_.simulation();
  if (frames() == 0) return v0_;
  if (s.stagger == Real(0)) return v_;
  ad::Vars<Real> inputs{x_, v_, f_ext_.back()};
  if (s.law.keeps_nothing()) inputs.push_back(s.law.internal_force(s.mesh, x_));
  fem::Boundary<Real> still = motion_.boundary();
  still.pin_v.setZero();
  const ad::Piece<Real> increment = [&s, still, forced = forced_](ad::Tape<Real>&,
                                                                  const ad::Vars<Real>& in) {
    Var<Real> f = in.size() > 3 ? in[3] : s.law.internal_force(s.mesh, in[0]);
    if (forced) f = ad::add(f, in[2]);
    const fem::StepContext<Real> context{s.mesh, s.h, still};
    return ad::Vars<Real>{fem::pin_velocities(still, s.integrator.dv(context, in[0], in[1], f))};
  };
  return ad::add(v_, ad::scale(ad::checkpoint<Real>(increment, inputs)[0], s.stagger));
}

template <class Real>
void Recording<Real>::add_loss(const Matrix<Real>& x_bar, const Matrix<Real>& v_bar) {
  for (const Matrix<Real>* bar : {&x_bar, &v_bar})
    NMP_CHECK(bar->rows() == x_.rows() && bar->cols() == 3,
              text("dL/dx and dL/dv must be ", x_.rows(), " x 3, got ", shape(*bar)));
  std::vector<Term> terms;
  if (!x_bar.isZero(0)) terms.push_back({x_, x_bar});
  if (!v_bar.isZero(0)) terms.push_back({reported_velocity(), v_bar});
  loss_.reserve(loss_.size() + terms.size());
  for (Term& term : terms) loss_.push_back(std::move(term));
}

template <class Real>
void Recording<Real>::backward() {
  std::vector<Var<Real>> y;
  std::vector<ConstMatrixMap<Real>> y_bar;
  for (const Term& term : loss_) {
    y.push_back(term.y);
    y_bar.emplace_back(term.bar.data(), term.bar.rows(), term.bar.cols());
  }
  tape_.backward(y.data(), y_bar.data(), y.size());
}

template class Recording<float>;
template class Recording<double>;

}  // namespace nmp
