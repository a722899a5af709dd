#include "nmp/trajectory.h"

#include <cstring>
#include <utility>

#include "base/check.h"
#include "nmp/config.h"
#include "nmp/dataset_format.h"

namespace nmp {

Trajectory::Trajectory(const Path& path, const RecordInfo& info, Index n_vertices, double h)
    : Trajectory(TensorFile::open(path), info, n_vertices, h) {}

Trajectory::Trajectory(TensorFile tensors, const RecordInfo& info, Index n_vertices, double h)
    : info_(info), n_vertices_(n_vertices), h_(h) {
  NMP_CHECK(info.frames >= 0 && info.frames < kMaxCount,
            text("frames must be from 0 to 2^31 - 2, got ", info.frames));
  NMP_CHECK(n_vertices >= 1, text("n_vertices must be >= 1, got ", n_vertices));
  auto file = std::make_shared<TensorFile>(std::move(tensors));
  check_version(*file);
  const auto find = [&](const char* name) {
    return file->bytes(file->require(name, DType::f32, {info.frames + 1, n_vertices, 3}));
  };
  x_ = find("x");
  if (file->contains("v") || h == 0) v_ = find("v");
  if (file->contains("f_int")) f_int_ = find("f_int");
  file_ = std::move(file);
}

void Trajectory::verify() const {
  if (!info_.checksum.empty()) check_hash(file_->name(), info_.checksum, file_->hash());
}

// The file is row-major, [t][vertex][xyz]; a batch is column-major. Files from elsewhere may have
// their elements at any byte, hence memcpy (a plain load to the compiler).
template <class Real>
void Trajectory::read(const std::byte* frames, Index t, View<Real> out) const {
  NMP_CHECK(t >= 0 && t <= info_.frames,
            text("t must be from 0 to ", info_.frames, " in ", info_.name, ", got ", t));
  NMP_CHECK(out.rows() == n_vertices_ && out.cols() == 3,
            text("a frame is ", n_vertices_, " x 3, got ", shape(out)));
  const std::byte* from = frames + t * n_vertices_ * 3 * static_cast<Index>(sizeof(float));
  for (Index i = 0; i < n_vertices_; ++i) {
    float point[3];
    std::memcpy(point, from, sizeof point);
    from += sizeof point;
    for (Index k = 0; k < 3; ++k) out(i, k) = static_cast<Real>(point[k]);
  }
}

template <class Real>
void Trajectory::read_x(Index t, View<Real> x) const {
  read<Real>(x_, t, x);
}

template <class Real>
void Trajectory::read_v(Index t, View<Real> v) const {
  v_ == nullptr ? difference<Real>(t, v) : read<Real>(v_, t, v);
}

// v_t = sum_k w_k x_{from + k} / 2h.
template <class Real>
void Trajectory::difference(Index t, View<Real> v) const {
  const Index n = frames();
  NMP_CHECK(t >= 0 && t <= n, text("t must be from 0 to ", n, " in ", info_.name, ", got ", t));
  NMP_CHECK(v.rows() == n_vertices_ && v.cols() == 3,
            text("a frame is ", n_vertices_, " x 3, got ", shape(v)));
  const Index from = std::clamp<Index>(t - 1, 0, std::max<Index>(0, n - 2));
  std::vector<double> w{-1, 0, 1};
  if (t == 0) w = {-3, 4, -1};
  if (t == n) w = {1, -4, 3};
  if (n == 1) w = {-2, 2};
  if (n == 0) w = {0};  // a single state says nothing of its velocity
  Matrix<double> x(n_vertices_, 3), sum = Matrix<double>::Zero(n_vertices_, 3);
  for (std::size_t k = 0; k < w.size(); ++k) {
    read_x<double>(from + static_cast<Index>(k), x);
    sum += w[k] / (2 * h_) * x;
  }
  v = sum.cast<Real>();
}

template <class Real>
void Trajectory::read_force(Index t, View<Real> f_int) const {
  if (f_int_ == nullptr) {
    throw InputError(text(file_->name(), ": expected the tensor f_int, found none; stages that ",
                          "learn from forces need it"));
  }
  read<Real>(f_int_, t, f_int);
}

template <class Real>
fem::State<Real> Trajectory::state(Index t) const {
  fem::State<Real> state{Matrix<Real>(n_vertices_, 3), Matrix<Real>(n_vertices_, 3)};
  read_x<Real>(t, state.x);
  read_v<Real>(t, state.v);
  return state;
}

#define NMP_INSTANTIATE(Real)                                          \
  template void Trajectory::read_x<Real>(Index, View<Real>) const;     \
  template void Trajectory::read_v<Real>(Index, View<Real>) const;     \
  template void Trajectory::read_force<Real>(Index, View<Real>) const; \
  template fem::State<Real> Trajectory::state<Real>(Index) const;

#include "autodiff/instantiate.h"

TrajectoryWriter::TrajectoryWriter(const Path& path, Index frames, Index n_vertices,
                                   std::uint64_t seed, double h, const std::string& scene,
                                   const std::vector<std::string>& tensors)
    : path_(path), n_vertices_(n_vertices), file_(std::make_unique<TensorFileWriter>(path)) {
  NMP_CHECK(
      frames >= 0 && n_vertices >= 1,
      text("a trajectory has at least 0 steps and 1 vertex, got ", frames, " and ", n_vertices));
  file_->set_metadata("what", "nmp-trajectory");
  file_->set_metadata("version", std::to_string(kDatasetVersion));
  file_->set_metadata("units", "x m, v m/s, f_int N, h s");
  file_->set_metadata("h", decimal(h));
  file_->set_metadata("seed", std::to_string(seed));
  if (!scene.empty()) file_->set_metadata("scene", scene);
  for (const std::string& name : tensors)
    file_->declare(name, DType::f32, {frames + 1, n_vertices, 3});
  file_->begin();
  row_major_.resize(static_cast<std::size_t>(n_vertices) * 3);
}

TrajectoryWriter::~TrajectoryWriter() = default;

void TrajectoryWriter::write(Index t, const ConstView<double>& x, const ConstView<double>& v,
                             const ConstView<double>& f_int) {
  write(t, "x", x);
  write(t, "v", v);
  write(t, "f_int", f_int);
}

void TrajectoryWriter::write(Index t, const std::string& tensor, const ConstView<double>& values) {
  NMP_CHECK(values.rows() == n_vertices_ && values.cols() == 3,
            text(tensor, " must be ", n_vertices_, " x 3, got ", shape(values)));
  float* to = row_major_.data();
  for (Index i = 0; i < n_vertices_; ++i) {
    for (Index k = 0; k < 3; ++k) *to++ = static_cast<float>(values(i, k));
  }
  file_->write(tensor, t * 3 * n_vertices_, row_major_.data(), 3 * n_vertices_);
}

std::string TrajectoryWriter::commit() {
  file_->commit();
  return hash_file(path_);
}

}  // namespace nmp
