// Wavefront .obj: a keyword and its values to a line, '#' begins a comment, '\' at the end of a
// line goes on with the next.
#include <algorithm>
#include <iterator>
#include <limits>
#include <optional>

#include "fem/surface_reader.h"

namespace nmp::fem {

namespace {

// What a surface of polygons has no use for: attributes, names, groups, appearance.
constexpr std::string_view kPassed[] = {
    "vt",    "vn",       "vp",       "g",   "o",          "s",         "mg",     "usemtl", "mtllib",
    "bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj", "usemap", "maplib"};

class ObjReader {
 public:
  ObjReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : in_(bytes, name, 1, '#'), surface_(limits) {}

  RawSurface read() {
    while (!in_.at_end()) {
      const std::string_view keyword = in_.word();
      if (keyword == "v") {
        read_vertex();
      } else if (keyword == "f" || keyword == "fo") {
        read_face();
      } else if (keyword == "l" || keyword == "p") {
        surface_.ignore_cell();
        pass_line();
      } else if (std::find(std::begin(kPassed), std::end(kPassed), keyword) != std::end(kPassed)) {
        pass_line();
      } else {
        in_.fail("a line of a polygon mesh that begins with v, f, vt, vn, g, o, s, usemtl, ...",
                 in_quotes(keyword));
      }
    }
    if (ahead_ && ahead_->vertex >= surface_.n_vertices()) {
      ahead_->at.fail(text("a vertex from 1 to ", surface_.n_vertices()), text(ahead_->vertex + 1));
    }
    return surface_.finish();
  }

 private:
  // The next word of the line, which may go on after a backslash; empty at its end.
  std::string_view next() {
    std::string_view word = in_.word_on_line();
    while (word == "\\") {
      in_.line();
      word = in_.word_on_line();
    }
    return word;
  }

  void pass_line() {
    while (!next().empty()) {
    }
  }

  // x y z, then nothing, a weight, a colour, or a colour with opacity.
  void read_vertex() {
    double values[3];
    for (double& value : values) value = in_.to_number(next(), "coordinate");
    surface_.add_vertex(in_, values[0], values[1], values[2]);
    int n_more = 0;
    for (std::string_view word = next(); !word.empty(); word = next()) {
      if (++n_more > 4) in_.fail("at most 4 values after the coordinates", in_quotes(word));
      in_.to_number(word, "weight or colour");
    }
  }

  void read_face() {
    corners_.clear();
    for (std::string_view word = next(); !word.empty(); word = next()) {
      corners_.push_back(corner(word));
    }
    surface_.add_polygon(in_, corners_);
  }

  // v, v/vt, v//vn or v/vt/vn
  std::int64_t corner(std::string_view word) {
    const std::size_t slash = std::min(word.find('/'), word.size());
    const std::string_view rest = word.substr(slash);
    if (std::count(rest.begin(), rest.end(), '/') > 2 ||
        rest.find_first_not_of("/-0123456789") != std::string_view::npos) {
      in_.fail("a corner as v, v/vt, v//vn or v/vt/vn", in_quotes(word));
    }
    const std::int64_t n = surface_.n_vertices();
    const std::int64_t number = in_.to_integer(word.substr(0, slash), "vertex", -n,
                                               std::numeric_limits<std::int32_t>::max());
    if (number == 0) in_.fail("vertices counted from 1, or back from -1", "0");
    if (number < 0) return n + number;
    // A vertex may come after the faces that have it.
    if (number > n && (!ahead_ || number - 1 > ahead_->vertex))
      ahead_.emplace(Ahead{in_, number - 1});
    return number - 1;
  }

  struct Ahead {
    MeshCursor at;
    std::int64_t vertex;
  };
  MeshCursor in_;
  SurfaceBuilder surface_;
  std::optional<Ahead> ahead_;  // the highest vertex that was named before it was there
  std::vector<std::int64_t> corners_;
};

}  // namespace

RawSurface read_obj(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return ObjReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
