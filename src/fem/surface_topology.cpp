#include "fem/surface_topology.h"

#include <Eigen/Geometry>
#include <array>
#include <tuple>
#include <utility>

namespace nmp::fem {

// An edge as one of its triangles sees it: ascending places, and whether it runs along them so.
struct SurfaceTopology::Side {
  std::int32_t low, high, triangle;
  bool ascends;
  bool same_edge(const Side& other) const { return low == other.low && high == other.high; }
  bool operator<(const Side& other) const {
    return std::tie(low, high, triangle) < std::tie(other.low, other.high, other.triangle);
  }
};

SurfaceTopology::SurfaceTopology(const RawSurface& surface)
    : place(number_places(surface.vertices)),
      joined(surface.vertices.rows()),
      degenerate(surface.triangles.rows()),
      repeated(surface.triangles.rows()),
      two_sided(surface.triangles.rows()),
      open(surface.triangles.rows()),
      non_manifold(surface.triangles.rows()),
      not_orientable(surface.triangles.rows()),
      turned(surface.triangles.rows()),
      triangles(surface.triangles.rows(), 3) {
  for (std::size_t v = 0; v < place.size(); ++v) {
    if (place[v] < n_places) joined.mark(static_cast<Index>(v));
    n_places = std::max(n_places, Index{place[v]} + 1);
  }
  for (Index f = 0; f < triangles.rows(); ++f) {
    for (int a = 0; a < 3; ++a) {
      triangles(f, a) = place[static_cast<std::size_t>(surface.triangles(f, a))];
    }
    const auto row = triangles.row(f);
    if (row(0) == row(1) || row(1) == row(2) || row(2) == row(0)) degenerate.mark(f);
  }
  const Marks in_both_senses = find_repeated();
  turn(surface, find_edges());
  find_two_sided(in_both_senses);
  if (two_sided.count() > 0) turn(surface, find_edges());  // now without them
  for (Index f = 0; f < triangles.rows(); ++f)
    if (turned[f]) std::swap(triangles(f, 1), triangles(f, 2));
  find_parts();
}

// Of triangles on the same places the first one stays.
Marks SurfaceTopology::find_repeated() {
  struct Named {
    std::array<std::int32_t, 3> name;
    bool even;
    Index f;
    bool operator<(const Named& other) const {
      return std::tie(name, f) < std::tie(other.name, other.f);
    }
  };
  std::vector<Named> all;
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (degenerate[f]) continue;
    const std::int32_t a = triangles(f, 0), b = triangles(f, 1), c = triangles(f, 2);
    Named named{{a, b, c}, ((a < b) + (b < c) + (c < a)) == 2, f};
    std::sort(named.name.begin(), named.name.end());
    all.push_back(named);
  }
  std::sort(all.begin(), all.end());
  Marks in_both_senses(triangles.rows());
  for (std::size_t i = 0, next; i < all.size(); i = next) {
    for (next = i + 1; next < all.size() && all[next].name == all[i].name; ++next) {
      repeated.mark(all[next].f);
      if (all[next].even != all[i].even) in_both_senses.mark(all[i].f);
    }
  }
  return in_both_senses;
}

void SurfaceTopology::find_two_sided(const Marks& in_both_senses) {
  std::vector<char> all_in_both(static_cast<std::size_t>(triangles.rows()), 1), ends(all_in_both);
  std::fill(ends.begin(), ends.end(), 0);
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (!kept(f)) continue;
    const auto r = static_cast<std::size_t>(region[static_cast<std::size_t>(f)]);
    if (!in_both_senses[f]) all_in_both[r] = 0;
    if (open[f] || non_manifold[f]) ends[r] = 1;
  }
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (!kept(f)) continue;
    const auto r = static_cast<std::size_t>(region[static_cast<std::size_t>(f)]);
    if (all_in_both[r] && ends[r]) two_sided.mark(f);
  }
}

