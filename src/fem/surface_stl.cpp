// .stl: triangles by the coordinates of their corners. Binary: 80 bytes of anything, their number,
// then 50 bytes each, little-endian; it may begin with the word of the text form too.
#include "fem/surface_reader.h"

namespace nmp::fem {

namespace {

constexpr std::size_t kHead = 84, kTriangle = 50;

bool is_binary(std::string_view bytes) {
  if (bytes.size() < kHead) return false;
  const auto n = MeshCursor::load<std::uint32_t>(bytes.data() + 80, !is_little_endian());
  return bytes.size() - kHead == kTriangle * n;
}

class StlReader {
 public:
  StlReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : bytes_(bytes), in_(bytes, name), limits_(limits), soup_(limits) {}

  RawSurface read() {
    // A binary file that was cut or has something behind it is told by its bytes, not its length.
    const bool as_text = !is_binary(bytes_) && lower_word(in_.peek()) == "solid" &&
                         bytes_.substr(0, 1000).find('\0') == std::string_view::npos;
    as_text ? read_text() : read_binary();
    const RawSurface soup = soup_.finish();
    const std::vector<std::int32_t> place = number_places(soup.vertices);
    SurfaceBuilder surface(limits_);
    for (std::size_t v = 0; v < place.size(); ++v) {
      const auto row = static_cast<Index>(v);
      if (place[v] == surface.n_vertices()) {
        surface.add_vertex(in_, soup.vertices(row, 0), soup.vertices(row, 1),
                           soup.vertices(row, 2));
      }
    }
    for (std::size_t v = 0; v < place.size(); v += 3) {
      surface.add_polygon(in_, {place[v], place[v + 1], place[v + 2]});
    }
    return surface.finish();
  }

 private:
  void expect(std::string_view wanted) {
    const std::string_view found = in_.word();
    if (lower_word(found) != wanted) in_.fail(std::string(wanted), MeshCursor::quoted(found));
  }

  // solid name, facets, endsolid name; perhaps another solid behind it
  void read_text() {
    while (!in_.at_end()) {
      expect("solid");
      in_.line();
      for (;;) {
        const std::string_view word = in_.word();
        if (lower_word(word) == "endsolid") break;
        if (lower_word(word) != "facet") in_.fail("facet or endsolid", MeshCursor::quoted(word));
        expect("normal");
        for (int k = 0; k < 3; ++k) in_.word();  // some write nan
        expect("outer");
        expect("loop");
        for (int a = 0; a < 3; ++a) {
          expect("vertex");
          const double x = in_.number("x"), y = in_.number("y"), z = in_.number("z");
          soup_.add_vertex(in_, x, y, z);
        }
        expect("endloop");
        expect("endfacet");
      }
      in_.line();
    }
  }

  void read_binary() {
    in_ = MeshCursor(bytes_, in_.name());
    in_.set_binary(!is_little_endian());
    in_.take(80 - in_.position(), "the head of a binary .stl");
    const auto n_claimed = in_.binary<std::uint32_t>("number of triangles");
    const Index n = in_.check_count(n_claimed, "number of triangles", limits_.triangles, kTriangle);
    for (Index f = 0; f < n; ++f) {
      in_.take(12, "a normal");
      for (int a = 0; a < 3; ++a) {
        const double x = in_.binary<float>("x"), y = in_.binary<float>("y"),
                     z = in_.binary<float>("z");
        soup_.add_vertex(in_, x, y, z);
      }
      in_.take(2, "attributes");
    }
    if (in_.left() > 0) {
      in_.fail(text("the end of the file after ", n, " triangles"),
               text(in_.left(), " bytes more"));
    }
  }

  std::string_view bytes_;
  MeshCursor in_;
  MeshLimits limits_;
  SurfaceBuilder soup_;  // its vertices: the corners of the triangles, one after the other
};

}  // namespace

RawSurface read_stl(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return StlReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
