#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "nmp/dataset.h"

namespace nmp {

struct IdentifyOptions {
  /// Of "E", "nu", "density", "friction", "drag", "wind".
  std::vector<std::string> params{"E", "nu"};
  /// Where to begin, and what is held: E [Pa], nu, density [kg/m3], friction, drag [1/s].
  /// By default what is held is the record's (E and nu of its law at rest), friction and drag 0; a
  /// fit begins with nu 0.3, a little friction and drag, and that E which strays least of ten
  /// around the one for which a step of half a frame is just stable.
  std::map<std::string, double> guess;
  std::string law;      // empty: the dataset's, if it is known, else neo-hookean
  Index segments = 16;  // of training trajectories, at random
  Index length = 60;    // frames of a segment
  Index max_iterations = 40;
  std::uint64_t seed = 1;
  /// What is going on, and the part of an iteration that is done. May throw, to stop.
  std::function<void(const std::string&, double)> progress;
};

struct IdentifiedParameter {
  std::string name, unit;  // "E", "Pa"; "wind x", "m/s"; "E/density", "m2/s2"
  double guess = 0, value = 0;
  /// Standard deviation: the scatter of the segments' gradients, the rounding of the record, and
  /// what halving the step would change. It knows nothing of a law that is the wrong one.
  double std = 0;
  std::optional<double> truth;  // of a dataset that tells, for small strains
};

struct Identified {
  std::vector<IdentifiedParameter> parameters;
  fem::Physics
      physics;         // all numbers of the fitted simulator; its E is at the density that is held
  Index substeps = 1;  // its steps per frame
  double rms_guess = 0, rms = 0;  // of x - x* over the segments [m]
  Index n_segments = 0, length = 0, iterations = 0;
  bool converged = false;
  std::vector<std::string> notes;  // sentences
};

/// Fits physical parameters to the positions of a dataset's training trajectories, and nothing else
/// of them: rollouts of an explicit simulator over short segments (FitObjective), gradients through
/// every step, Gauss-Newton with Levenberg's damping. Positions fix E and density by their ratio
/// only: asked for both, the ratio is fitted.
/// @throws ConfigError  for a parameter, law or guess that does not exist or is out of range;
///         InputError  if the positions do not tell a parameter, naming it; NumericalError  if not
///         even the guess can be rolled out
Identified identify(const Dataset& dataset, const IdentifyOptions& options = {});

/// The document of `nmp fit --json`, and a table for people.
std::string to_json(const Identified& found);
std::string to_table(const Identified& found);

}  // namespace nmp
