#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "nmp/model.h"

namespace nmp {

/// One gradient, by the tape and by central differences.
struct CheckRow {
  std::string group;  // "operator", "law", "module", "rollout"
  std::string what;
  double error = 0;  // largest relative error of an entry (ad::GradientCheck)
  double tolerance = 0;
  bool ok = false;    // below the tolerance, and not all gradients were zero
  std::string worst;  // the entry with that error; empty if all agree to the last digit
};

struct SelfCheckOptions {
  std::uint64_t seed = 1;          // of the points at which gradients are taken
  Model<double>* model = nullptr;  // check these modules; none: untrained ones of every form
  /// Called before every check with the part that is done, in [0, 1], and its name.
  std::function<void(double, const std::string&)> progress;
};

/// The gradient check that users can run: every operator at generic points, the analytic laws with
/// their material constants, both networks, and a rollout of ten steps into the ground of every
/// pairing of modules on a cube of 27 vertices. Double precision.
std::vector<CheckRow> self_check(const SelfCheckOptions& options = {});

}  // namespace nmp
