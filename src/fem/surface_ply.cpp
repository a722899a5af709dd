// .ply: a header that lists elements and their properties, then the elements' rows in this order,
// as words or as binary numbers.
#include <iterator>
#include <limits>
#include <optional>

#include "fem/surface_reader.h"

namespace nmp::fem {

namespace {

enum class Kind { integer, unsigned_integer, real };
struct NumberType {
  const char* name;
  const char* other_name;
  Kind kind;
  std::size_t bytes;
};

constexpr NumberType kTypes[] = {
    {"char", "int8", Kind::integer, 1},   {"uchar", "uint8", Kind::unsigned_integer, 1},
    {"short", "int16", Kind::integer, 2}, {"ushort", "uint16", Kind::unsigned_integer, 2},
    {"int", "int32", Kind::integer, 4},   {"uint", "uint32", Kind::unsigned_integer, 4},
    {"float", "float32", Kind::real, 4},  {"double", "float64", Kind::real, 8},
};

struct Property {
  const NumberType* length = nullptr;  // of a list; none: a single number
  const NumberType* type = nullptr;
  std::string name;
};

struct Element {
  std::string name;
  Index n = 0;
  std::vector<Property> properties;
};

class PlyReader {
 public:
  PlyReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : in_(bytes, name), surface_(limits) {}

  RawSurface read() {
    read_header();
    if (binary_) in_.set_binary(big_endian_ == is_little_endian());
    bool has_vertices = false, has_faces = false;
    for (const Element& element : elements_) {
      const bool vertices = element.name == "vertex", faces = element.name == "face";
      if (vertices && !has_vertices) {
        read_vertices(element);
      } else if (faces && !has_faces) {
        read_faces(element);
      } else if (vertices || faces || element.name == "tristrips") {
        in_.fail("the elements vertex and face, once each", "'" + element.name + "' too");
      } else {
        pass(element);
      }
      has_vertices = has_vertices || vertices;
      has_faces = has_faces || faces;
    }
    if (!has_vertices) in_.fail("an element 'vertex'", "none");
    if (!has_faces) in_.fail("an element 'face'", "none");
    if (highest_ >= surface_.n_vertices()) {
      in_.fail(text("vertices of faces from 0 to ", surface_.n_vertices() - 1), text(highest_));
    }
    return surface_.finish();
  }

 private:
  void read_header() {
    in_.expect("ply");
    end_line();
    in_.expect("format");
    const std::string_view format = in_.word_on_line();
    binary_ = format != "ascii";
    big_endian_ = format == "binary_big_endian";
    if (binary_ && !big_endian_ && format != "binary_little_endian") {
      in_.fail("ascii, binary_little_endian or binary_big_endian", MeshCursor::quoted(format));
    }
    const std::string_view version = in_.word_on_line();
    if (version != "1.0") in_.fail("version 1.0", MeshCursor::quoted(version));
    end_line();
    for (;;) {
      const std::string_view keyword = in_.word();
      if (keyword == "end_header") break;
      if (keyword == "comment" || keyword == "obj_info") {
        in_.line();
      } else if (keyword == "element") {
        elements_.emplace_back();
        elements_.back().name = in_.word_on_line();
        elements_.back().n = in_.count("number of rows", std::numeric_limits<Index>::max(), 0);
        end_line();
      } else if (keyword == "property" && !elements_.empty()) {
        elements_.back().properties.push_back(read_property());
        end_line();
      } else {
        in_.fail("element, property of an element, comment or end_header",
                 MeshCursor::quoted(keyword));
      }
    }
    end_line();
  }

  // Data begin right behind the end of a line, which may be \r\n.
  void end_line() {
    const std::string_view found = in_.word_on_line();
    if (!found.empty()) in_.fail("the end of the line", in_quotes(found));
    in_.line();
  }

  const NumberType& read_type() {
    const std::string_view word = in_.word_on_line();
    for (const NumberType& type : kTypes)
      if (word == type.name || word == type.other_name) return type;
    in_.fail("a type such as float or uchar", MeshCursor::quoted(word));
  }

  Property read_property() {
    const MeshCursor before = in_;
    Property property;
    if (in_.word_on_line() == "list") {
      property.length = &read_type();
      if (property.length->kind == Kind::real) {
        in_.fail("an integer type as length of a list", property.length->name);
      }
    } else {
      in_ = before;
    }
    property.type = &read_type();
    property.name = in_.word_on_line();
    return property;
  }

  double number(const NumberType& type, const char* what) {
    if (!binary_) return in_.to_number(in_.word(), what);
    if (type.kind == Kind::real) {
      return type.bytes == 4 ? double{in_.binary<float>(what)} : in_.binary<double>(what);
    }
    return static_cast<double>(integer(type, what));
  }

