#pragma once

#include <functional>
#include <string>
#include <vector>

#include "base/file.h"

namespace nmp {

/// How much of a study is run.
enum class Scale {
  smoke,  // whether it works: a trajectory of 50 frames, trainings of a few steps
  small,  // 2 trajectories of 1000 frames, short trainings
  paper,  // as many trajectories and frames as the paper
};

struct StudyOptions {
  Scale scale = Scale::paper;
  Path models = "models";          // holds SCENE.safetensors
  Path work = "out/reproduce";     // where trajectories and models are made, and found again
  std::vector<Path> mesh_folders;  // where bob.msh and spot.msh are looked for
  /// What is going on, and the part of it that is done, in [0, 1]. May throw, to stop.
  std::function<void(const std::string&, double)> progress;
  std::function<void(const std::string&)> warn;
  /// Asked while trajectories are made and models trained: true keeps what there is, and calls
  /// progress() to stop.
  std::function<bool()> stop;
};

/// What a study has found.
struct Study {
  std::string name, title;
  std::vector<std::string> notes;              // sentences: what was done, what it says
  std::vector<std::vector<std::string>> rows;  // a table, its first row the header
  std::string json;                            // the numbers, a JSON document
  std::string figures;                         // HTML, beside the table
};

/// A study of the paper, or of ours.
struct StudyKind {
  const char *name, *summary;
  Study (*run)(const StudyOptions&);
};
/// All of them, in the order of a report.
const std::vector<StudyKind>& study_kinds();

// Studies of the paper with the models that ship (its Sec. 4.3 to 4.5 and Appendix).
// @throws ConfigError  if a model or mesh is missing; as generate_dataset, load_model and
//         run_training do
Study study_unseen(const StudyOptions& options);       // velocities, spins, heights beyond training
Study study_resolution(const StudyOptions& options);   // weights of 22^3 vertices on 28^3
Study study_interchange(const StudyOptions& options);  // one module swapped for another
Study study_volume(const StudyOptions& options);       // violations with and without the hinge
Study study_collapse(const StudyOptions& options);     // joint from scratch against two stages
Study study_model_size(const StudyOptions& options);   // width of the stress net
Study study_laws(const StudyOptions& options);         // a law with an energy beside the paper's
Study study_efficiency(const StudyOptions& options);   // seconds per rollout and their errors
Study study_failure(const StudyOptions& options);      // the worst rollout
Study study_trajectories(const StudyOptions& options);   // the 40 trajectories of CUBE
Study study_friction(const StudyOptions& options);       // learned, against simulators without it
Study study_sysid(const StudyOptions& options);          // E and nu from positions
Study study_transfer(const StudyOptions& options);       // CUBE's model on a softer cube in wind
Study study_volume_weight(const StudyOptions& options);  // the hinge at four weights, there

/// Keeps a study in the folder, WORK/studies/NAME.json, and makes WORK/report.html of all that are
/// kept there. @return  the report's path
Path add_to_report(const Study& study, const Path& work);

}  // namespace nmp
