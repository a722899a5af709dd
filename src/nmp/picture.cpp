#include "nmp/picture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>

#include "base/check.h"
#include "nmp/plot.h"

namespace nmp {

namespace {

using Rgb = std::array<double, 3>;

// Nearly even steps of lightness, told apart with any colour vision.
Rgb colour_of(double value) {
  constexpr std::array<Rgb, 5> kScale{{{0.05, 0.10, 0.35},
                                       {0.30, 0.20, 0.50},
                                       {0.70, 0.27, 0.42},
                                       {0.93, 0.53, 0.28},
                                       {0.99, 0.90, 0.45}}};
  const double place = std::clamp(value, 0.0, 1.0) * (kScale.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(place), kScale.size() - 2);
  const double part = place - static_cast<double>(i);
  Rgb result{};
  for (std::size_t c = 0; c < 3; ++c)
    result[c] = (1 - part) * kScale[i][c] + part * kScale[i + 1][c];
  return result;
}

std::string hex(const Rgb& colour, double light) {
  char digits[8];
  const auto byte = [&](std::size_t c) {
    return static_cast<int>(std::lround(255 * std::clamp(light * colour[c], 0.0, 1.0)));
  };
  std::snprintf(digits, sizeof digits, "#%02x%02x%02x", byte(0), byte(1), byte(2));
  return digits;
}

std::string px(double value) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.1f", value);
  return digits;
}

// A triangle that is seen, in the picture's coordinates.
struct Facet {
  double depth;
  std::string path, fill;
  bool wire;
};

}  // namespace

Camera::Camera(double azimuth, double elevation) {
  const double a = azimuth * EIGEN_PI / 180, e = elevation * EIGEN_PI / 180;
  towards_ = Vec3<double>(std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e));
  right_ = Vec3<double>(-std::sin(a), std::cos(a), 0);
  up_ = towards_.cross(right_);
}

Camera::Point Camera::project(const Vec3<double>& x) const {
  return {right_.dot(x), up_.dot(x), towards_.dot(x)};
}

void Camera::include(const Matrix<double>& x) {
  for (Index i = 0; i < x.rows(); ++i) {
    const Point p = project(x.row(i).transpose());
    if (!std::isfinite(p.right + p.up + p.towards)) continue;
    if (empty_) low_ = high_ = p;
    empty_ = false;
    low_ = {std::min(low_.right, p.right), std::min(low_.up, p.up),
            std::min(low_.towards, p.towards)};
    high_ = {std::max(high_.right, p.right), std::max(high_.up, p.up),
             std::max(high_.towards, p.towards)};
  }
}

double Camera::width() const { return high_.right - low_.right; }
double Camera::height() const { return high_.up - low_.up; }

std::string draw(const std::string& name, const fem::Surface& surface,
                 const std::vector<PictureBody>& bodies, const Camera& camera,
                 const std::optional<double>& ground, double width) {
  constexpr double kMargin = 8;
  const double scale = (width - 2 * kMargin) / std::max(camera.width(), 1e-12);
  const double height = scale * camera.height() + 2 * kMargin;
  const auto place = [&](const Camera::Point& p) {
    return std::pair(kMargin + scale * (p.right - camera.corner().right),
                     height - kMargin - scale * (p.up - camera.corner().up));
  };

  std::vector<Facet> facets;
  for (const PictureBody& body : bodies) {
    NMP_CHECK(body.values.empty() || static_cast<Index>(body.values.size()) == body.x.rows(),
              "a picture needs a value for every vertex");
    for (Index f = 0; f < surface.triangles.rows(); ++f) {
      Camera::Point corner[3];
      std::pair<double, double> at[3];
      double depth = 0, value = 0;
      for (int k = 0; k < 3; ++k) {
        const std::int32_t v = surface.vertices[static_cast<std::size_t>(surface.triangles(f, k))];
        corner[k] = camera.project(body.x.row(v).transpose());
        at[k] = place(corner[k]);
        depth += corner[k].towards / 3;
        if (!body.values.empty()) value += body.values[static_cast<std::size_t>(v)] / 3;
      }
      const Vec3<double> a(corner[1].right - corner[0].right, corner[1].up - corner[0].up,
                           corner[1].towards - corner[0].towards);
      const Vec3<double> b(corner[2].right - corner[0].right, corner[2].up - corner[0].up,
                           corner[2].towards - corner[0].towards);
      const Vec3<double> normal = a.cross(b).normalized();
      if (!(normal[2] > 1e-9)) continue;  // looks away, or is seen edge on
      const double light = 0.45 + 0.55 * std::max(0.0, normal.dot(Vec3<double>(-0.3, 0.5, 0.81)));
      std::string path = "M";
      for (const auto& [u, v] : at) path += px(u) + " " + px(v) + (&u == &at[2].first ? "Z" : "L");
      const Rgb colour = body.values.empty() ? body.colour : colour_of(value);
      // The wire is drawn over what it touches.
      facets.push_back({depth + (body.wire ? 1e-3 * camera.width() : 0), path,
                        hex(colour, body.wire ? 1 : light), body.wire});
    }
  }
  std::sort(facets.begin(), facets.end(),
            [](const Facet& a, const Facet& b) { return a.depth < b.depth; });

  std::string svg = "<svg viewBox=\"0 0 " + px(width) + " " + px(height) +
                    "\" role=\"img\" aria-label=\"" + escape_html(name) + "\">";
  if (ground) {
    // The plane is seen from above: its trace below the middle of the view.
    const double y = place(camera.project({0, 0, *ground})).second;
    svg += "<line x1=\"0\" x2=\"" + px(width) + "\" y1=\"" + px(y) + "\" y2=\"" + px(y) +
           "\" class=\"grid\"/>";
  }
  for (const Facet& facet : facets)
    svg += "<path d=\"" + facet.path + "\" " +
           (facet.wire
                ? "fill=\"none\" stroke=\"" + facet.fill + "\" stroke-width=\".5\""
                : "fill=\"" + facet.fill + "\" stroke=\"" + facet.fill + "\" stroke-width=\".4\"") +
           "/>";
  return svg + "</svg>";
}

}  // namespace nmp
