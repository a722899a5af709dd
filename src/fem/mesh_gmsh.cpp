// Gmsh .msh. Version 2 lists nodes and elements one by one, 4.1 in blocks; the binary forms hold
// the same numbers as int32, size_t (its width is in the header) and double.
#include <algorithm>
#include <limits>
#include <utility>

#include "fem/mesh_reader.h"

namespace nmp::fem {

namespace {

constexpr std::int64_t kMaxTag = std::numeric_limits<std::int64_t>::max();

struct GmshCell {
  std::int64_t type;
  int n_nodes;
  CellKind kind;
  const char* name;
};

constexpr GmshCell kGmshCells[] = {
    {1, 2, CellKind::lower, "a line"},
    {2, 3, CellKind::lower, "a triangle"},
    {3, 4, CellKind::lower, "a quadrilateral"},
    {4, 4, CellKind::tet, "a tetrahedron"},
    {5, 8, CellKind::volume, "a hexahedron"},
    {6, 6, CellKind::volume, "a prism"},
    {7, 5, CellKind::volume, "a pyramid"},
    {8, 3, CellKind::lower, "a second-order line"},
    {9, 6, CellKind::lower, "a second-order triangle"},
    {10, 9, CellKind::lower, "a second-order quadrilateral"},
    {11, 10, CellKind::volume, "a second-order tetrahedron of 10 nodes"},
    {12, 27, CellKind::volume, "a second-order hexahedron"},
    {13, 18, CellKind::volume, "a second-order prism"},
    {14, 14, CellKind::volume, "a second-order pyramid"},
    {15, 1, CellKind::lower, "a point"},
    {16, 8, CellKind::lower, "a second-order quadrilateral"},
    {17, 20, CellKind::volume, "a second-order hexahedron"},
    {18, 15, CellKind::volume, "a second-order prism"},
    {19, 13, CellKind::volume, "a second-order pyramid"},
    {20, 9, CellKind::lower, "a third-order triangle"},
    {21, 10, CellKind::lower, "a third-order triangle"},
    {22, 12, CellKind::lower, "a fourth-order triangle"},
    {23, 15, CellKind::lower, "a fourth-order triangle"},
    {24, 15, CellKind::lower, "a fifth-order triangle"},
    {25, 21, CellKind::lower, "a fifth-order triangle"},
    {26, 4, CellKind::lower, "a third-order line"},
    {27, 5, CellKind::lower, "a fourth-order line"},
    {28, 6, CellKind::lower, "a fifth-order line"},
    {29, 20, CellKind::volume, "a third-order tetrahedron"},
    {30, 35, CellKind::volume, "a fourth-order tetrahedron"},
    {31, 56, CellKind::volume, "a fifth-order tetrahedron"},
    {36, 16, CellKind::lower, "a third-order quadrilateral"},
    {37, 25, CellKind::lower, "a fourth-order quadrilateral"},
};

// The cell of that type, which is a tet or may be left out.
const GmshCell& find_cell(const MeshCursor& at, std::int64_t type) {
  for (const GmshCell& cell : kGmshCells) {
    if (cell.type != type) continue;
    if (cell.kind == CellKind::volume) {
      at.fail("tetrahedra of 4 nodes (type 4) as the only volume cells",
              text(cell.name, " (type ", type, ")"));
    }
    return cell;
  }
  at.fail("an element type that is known", text("type ", type));
}

// From node tags, any integers, to rows of vertices.
class NodeTags {
 public:
  void add(std::int64_t tag) { tags_.emplace_back(tag, static_cast<std::int64_t>(tags_.size())); }

