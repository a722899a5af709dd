#include "nmp/slide.h"

namespace nmp {

SlideMeter::SlideMeter(const fem::TetMesh<double>& mesh, double ground, double h)
    : mesh_(mesh), ground_(ground), h_(h) {}

void SlideMeter::add(const ConstView<double>& x) {
  // Positions of the recorder are single precision.
  const double near = 1e-6 * mesh_.diagonal();
  const Vec3<double> centroid =
      x.transpose() * mesh_.vertex_volumes().col(0) / mesh_.total_volume();
  const auto on_ground = [&](const auto& height) { return height <= ground_ + near; };
  Index contacts = 0, stayed = 0;
  Vec3<double> feet = Vec3<double>::Zero();  // motion of those that stayed on the ground, summed
  for (Index i = 0; i < x.rows(); ++i) {
    if (!on_ground(x(i, 2))) continue;
    ++contacts;
    if (frames_ == 0 || !on_ground(x_(i, 2))) continue;
    ++stayed;
    feet += (x.row(i) - x_.row(i)).transpose();
  }
  slide_.contacts += static_cast<double>(contacts);
  if (frames_ > 0) {
    const double slow = kRestSpeed * h_, moved = (centroid - centroid_).head<2>().norm();
    if (slide_.first_contact) slide_.path += moved;
    slow_frames_ = moved < slow ? slow_frames_ + 1 : 0;
    const bool stuck = stayed > 0 && feet.head<2>().norm() < slow * static_cast<double>(stayed);
    stuck_frames_ = stuck ? stuck_frames_ + 1 : 0;
  }
  if (contacts > 0 && !slide_.first_contact) slide_.first_contact = frames_;
  centroid_ = centroid;
  x_ = x;
  ++frames_;
}

Slide SlideMeter::result() const {
  Slide result = slide_;
  if (frames_ > 0) result.contacts /= static_cast<double>(frames_);
  result.at_rest = slow_frames_ >= kRestFrames;
  result.stuck = stuck_frames_ >= kRestFrames;
  return result;
}

}  // namespace nmp
