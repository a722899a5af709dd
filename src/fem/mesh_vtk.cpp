// Legacy VTK: a header of four lines, then keywords with data behind them; binary data are
// big-endian. Point and cell data come last and are not read.
#include <limits>

#include "fem/mesh_reader.h"

namespace nmp::fem {

namespace {

constexpr std::int64_t kMostOffset = std::numeric_limits<std::int64_t>::max();

enum class Kind { integer, unsigned_integer, real, bit, string };
struct DataType {
  const char* name;
  Kind kind;
  std::size_t bytes;
};

constexpr DataType kTypes[] = {
    {"bit", Kind::bit, 0},
    {"char", Kind::integer, 1},
    {"signed_char", Kind::integer, 1},
    {"unsigned_char", Kind::unsigned_integer, 1},
    {"short", Kind::integer, 2},
    {"unsigned_short", Kind::unsigned_integer, 2},
    {"int", Kind::integer, 4},
    {"unsigned_int", Kind::unsigned_integer, 4},
    {"long", Kind::integer, 8},
    {"unsigned_long", Kind::unsigned_integer, 8},
    {"vtkidtype", Kind::integer, 4},  // what VTK writes for it
    {"vtktypeint64", Kind::integer, 8},
    {"vtktypeuint64", Kind::unsigned_integer, 8},
    {"vtktypeint32", Kind::integer, 4},
    {"float", Kind::real, 4},
    {"double", Kind::real, 8},
    {"string", Kind::string, 0},
};

class VtkReader {
 public:
  VtkReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : in_(bytes, name), mesh_(limits) {}

  RawMesh read() {
    read_header();
    bool has_points = false, has_types = false;
    while (!in_.at_end()) {
      const std::string_view word = in_.word();
      const std::string keyword = lower_word(word);
      if (keyword == "points" && !has_points) {
        read_points();
        has_points = true;
      } else if (keyword == "cells" && offsets_.empty()) {
        new_cells_ ? read_cells_5() : read_cells_4();
      } else if (keyword == "cell_types" && !has_types && !offsets_.empty()) {
        read_types();
        has_types = true;
      } else if (keyword == "field") {
        skip_field();
      } else if (keyword == "metadata") {
        skip_metadata();
      } else if (keyword == "point_data" || keyword == "cell_data") {
        break;
      } else {
        in_.fail("POINTS, CELLS, CELL_TYPES (each once, in this order), FIELD or METADATA",
                 in_quotes(word));
      }
    }
    if (!has_points) in_.fail("POINTS", "none");
    if (offsets_.empty()) in_.fail("CELLS", "none");
    if (!has_types) in_.fail("CELL_TYPES", "none");
    add_vtk_cells(mesh_, in_, types_, offsets_, connectivity_);
    return mesh_.finish();
  }

 private:
  void read_header() {
    constexpr std::string_view kMagic = "# vtk DataFile Version ";
    std::string_view line = in_.line();
    if (line.substr(0, kMagic.size()) != kMagic) {
      in_.fail("'# vtk DataFile Version ...' as the first line", MeshCursor::quoted(line));
    }
    line.remove_prefix(kMagic.size());
    while (!line.empty() && line.back() == ' ') line.remove_suffix(1);
    const bool old = line == "2.0" || line == "3.0" || line == "3.1" || line == "4.0" ||
                     line == "4.1" || line == "4.2";
    new_cells_ = line == "5.1";
    if (!old && !new_cells_) in_.fail("version 2.0 to 4.2 or 5.1", in_quotes(line));
    in_.line();  // a title
    const std::string_view form = in_.word();
    binary_ = lower_word(form) == "binary";
    if (!binary_ && lower_word(form) != "ascii") {
      in_.fail("ASCII or BINARY", MeshCursor::quoted(form));
    }
    const std::string_view dataset = in_.word();
    if (lower_word(dataset) != "dataset") in_.fail("DATASET", MeshCursor::quoted(dataset));
    const std::string_view kind = in_.word();
    if (lower_word(kind) != "unstructured_grid") {
      in_.fail("UNSTRUCTURED_GRID, the only data set that can hold tetrahedra",
               MeshCursor::quoted(kind));
    }
    if (binary_) in_.set_binary(is_little_endian());
  }

