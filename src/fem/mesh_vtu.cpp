// VTK's XML unstructured grid.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "fem/vtk_xml.h"
#include "fem/vtu_array.h"
#include "fem/vtu_grid.h"

namespace nmp::fem {

namespace {

constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
constexpr std::int64_t kMaxComponents = 9;  // a tensor

// A DataArray of the file, not decoded.
struct Array {
  bool found = false;
  std::string type, format, n_components, offset;
  std::string_view content;  // between its tags
  std::size_t line = 1;      // where the content begins
};

// What the XML says: one piece, its arrays, and where appended data begin.
class VtuDocument final : VtkXml {
 public:
  VtuDocument(std::string_view bytes, const std::string& name,
              const std::vector<std::string>& wanted)
      : VtkXml(bytes, name, "a VTU file") {
    for (const std::string& each : wanted) point_data[each];
    parse();
  }

  using VtkXml::fail;

  bool has_piece = false;
  std::int64_t n_points = 0, n_cells = 0;
  VtuEncoding encoding;
  Array points, connectivity, offsets, types;
  std::map<std::string, Array> point_data;
  bool has_appended = false, appended_base64 = false;
  std::string_view appended;  // behind its underscore

 private:
  void begin(std::string_view tag, Attributes attributes) override {
    if (in_array_ != nullptr) {
      end_segment(tag_begin());  // information about an array stands inside it
      return;
    }
    if (path().size() == 1) {
      begin_file(tag, attributes);
    } else if (is_at({"VTKFile", "UnstructuredGrid", "Piece"})) {
      if (has_piece) fail("one Piece; merge them first, or save without pieces", "a second one");
      has_piece = true;
      n_points = integer(find(attributes, "NumberOfPoints"), "NumberOfPoints");
      n_cells = integer(find(attributes, "NumberOfCells"), "NumberOfCells");
    } else if (is_at({"VTKFile", "UnstructuredGrid", "Piece", "Points", "DataArray"})) {
      begin_array(points, attributes);
    } else if (is_at({"VTKFile", "UnstructuredGrid", "Piece", "Cells", "DataArray"})) {
      const std::string name = find(attributes, "Name");
      if (name == "connectivity") begin_array(connectivity, attributes);
      if (name == "offsets") begin_array(offsets, attributes);
      if (name == "types") begin_array(types, attributes);
    } else if (is_at({"VTKFile", "UnstructuredGrid", "Piece", "PointData", "DataArray"})) {
      const auto array = point_data.find(find(attributes, "Name"));
      if (array != point_data.end()) begin_array(array->second, attributes);
    } else if (is_at({"VTKFile", "AppendedData"})) {
      begin_appended(find(attributes, "encoding"));
    }
  }

  void end() override {
    if (in_array_ != nullptr && path().size() == array_depth_) {
      end_segment(tag_begin());
      in_array_ = nullptr;
    } else if (in_array_ != nullptr && path().size() == array_depth_ + 1) {
      begin_segment();
    }
  }

  std::int64_t integer(const std::string& word, const char* what) const {
    return MeshCursor("", name_, line()).to_integer(word, what, 0, kMost);
  }

  void begin_file(std::string_view tag, Attributes attributes) {
    check_root(tag, attributes, "UnstructuredGrid");
    const auto choose = [&](const char* name, std::string_view absent, std::string_view first,
                            std::string_view second) {
      std::string value = find(attributes, name);
      if (value.empty()) value = absent;
      if (value != first && value != second) {
        fail(text(name, " ", first, " or ", second), in_quotes(value));
      }
      return value == second;
    };
    const bool big = choose("byte_order", "LittleEndian", "LittleEndian", "BigEndian");
    encoding.swap = big == is_little_endian();
    encoding.header64 = choose("header_type", "UInt32", "UInt32", "UInt64");
    const std::string compressor = find(attributes, "compressor");
    encoding.zlib = compressor == "vtkZLibDataCompressor";
    if (!compressor.empty() && !encoding.zlib) {
      fail("no compressor or vtkZLibDataCompressor", in_quotes(compressor));
    }
  }

