#pragma once

#include <functional>
#include <string>
#include <vector>

#include "autodiff/types.h"
#include "base/file.h"

namespace nmp {

/// Something that is wrong with a file of a dataset.
struct DatasetProblem {
  std::string file;  // as the manifest names it
  std::string what;  // with the place, what was expected and what was found
};

struct DatasetCheck {
  Index n_files = 0;             // that were read
  Index n_without_checksum = 0;  // of them: a change of their bytes would go unseen
  std::vector<DatasetProblem> problems;
};

/// Reads every byte of a dataset and tells all that is wrong with it, not only the first: of the
/// manifest (without which there is nothing else to say), the mesh and each trajectory
///   - whether it is there, has the format, the shapes and the checksum of the manifest;
///   - that x, v and f_int are finite, pinned vertices at rest, no element inside out under the
///     neo-Hookean law;
///   - that frames follow each other. v_t is the velocity of the substep that ends at frame t, so
///     that x_{t+1} - x_t = h v_{t+1} where a frame is one substep and the vertex neither pinned
///     nor on the ground. Where it is n of them, the mass centre of a body without pins that is
///     clear of the ground obeys  c_{t+1} - c_t = h c'_t + n (n + 1)/2 dt^2 g,  whatever the law.
/// Checksums and velocities that are not recorded are not checked.
/// @throws IoError  if the manifest cannot be read
/// @param progress  called after every file with the part that is done, in [0, 1]
DatasetCheck verify_dataset(const Path& folder, const std::function<void(double)>& progress = {});

/// The document of `nmp data verify --json`.
std::string to_json(const DatasetCheck& check);

}  // namespace nmp