std::vector<SurfaceTopology::Side> SurfaceTopology::find_edges() {
  open = non_manifold = Marks(triangles.rows());
  std::vector<Side> sides;
  for (Index f = 0; f < triangles.rows(); ++f) {
    for (int a = 0; kept(f) && a < 3; ++a) {
      const std::int32_t i = triangles(f, a), j = triangles(f, (a + 1) % 3);
      sides.push_back({std::min(i, j), std::max(i, j), static_cast<std::int32_t>(f), i < j});
    }
  }
  std::sort(sides.begin(), sides.end());
  for (std::size_t i = 0, next; i < sides.size(); i = next) {
    for (next = i + 1; next < sides.size() && sides[next].same_edge(sides[i]);) ++next;
    for (std::size_t k = i; k < next; ++k) {
      if (next - i == 1) open.mark(sides[k].triangle);
      if (next - i > 2) non_manifold.mark(sides[k].triangle);
    }
  }
  return sides;
}

// Walks over edges of two triangles and turns each triangle as the one it comes from; then, in each
// region reached so, turns back all if that leaves more of the area as the file has it.
void SurfaceTopology::turn(const RawSurface& surface, const std::vector<Side>& sides) {
  struct Link {
    std::int32_t from, to;
    bool against;  // both run along their edge the same way
    bool operator<(const Link& other) const {
      return std::tie(from, to, against) < std::tie(other.from, other.to, other.against);
    }
  };
  std::vector<Link> links;
  for (std::size_t i = 0, next; i < sides.size(); i = next) {
    for (next = i + 1; next < sides.size() && sides[next].same_edge(sides[i]);) ++next;
    if (next - i != 2) continue;
    const Side &a = sides[i], &b = sides[i + 1];
    const bool against = a.ascends == b.ascends;
    links.push_back({a.triangle, b.triangle, against});
    links.push_back({b.triangle, a.triangle, against});
  }
  std::sort(links.begin(), links.end());
  std::vector<std::size_t> begin(static_cast<std::size_t>(triangles.rows()) + 1, 0);
  for (const Link& link : links) ++begin[static_cast<std::size_t>(link.from) + 1];
  for (std::size_t f = 1; f < begin.size(); ++f) begin[f] += begin[f - 1];

  const auto area = [&](std::int32_t f) {
    const Vec3<double> x0 = load_vec3<double>(surface.vertices, surface.triangles(f, 0));
    return (load_vec3<double>(surface.vertices, surface.triangles(f, 1)) - x0)
        .cross(load_vec3<double>(surface.vertices, surface.triangles(f, 2)) - x0)
        .norm();
  };
  turned = not_orientable = Marks(triangles.rows());
  region.assign(static_cast<std::size_t>(triangles.rows()), -1);
  std::int32_t n_regions = 0;
  std::vector<std::int32_t> members;
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (region[static_cast<std::size_t>(f)] >= 0 || !kept(f)) continue;
    members.assign(1, static_cast<std::int32_t>(f));
    region[static_cast<std::size_t>(f)] = n_regions;
    double area_turned = 0, area_left = 0;
    for (std::size_t k = 0; k < members.size(); ++k) {
      const std::int32_t from = members[k];
      (turned[from] ? area_turned : area_left) += area(from);
      for (std::size_t l = begin[static_cast<std::size_t>(from)];
           l < begin[static_cast<std::size_t>(from) + 1]; ++l) {
        const bool to_turned = turned[from] != links[l].against;
        std::int32_t& its_region = region[static_cast<std::size_t>(links[l].to)];
        if (its_region < 0) {
          its_region = n_regions;
          if (to_turned) turned.mark(links[l].to);
          members.push_back(links[l].to);
        } else if (turned[links[l].to] != to_turned) {
          not_orientable.mark(links[l].to);
        }
      }
    }
    if (area_turned > area_left) {
      for (const std::int32_t g : members) turned.set[static_cast<std::size_t>(g)] ^= 1;
    }
    ++n_regions;
  }
}

void SurfaceTopology::find_parts() {
  Groups groups(n_places);
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (!kept(f)) continue;
    groups.join(triangles(f, 0), triangles(f, 1));
    groups.join(triangles(f, 0), triangles(f, 2));
  }
  std::vector<std::int32_t> number(static_cast<std::size_t>(n_places), -1);
  part.assign(static_cast<std::size_t>(triangles.rows()), -1);
  for (Index f = 0; f < triangles.rows(); ++f) {
    if (!kept(f)) continue;
    std::int32_t& n = number[static_cast<std::size_t>(groups.root(triangles(f, 0)))];
    if (n < 0) n = static_cast<std::int32_t>(n_parts++);
    part[static_cast<std::size_t>(f)] = n;
  }
}

}  // namespace nmp::fem
