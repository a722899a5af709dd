#include "fem/mesh_reader.h"

#include <charconv>
#include <cmath>
#include <limits>
#include <system_error>
#include <utility>

namespace nmp::fem {

namespace {

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

template <class T>
bool parse(std::string_view word, T& value) {
  // from_chars takes no plus sign, which some programs write.
  if (word.size() > 1 && word[0] == '+' && word[1] != '-') word.remove_prefix(1);
  const char* end = word.data() + word.size();
  const auto [at, error] = std::from_chars(word.data(), end, value);
  return error == std::errc() && at == end;
}

}  // namespace

MeshCursor::MeshCursor(std::string_view bytes, std::string name, std::size_t line, char comment)
    : bytes_(bytes), name_(std::move(name)), line_(line), word_line_(line), comment_(comment) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (bytes_.substr(0, 3) == kByteOrderMark) position_ = 3;
}

void MeshCursor::skip_blanks(bool over_lines) {
  for (; position_ < bytes_.size(); ++position_) {
    const char c = bytes_[position_];
    if (c == '\n') {
      if (!over_lines) return;
      ++line_;
    } else if (comment_ != 0 && c == comment_) {
      position_ = std::min(bytes_.find('\n', position_), bytes_.size());
      --position_;
    } else if (!is_blank(c)) {
      return;
    }
  }
}

std::string_view MeshCursor::next_word() {
  word_line_ = line_;
  word_position_ = position_;
  std::size_t end = position_;
  while (end < bytes_.size() && !is_blank(bytes_[end]) && bytes_[end] != '\n' &&
         (comment_ == 0 || bytes_[end] != comment_)) {
    ++end;
  }
  const std::string_view word = bytes_.substr(position_, end - position_);
  position_ = end;
  return word;
}

std::string_view MeshCursor::word() {
  skip_blanks(true);
  return next_word();
}

std::string_view MeshCursor::word_on_line() {
  skip_blanks(false);
  return next_word();
}

std::string_view MeshCursor::peek() {
  const std::string_view next = word();
  position_ = word_position_;
  return next;
}

std::string_view MeshCursor::line() {
  word_line_ = line_;
  word_position_ = position_;
  const std::size_t end = std::min(bytes_.find('\n', position_), bytes_.size());
  std::string_view line = bytes_.substr(position_, end - position_);
  position_ = std::min(end + 1, bytes_.size());
  if (end < bytes_.size()) ++line_;
  if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
  return line;
}

void MeshCursor::expect(std::string_view expected) {
  const std::string_view found = word();
  if (found != expected) fail(std::string(expected), quoted(found));
}

double MeshCursor::to_number(std::string_view word, const char* what) {
  double value = 0;
  if (!parse(word, value) || !std::isfinite(value)) {
    fail(text("a finite decimal number as ", what), quoted(word));
  }
  return value;
}

std::int64_t MeshCursor::to_integer(std::string_view word, const char* what, std::int64_t low,
                                    std::int64_t high) {
  std::int64_t value = 0;
  if (!parse(word, value) || value < low || value > high) {
    fail(text("an integer from ", low, " to ", high, " as ", what), quoted(word));
  }
  return value;
}

double MeshCursor::number(const char* what) { return to_number(word(), what); }

std::int64_t MeshCursor::integer(const char* what, std::int64_t low, std::int64_t high) {
  return to_integer(word(), what, low, high);
}

Index MeshCursor::count(const char* what, Index limit, std::size_t least_bytes) {
  const std::int64_t found = integer(what, 0, std::numeric_limits<std::int64_t>::max());
  return check_count(static_cast<std::uint64_t>(found), what, limit, least_bytes);
}