  void begin_array(Array& array, Attributes attributes) {
    if (array.found) fail("each array of a Piece once", "it again");
    array.found = true;
    array.type = find(attributes, "type");
    array.format = find(attributes, "format");
    array.n_components = find(attributes, "NumberOfComponents");
    array.offset = find(attributes, "offset");
    array.line = line();
    in_array_ = &array;
    array_depth_ = path().size();
    begin_segment();
  }

  void begin_segment() { segment_ = tag_end(); }

  void end_segment(std::size_t at) {
    if (path().size() > array_depth_ + 1) return;
    const std::string_view segment = bytes_.substr(segment_, at - segment_);
    if (segment.find_first_not_of(" \t\r\n") == std::string_view::npos) return;
    if (!in_array_->content.empty()) fail("the values of an array in one piece", "two");
    in_array_->content = segment;
    in_array_->line =
        line() - static_cast<std::size_t>(std::count(segment.begin(), segment.end(), '\n'));
  }

  // Nothing behind this tag is XML.
  void begin_appended(const std::string& encoded) {
    if (encoded != "raw" && encoded != "base64") {
      fail("the encoding raw or base64", in_quotes(encoded));
    }
    std::size_t from = tag_end();
    while (from < bytes_.size() &&
           std::string_view(" \t\r\n").find(bytes_[from]) != std::string_view::npos) {
      ++from;
    }
    if (from == bytes_.size() || bytes_[from] != '_') {
      fail("an underscore where appended data begin",
           MeshCursor::quoted(bytes_.substr(std::min(from, bytes_.size()), 1)));
    }
    has_appended = true;
    appended_base64 = encoded == "base64";
    appended = bytes_.substr(from + 1);
    stop();
  }

  Array* in_array_ = nullptr;
  std::size_t array_depth_ = 0, segment_ = 0;
};

class VtuReader {
 public:
  VtuReader(std::string_view bytes, const std::string& name, const std::vector<std::string>& wanted,
            const MeshLimits& limits)
      : file_(bytes, name, wanted), name_(name), mesh_(limits), budget_(limits.decoded_bytes) {}

  VtuGrid read() {
    if (!file_.has_piece) file_.fail("an UnstructuredGrid with a Piece", "none");
    read_points();
    const std::vector<std::int64_t> types = integers(file_.types, "types", file_.n_cells);
    const std::vector<std::int64_t> ends = integers(file_.offsets, "offsets", file_.n_cells);
    const std::vector<std::int64_t> connectivity =
        integers(file_.connectivity, "connectivity", ends.empty() ? 0 : ends.back());
    std::vector<std::int64_t> offsets = {0};  // VTU gives where each cell ends
    offsets.insert(offsets.end(), ends.begin(), ends.end());
    add_vtk_cells(mesh_, MeshCursor("", name_, file_.types.line), types, offsets, connectivity);
    VtuGrid grid{mesh_.finish(), {}};
    for (const auto& [name, array] : file_.point_data)
      if (array.found) grid.point_data[name] = read_point_data(name, array);
    return grid;
  }

 private:
  MeshCursor cursor(const Array& array) const { return {array.content, name_, array.line}; }

  // Text is read from the cursor itself; else the bytes of the array.
  std::string decode(const Array& array, const MeshCursor& at) {
    if (array.format == "binary") {
      return decode_vtu_array(array.content, true, file_.encoding, at, budget_);
    }
    if (array.format != "appended") {
      at.fail("the format ascii, binary or appended", in_quotes(array.format));
    }
    if (!file_.has_appended) at.fail("the tag AppendedData after the grid", "none");
    const auto size = static_cast<std::int64_t>(file_.appended.size());
    const std::int64_t offset = at_integer(at, array.offset, "offset", size);
    return decode_vtu_array(file_.appended.substr(static_cast<std::size_t>(offset)),
                            file_.appended_base64, file_.encoding, at, budget_);
  }

  static std::int64_t at_integer(MeshCursor at, const std::string& word, const char* what,
                                 std::int64_t high) {
    return at.to_integer(word, what, 0, high);
  }

  static void check_size(const MeshCursor& at, const std::string& name, std::size_t found,
                         std::int64_t expected) {
    if (static_cast<std::int64_t>(found) == expected) return;
    at.fail(text(expected, " values in the array ", name), text(found));
  }

