#pragma once

#include "fem/block.h"

namespace nmp::fem {

/// The singular values nearest to others whose product is 1, a block at a time:
///   min |q - s|^2  subject to  q_1 q_2 q_3 = 1:   q_i + m / q_i = s_i  with a multiplier m.
/// @param s  s_1 >= s_2 >= |s_3|, as of a rotation-variant decomposition
/// @param q  all > 0, to a few units in the last place; NaN where s is
template <class Real>
void project_volume(const Block<Real, 3>& s, Block<Real, 3>& q, Block<Real, 1>& m);

}  // namespace nmp::fem