  // To be called once, after the last add.
  void sort(const MeshCursor& at) {
    std::sort(tags_.begin(), tags_.end());
    for (std::size_t i = 1; i < tags_.size(); ++i) {
      if (tags_[i].first == tags_[i - 1].first) {
        at.fail("every node tag once", text("tag ", tags_[i].first, " twice"));
      }
    }
    // Nearly always the tags are 1 to n or a little more: then a table does.
    if (tags_.empty()) return;
    lowest_ = tags_.front().first;
    const auto span =
        static_cast<std::uint64_t>(tags_.back().first) - static_cast<std::uint64_t>(lowest_);
    if (span > 4 * tags_.size() + 1024) return;
    table_.assign(static_cast<std::size_t>(span) + 1, -1);
    for (const auto& [tag, row] : tags_) table_[static_cast<std::size_t>(tag - lowest_)] = row;
    tags_.clear();
    tags_.shrink_to_fit();
  }

  std::int64_t row(const MeshCursor& at, std::int64_t tag) const {
    std::int64_t found = -1;
    if (!table_.empty()) {
      const auto place = static_cast<std::uint64_t>(tag) - static_cast<std::uint64_t>(lowest_);
      if (place < table_.size()) found = table_[static_cast<std::size_t>(place)];
    } else {
      const auto entry =
          std::lower_bound(tags_.begin(), tags_.end(), std::make_pair(tag, std::int64_t{0}));
      if (entry != tags_.end() && entry->first == tag) found = entry->second;
    }
    if (found < 0) at.fail("the tag of a node", text(tag));
    return found;
  }

 private:
  std::vector<std::pair<std::int64_t, std::int64_t>> tags_;
  std::vector<std::int64_t> table_;
  std::int64_t lowest_ = 0;
};

class GmshReader {
 public:
  GmshReader(std::string_view bytes, const std::string& name, const MeshLimits& limits)
      : in_(bytes, name), mesh_(limits) {}

  RawMesh read() {
    while (!in_.at_end()) {
      const std::string_view section = in_.word();
      const bool begins = section.size() > 1 && section[0] == '$' &&
                          section.substr(0, 4) != "$End" &&
                          (has_format_ || section == "$MeshFormat" || section == "$Comments");
      if (!begins) {
        in_.fail(has_format_ ? "the beginning of a section, such as $Nodes" : "$MeshFormat",
                 MeshCursor::quoted(section));
      }
      if (section == "$MeshFormat") {
        read_format();
      } else if (section == "$Nodes" || section == "$Elements") {
        if (section == "$Nodes" ? has_nodes_ : has_elements_) {
          in_.fail(text(section, " once"), "it again");
        }
        if (section == "$Elements" && !has_nodes_) in_.fail("$Nodes before $Elements", "none");
        in_.line();
        if (section == "$Nodes") {
          major_ == 4 ? read_nodes_4() : read_nodes_2();
          has_nodes_ = true;
          tags_.sort(in_);
        } else {
          major_ == 4 ? read_elements_4() : read_elements_2();
          has_elements_ = true;
        }
        in_.expect(section == "$Nodes" ? "$EndNodes" : "$EndElements");
      } else {
        skip_section(section);
      }
    }
    if (!has_format_) in_.fail("a Gmsh file, beginning with $MeshFormat", "the end of the file");
    if (!has_nodes_) in_.fail("a section $Nodes", "the end of the file");
    if (!has_elements_) in_.fail("a section $Elements", "the end of the file");
    return mesh_.finish();
  }

 private:
  void read_format() {
    if (has_format_) in_.fail("$MeshFormat once", "it again");
    has_format_ = true;
    const std::string_view version = in_.word();
    major_ = version == "4.1" ? 4 : 2;
    if (version != "2" && version != "2.0" && version != "2.1" && version != "2.2" && major_ != 4) {
      in_.fail("version 2.2 or 4.1 (Gmsh writes them by 'gmsh -save -format msh41')",
               MeshCursor::quoted(version));
    }
    binary_ = in_.integer("file type, 0 for ASCII and 1 for binary", 0, 1) == 1;
    word_size_ = in_.integer("size of a number in bytes", 4, 8);
    if (word_size_ != 8 && (word_size_ != 4 || major_ == 2)) {
      in_.fail(major_ == 2 ? "8 bytes to a number" : "4 or 8 bytes to a number", text(word_size_));
    }
    in_.line();
    if (binary_) {
      in_.set_binary(false);
      const std::string_view one = in_.take(4, "the number 1 that tells the byte order");
      const bool swap = MeshCursor::load<std::int32_t>(one.data(), true) == 1;
      if (!swap && MeshCursor::load<std::int32_t>(one.data(), false) != 1) {
        in_.fail("the number 1 in binary, which tells the byte order (is the file ASCII?)",
                 in_quotes(one));
      }
      in_.set_binary(swap);
    }
    in_.expect("$EndMeshFormat");
  }