Index MeshCursor::check_count(std::uint64_t found, const char* what, Index limit,
                              std::size_t least_bytes) {
  if (found > static_cast<std::uint64_t>(limit))
    fail(text(what, " of at most ", limit), text(found));
  // The last one may lack the blank that ends it.
  if (least_bytes > 0 && found > (left() + 1) / least_bytes) {
    fail(text(what, " that the rest of the file can hold (", left(), " bytes)"), text(found));
  }
  return static_cast<Index>(found);
}

std::string_view MeshCursor::take(std::size_t n, const char* what) {
  word_line_ = line_;
  word_position_ = position_;
  if (n > left()) fail(text(n, " bytes of ", what), text(left(), " to the end of the file"));
  const std::string_view bytes = bytes_.substr(position_, n);
  position_ += n;
  return bytes;
}

void MeshCursor::set_binary(bool swap) {
  binary_ = true;
  swap_ = swap;
}

void MeshCursor::fail(const std::string& expected, const std::string& found) const {
  const std::string place =
      binary_ ? text(name_, ": byte ", word_position_) : text(name_, ":", word_line_);
  throw InputError(text(place, ": expected ", expected, ", found ", found));
}

std::string MeshCursor::quoted(std::string_view word) {
  return word.empty() ? "the end of the file" : in_quotes(word);
}

bool is_little_endian() {
  const std::uint16_t one = 1;
  char first = 0;
  std::memcpy(&first, &one, 1);
  return first == 1;
}

std::string lower_word(std::string_view word) {
  std::string out(word.substr(0, 64));
  for (char& c : out)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  return out;
}

std::string lower_ending(const Path& path) { return lower_word(path.extension().string()); }

std::string_view bytes_of(const MappedFile& file, const Path& path, const MeshLimits& limits) {
  if (file.size() > limits.file_bytes) {
    throw InputError(text(path.string(), ": expected at most ", limits.file_bytes, " bytes, found ",
                          file.size()));
  }
  return {reinterpret_cast<const char*>(file.data()), file.size()};
}

void check_vertex(const MeshCursor& at, double x, double y, double z, Index v,
                  const MeshLimits& limits) {
  if (!std::isfinite(x) || !std::isfinite(y) || !std::isfinite(z)) {
    at.fail("finite coordinates", text(x, " ", y, " ", z, " for vertex ", v));
  }
  if (v >= limits.vertices) at.fail(text("at most ", limits.vertices, " vertices"), "more");
}

void MeshBuilder::add_vertex(const MeshCursor& at, double x, double y, double z) {
  check_vertex(at, x, y, z, n_vertices(), limits_);
  xyz_.insert(xyz_.end(), {x, y, z});
}

void MeshBuilder::add_tet(const MeshCursor& at, const std::int64_t corners[4]) {
  if (static_cast<Index>(tets_.size() / 4) >= limits_.tets) {
    at.fail(text("at most ", limits_.tets, " tetrahedra"), "more");
  }
  for (int a = 0; a < 4; ++a) tets_.push_back(static_cast<std::int32_t>(corners[a]));
}

RawMesh MeshBuilder::finish() const {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
  using RowMajorTets = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
  RawMesh mesh;
  mesh.vertices = Eigen::Map<const RowMajor>(xyz_.data(), n_vertices(), 3);
  mesh.tets = Eigen::Map<const RowMajorTets>(tets_.data(), static_cast<Index>(tets_.size() / 4), 4);
  if (n_ignored_ > 0) {
    mesh.notes.push_back(text(
        n_ignored_,
        n_ignored_ == 1 ? " surface, line or point cell is" : " surface, line and point cells are",
        " left out"));
  }
  return mesh;
}

