#include "fem/stuffing.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>
#include <utility>
#include <vector>

#include "base/check.h"
#include "base/parallel.h"

namespace nmp::fem {

namespace {

using Vec = Vec3<double>;

// A cut nearer to a point of the lattice than these parts of its edge is a place to move the point
// to. Found by search for the widest least angle over random answers of a solid: 10.78 to 164.2
// degrees.
constexpr double kAlphaLong = 0.2852, kAlphaShort = 0.3985;

class Stuffer {
 public:
  Stuffer(const Lattice& lattice, const Solid& solid) : lattice_(lattice), solid_(solid) {}

  RawMesh run() {
    find_sides();
    find_cuts();
    warp();
    emit_all();
    return finish();
  }

 private:
  struct Cut {
    std::int32_t inside, outside;  // points of the lattice
    bool is_long;
    double t = 0;  // from inside to outside
    bool nearer_to(std::int32_t point) const {
      const double alpha = is_long ? kAlphaLong : kAlphaShort;
      return (point == inside ? t : 1 - t) < alpha;
    }
  };
  // A corner of a lattice tet.
  struct Corner {
    std::int32_t point;
    int side;
    bool even;
    int place;  // 0 to 3: long edges are 0-3 and 1-2
  };

  void find_sides() {
    const Index n = lattice_.n_points();
    side_.resize(static_cast<std::size_t>(n));
    parallel_for(n, [&](Index p) {
      side_[static_cast<std::size_t>(p)] = static_cast<signed char>(solid_.side(lattice_.place(p)));
    });
    const auto [nx, ny, nz] = lattice_.cells;
    for (Index p = 0; p < lattice_.n_corners(); ++p) {
      const auto [i, j, k] = lattice_.indices(p);
      const bool outermost = i == 0 || j == 0 || k == 0 || i == nx || j == ny || k == nz;
      NMP_CHECK(!outermost || side(p) < 0,
                text("outermost point ", p, " of the lattice is inside"));
    }
  }

  void find_cuts() {
    const auto [nx, ny, nz] = lattice_.cells;
    const auto add = [&](Index p, Index q, bool is_long) {
      if (side(p) * side(q) >= 0) return;
      const auto a = static_cast<std::int32_t>(p), b = static_cast<std::int32_t>(q);
      cuts_.push_back(side(p) > 0 ? Cut{a, b, is_long} : Cut{b, a, is_long});
    };
    for (Index k = 0; k <= nz; ++k)
      for (Index j = 0; j <= ny; ++j)
        for (Index i = 0; i <= nx; ++i) {
          const Index p = lattice_.corner(i, j, k);
          if (i < nx) add(p, lattice_.corner(i + 1, j, k), true);
          if (j < ny) add(p, lattice_.corner(i, j + 1, k), true);
          if (k < nz) add(p, lattice_.corner(i, j, k + 1), true);
          if (i == nx || j == ny || k == nz) continue;
          const Index c = lattice_.centre(i, j, k);
          if (i + 1 < nx) add(c, lattice_.centre(i + 1, j, k), true);
          if (j + 1 < ny) add(c, lattice_.centre(i, j + 1, k), true);
          if (k + 1 < nz) add(c, lattice_.centre(i, j, k + 1), true);
          for (int b = 0; b < 8; ++b) {
            add(c, lattice_.corner(i + (b & 1), j + (b >> 1 & 1), k + (b >> 2)), false);
          }
        }
    parallel_for(static_cast<Index>(cuts_.size()), [&](Index c) {
      Cut& cut = cuts_[static_cast<std::size_t>(c)];
      const double t = solid_.cut(lattice_.place(cut.inside), lattice_.place(cut.outside));
      cut.t = std::isfinite(t) ? std::clamp(t, 0.0, 1.0) : 0.5;
    });
  }

  Vec place(const Cut& cut) const {
    const Vec from = lattice_.place(cut.inside);
    return from + cut.t * (lattice_.place(cut.outside) - from);
  }

  // Moves each point that a cut is near to, one after the other, to the nearest such cut; then it
  // is on the surface, and its edges are cut no more.
  void warp() {
    std::vector<std::size_t> begin(side_.size() + 1, 0);
    for (const Cut& cut : cuts_)
      for (const std::int32_t p : {cut.inside, cut.outside})
        ++begin[static_cast<std::size_t>(p) + 1];
    for (std::size_t p = 1; p < begin.size(); ++p) begin[p] += begin[p - 1];
    std::vector<std::int32_t> around(2 * cuts_.size());
    std::vector<std::size_t> end(begin.begin(), begin.end() - 1);
    for (std::size_t c = 0; c < cuts_.size(); ++c)
      for (const std::int32_t p : {cuts_[c].inside, cuts_[c].outside}) {
        around[end[static_cast<std::size_t>(p)]++] = static_cast<std::int32_t>(c);
      }
    for (std::size_t p = 0; p < side_.size(); ++p) {
      const auto point = static_cast<std::int32_t>(p);
      double nearest = HUGE_VAL;
      Vec target = Vec::Zero();
      for (std::size_t k = begin[p]; k < begin[p + 1]; ++k) {
        const Cut& cut = cuts_[static_cast<std::size_t>(around[k])];
        if (side(cut.inside) * side(cut.outside) >= 0 || !cut.nearer_to(point)) continue;
        const double distance = (place(cut) - lattice_.place(point)).norm();
        if (distance < nearest) {
          nearest = distance;
          target = place(cut);
        }
      }
      if (nearest == HUGE_VAL) continue;
      side_[p] = 0;
      warped_.emplace(point, target);
    }
    for (std::size_t c = 0; c < cuts_.size(); ++c) {
      const Cut& cut = cuts_[c];
      if (side(cut.inside) * side(cut.outside) < 0) {
        cut_at_.emplace(std::make_pair(cut.inside, cut.outside), static_cast<std::int32_t>(c));
      }
    }
  }