  // Anything that is not needed, up to its end mark.
  void skip_section(std::string_view section) {
    const std::string end = "$End" + std::string(section.substr(1, 60));
    const std::size_t at = in_.rest().find(end);
    if (at == std::string_view::npos || section.size() > 61) {
      in_.fail("the end of the section " + in_quotes(section), "the end of the file");
    }
    // Counts the lines where there are any.
    const std::size_t to = in_.position() + at;
    if (binary_) {
      in_.skip(at);
    } else {
      while (in_.position() < to && in_.rest().find('\n') < to - in_.position()) in_.line();
      in_.skip(to - in_.position());
    }
    in_.expect(end);
  }

  std::int64_t integer32(const char* what, std::int64_t low, std::int64_t high) {
    if (!binary_) return in_.integer(what, low, high);
    const auto found = std::int64_t{in_.binary<std::int32_t>(what)};
    if (found < low || found > high) {
      in_.fail(text("an integer from ", low, " to ", high, " as ", what), text(found));
    }
    return found;
  }

  std::int64_t size(const char* what, std::int64_t high) {
    if (!binary_) return in_.integer(what, 0, high);
    const std::uint64_t found =
        word_size_ == 8 ? in_.binary<std::uint64_t>(what) : in_.binary<std::uint32_t>(what);
    if (found > static_cast<std::uint64_t>(high)) {
      in_.fail(text("an integer from 0 to ", high, " as ", what), text(found));
    }
    return static_cast<std::int64_t>(found);
  }

  Index size_count(const char* what, Index limit, std::size_t least_bytes) {
    return in_.check_count(static_cast<std::uint64_t>(size(what, kMaxTag)), what, limit,
                           least_bytes);
  }

  double coordinate() {
    return binary_ ? in_.binary<double>("coordinate") : in_.number("coordinate");
  }

  void add_vertex() {
    const double x = coordinate(), y = coordinate(), z = coordinate();
    mesh_.add_vertex(in_, x, y, z);
  }

  // The line end after a count, before binary data.
  void end_line() {
    const std::string_view rest = in_.line();
    if (!rest.empty()) in_.fail("the end of the line", in_quotes(rest));
  }

  void read_nodes_2() {
    const Index n = in_.count("number of nodes", mesh_.limits().vertices, binary_ ? 28 : 8);
    if (binary_) end_line();
    for (Index i = 0; i < n; ++i) {
      tags_.add(integer32("node tag", std::numeric_limits<std::int32_t>::min(),
                          std::numeric_limits<std::int32_t>::max()));
      add_vertex();
    }
  }

  void read_elements_2() {
    constexpr std::int64_t kMaxInt = std::numeric_limits<std::int32_t>::max();
    const Index n = in_.count("number of elements", kMaxInt, 8);
    if (binary_) end_line();
    for (Index done = 0; done < n;) {
      // ASCII: tag type #tags tags... nodes...; binary: type #elements #tags, then tag tags nodes.
      if (!binary_) in_.integer("element tag", -kMaxInt, kMaxInt);
      const GmshCell& cell = find_cell(in_, integer32("element type", 1, kMaxInt));
      const std::int64_t n_block = binary_ ? integer32("number of elements", 1, n - done) : 1;
      const std::int64_t n_tags = integer32("number of tags", 0, 1 << 20);
      for (std::int64_t e = 0; e < n_block; ++e) {
        if (binary_) in_.binary<std::int32_t>("element tag");
        for (std::int64_t t = 0; t < n_tags; ++t) integer32("tag", -kMaxInt - 1, kMaxInt);
        add_cell(cell, [&] { return integer32("node tag", -kMaxInt - 1, kMaxInt); });
      }
      done += n_block;
    }
  }