namespace {

struct VtkCell {
  std::int64_t type;
  CellKind kind;
  const char* name;
};

constexpr VtkCell kVtkCells[] = {
    {0, CellKind::lower, "an empty cell"},
    {1, CellKind::lower, "a vertex"},
    {2, CellKind::lower, "a set of vertices"},
    {3, CellKind::lower, "a line"},
    {4, CellKind::lower, "a polyline"},
    {5, CellKind::lower, "a triangle"},
    {6, CellKind::lower, "a triangle strip"},
    {7, CellKind::lower, "a polygon"},
    {8, CellKind::lower, "a pixel"},
    {9, CellKind::lower, "a quadrilateral"},
    {10, CellKind::tet, "a tetrahedron"},
    {11, CellKind::volume, "a voxel"},
    {12, CellKind::volume, "a hexahedron"},
    {13, CellKind::volume, "a wedge"},
    {14, CellKind::volume, "a pyramid"},
    {15, CellKind::volume, "a pentagonal prism"},
    {16, CellKind::volume, "a hexagonal prism"},
    {21, CellKind::lower, "a quadratic edge"},
    {22, CellKind::lower, "a quadratic triangle"},
    {23, CellKind::lower, "a quadratic quadrilateral"},
    {24, CellKind::volume, "a quadratic tetrahedron of 10 vertices"},
    {25, CellKind::volume, "a quadratic hexahedron"},
    {28, CellKind::lower, "a biquadratic quadrilateral"},
    {30, CellKind::lower, "a quadratic-linear quadrilateral"},
    {34, CellKind::lower, "a biquadratic triangle"},
    {35, CellKind::lower, "a cubic line"},
    {36, CellKind::lower, "a quadratic polygon"},
    {42, CellKind::volume, "a polyhedron"},
    {68, CellKind::lower, "a Lagrange curve"},
    {69, CellKind::lower, "a Lagrange triangle"},
    {70, CellKind::lower, "a Lagrange quadrilateral"},
    {71, CellKind::volume, "a Lagrange tetrahedron"},
    {75, CellKind::lower, "a Bezier curve"},
    {76, CellKind::lower, "a Bezier triangle"},
    {77, CellKind::lower, "a Bezier quadrilateral"},
};

const VtkCell* find_vtk_cell(std::int64_t type) {
  for (const VtkCell& cell : kVtkCells)
    if (cell.type == type) return &cell;
  return nullptr;
}

}  // namespace

CellKind vtk_cell_kind(std::int64_t type) {
  const VtkCell* cell = find_vtk_cell(type);
  return cell == nullptr ? CellKind::volume : cell->kind;
}

std::string vtk_cell_name(std::int64_t type) {
  const VtkCell* cell = find_vtk_cell(type);
  return text(cell == nullptr ? "a cell" : cell->name, " (VTK type ", type, ")");
}

void add_vtk_cells(MeshBuilder& mesh, const MeshCursor& at, const std::vector<std::int64_t>& types,
                   const std::vector<std::int64_t>& offsets,
                   const std::vector<std::int64_t>& connectivity) {
  const auto n = static_cast<std::int64_t>(connectivity.size());
  for (std::size_t e = 0; e < types.size(); ++e) {
    const CellKind kind = vtk_cell_kind(types[e]);
    if (kind == CellKind::volume) {
      at.fail("tetrahedra of 4 vertices only", text(vtk_cell_name(types[e]), " as cell ", e));
    }
    const std::int64_t begin = offsets[e], end = offsets[e + 1];
    if (begin < 0 || end < begin || end > n) {
      at.fail(text("offsets that ascend from 0 to ", n), text(begin, " and ", end, " at cell ", e));
    }
    if (kind == CellKind::lower) {
      mesh.ignore_cell();
      continue;
    }
    if (end - begin != 4) {
      at.fail("4 vertices of a tetrahedron", text(end - begin, " at cell ", e));
    }
    const std::int64_t* corners = connectivity.data() + begin;
    for (int a = 0; a < 4; ++a) {
      if (corners[a] < 0 || corners[a] >= mesh.n_vertices()) {
        at.fail(text("a vertex from 0 to ", mesh.n_vertices() - 1),
                text(corners[a], " at cell ", e));
      }
    }
    mesh.add_tet(at, corners);
  }
}

}  // namespace nmp::fem