  const DataType& read_type() {
    const std::string_view word = in_.word_on_line();
    const std::string name = lower_word(word);
    for (const DataType& type : kTypes)
      if (name == type.name) return type;
    in_.fail("a type of VTK, such as float", MeshCursor::quoted(word));
  }

  // The end of a line that says what follows; binary data begin right behind it.
  void end_line() {
    const std::string_view found = in_.word_on_line();
    if (!found.empty()) in_.fail("the end of the line", in_quotes(found));
    in_.line();
  }

  std::size_t least_bytes(const DataType& type) const { return binary_ ? type.bytes : 2; }

  double real(const DataType& type) {
    if (!binary_) return in_.number("coordinate");
    return type.bytes == 4 ? double{in_.binary<float>("coordinate")}
                           : in_.binary<double>("coordinate");
  }

  std::int64_t integer(const DataType& type, const char* what, std::int64_t low,
                       std::int64_t high) {
    if (!binary_) return in_.integer(what, low, high);
    const std::int64_t found = type.bytes == 4 ? std::int64_t{in_.binary<std::int32_t>(what)}
                                               : in_.binary<std::int64_t>(what);
    if (found < low || found > high) {
      in_.fail(text("an integer from ", low, " to ", high, " as ", what), text(found));
    }
    return found;
  }

  void read_points() {
    const std::int64_t n_claimed = in_.integer("number of points", 0, mesh_.limits().vertices);
    const DataType& type = read_type();
    if (type.kind != Kind::real) in_.fail("points as float or double", type.name);
    end_line();
    const Index n = in_.check_count(static_cast<std::uint64_t>(n_claimed), "number of points",
                                    mesh_.limits().vertices, 3 * least_bytes(type));
    for (Index i = 0; i < n; ++i) {
      const double x = real(type), y = real(type), z = real(type);
      mesh_.add_vertex(in_, x, y, z);
    }
  }

  // CELLS #cells #numbers, then for each cell how many vertices and which.
  void read_cells_4() {
    constexpr DataType kInt = {"int", Kind::integer, 4};
    const Index n = in_.count("number of cells", kMostOffset / 2, binary_ ? 8 : 4);
    const Index n_numbers =
        in_.count("size of the list of cells", kMostOffset / 2, binary_ ? 4 : 2);
    end_line();
    offsets_.push_back(0);
    Index used = 0;
    for (Index e = 0; e < n; ++e) {
      const std::int64_t n_corners =
          integer(kInt, "number of vertices of a cell", 0, n_numbers - used - 1);
      used += 1 + n_corners;
      for (std::int64_t a = 0; a < n_corners; ++a) connectivity_.push_back(vertex(kInt));
      offsets_.push_back(static_cast<std::int64_t>(connectivity_.size()));
    }
    if (used != n_numbers) {
      in_.fail(text(n_numbers, " numbers in the list of cells"), text(used));
    }
  }

  // CELLS #offsets #corners, then OFFSETS type ... CONNECTIVITY type ...
  void read_cells_5() {
    const Index n = in_.count("number of offsets", kMostOffset / 2, 2);
    const Index n_corners = in_.count("size of the list of corners", kMostOffset / 2, 2);
    if (n == 0) in_.fail("at least one offset", "none");
    end_line();
    const DataType& offset_type = read_array_head("offsets", n);
    for (Index i = 0; i < n; ++i) {
      const std::int64_t low = offsets_.empty() ? 0 : offsets_.back();
      offsets_.push_back(integer(offset_type, "offset", low, n_corners));
    }
    if (offsets_.front() != 0 || offsets_.back() != n_corners) {
      in_.fail(text("offsets from 0 to ", n_corners),
               text(offsets_.front(), " to ", offsets_.back()));
    }
    const DataType& corner_type = read_array_head("connectivity", n_corners);
    for (Index i = 0; i < n_corners; ++i) connectivity_.push_back(vertex(corner_type));
  }

