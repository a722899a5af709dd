#include "capi/snapshot.h"

#include <cstring>
#include <utility>

#include "base/check.h"
#include "base/file.h"

namespace nmp::capi {

namespace {

constexpr std::uint64_t kMostFrames = std::uint64_t{1} << 40;
constexpr char kMagic[9] = "NMPSTATE";
constexpr std::uint64_t kVersion = 3;

class Writer {
 public:
  template <class T>
  void put(const T* values, std::size_t n) {
    if (n > 0) bytes_.append(reinterpret_cast<const char*>(values), n * sizeof(T));
  }
  void number(std::uint64_t value) { put(&value, 1); }
  template <class Real>
  void matrix(const Matrix<Real>& m) {
    number(static_cast<std::uint64_t>(m.rows()));
    put(m.data(), static_cast<std::size_t>(m.size()));
  }
  std::string finish() {
    const std::uint64_t size = bytes_.size() + sizeof size;
    std::memcpy(&bytes_[8], &size, sizeof size);
    number(hash_bytes(bytes_.data(), bytes_.size()));
    return std::move(bytes_);
  }

 private:
  std::string bytes_;
};

class Reader {
 public:
  // Nothing beyond the first 16 bytes is read before they say that it is there.
  explicit Reader(std::string_view bytes) : bytes_(bytes), end_(2 * sizeof(std::uint64_t)) {
    if (bytes.size() < 3 * sizeof(std::uint64_t)) fail("is too short");
    char magic[8];
    get(magic, 8);
    if (std::memcmp(magic, kMagic, 8) != 0) fail("does not begin with NMPSTATE");
    const std::uint64_t size = number();
    if (size != bytes.size()) fail(text("has ", bytes.size(), " bytes, expected ", size));
    end_ = bytes.size() - sizeof(std::uint64_t);
    std::uint64_t hash = 0;
    std::memcpy(&hash, bytes.data() + end_, sizeof hash);
    if (hash != hash_bytes(bytes.data(), end_)) fail("is damaged: its checksum differs");
  }
  [[noreturn]] static void fail(const std::string& what) {
    throw InputError("the saved state " + what);
  }
  template <class T>
  void get(T* values, std::size_t n) {
    if (n > (end_ - at_) / sizeof(T)) fail("ends too early");
    if (n > 0) std::memcpy(static_cast<void*>(values), bytes_.data() + at_, n * sizeof(T));
    at_ += n * sizeof(T);
  }
  std::uint64_t number() {
    std::uint64_t value = 0;
    get(&value, 1);
    return value;
  }
  /// @param rows  that it has, unless it is empty
  template <class Real>
  Matrix<Real> matrix(Index rows, Index cols) {
    const std::uint64_t n = number();
    if (n == 0) return {};
    if (n != static_cast<std::uint64_t>(rows)) fail(text("has ", n, " rows instead of ", rows));
    Matrix<Real> m(rows, cols);
    get(m.data(), static_cast<std::size_t>(m.size()));
    return m;
  }
  template <class T>
  void expect(T wanted, const char* what) {
    T found{};
    get(&found, 1);
    if (found != wanted) fail(text("is of ", what, " ", found, ", this simulation's is ", wanted));
  }
  void finish() const {
    if (at_ != end_) fail("is too long");
  }

