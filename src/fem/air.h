#pragma once

#include "autodiff/parameter.h"
#include "fem/integrator.h"
#include "fem/material.h"

namespace nmp::fem {

/// An integrator in moving air that drags every vertex along: dv + h c (w - v), with the drag c
/// [1/s] and the wind w [m/s]. Both are differentiable, and frozen until asked for.
template <class Real>
class InAir : public Integrator<Real> {
 public:
  /// @param integrator  lives as long as this
  /// @throws std::invalid_argument  as check(Air)
  InAir(const Integrator<Real>& integrator, const Air& air);
  Var<Real> dv(const StepContext<Real>& context, Var<Real> x, Var<Real> v,
               Var<Real> f_int) const override;

  ad::Parameter<Real> drag, wind;  // 1 x 1, named "drag"; 1 x 3, named "wind"

 private:
  const Integrator<Real>& integrator_;
};

/// The plain function: adds h c (w - v).   v, dv #V x 3
template <class Real>
void add_drag(const Air& air, Real h, const ConstView<Real>& v, View<Real> dv);

}  // namespace nmp::fem
