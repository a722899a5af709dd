#include "nmp/slide.h"

namespace nmp {

SlideMeter::SlideMeter(const fem::TetMesh<double>& mesh, double ground, double h)
    : mesh_(mesh), ground_(ground), h_(h) {}

void SlideMeter::add(const ConstView<double>& x) {
  // Positions of the recorder are single precision.
  const double near = 1e-6 * mesh_.diagonal();
  const Vec3<double> centroid =
      x.transpose() * mesh_.vertex_volumes().col(0) / mesh_.total_volume();
  const auto contacts = static_cast<double>((x.col(2).array() <= ground_ + near).count());
  slide_.contacts += contacts;
  if (frames_ > 0) {
    const double moved = (centroid - centroid_).head<2>().norm();
    if (slide_.first_contact) slide_.path += moved;
    slow_frames_ = moved < kRestSpeed * h_ ? slow_frames_ + 1 : 0;
  }
  if (contacts > 0 && !slide_.first_contact) slide_.first_contact = frames_;
  centroid_ = centroid;
  ++frames_;
}

Slide SlideMeter::result() const {
  Slide result = slide_;
  if (frames_ > 0) result.contacts /= static_cast<double>(frames_);
  result.at_rest = slow_frames_ >= kRestFrames;
  return result;
}

}  // namespace nmp
