#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "fem/mesh_file.h"
#include "fem/vtu_grid.h"

namespace nmp {

/// A motion in the files of another program: a ParaView collection (.pvd) of VTU files, or of
/// multi-block files (.vtm), whose first VTU file is read. All have the same tetrahedra. Names in
/// these files may not lead out of the folder of the file they stand in.
class FrameSeries {
 public:
  /// @param displacement  a vector of PointData that is added to the points; empty: none
  /// @throws InputError  with the file, also for less than two frames and for times that do not
  ///         rise; IoError
  FrameSeries(const Path& collection, const std::string& displacement);

  const std::string& name() const { return name_; }
  Index n() const { return static_cast<Index>(times_.size()); }
  /// [s], ascending.
  const std::vector<double>& times() const { return times_; }
  /// The folder of frame 0.
  Path folder() const { return files_.front().parent_path(); }

  struct Frame {
    Matrix<double> points;            // #V x 3, without the displacement
    Matrix<double> x;                 // with it
    std::optional<Matrix<double>> v;  // PointData v, velocity or Velocity
    std::optional<Matrix<double>> f;  // PointData f_int
  };
  /// As it stands in the file. The last few are kept.
  /// @throws InputError  naming the file if it has other tetrahedra than `tets`
  const Frame& frame(Index k, const fem::Tets& tets);
  /// The tetrahedra of frame 0.
  fem::Tets tets() const;

 private:
  fem::VtuGrid read(Index k, const std::vector<std::string>& wanted) const;
  std::string name_, displacement_;
  std::vector<double> times_;
  std::vector<Path> files_;
  std::map<Index, Frame> kept_;
};

}  // namespace nmp
