#pragma once

#include <string>

#include "fem/tet_mesh.h"
#include "nmp/dataset.h"
#include "nmp/player_data.h"
#include "nmp/vertex_measures.h"

namespace nmp {

/// Surface, pinned surface vertices and ground of a dataset's body.
/// @param stress_law  name of the law whose stresses are shown; empty: none are
PlayerBody player_body(const Dataset& dataset, const std::string& stress_law = "");

/// What errors are counted from: a recorded motion, at any time of it.
class Reference {
 public:
  /// @param h  time between its frames [s]. Keeps a reference to the record.
  Reference(const Trajectory& record, double h) : record_(record), h_(h) {}
  double h() const { return h_; }
  /// Positions at a time; between frames the cubic through positions and velocities of both.
  /// @return  false where the record has ended: x is left alone
  bool at(double time, Matrix<double>& x) const;

 private:
  const Trajectory& record_;
  double h_;
};

/// Turns frames into a motion for the player as they come.
class MotionRecorder {
 public:
  /// Everything but the references must outlive the recorder.
  struct Options {
    std::string label;
    std::size_t body = 0;               // its number in the document
    const PlayerBody* shape = nullptr;  // and what it is
    const fem::TetMesh<double>* mesh = nullptr;
    double h = 0;                          // time between frames [s]
    Index stride = 1;                      // every so many of them are kept, and the last
    StressLaw law;                         // may be none
    const Reference* reference = nullptr;  // nullptr: there are no errors
  };
  explicit MotionRecorder(Options options);

  /// Frame t = 0, 1, ...: x, v #V x 3 [m, m/s].
  /// @throws InputError  naming label and frame if a number is not finite
  void add(Index t, const ConstView<double>& x, const ConstView<double>& v);
  /// The motion, which ends with the last frame that was added. @throws std::invalid_argument  if
  /// none was
  PlayerMotion finish(bool diverged = false);

 private:
  void keep(Index t, const Matrix<double>& x, const Matrix<double>& v);
  Options options_;
  PlayerMotion motion_;
  Index last_ = -1;  // frame that was added last, and what it is
  Matrix<double> x_, v_;
};

}  // namespace nmp