  // A block begins with the dimension and tag of its part of the geometry and one more number.
  std::int64_t read_block_head(const char* what, std::int64_t low, std::int64_t high,
                               std::int64_t& dimension) {
    dimension = integer32("dimension of a block", 0, 3);
    integer32("tag of a block", std::numeric_limits<std::int32_t>::min(),
              std::numeric_limits<std::int32_t>::max());
    return integer32(what, low, high);
  }

  void read_nodes_4() {
    const std::size_t least_block = binary_ ? 12 + word_bytes() : 8;
    const Index n_blocks = size_count("number of blocks", kMaxTag, least_block);
    const Index n =
        size_count("number of nodes", mesh_.limits().vertices, binary_ ? 24 + word_bytes() : 8);
    size("lowest node tag", kMaxTag);
    size("highest node tag", kMaxTag);
    Index done = 0;
    for (Index b = 0; b < n_blocks; ++b) {
      std::int64_t dimension = 0;
      const bool parametric = read_block_head("parametric flag, 0 or 1", 0, 1, dimension) == 1;
      const std::int64_t n_block = size("number of nodes in a block", n - done);
      for (std::int64_t i = 0; i < n_block; ++i) tags_.add(size("node tag", kMaxTag));
      for (std::int64_t i = 0; i < n_block; ++i) {
        add_vertex();
        for (std::int64_t k = 0; parametric && k < dimension; ++k) coordinate();
      }
      done += n_block;
    }
    if (done != n) in_.fail(text(n, " nodes, as the section says"), text(done, " in its blocks"));
  }

  void read_elements_4() {
    const Index n_blocks = size_count("number of blocks", kMaxTag, binary_ ? 12 + word_bytes() : 8);
    const Index n = size_count("number of elements", kMaxTag, binary_ ? 2 * word_bytes() : 4);
    size("lowest element tag", kMaxTag);
    size("highest element tag", kMaxTag);
    Index done = 0;
    for (Index b = 0; b < n_blocks; ++b) {
      std::int64_t dimension = 0;
      const std::int64_t type =
          read_block_head("element type", 1, std::numeric_limits<std::int32_t>::max(), dimension);
      const GmshCell& cell = find_cell(in_, type);
      const std::int64_t n_block = size("number of elements in a block", n - done);
      for (std::int64_t e = 0; e < n_block; ++e) {
        size("element tag", kMaxTag);
        add_cell(cell, [&] { return size("node tag", kMaxTag); });
      }
      done += n_block;
    }
    if (done != n) {
      in_.fail(text(n, " elements, as the section says"), text(done, " in its blocks"));
    }
  }

  template <class NextTag>
  void add_cell(const GmshCell& cell, NextTag&& next_tag) {
    if (cell.kind == CellKind::lower) {
      for (int a = 0; a < cell.n_nodes; ++a) next_tag();
      mesh_.ignore_cell();
      return;
    }
    std::int64_t corners[4];
    for (std::int64_t& corner : corners) corner = tags_.row(in_, next_tag());
    mesh_.add_tet(in_, corners);
  }

  std::size_t word_bytes() const { return static_cast<std::size_t>(word_size_); }

  MeshCursor in_;
  MeshBuilder mesh_;
  NodeTags tags_;
  int major_ = 0;
  std::int64_t word_size_ = 8;
  bool binary_ = false, has_format_ = false, has_nodes_ = false, has_elements_ = false;
};

}  // namespace

RawMesh read_gmsh(std::string_view bytes, const std::string& name, const MeshLimits& limits) {
  return GmshReader(bytes, name, limits).read();
}

}  // namespace nmp::fem
