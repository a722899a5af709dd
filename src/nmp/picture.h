#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "fem/surface.h"

namespace nmp {

/// Where a picture is looked at from, and how large: an orthographic view of everything that it was
/// fitted to.
class Camera {
 public:
  /// @param azimuth    of the camera around the z axis, from +x towards +y [degrees]
  /// @param elevation  above the horizon [degrees]
  Camera(double azimuth, double elevation);

  /// Makes the view hold these positions, too.   #V x 3 [m]
  void include(const Matrix<double>& x);

  struct Point {
    double right, up, towards;  // the last one: larger is nearer to the camera [m]
  };
  Point project(const Vec3<double>& x) const;
  /// Of what was included; 0 if nothing was [m].
  double width() const;
  double height() const;
  /// Its lower left corner [m].
  Point corner() const { return low_; }

 private:
  Vec3<double> right_, up_, towards_;
  bool empty_ = true;
  Point low_{0, 0, 0}, high_{0, 0, 0};
};

/// A body in a picture, shaded by a light behind the camera.
struct PictureBody {
  Matrix<double> x;                            // #V x 3, every vertex of the mesh [m]
  std::array<double, 3> colour{0, 0.45, 0.7};  // red, green, blue in [0, 1]
  /// Per vertex in [0, 1]: dark blue to yellow in place of the colour; empty: none.
  std::vector<double> values;
  bool wire = false;  // its edges alone
};

/// A surface in several positions, as inline SVG.
/// @param name    for people who cannot see it
/// @param ground  height of a ground plane to hint at [m]
std::string draw(const std::string& name, const fem::Surface& surface,
                 const std::vector<PictureBody>& bodies, const Camera& camera,
                 const std::optional<double>& ground = {}, double width = 300);

}  // namespace nmp
