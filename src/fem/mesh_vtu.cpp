// VTK's XML unstructured grid. Expat reads the XML: it keeps no tree and does not recurse, and it
// can be stopped before the appended data, which may hold any bytes and so are no XML.
#include <expat.h>

#include <algorithm>
#include <exception>
#include <initializer_list>
#include <limits>
#include <memory>
#include <new>

#include "fem/vtu_array.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kMaxDepth = 64;
constexpr std::size_t kPiece = std::size_t{1} << 24;  // given to expat at a time
constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();

// A DataArray of the file, not decoded.
struct Array {
  bool found = false;
  std::string type, format, n_components, offset;
  std::string_view content;  // between its tags
  std::size_t line = 1;      // where the content begins
};

// What the XML says: one piece, its arrays, and where appended data begin.
class VtuDocument {
 public:
  VtuDocument(std::string_view bytes, const std::string& name) : bytes_(bytes), name_(name) {
    const std::unique_ptr<XML_ParserStruct, void (*)(XML_Parser)> parser(
        XML_ParserCreate("UTF-8"), [](XML_Parser p) { XML_ParserFree(p); });
    if (!parser) throw std::bad_alloc();
    parser_ = parser.get();
    XML_SetUserData(parser_, this);
    XML_SetElementHandler(
        parser_,
        [](void* self, const XML_Char* tag, const XML_Char** attributes) {
          static_cast<VtuDocument*>(self)->guard([&](VtuDocument& d) { d.begin(tag, attributes); });
        },
        [](void* self, const XML_Char*) {
          static_cast<VtuDocument*>(self)->guard([](VtuDocument& d) { d.end(); });
        });
    XML_SetStartDoctypeDeclHandler(
        parser_, [](void* self, const XML_Char*, const XML_Char*, const XML_Char*, int) {
          static_cast<VtuDocument*>(self)->guard(
              [](VtuDocument& d) { d.fail("a VTU file, which has no DOCTYPE", "one"); });
        });
    XML_SetDefaultHandler(parser_, [](void* self, const XML_Char*, int) {
      static_cast<VtuDocument*>(self)->note_progress();
    });
    parse();
    parser_ = nullptr;
  }

  [[noreturn]] void fail(const std::string& expected, const std::string& found) const {
    const std::size_t line = parser_ ? XML_GetCurrentLineNumber(parser_) : 1;
    throw InputError(text(name_, ":", line, ": expected ", expected, ", found ", found));
  }

  bool has_piece = false;
  std::int64_t n_points = 0, n_cells = 0;
  VtuEncoding encoding;
  Array points, connectivity, offsets, types;
  bool has_appended = false, appended_base64 = false;
  std::string_view appended;  // behind its underscore

 private:
  // Handlers are called from C, which no exception may cross.
  template <class Handler>
  void guard(Handler&& handler) {
    if (failure_ || stopped_) return;
    note_progress();
    try {
      handler(*this);
    } catch (...) {
      failure_ = std::current_exception();
      XML_StopParser(parser_, XML_FALSE);
    }
  }

  void note_progress() {
    seen_ = static_cast<std::size_t>(std::max<XML_Index>(0, XML_GetCurrentByteIndex(parser_)));
  }

  void parse() {
    for (std::size_t from = 0; !stopped_;) {
      const std::size_t n = std::min(kPiece, bytes_.size() - from);
      const bool is_last = from + n == bytes_.size();
      const XML_Status status =
          XML_Parse(parser_, bytes_.data() + from, static_cast<int>(n), is_last);
      if (failure_) std::rethrow_exception(failure_);
      if (stopped_) return;
      if (status != XML_STATUS_OK) {
        fail("a VTU file, which is XML",
             text("'", printable(XML_ErrorString(XML_GetErrorCode(parser_))), "'"));
      }
      from += n;
      if (is_last) return;
      // A tag that goes on and on would be looked at again with every piece.
      if (from - seen_ > 2 * kPiece)
        fail(text("tags of less than ", kPiece, " bytes"), "a longer one");
    }
  }

  std::size_t tag_begin() const {
    return static_cast<std::size_t>(XML_GetCurrentByteIndex(parser_));
  }
  std::size_t tag_end() const {
    return tag_begin() + static_cast<std::size_t>(XML_GetCurrentByteCount(parser_));
  }

  static std::string find(const XML_Char** attributes, std::string_view name) {
    for (; *attributes; attributes += 2)
      if (name == attributes[0]) return attributes[1];
    return "";
  }

  void begin(std::string_view tag, const XML_Char** attributes) {
    if (path_.size() >= kMaxDepth) fail(text("tags at most ", kMaxDepth, " deep"), "more");
    path_.emplace_back(tag.substr(0, 64));
    if (in_array_ != nullptr) {
      end_segment(tag_begin());  // information about an array stands inside it
      return;
    }
    if (path_.size() == 1) {
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
    } else if (is_at({"VTKFile", "AppendedData"})) {
      begin_appended(find(attributes, "encoding"));
    }
  }

  void end() {
    if (in_array_ != nullptr && path_.size() == array_depth_) {
      end_segment(tag_begin());
      in_array_ = nullptr;
    } else if (in_array_ != nullptr && path_.size() == array_depth_ + 1) {
      begin_segment();
    }
    path_.pop_back();
  }

  bool is_at(std::initializer_list<std::string_view> path) const {
    return std::equal(path_.begin(), path_.end(), path.begin(), path.end());
  }

  std::int64_t integer(const std::string& word, const char* what) const {
    return MeshCursor("", name_, XML_GetCurrentLineNumber(parser_))
        .to_integer(word, what, 0, kMost);
  }