  int side(Index p) const { return side_[static_cast<std::size_t>(p)]; }

  // The lattice tets: for each pair of centres along an axis those around the face between them.
  void emit_all() {
    const auto& n = lattice_.cells;
    for (int axis = 0; axis < 3; ++axis) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      std::array<Index, 3> at;
      for (at[2] = 0; at[2] + (axis == 2) < n[2]; ++at[2])
        for (at[1] = 0; at[1] + (axis == 1) < n[1]; ++at[1])
          for (at[0] = 0; at[0] + (axis == 0) < n[0]; ++at[0]) {
            std::array<Index, 3> next = at;
            ++next[static_cast<std::size_t>(axis)];
            const Index c1 = lattice_.centre(at[0], at[1], at[2]),
                        c2 = lattice_.centre(next[0], next[1], next[2]);
            Index face[4];  // counter-clockwise around the axis
            for (int b = 0; b < 4; ++b) {
              std::array<Index, 3> corner = next;
              corner[static_cast<std::size_t>(u)] += b == 1 || b == 2;
              corner[static_cast<std::size_t>(v)] += b >= 2;
              face[b] = lattice_.corner(corner[0], corner[1], corner[2]);
            }
            for (int b = 0; b < 4; ++b) emit({c1, face[b], face[(b + 1) % 4], c2});
          }
    }
  }

  // The part of a lattice tet that is inside. Corners are taken in an order that is an even
  // permutation: those inside, then those on the surface, then those outside.
  void emit(const std::array<Index, 4>& points) {
    std::array<Corner, 4> v;
    int n_in = 0, n_out = 0;
    for (std::size_t a = 0; a < 4; ++a) {
      const auto point = static_cast<std::int32_t>(points[a]);
      v[a] = {point, side(point), false, static_cast<int>(a)};
      n_in += v[a].side > 0;
      n_out += v[a].side < 0;
    }
    if (n_in == 0) return;
    for (Corner& corner : v) corner.even = lattice_.is_even(corner.point);
    sort_by_side(v);
    const Corner &A = v[0], &B = v[1], &C = v[2], &D = v[3];
    if (n_out == 0) return add(node(A), node(B), node(C), node(D));
    if (n_in == 1) {
      const auto end = [&](const Corner& c) { return c.side == 0 ? node(c) : cut(A, c); };
      return add(node(A), end(B), end(C), end(D));
    }
    if (n_in == 2 && n_out == 1) {  // a pyramid over the quadrilateral of A, B; C is its apex
      const std::int32_t quad[4] = {node(A), node(B), cut(B, D), cut(A, D)};
      return add_pyramid(node(C), quad, diagonal_from_first(A, B, D), false);
    }
    if (n_in == 3) {
      const std::int32_t a[3] = {node(A), node(B), node(C)},
                         b[3] = {cut(A, D), cut(B, D), cut(C, D)};
      const bool diagonal[3] = {diagonal_from_first(A, B, D), diagonal_from_first(B, C, D),
                                diagonal_from_first(C, A, D)};
      return add_prism(a, b, diagonal);
    }
    const std::int32_t a[3] = {node(A), cut(A, C), cut(A, D)},
                       b[3] = {node(B), cut(B, C), cut(B, D)};
    // The rule below takes one of these two from A, the other from B. The quadrilateral between the
    // cuts is on the surface, of this tet alone: its diagonal is the one that makes no cycle.
    const bool from_a = diagonal_from_first(A, B, C), to_a = !diagonal_from_first(A, B, D);
    const bool diagonal[3] = {from_a, !from_a, to_a};
    add_prism(a, b, diagonal);
  }

  static void sort_by_side(std::array<Corner, 4>& v) {
    bool odd = false;
    for (int pass = 0; pass < 3; ++pass)
      for (std::size_t a = 0; a < 3; ++a)
        if (v[a].side < v[a + 1].side) {
          std::swap(v[a], v[a + 1]);
          odd = !odd;
        }
    if (!odd) return;
    // Two of four corners have equal sides: all three cannot differ pairwise.
    for (std::size_t a = 0; a < 3; ++a)
      if (v[a].side == v[a + 1].side) return std::swap(v[a], v[a + 1]);
  }

  static bool is_long(const Corner& a, const Corner& b) { return a.place + b.place == 3; }

