#include "nmp/ensemble.h"

#include <vector>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/lane_simulator.h"
#include "fem/projective_dynamics.h"

namespace nmp {

namespace {

class Explicit : public Ensemble {
 public:
  Explicit(const fem::TetMesh<double>& mesh, const fem::Physics& physics, double dt, Index n)
      : simulator_(mesh, physics, dt, n) {}
  void set_state(Index k, const fem::State<double>& state) override {
    simulator_.set_state(k, state);
  }
  fem::State<double> state(Index k) const override { return simulator_.state(k); }
  Matrix<double> internal_force(Index k) override { return simulator_.internal_force(k); }
  void advance(Index n_steps) override { simulator_.advance(n_steps); }

 private:
  fem::LaneSimulator simulator_;
};

// A trajectory per thread.
class Implicit : public Ensemble {
 public:
  Implicit(const fem::TetMesh<double>& mesh, const fem::Physics& physics, double dt, Index n)
      : states_(static_cast<std::size_t>(n)) {
    for (Index k = 0; k < n; ++k)
      simulators_.push_back(std::make_unique<fem::ProjectiveDynamics>(mesh, physics, dt));
  }
  void set_state(Index k, const fem::State<double>& state) override {
    states_[static_cast<std::size_t>(k)] = state;
  }
  fem::State<double> state(Index k) const override { return states_[static_cast<std::size_t>(k)]; }
  Matrix<double> internal_force(Index k) override {
    const auto i = static_cast<std::size_t>(k);
    return simulators_[i]->internal_force(states_[i].x);
  }
  void advance(Index n_steps) override {
    parallel_chunks(static_cast<Index>(states_.size()), 1, [&](Index begin, Index) {
      const auto i = static_cast<std::size_t>(begin);
      try {
        simulators_[i]->advance(states_[i], n_steps);
      } catch (const NumericalError& error) {
        NumericalError named(text("trajectory ", begin, ": ", error.what()));
        named.element = error.element;
        named.step = error.step;
        throw named;
      }
    });
  }
  std::string complaint() const override {
    Index unsolved = 0, steps = 0;
    for (const auto& simulator : simulators_) {
      unsolved += simulator->work().unsolved;
      steps += simulator->work().steps;
    }
    if (unsolved == 0) return {};
    return text(unsolved, " of ", steps,
                " implicit steps were not solved to their tolerance: try a smaller time.dt");
  }

 private:
  std::vector<std::unique_ptr<fem::ProjectiveDynamics>> simulators_;
  std::vector<fem::State<double>> states_;
};

}  // namespace

std::unique_ptr<Ensemble> make_ensemble(const fem::TetMesh<double>& mesh,
                                        const fem::Physics& physics, double dt,
                                        Index n_trajectories) {
  if (physics.material.law == "projective")
    return std::make_unique<Implicit>(mesh, physics, dt, n_trajectories);
  return std::make_unique<Explicit>(mesh, physics, dt, n_trajectories);
}

}  // namespace nmp
