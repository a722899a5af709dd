#include "fem/surface_writer.h"

#include <cstdint>

#include "base/check.h"
#include "fem/mesh_output.h"
#include "fem/mesh_reader.h"

namespace nmp::fem {

template <class Real>
std::string to_obj(const Matrix<Real>& vertices, const Triangles& triangles) {
  NMP_CHECK(vertices.cols() == 3, "vertices must be #V x 3, got " + shape(vertices));
  Output out;
  for (Index i = 0; i < vertices.rows(); ++i) (out << "v ").line(vertices.row(i));
  for (Index i = 0; i < triangles.rows(); ++i)
    (out << "f ").line((triangles.row(i).array() + 1).eval());
  return out.text();
}

template std::string to_obj(const Matrix<float>&, const Triangles&);
template std::string to_obj(const Matrix<double>&, const Triangles&);

Pc2Writer::Pc2Writer(const Path& path, Index n_points, Index n_samples)
    : file_(path), n_points_(n_points), n_left_(n_samples) {
  NMP_CHECK(
      n_points >= 1 && n_points < Index(1) << 31 && n_samples >= 1 && n_samples < Index(1) << 31,
      text("a point cache has 1 to 2^31 - 1 points and samples, got ", n_points, " and ",
           n_samples));
  const bool swap = !is_little_endian();
  Output header;
  header << std::string_view("POINTCACHE2\0", 12);
  header.binary(std::int32_t{1}, swap);
  header.binary(static_cast<std::int32_t>(n_points), swap);
  header.binary(0.0f, swap);
  header.binary(1.0f, swap);
  header.binary(static_cast<std::int32_t>(n_samples), swap);
  file_.append(header.text().data(), header.text().size());
}

void Pc2Writer::write(const Matrix<float>& positions) {
  NMP_CHECK(positions.rows() == n_points_ && positions.cols() == 3,
            text("a sample is ", n_points_, " x 3, got ", shape(positions)));
  NMP_CHECK(n_left_ > 0, "there are more samples than were announced");
  const bool swap = !is_little_endian();
  Output sample;
  for (Index i = 0; i < n_points_; ++i)
    for (Index k = 0; k < 3; ++k) sample.binary(positions(i, k), swap);
  file_.append(sample.text().data(), sample.text().size());
  --n_left_;
}

void Pc2Writer::commit() {
  NMP_CHECK(n_left_ == 0, text(n_left_, " samples are missing"));
  file_.commit();
}

}  // namespace nmp::fem