  const DataType& read_array_head(const char* name, Index n) {
    const std::string_view word = in_.word();
    if (lower_word(word) != name) in_.fail(name, MeshCursor::quoted(word));
    const DataType& type = read_type();
    if (type.kind != Kind::integer || type.bytes < 4) {
      in_.fail("integers of 4 or 8 bytes, such as vtktypeint64", type.name);
    }
    end_line();
    in_.check_count(static_cast<std::uint64_t>(n), name, kMostOffset, least_bytes(type));
    return type;
  }

  std::int64_t vertex(const DataType& type) {
    if (mesh_.n_vertices() == 0) in_.fail("POINTS before CELLS", "none");
    return integer(type, "vertex", 0, mesh_.n_vertices() - 1);
  }

  void read_types() {
    constexpr DataType kInt = {"int", Kind::integer, 4};
    const auto n_cells = static_cast<std::int64_t>(offsets_.size()) - 1;
    const std::int64_t n = in_.integer("number of cell types", n_cells, n_cells);
    end_line();
    in_.check_count(static_cast<std::uint64_t>(n), "number of cell types", kMostOffset,
                    binary_ ? 4 : 2);
    for (std::int64_t e = 0; e < n; ++e) {
      types_.push_back(integer(kInt, "cell type", 0, std::numeric_limits<std::int32_t>::max()));
      if (vtk_cell_kind(types_.back()) == CellKind::volume) {
        in_.fail("tetrahedra of 4 vertices only",
                 text(vtk_cell_name(types_.back()), " as cell ", e));
      }
    }
  }

  // Up to an empty line.
  void skip_metadata() {
    in_.line();
    while (in_.left() > 0 && !in_.line().empty()) {
    }
  }

  // FIELD name #arrays, then for each: name #components #tuples type, and its data.
  void skip_field() {
    in_.word_on_line();
    const Index n_arrays = in_.count("number of arrays", kMostOffset, 8);
    end_line();
    for (Index k = 0; k < n_arrays; ++k) {
      if (lower_word(in_.word()) == "metadata") {  // of the array before
        skip_metadata();
        in_.word();
      }  // else its name
      const Index n_components = in_.count("number of components", kMostOffset, 0);
      const Index n_tuples = in_.count("number of tuples", kMostOffset, 0);
      const DataType& type = read_type();
      end_line();
      if (n_components > 0 && n_tuples > kMostOffset / n_components) {
        in_.fail("an array that the file can hold", text(n_components, " x ", n_tuples));
      }
      const Index n = n_components * n_tuples;
      in_.check_count(static_cast<std::uint64_t>(n), "number of values",
                      type.kind == Kind::bit ? Index(8 * in_.left()) : kMostOffset,
                      type.kind == Kind::bit      ? 0
                      : type.kind == Kind::string ? 1
                                                  : least_bytes(type));
      if (binary_ && type.kind == Kind::string) {
        in_.fail("field data without strings in a binary file", "some");
      } else if (binary_) {
        in_.skip(type.kind == Kind::bit ? (static_cast<std::size_t>(n) + 7) / 8
                                        : static_cast<std::size_t>(n) * type.bytes);
      } else if (type.kind == Kind::string) {
        for (Index i = 0; i < n; ++i) in_.line();
      } else {
        for (Index i = 0; i < n; ++i) in_.number("value of a field");
      }
    }
  }

  MeshCursor in_;
  MeshBuilder mesh_;
  bool binary_ = false, new_cells_ = false;
  std::vector<std::int64_t> types_, offsets_, connectivity_;
};

}  // namespace

RawMesh read_vtk(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return VtkReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