  // On the face of A and B inside and C outside: whether the quadrilateral A B cut(BC) cut(AC) has
  // its diagonal from A. A rule that both tets of the face see alike: from the cut of the long
  // edge, or if that is AB, from its even end.
  static bool diagonal_from_first(const Corner& A, const Corner& B, const Corner& C) {
    if (is_long(A, B)) return A.even == C.even;
    return is_long(B, C);
  }

  // quad: q0 q1 q2 q3 seen counter-clockwise from the apex side as in add_prism.
  void add_pyramid(std::int32_t apex, const std::int32_t q[4], bool from_first, bool odd) {
    const auto tet = [&](std::int32_t x, std::int32_t y, std::int32_t z) {
      odd ? add(apex, x, z, y) : add(apex, x, y, z);
    };
    if (from_first) {
      tet(q[0], q[1], q[2]);
      tet(q[0], q[2], q[3]);
    } else {
      tet(q[0], q[1], q[3]);
      tet(q[1], q[2], q[3]);
    }
  }

  // Triangles a and b, (a0, a1, a2, b0) positive. diagonal[k] of the quadrilateral of a_k, a_k+1,
  // b_k+1, b_k runs from a_k, else from a_k+1. One corner has two of them: the opposite triangle
  // makes a tet with it, the quadrilateral opposite a pyramid.
  void add_prism(const std::int32_t a[3], const std::int32_t b[3], const bool diagonal[3]) {
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      if (diagonal[i] && !diagonal[k]) {  // both from a_i
        add(a[i], b[i], b[j], b[k]);
        const std::int32_t quad[4] = {a[j], a[k], b[k], b[j]};
        return add_pyramid(a[i], quad, diagonal[j], false);
      }
    }
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, k = (i + 2) % 3;
      if (!diagonal[i] && diagonal[k]) {  // both from b_i
        add(b[i], a[i], a[k], a[j]);
        const std::int32_t quad[4] = {b[j], b[k], a[k], a[j]};
        return add_pyramid(b[i], quad, !diagonal[j], true);
      }
    }
    NMP_CHECK(false, "three diagonals of a prism in a cycle");
  }

  // Nodes: points of the lattice, then cuts.
  static std::int32_t node(const Corner& corner) { return corner.point; }
  std::int32_t cut(const Corner& inside, const Corner& outside) const {
    return static_cast<std::int32_t>(side_.size()) +
           cut_at_.at(std::make_pair(inside.point, outside.point));
  }
  Vec at(std::int32_t node) const {
    const auto n = static_cast<std::int32_t>(side_.size());
    if (node >= n) return place(cuts_[static_cast<std::size_t>(node - n)]);
    const auto moved = warped_.find(node);
    return moved == warped_.end() ? lattice_.place(node) : moved->second;
  }
  void add(std::int32_t p, std::int32_t q, std::int32_t r, std::int32_t s) {
    tets_.push_back({p, q, r, s});
  }

  // Numbers the nodes that are used, in ascending order.
  RawMesh finish() const {
    std::vector<std::int32_t> nodes;
    for (const auto& tet : tets_) nodes.insert(nodes.end(), tet.begin(), tet.end());
    std::sort(nodes.begin(), nodes.end());
    nodes.erase(std::unique(nodes.begin(), nodes.end()), nodes.end());
    RawMesh mesh;
    mesh.vertices.resize(static_cast<Index>(nodes.size()), 3);
    for (Index v = 0; v < mesh.vertices.rows(); ++v) {
      mesh.vertices.row(v) = at(nodes[static_cast<std::size_t>(v)]).transpose();
    }
    mesh.tets.resize(static_cast<Index>(tets_.size()), 4);
    for (Index e = 0; e < mesh.tets.rows(); ++e)
      for (int a = 0; a < 4; ++a) {
        const std::int32_t name = tets_[static_cast<std::size_t>(e)][static_cast<std::size_t>(a)];
        mesh.tets(e, a) = static_cast<std::int32_t>(
            std::lower_bound(nodes.begin(), nodes.end(), name) - nodes.begin());
      }
    return mesh;
  }

  struct EdgeHash {
    std::size_t operator()(const std::pair<std::int32_t, std::int32_t>& edge) const {
      return std::hash<std::int64_t>()((std::int64_t{edge.first} << 32) ^ edge.second);
    }
  };
  const Lattice& lattice_;
  const Solid& solid_;
  std::vector<signed char> side_;
  std::vector<Cut> cuts_;
  std::unordered_map<std::int32_t, Vec> warped_;
  std::unordered_map<std::pair<std::int32_t, std::int32_t>, std::int32_t, EdgeHash> cut_at_;
  std::vector<std::array<std::int32_t, 4>> tets_;
};

}  // namespace

RawMesh stuff(const Lattice& lattice, const Solid& solid) {
  NMP_CHECK(lattice.cells[0] > 0 && lattice.cells[1] > 0 && lattice.cells[2] > 0,
            "a lattice has cells along each axis");
  NMP_CHECK(
      lattice.n_points() <= kMostLatticePoints,
      text("a lattice has at most ", kMostLatticePoints, " points, got ", lattice.n_points()));
  return Stuffer(lattice, solid).run();
}

}  // namespace nmp::fem