  void begin_file(std::string_view tag, const XML_Char** attributes) {
    if (tag != "VTKFile") fail("the tag VTKFile", in_quotes(tag));
    const auto choose = [&](const char* name, std::string_view absent, std::string_view first,
                            std::string_view second) {
      std::string value = find(attributes, name);
      if (value.empty()) value = absent;
      if (value != first && value != second) {
        fail(text(name, " ", first, " or ", second), in_quotes(value));
      }
      return value == second;
    };
    if (find(attributes, "type") != "UnstructuredGrid") {
      fail("the type UnstructuredGrid", in_quotes(find(attributes, "type")));
    }
    const std::string version = find(attributes, "version");
    if (!version.empty() && version[0] != '0' && version[0] != '1' && version[0] != '2') {
      fail("version 0.1 to 2", in_quotes(version));
    }
    const bool big = choose("byte_order", "LittleEndian", "LittleEndian", "BigEndian");
    encoding.swap = big == is_little_endian();
    encoding.header64 = choose("header_type", "UInt32", "UInt32", "UInt64");
    const std::string compressor = find(attributes, "compressor");
    encoding.zlib = compressor == "vtkZLibDataCompressor";
    if (!compressor.empty() && !encoding.zlib) {
      fail("no compressor or vtkZLibDataCompressor", in_quotes(compressor));
    }
  }

  void begin_array(Array& array, const XML_Char** attributes) {
    if (array.found) fail("each array of a Piece once", "it again");
    array.found = true;
    array.type = find(attributes, "type");
    array.format = find(attributes, "format");
    array.n_components = find(attributes, "NumberOfComponents");
    array.offset = find(attributes, "offset");
    array.line = XML_GetCurrentLineNumber(parser_);
    in_array_ = &array;
    array_depth_ = path_.size();
    begin_segment();
  }

  void begin_segment() { segment_ = tag_end(); }

  void end_segment(std::size_t at) {
    if (path_.size() > array_depth_ + 1) return;
    const std::string_view segment = bytes_.substr(segment_, at - segment_);
    if (segment.find_first_not_of(" \t\r\n") == std::string_view::npos) return;
    if (!in_array_->content.empty()) fail("the values of an array in one piece", "two");
    in_array_->content = segment;
    in_array_->line = XML_GetCurrentLineNumber(parser_) -
                      static_cast<std::size_t>(std::count(segment.begin(), segment.end(), '\n'));
  }

  // Nothing behind this tag is XML: expat is done.
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
    stopped_ = true;
    XML_StopParser(parser_, XML_FALSE);
  }

  std::string_view bytes_;
  const std::string& name_;
  XML_Parser parser_ = nullptr;
  std::exception_ptr failure_;
  bool stopped_ = false;
  std::size_t seen_ = 0;  // where expat was last
  std::vector<std::string> path_;
  Array* in_array_ = nullptr;
  std::size_t array_depth_ = 0, segment_ = 0;
};

class VtuReader {
 public:
  VtuReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : file_(bytes, name), name_(name), mesh_(limits), budget_(limits.decoded_bytes) {}

  RawMesh read() {
    if (!file_.has_piece) file_.fail("an UnstructuredGrid with a Piece", "none");
    read_points();
    const std::vector<std::int64_t> types = integers(file_.types, "types", file_.n_cells);
    const std::vector<std::int64_t> ends = integers(file_.offsets, "offsets", file_.n_cells);
    const std::vector<std::int64_t> connectivity =
        integers(file_.connectivity, "connectivity", ends.empty() ? 0 : ends.back());
    std::vector<std::int64_t> offsets = {0};  // VTU gives where each cell ends
    offsets.insert(offsets.end(), ends.begin(), ends.end());
    add_vtk_cells(mesh_, MeshCursor("", name_, file_.types.line), types, offsets, connectivity);
    return mesh_.finish();
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

  static void check_size(const MeshCursor& at, const char* name, std::size_t found,
                         std::int64_t expected) {
    if (static_cast<std::int64_t>(found) == expected) return;
    at.fail(text(expected, " values in the array ", name), text(found));
  }

  void read_points() {
    const Array& array = file_.points;
    MeshCursor in = cursor(array);
    if (!array.found) in.fail("a DataArray in Points", "none");
    if (array.n_components != "3") {
      in.fail("NumberOfComponents 3 of the points", in_quotes(array.n_components));
    }
    const VtuType type = vtu_type(array.type, in);
    if (array.format == "ascii") {
      if (type.kind != VtuType::real)
        in.fail("points of Float32 or Float64", in_quotes(array.type));
      const Index n = in.check_count(static_cast<std::uint64_t>(file_.n_points), "NumberOfPoints",
                                     mesh_.limits().vertices, 6);
      for (Index i = 0; i < n; ++i) {
        const double x = in.number("x"), y = in.number("y"), z = in.number("z");
        mesh_.add_vertex(in, x, y, z);
      }
      if (!in.at_end()) in.fail(text("the end of ", n, " points"), in_quotes(in.word()));
      return;
    }
    const std::vector<double> xyz = to_reals(decode(array, in), type, file_.encoding.swap, in);
    if (file_.n_points > kMost / 3) in.fail("a smaller NumberOfPoints", text(file_.n_points));
    check_size(in, "Points", xyz.size(), 3 * file_.n_points);
    for (std::size_t i = 0; i < xyz.size(); i += 3) {
      mesh_.add_vertex(in, xyz[i], xyz[i + 1], xyz[i + 2]);
    }
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

RawMesh read_vtu(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return VtuReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
