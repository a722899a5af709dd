// TetGen's .node and .ele: one item to a line, numbered from 0 or 1, '#' begins a comment.
#include "fem/mesh_reader.h"

namespace nmp::fem {

namespace {

constexpr std::int64_t kMostColumns = 1 << 20;  // attributes

// The words of a line, in order; each must be there.
class Line {
 public:
  explicit Line(MeshCursor& in) : in_(in), first_(in.word()) {}
  double number(const char* what) { return in_.to_number(next(what), what); }
  std::int64_t integer(const char* what, std::int64_t low, std::int64_t high) {
    return in_.to_integer(next(what), what, low, high);
  }
  std::int64_t integer_or(std::int64_t absent, const char* what, std::int64_t low,
                          std::int64_t high) {
    const std::string_view found = in_.word_on_line();
    return found.empty() ? absent : in_.to_integer(found, what, low, high);
  }
  void skip(std::int64_t n, const char* what) {
    for (std::int64_t i = 0; i < n; ++i) number(what);
  }
  void end() {
    const std::string_view found = in_.word_on_line();
    if (!found.empty()) in_.fail("the end of the line", in_quotes(found));
  }

 private:
  std::string_view next(const char* what) {
    const std::string_view found = used_first_ ? in_.word_on_line() : first_;
    if (found.empty()) {
      in_.fail(what, used_first_ ? "the end of the line" : "the end of the file");
    }
    used_first_ = true;
    return found;
  }
  MeshCursor& in_;
  std::string_view first_;
  bool used_first_ = false;
};

void expect_end(MeshCursor& in, std::int64_t n) {
  const std::string_view found = in.word();
  if (!found.empty()) in.fail(text("the end of the file after ", n, " lines"), in_quotes(found));
}

}  // namespace

RawMesh read_tetgen(std::string_view node, const std::string& node_name, std::string_view ele,
                    const std::string& ele_name, const MeshLimits& limits) {
  MeshBuilder mesh(limits);

  // #points dimension #attributes #markers; then: number x y z attributes... marker
  MeshCursor nodes(node, node_name, 1, '#');
  Line node_head(nodes);
  const std::int64_t n_claimed = node_head.integer("number of points", 0, limits.vertices);
  const Index n_vertices = nodes.check_count(static_cast<std::uint64_t>(n_claimed),
                                             "number of points", limits.vertices, 8);
  node_head.integer("dimension", 3, 3);
  const std::int64_t n_values = node_head.integer_or(0, "number of attributes", 0, kMostColumns) +
                                node_head.integer_or(0, "number of boundary markers", 0, 1);
  node_head.end();
  std::int64_t first = 0;
  for (Index i = 0; i < n_vertices; ++i) {
    Line line(nodes);
    if (i == 0) {
      first = line.integer("number of the first point", 0, 1);
    } else {
      line.integer("number of the next point", first + i, first + i);
    }
    const double x = line.number("x"), y = line.number("y"), z = line.number("z");
    mesh.add_vertex(nodes, x, y, z);
    line.skip(n_values, "attribute or marker");
    line.end();
  }
  expect_end(nodes, n_vertices);

  // #tets #nodes-per-tet #attributes; then: number corners... attributes...
  MeshCursor cells(ele, ele_name, 1, '#');
  Line ele_head(cells);
  const std::int64_t n_tets_claimed = ele_head.integer("number of tetrahedra", 0, limits.tets);
  const Index n_tets = cells.check_count(static_cast<std::uint64_t>(n_tets_claimed),
                                         "number of tetrahedra", limits.tets, 10);
  const std::int64_t n_corners = ele_head.integer("number of corners, 4", 4, 10);
  if (n_corners != 4) {
    cells.fail(
        "4 corners to a tetrahedron",
        text(n_corners, n_corners == 10 ? ", second order (TetGen's -o2): make the mesh again "
                                          "without it"
                                        : ""));
  }
  const std::int64_t n_attributes = ele_head.integer_or(0, "number of attributes", 0, kMostColumns);
  ele_head.end();
  for (Index e = 0; e < n_tets; ++e) {
    Line line(cells);
    const std::int64_t number = e + first;
    line.integer("number of the next tetrahedron", number, number);
    std::int64_t corners[4];
    for (std::int64_t& corner : corners) {
      corner = line.integer("corner", first, first + n_vertices - 1) - first;
    }
    mesh.add_tet(cells, corners);
    line.skip(n_attributes, "attribute");
    line.end();
  }
  expect_end(cells, n_tets);
  return mesh.finish();
}

}  // namespace nmp::fem