 private:
  std::string_view bytes_;
  std::size_t at_ = 0, end_ = 0;
};

// Its rest positions and tets.
template <class Real>
std::uint64_t hash_of(const fem::TetMesh<Real>& mesh) {
  const auto& x = mesh.rest();
  const auto& tets = mesh.tets();
  return hash_bytes(x.data(), static_cast<std::size_t>(x.size()) * sizeof(Real)) ^
         (hash_bytes(tets.data(), static_cast<std::size_t>(tets.size()) * sizeof(std::int32_t))
          << 1);
}

template <class Real>
Matrix<Real> as_matrix(const std::vector<fem::Plane<Real>>& planes) {
  Matrix<Real> m(static_cast<Index>(planes.size()), 5);
  for (std::size_t i = 0; i < planes.size(); ++i)
    m.row(static_cast<Index>(i)) << planes[i].normal.transpose(), planes[i].height,
        planes[i].friction;
  return m;
}

}  // namespace

template <class Real>
std::string encode(const SavedState<Real>& state, const Simulation<Real>& simulation) {
  const fem::TetMesh<Real>& mesh = simulation.mesh;
  const typename Motion<Real>::Snapshot& s = state.motion;
  Writer out;
  out.put(kMagic, 8);
  out.number(0);  // of bytes, known at the end
  out.number(kVersion);
  out.number(sizeof(Real));
  out.number(static_cast<std::uint64_t>(mesh.n_vertices()));
  out.number(static_cast<std::uint64_t>(mesh.n_tets()));
  out.number(hash_of(mesh));
  out.number(static_cast<std::uint64_t>(simulation.substeps));
  for (const Real value : {simulation.h, simulation.stagger}) out.put(&value, 1);
  out.number(static_cast<std::uint64_t>(s.frame));
  for (const Matrix<Real>* m : {&s.x, &s.v, &s.v_reported, &s.f_ext, &s.f_acted}) out.matrix(*m);
  out.number(s.boundary.pinned.size());
  out.put(s.boundary.pinned.data(), s.boundary.pinned.size());
  for (const Index place : state.pin_order) out.number(static_cast<std::uint64_t>(place));
  for (const Matrix<Real>* m : {&s.boundary.pin_x, &s.boundary.pin_v, &s.pin_target})
    out.matrix(*m);
  out.number(s.boundary.planes.size());
  out.matrix(as_matrix(s.boundary.planes));
  return out.finish();
}

template <class Real>
SavedState<Real> decode(std::string_view bytes, const Simulation<Real>& simulation) {
  const fem::TetMesh<Real>& mesh = simulation.mesh;
  Reader in(bytes);
  in.expect(kVersion, "version");
  in.expect(std::uint64_t{sizeof(Real)}, "a precision of bytes");
  const Index n = mesh.n_vertices();
  in.expect(static_cast<std::uint64_t>(n), "a mesh whose number of vertices is");
  in.expect(static_cast<std::uint64_t>(mesh.n_tets()), "a mesh whose number of tetrahedra is");
  if (in.number() != hash_of(mesh)) Reader::fail("is of another mesh with the same counts");
  in.expect(static_cast<std::uint64_t>(simulation.substeps), "substeps");
  in.expect(simulation.h, "a step of seconds");
  in.expect(simulation.stagger, "a stagger of");
  SavedState<Real> state;
  typename Motion<Real>::Snapshot& s = state.motion;
  s.boundary.ground = simulation.boundary.ground;
  s.boundary.friction = simulation.boundary.friction;
  const std::uint64_t frame = in.number();
  if (frame > kMostFrames) Reader::fail(text("is of frame ", frame));
  s.frame = static_cast<Index>(frame);
  for (Matrix<Real>* m : {&s.x, &s.v, &s.v_reported, &s.f_ext, &s.f_acted})
    *m = in.matrix<Real>(n, 3);
  const std::uint64_t n_pins = in.number();
  if (n_pins > static_cast<std::uint64_t>(n)) Reader::fail("has more pins than vertices");
  s.boundary.pinned.resize(static_cast<std::size_t>(n_pins));
  in.get(s.boundary.pinned.data(), s.boundary.pinned.size());
  for (std::size_t i = 0; i < s.boundary.pinned.size(); ++i)
    if (s.boundary.pinned[i] < 0 || s.boundary.pinned[i] >= n ||
        (i > 0 && s.boundary.pinned[i] <= s.boundary.pinned[i - 1]))
      Reader::fail("has pins that are no vertices in ascending order");
  std::vector<char> taken(s.boundary.pinned.size(), 0);
  for (std::size_t i = 0; i < s.boundary.pinned.size(); ++i) {
    const std::uint64_t place = in.number();
    if (place >= n_pins || taken[place]) Reader::fail("has pins in an order that is none");
    taken[place] = 1;
    state.pin_order.push_back(static_cast<Index>(place));
  }
  for (Matrix<Real>* m : {&s.boundary.pin_x, &s.boundary.pin_v, &s.pin_target})
    *m = in.matrix<Real>(static_cast<Index>(n_pins), 3);
  const auto n_planes = in.number();
  if (n_planes > bytes.size()) Reader::fail("ends too early");
  Matrix<Real> planes = in.matrix<Real>(static_cast<Index>(n_planes), 5);
  for (Index i = 0; i < planes.rows(); ++i)
    s.boundary.planes.push_back({planes.row(i).template head<3>(), planes(i, 3), planes(i, 4)});
  in.finish();
  if (s.x.rows() != n || s.v.rows() != n) Reader::fail("has no positions or velocities");
  if (s.boundary.pin_x.rows() != s.boundary.pin_v.rows() ||
      (s.pin_target.rows() > 0 && s.boundary.pin_x.rows() == 0))
    Reader::fail("has pins under way from nowhere");
  for (const Matrix<Real>* m : {&s.x, &s.v, &s.v_reported, &s.f_ext, &s.f_acted, &s.boundary.pin_x,
                                &s.boundary.pin_v, &s.pin_target, &planes})
    if (!m->allFinite()) Reader::fail("has a number that is not finite");
  return state;
}

template std::string encode(const SavedState<float>&, const Simulation<float>&);
template std::string encode(const SavedState<double>&, const Simulation<double>&);
template SavedState<float> decode(std::string_view, const Simulation<float>&);
template SavedState<double> decode(std::string_view, const Simulation<double>&);

}  // namespace nmp::capi
