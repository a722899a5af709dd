#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "base/file.h"
#include "nmp/evaluate.h"

namespace nmp {

/// The paper's Table 1 (its own method's row) with shipped models: RMSE over validation
/// trajectories at 100, 500 and 1000 frames of CUBE, CUBEXL, SPOT and BOB.
struct Table1Options {
  /// Holds SCENE.safetensors, and for two more columns, if they are there, models with the same law
  /// beside an integrator that is a net alone: SCENE-density.safetensors, SCENE-paper.safetensors.
  Path models = "models";
  Path work = "out/reproduce";      // where the scenes' validation trajectories are made and kept
  std::vector<Path> mesh_folders;   // where bob.msh and spot.msh are looked for
  std::vector<std::string> scenes;  // empty: all four
  Index trajectories = 8;           // of validation
  std::vector<Index> horizons{100, 500, 1000};
  /// What is going on, and the part of it that is done, in [0, 1]. May throw, to stop.
  std::function<void(const std::string&, double)> progress;
  std::function<void(const std::string&)> warn;
  /// Asked while trajectories are made: true keeps what is complete, and calls progress() to stop.
  std::function<bool()> stop;
};

/// One scene at one horizon. RMSE in metres, mean over the trajectories.
struct Table1Cell {
  std::string scene;
  Index horizon = 0;
  HorizonError error;                                       // of both modules of the model
  std::optional<double> residual_zeroed;                    // the same without the integrator's net
  std::optional<double> affine_only;                        // true law, two fitted numbers
  std::optional<double> density_form, paper_form;           // other integrators, see Table1Options
  std::optional<double> coarse_physics, staggered_physics;  // true law, the same step
  double ballistic = 0, rest = 0;
  Index diverged = 0;
  std::optional<double> paper, paper_std;
  std::optional<double> goal;
  /// "missed" the goal, or "tenth": missed, but at most a tenth of the paper's error. Else "goal",
  /// "coarse" or "staggered": at most the error of that physics, too. "" where there is no goal.
  std::string verdict;
};

struct Table1 {
  struct Source {
    std::string scene, model;        // the model's file
    std::string trained_on, config;  // hash of the dataset's manifest; name of the configuration
    double force_error = 0;          // of the stress net, pooled along the truth
    /// "learned" if the error is larger without the integrator's net at every horizon, else
    /// "identified": two fitted numbers did it. "" if there are no such numbers.
    std::string integrator;
  };
  std::vector<Source> sources;
  std::vector<Table1Cell> cells;
};

/// Makes the validation trajectories that are missing, rolls the models out on them, and compares.
/// @throws ConfigError  if a model or mesh is missing, or a scene is not one of the four; as
///         generate_dataset, load_model and evaluate do
Table1 reproduce_table1(const Table1Options& options);

/// The names of the four scenes, in the paper's order.
const std::vector<std::string>& table1_scenes();

/// The document of `nmp reproduce table1 --json`.
std::string to_json(const Table1& table);

}  // namespace nmp