  std::int64_t integer(const NumberType& type, const char* what) {
    constexpr std::int64_t kMost = std::numeric_limits<std::uint32_t>::max();
    if (!binary_) return in_.integer(what, -kMost, kMost);
    const bool is_unsigned = type.kind == Kind::unsigned_integer;
    switch (type.bytes) {
      case 1:
        return is_unsigned ? std::int64_t{in_.binary<std::uint8_t>(what)}
                           : std::int64_t{in_.binary<std::int8_t>(what)};
      case 2:
        return is_unsigned ? std::int64_t{in_.binary<std::uint16_t>(what)}
                           : std::int64_t{in_.binary<std::int16_t>(what)};
      default:
        return is_unsigned ? std::int64_t{in_.binary<std::uint32_t>(what)}
                           : std::int64_t{in_.binary<std::int32_t>(what)};
    }
  }

  std::size_t least_bytes(const NumberType& type) const { return binary_ ? type.bytes : 2; }

  Index list_length(const Property& list) {
    const std::int64_t n = integer(*list.length, "length of a list");
    if (n < 0) in_.fail("a length of at least 0", text(n));
    return in_.check_count(static_cast<std::uint64_t>(n), "length of a list",
                           std::numeric_limits<Index>::max(), least_bytes(*list.type));
  }

  void pass(const Property& property) {
    const Index n = property.length == nullptr ? 1 : list_length(property);
    for (Index i = 0; i < n; ++i) {
      if (binary_) {
        in_.skip(property.type->bytes);
      } else {
        in_.to_number(in_.word(), "property");
      }
    }
  }

  // The rows must fit into the rest of the file before anything is made of their number.
  void check_rows(const Element& element) {
    std::size_t row = 0;
    for (const Property& property : element.properties) {
      row += least_bytes(property.length == nullptr ? *property.type : *property.length);
    }
    in_.check_count(static_cast<std::uint64_t>(element.n), "number of rows",
                    std::numeric_limits<Index>::max(), row);
  }

  void pass(const Element& element) {
    if (element.properties.empty()) return;
    check_rows(element);
    for (Index i = 0; i < element.n; ++i)
      for (const Property& property : element.properties) pass(property);
  }

  void read_vertices(const Element& element) {
    int axis[3] = {-1, -1, -1};
    const auto n = static_cast<int>(element.properties.size());
    for (int p = 0; p < n; ++p) {
      const Property& property = element.properties[static_cast<std::size_t>(p)];
      for (int k = 0; k < 3; ++k) {
        if (property.length == nullptr && property.name == std::string(1, "xyz"[k])) axis[k] = p;
      }
    }
    if (axis[0] < 0 || axis[1] < 0 || axis[2] < 0) {
      in_.fail("the properties x, y and z of a vertex", "some of them missing");
    }
    check_rows(element);
    for (Index i = 0; i < element.n; ++i) {
      double x[3] = {0, 0, 0};
      for (int p = 0; p < n; ++p) {
        const int k = p == axis[0] ? 0 : p == axis[1] ? 1 : p == axis[2] ? 2 : -1;
        const Property& property = element.properties[static_cast<std::size_t>(p)];
        if (k < 0) {
          pass(property);
        } else {
          x[k] = number(*property.type, "coordinate");
        }
      }
      surface_.add_vertex(in_, x[0], x[1], x[2]);
    }
  }

  void read_faces(const Element& element) {
    const Property* corners = nullptr;
    for (const Property& property : element.properties) {
      if (property.length != nullptr && property.type->kind != Kind::real &&
          (property.name == "vertex_indices" || property.name == "vertex_index")) {
        corners = &property;
      }
    }
    if (corners == nullptr) {
      in_.fail("a list vertex_indices or vertex_index of integers for each face", "none");
    }
    check_rows(element);
    std::vector<std::int64_t> polygon;
    for (Index i = 0; i < element.n; ++i) {
      for (const Property& property : element.properties) {
        if (&property != corners) {
          pass(property);
          continue;
        }
        polygon.clear();
        const Index n = list_length(property);
        for (Index a = 0; a < n; ++a) polygon.push_back(vertex(*property.type));
      }
      surface_.add_polygon(in_, polygon);
    }
  }

  std::int64_t vertex(const NumberType& type) {
    const std::int64_t v = integer(type, "vertex");
    constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();
    if (v < 0 || v > kMost) in_.fail(text("a vertex from 0 to ", kMost), text(v));
    highest_ = std::max(highest_, v);  // faces may come before vertices
    return v;
  }

  MeshCursor in_;
  SurfaceBuilder surface_;
  bool binary_ = false, big_endian_ = false;
  std::vector<Element> elements_;
  std::int64_t highest_ = -1;
};

}  // namespace

RawSurface read_ply(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return PlyReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
