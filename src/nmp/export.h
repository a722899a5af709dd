#pragma once

#include <functional>
#include <optional>
#include <string>

#include "nmp/dataset.h"

namespace nmp {

/// What there is to see.
struct ExportSource {
  fem::TetMesh<double> mesh;
  std::vector<int> pinned;
  const Trajectory* frames = nullptr;
  double h = 0;                           // between frames [s]
  const Trajectory* record = nullptr;     // that the frames predict; null: there is none
  std::optional<fem::Material> material;  // whose stress and energy are shown; none: neither
};

struct ExportOptions {
  std::string format = "vtu";  // or "obj", "pc2"
  Index every = 1;             // frames 0, every, 2 every, ...
  bool zlib = false;           // vtu: compressed
  bool force = false;
  /// Called after every frame with the part that is done; what it throws ends the export, of which
  /// nothing stays then.
  std::function<void(double)> progress;
};

struct Exported {
  Path file;  // what to open: the collection, the first surface, the point cache
  Index n_frames = 0;
};

/// Writes frames for other programs; `out` appears whole or not at all.
///   vtu  a folder with frame_0000.vtu ..., rest.vtu (the shape at rest, with `pinned`) and
///        frames.pvd with the times; if `out` ends in .pvd it is the collection, beside a folder of
///        its name. At points v and f_int as far as they are recorded, error (x - x* of the
///        record); in cells det_F, and von_mises (of the Cauchy stress) and energy (density) with a
///        material, NaN where det F <= 0.
///   obj  a folder with the surface of every frame, frame_0000.obj ..., and times.csv
///   pc2  a point cache for Blender, and beside it the surface it moves, of ending .obj
/// @throws ConfigError  for an unknown format, or if something is in the way; IoError
Exported export_frames(const ExportSource& source, const Path& out, const ExportOptions& options);

}  // namespace nmp
