#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "nmp/motion.h"

namespace nmp::capi {

/// What nmp_sim_save keeps.
template <class Real>
struct SavedState {
  typename Motion<Real>::Snapshot motion;
  std::vector<Index> pin_order;  // place in what hosts give, of each pin in ascending order
};

/// As bytes: "NMPSTATE", how many bytes in all, a version, the bytes of a Real, #V, #T and the
/// hash of the mesh, the step, substeps and stagger, the numbers as they are, and the XXH3 of all
/// that.
template <class Real>
std::string encode(const SavedState<Real>& state, const Simulation<Real>& simulation);

/// @param simulation  whose ground and friction are taken over
/// @throws InputError  for bytes that are damaged, or of another mesh, stepping, precision or
/// version
template <class Real>
SavedState<Real> decode(std::string_view bytes, const Simulation<Real>& simulation);

}  // namespace nmp::capi