  // Shows each of n numbers with the cursor behind it.
  template <class Visit>
  void read_numbers(const Array& array, const std::string& name, std::int64_t n, Visit&& visit) {
    MeshCursor in = cursor(array);
    const VtuType type = vtu_type(array.type, in);
    if (array.format != "ascii") {
      const std::vector<double> values = to_reals(decode(array, in), type, file_.encoding.swap, in);
      check_size(in, name, values.size(), n);
      for (const double value : values) visit(in, value);
      return;
    }
    if (type.kind != VtuType::real)
      in.fail(text(name, " of Float32 or Float64"), in_quotes(array.type));
    in.check_count(static_cast<std::uint64_t>(n), ("values of " + name).c_str(), kMost, 2);
    for (std::int64_t i = 0; i < n; ++i) {
      const double value = in.number(name.c_str());
      visit(in, value);
    }
    if (!in.at_end()) in.fail(text("the end of ", n, " values in ", name), in_quotes(in.word()));
  }

  // What follows allocates what the file holds, not what it claims.
  std::int64_t count_values(const MeshCursor& at, std::int64_t n_components) const {
    if (file_.n_points > kMost / n_components)
      at.fail("a smaller NumberOfPoints", text(file_.n_points));
    return n_components * file_.n_points;
  }

  void read_points() {
    const Array& array = file_.points;
    const MeshCursor at = cursor(array);
    if (!array.found) at.fail("a DataArray in Points", "none");
    if (array.n_components != "3") {
      at.fail("NumberOfComponents 3 of the points", in_quotes(array.n_components));
    }
    double xyz[3];
    int k = 0;
    read_numbers(array, "Points", count_values(at, 3), [&](const MeshCursor& in, double value) {
      xyz[k++] = value;
      if (k < 3) return;
      mesh_.add_vertex(in, xyz[0], xyz[1], xyz[2]);
      k = 0;
    });
  }

  Matrix<double> read_point_data(const std::string& name, const Array& array) {
    const MeshCursor at = cursor(array);
    const std::int64_t n_columns =
        array.n_components.empty()
            ? 1
            : at_integer(at, array.n_components, "NumberOfComponents", kMaxComponents);
    if (n_columns == 0) at.fail("at least one component", "none");
    std::vector<double> values;
    const std::string what = "the array " + printable(name);
    read_numbers(array, what, count_values(at, n_columns), [&](const MeshCursor& in, double value) {
      if (!std::isfinite(value)) in.fail("finite numbers in " + what, text(value));
      values.push_back(value);
    });
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    return Eigen::Map<const RowMajor>(values.data(), file_.n_points, n_columns);
  }

  std::vector<std::int64_t> integers(const Array& array, const char* name, std::int64_t n) {
    MeshCursor in = cursor(array);
    if (!array.found) in.fail(text("a DataArray named ", name, " in Cells"), "none");
    if (n < 0) in.fail(text("at least 0 values in ", name), text(n));
    const VtuType type = vtu_type(array.type, in);
    if (array.format != "ascii") {
      const std::vector<std::int64_t> values =
          to_integers(decode(array, in), type, file_.encoding.swap, in);
      check_size(in, name, values.size(), n);
      return values;
    }
    if (type.kind == VtuType::real) in.fail(text("integers in ", name), in_quotes(array.type));
    in.check_count(static_cast<std::uint64_t>(n), name, kMost, 2);
    std::vector<std::int64_t> values;
    for (std::int64_t i = 0; i < n; ++i) values.push_back(in.integer(name, 0, kMost));
    if (!in.at_end()) in.fail(text("the end of ", n, " values in ", name), in_quotes(in.word()));
    return values;
  }

  VtuDocument file_;
  std::string name_;
  MeshBuilder mesh_;
  std::uint64_t budget_;
};

}  // namespace

VtuGrid read_vtu_grid(std::string_view bytes, const std::string& name,
                      const std::vector<std::string>& wanted, const MeshLimits& limits) {
  return VtuReader(bytes, name, wanted, limits).read();
}

RawMesh read_vtu(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return read_vtu_grid(bytes, name, {}, limits).mesh;
}

}  // namespace nmp::fem
