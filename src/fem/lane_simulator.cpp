#include "fem/lane_simulator.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/guard.h"
#include "fem/lanes.h"

namespace nmp::fem {

namespace {

// A vertex of a group of trajectories, one trajectory per lane.
struct Point {
  Lanes at[kParts][3];
  double get(int i, Index lane) const { return at[lane / kWidth][i][lane % kWidth]; }
  void set(int i, Index lane, double value) { at[lane / kWidth][i][lane % kWidth] = value; }
};

struct Flags {
  LaneFlags good[kParts];  // all bits of a lane are 1 until something is wrong with it
  bool is_good(Index lane) const { return good[lane / kWidth][lane % kWidth] != 0; }
};

Flags all_good() {
  Flags flags;
  for (LaneFlags& part : flags.good) part = ~LaneFlags{};
  return flags;
}

Flags all_of(const std::vector<Flags>& flags) {
  Flags all = all_good();
  for (const Flags& each : flags)
    for (int part = 0; part < kParts; ++part) all.good[part] &= each.good[part];
  return all;
}

constexpr Index kElementsPerChunk = 512;
constexpr Index kVerticesPerChunk = 256;

// What both laws see of an element: the deformed edges from corner 0, D_s = [d1, d2, d3], with
// component i of d_b in d[3 (b - 1) + i]. They give V P grad N_a, minus the force on corner
// a = 1, 2, 3, in f[3 (a - 1) + i]; corner 0 takes minus their sum. At rest D_s = D, and
// B = (D^T D)^-1 holds all products grad N_a . grad N_b.
struct Rest {
  Mat3<double> B;
  double volume;
};

struct Corners {
  std::int32_t vertex[4], slot[4];
};

// A symmetric 3x3: 00, 01, 02, 11, 12, 22.
constexpr int kEntry[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};

inline void cross(const Lanes* a, const Lanes* b, Lanes* c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

// f_a = sum_b d_b K_ba.
template <class Scalar>
inline void multiply_edges(const Lanes* d, const Scalar* K, Lanes* f) {
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i)
      f[3 * a + i] =
          d[i] * K[kEntry[0][a]] + d[3 + i] * K[kEntry[1][a]] + d[6 + i] * K[kEntry[2][a]];
}

// P = mu F + (lambda ln J - mu) F^-T, where V cof(F) grad N_a is the area vector of the deformed
// face opposite to a, n_a / 6 with n_1 = d2 x d3 and so on, and V F grad N_a = V sum_b d_b B_ba:
//   V P grad N_a = sum_b d_b (mu V B)_ba + (lambda ln J - mu) V / q n_a,
//   q = d1 . n_1 = 6 V J.
struct NeoHookeanLanes {
  struct Element {
    double S[6];  // mu V B
    double inverse_det, volume;
    Corners corners;
  };
  double mu, lambda;

  Element element(const Rest& rest) const {
    Element e;
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b) e.S[kEntry[a][b]] = mu * rest.volume * rest.B(a, b);
    e.inverse_det = 1 / (6 * rest.volume);
    e.volume = rest.volume;
    return e;
  }

  void force(const Element& e, const Lanes* d, Lanes* f, LaneFlags& good) const {
    Lanes n[9];
    cross(d + 3, d + 6, n);
    cross(d + 6, d, n + 3);
    cross(d, d + 3, n + 6);
    const Lanes q = d[0] * n[0] + d[1] * n[1] + d[2] * n[2];
    const Lanes J = q * e.inverse_det;
    good &= J > 0.0;
    const Lanes c = (lambda * natural_log(J) - mu) * e.volume / q;
    multiply_edges(d, e.S, f);
    for (int k = 0; k < 9; ++k) f[k] += c * n[k];
  }
};

// With E2 = D_s^T D_s - D^T D, twice the Green strain in rest edge coordinates, and Q = B E2:
//   V P grad N_a = sum_b d_b K_ba,   K = V (mu Q B + lambda/2 tr(Q) B).
struct StVKLanes {
  struct Element {
    double B[6], G[6];  // G = D^T D
    double volume_mu, volume_half_lambda;
    Corners corners;
  };
  double mu, lambda;

  Element element(const Rest& rest) const {
    Element e;
    const Mat3<double> G = rest.B.inverse();
    for (int a = 0; a < 3; ++a) {
      for (int b = a; b < 3; ++b) {
        e.B[kEntry[a][b]] = rest.B(a, b);
        e.G[kEntry[a][b]] = G(a, b);
      }
    }
    e.volume_mu = rest.volume * mu;
    e.volume_half_lambda = rest.volume * lambda / 2;
    return e;
  }

  void force(const Element& e, const Lanes* d, Lanes* f, LaneFlags&) const {
    Lanes E2[6], Q[9], K[6];
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b)
        E2[kEntry[a][b]] = d[3 * a] * d[3 * b] + d[3 * a + 1] * d[3 * b + 1] +
                           d[3 * a + 2] * d[3 * b + 2] - e.G[kEntry[a][b]];
    for (int a = 0; a < 3; ++a)
      for (int b = 0; b < 3; ++b)
        Q[3 * a + b] = E2[kEntry[0][b]] * e.B[kEntry[a][0]] + E2[kEntry[1][b]] * e.B[kEntry[a][1]] +
                       E2[kEntry[2][b]] * e.B[kEntry[a][2]];
    const Lanes t = (Q[0] + Q[4] + Q[8]) * e.volume_half_lambda;
    for (int a = 0; a < 3; ++a)
      for (int b = a; b < 3; ++b)
        K[kEntry[a][b]] = (Q[3 * a] * e.B[kEntry[0][b]] + Q[3 * a + 1] * e.B[kEntry[1][b]] +
                           Q[3 * a + 2] * e.B[kEntry[2][b]]) *
                              e.volume_mu +
                          t * e.B[kEntry[a][b]];
    multiply_edges(d, K, f);
  }
};

// Adds minus the forces of elements [begin, end) to the slots of their chunk.
template <class Law>
Flags accumulate(const Law& law, const typename Law::Element* begin,
                 const typename Law::Element* end, const Point* x, Point* slots) {
  Flags flags = all_good();
  for (const auto* e = begin; e != end; ++e) {
    const Corners& c = e->corners;
    for (int part = 0; part < kParts; ++part) {
      Lanes d[9], f[9];
      for (int i = 0; i < 3; ++i) {
        const Lanes origin = x[c.vertex[0]].at[part][i];
        for (int a = 0; a < 3; ++a) d[3 * a + i] = x[c.vertex[a + 1]].at[part][i] - origin;
      }
      law.force(*e, d, f, flags.good[part]);
      for (int i = 0; i < 3; ++i) {
        slots[c.slot[0]].at[part][i] -= f[i] + f[3 + i] + f[6 + i];
        for (int a = 0; a < 3; ++a) slots[c.slot[a + 1]].at[part][i] += f[3 * a + i];
      }
    }
  }
  return flags;
}

// Sorts elements so that neighbours in space are neighbours in memory: halves across the longest
// side of the box around their centroids, again and again, cut at whole chunks.
void sort_in_space(const Matrix<double>& centroids, Index* begin, Index* end) {
  const Index n = end - begin;
  if (n <= 4) {
    std::sort(begin, end);
    return;
  }
  Vec3<double> low = centroids.row(*begin), high = low;
  for (const Index* e = begin; e != end; ++e) {
    low = low.cwiseMin(centroids.row(*e).transpose());
    high = high.cwiseMax(centroids.row(*e).transpose());
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  const Index chunks = (n + kElementsPerChunk - 1) / kElementsPerChunk;
  Index* middle = begin + (chunks > 1 ? chunks / 2 * kElementsPerChunk : n / 2);
  std::nth_element(begin, middle, end, [&](Index a, Index b) {
    return std::make_pair(centroids(a, axis), a) < std::make_pair(centroids(b, axis), b);
  });
  sort_in_space(centroids, begin, middle);
  sort_in_space(centroids, middle, end);
}

// v_T' = max(0, 1 - mu |v_N| / |v_T|) v_T of the lanes in contact, as rub() does.
void rub_lanes(double mu, const LaneFlags& touching, Lanes* v) {
  for (Index k = 0; k < kWidth; ++k) {
    if (touching[k] == 0) continue;
    const double speed = std::sqrt(v[0][k] * v[0][k] + v[1][k] * v[1][k]), most = -(mu * v[2][k]);
    const double left = speed > most ? 1 - most / speed : 0;
    v[0][k] *= left;
    v[1][k] *= left;
  }
}

}  // namespace

struct LaneSimulator::Impl {
  struct Group {  // kLanes trajectories
    std::vector<Point> x, v, slots;
    std::vector<Flags> element_flags, vertex_flags;  // one per chunk
  };

  Impl(const TetMesh<double>& mesh_in, const Physics& physics_in, double dt_in,
       Index n_trajectories_in);

  template <class Law>
  void build(const Law& law, std::vector<typename Law::Element>& elements);

  void accumulate_chunks(Group& group, Index begin, Index end) const;
  void move_vertices(Group& group, Index chunk) const;
  void advance(Index g, Index n_steps);
  void accumulate_all(Group& group);

  Index lanes_in(Index g) const { return std::min<Index>(kLanes, n_trajectories - g * kLanes); }
  void check_trajectory(Index trajectory) const {
    NMP_CHECK(trajectory >= 0 && trajectory < n_trajectories,
              text("trajectory ", trajectory, " is outside 0..", n_trajectories - 1));
  }
  State<double> state_of(Index trajectory) const;
  [[noreturn]] void fail_elements(Index g, Index lane, const std::string& when) const;
  void fail_vertices(Index g, Index lane, Index step) const;
  double det_F(const Group& group, Index lane, Index e) const;

  TetMesh<double> mesh;
  Physics physics;
  Boundary<double> boundary;
  double dt;
  Index n_trajectories, steps_done = 0;
  bool stvk;
  NeoHookeanLanes neo_hookean_law;
  StVKLanes stvk_law;
  std::vector<NeoHookeanLanes::Element> neo_hookean_elements;
  std::vector<StVKLanes::Element> stvk_elements;

  Index n_element_chunks, n_vertex_chunks;
  std::vector<Index> vertex_at;    // mesh vertex at each place in memory
  std::vector<Index> place_of;     // and its inverse
  std::vector<Index> chunk_slots;  // slots of element chunk c: [c], ..., [c + 1] - 1
  std::vector<std::int32_t> slot_begin, slots_of;  // slots of the vertex at a place, ascending
  std::vector<double> minus_h_over_m;              // by place
  std::vector<char> pinned;                        // by place
  std::vector<Group> groups;
};

LaneSimulator::Impl::Impl(const TetMesh<double>& mesh_in, const Physics& physics_in, double dt_in,
                          Index n_trajectories_in)
    : mesh(mesh_in), physics(physics_in), dt(dt_in), n_trajectories(n_trajectories_in) {
  check_explicit(physics);
  NMP_CHECK(std::isfinite(dt) && dt > 0, text("dt must be > 0 s and finite, got ", dt));
  NMP_CHECK(n_trajectories > 0, text("n_trajectories must be > 0, got ", n_trajectories));
  NMP_CHECK(physics.material.law != "projective",
            "LaneSimulator has no law \"projective\": use Simulator or ProjectiveDynamics");
  boundary = make_boundary(mesh, physics.pinned, physics.ground);
  if (physics.contact.law == "coulomb")
    boundary.friction = make_friction<double>(physics.contact.friction);
  const Lame constants = lame(physics.material.E, physics.material.nu);
  neo_hookean_law = {constants.mu, constants.lambda};
  stvk_law = {constants.mu, constants.lambda};
  stvk = physics.material.law == "stvk";
  if (stvk)
    build(stvk_law, stvk_elements);
  else
    build(neo_hookean_law, neo_hookean_elements);

  const auto n_vertices = static_cast<std::size_t>(mesh.n_vertices());
  minus_h_over_m.resize(n_vertices);
  pinned.assign(n_vertices, 0);
  for (std::size_t p = 0; p < n_vertices; ++p)
    minus_h_over_m[p] = -dt / (physics.material.density * mesh.vertex_volumes()(vertex_at[p], 0));
  for (const int v : boundary.pinned)
    pinned[static_cast<std::size_t>(place_of[std::size_t(v)])] = 1;

  n_vertex_chunks = (mesh.n_vertices() + kVerticesPerChunk - 1) / kVerticesPerChunk;
  groups.resize(static_cast<std::size_t>((n_trajectories + kLanes - 1) / kLanes));
  for (Group& group : groups) {
    group.x.resize(n_vertices);
    group.v.resize(n_vertices);
    group.slots.resize(static_cast<std::size_t>(chunk_slots.back()));
    group.element_flags.resize(static_cast<std::size_t>(n_element_chunks));
    group.vertex_flags.resize(static_cast<std::size_t>(n_vertex_chunks));
    for (std::size_t p = 0; p < n_vertices; ++p) {
      for (int i = 0; i < 3; ++i) {
        for (Index lane = 0; lane < kLanes; ++lane) {
          group.x[p].set(i, lane, mesh.rest()(vertex_at[p], i));
          group.v[p].set(i, lane, 0);
        }
      }
    }
  }
}

template <class Law>
void LaneSimulator::Impl::build(const Law& law, std::vector<typename Law::Element>& elements) {
  const Index n_tets = mesh.n_tets(), n_vertices = mesh.n_vertices();
  Matrix<double> centroids = Matrix<double>::Zero(n_tets, 3);
  for (Index e = 0; e < n_tets; ++e)
    for (int a = 0; a < 4; ++a) centroids.row(e) += mesh.rest().row(mesh.tets()(e, a)) / 4;
  std::vector<Index> order(static_cast<std::size_t>(n_tets));
  std::iota(order.begin(), order.end(), Index(0));
  sort_in_space(centroids, order.data(), order.data() + n_tets);

  // Vertices stand in the order in which the elements meet them; each chunk of elements adds up
  // forces in its own slots, one for every vertex that it touches.
  place_of.assign(static_cast<std::size_t>(n_vertices), -1);
  std::vector<std::pair<std::int32_t, std::int32_t>> vertex_slots;  // place, slot
  std::vector<std::int32_t> slot_of(static_cast<std::size_t>(n_vertices));
  std::vector<Index> chunk_of(static_cast<std::size_t>(n_vertices), -1);
  std::int32_t n_slots = 0;
  n_element_chunks = (n_tets + kElementsPerChunk - 1) / kElementsPerChunk;
  chunk_slots.assign(1, 0);
  for (Index k = 0; k < n_tets; ++k) {
    const Index e = order[static_cast<std::size_t>(k)];
    Mat3<double> gradients;  // row a - 1: grad N_a
    for (int a = 1; a < 4; ++a)
      for (int i = 0; i < 3; ++i) gradients(a - 1, i) = mesh.grad_N()(e, 3 * a + i);
    auto element = law.element({gradients * gradients.transpose(), mesh.volumes()(e, 0)});
    for (int a = 0; a < 4; ++a) {
      const auto v = static_cast<std::size_t>(mesh.tets()(e, a));
      if (place_of[v] < 0) {
        place_of[v] = static_cast<Index>(vertex_at.size());
        vertex_at.push_back(static_cast<Index>(v));
      }
      if (chunk_of[v] != k / kElementsPerChunk) {
        chunk_of[v] = k / kElementsPerChunk;
        slot_of[v] = n_slots++;
        vertex_slots.emplace_back(static_cast<std::int32_t>(place_of[v]), slot_of[v]);
      }
      element.corners.vertex[a] = static_cast<std::int32_t>(place_of[v]);
      element.corners.slot[a] = slot_of[v];
    }
    elements.push_back(element);
    if ((k + 1) % kElementsPerChunk == 0 || k + 1 == n_tets) chunk_slots.push_back(n_slots);
  }
  std::sort(vertex_slots.begin(), vertex_slots.end());
  slot_begin.assign(static_cast<std::size_t>(n_vertices) + 1, 0);
  for (const auto& [place, slot] : vertex_slots) {
    ++slot_begin[static_cast<std::size_t>(place) + 1];
    slots_of.push_back(slot);
  }
  for (std::size_t p = 1; p < slot_begin.size(); ++p) slot_begin[p] += slot_begin[p - 1];
}

void LaneSimulator::Impl::accumulate_chunks(Group& group, Index begin, Index end) const {
  for (Index c = begin; c < end; ++c) {
    const auto chunk = static_cast<std::size_t>(c);
    std::fill(group.slots.begin() + chunk_slots[chunk],
              group.slots.begin() + chunk_slots[chunk + 1], Point{});
    const Index first = c * kElementsPerChunk;
    const Index last = std::min(first + kElementsPerChunk, mesh.n_tets());
    group.element_flags[chunk] =
        stvk ? accumulate(stvk_law, stvk_elements.data() + first, stvk_elements.data() + last,
                          group.x.data(), group.slots.data())
             : accumulate(neo_hookean_law, neo_hookean_elements.data() + first,
                          neo_hookean_elements.data() + last, group.x.data(), group.slots.data());
  }
}

// v' = v + h (f_int / m + g + c (w - v)), rubbed, x' = x + h v', pins, ground: as `step` does.
void LaneSimulator::Impl::move_vertices(Group& group, Index chunk) const {
  const Index first = chunk * kVerticesPerChunk;
  const Index last = std::min(first + kVerticesPerChunk, mesh.n_vertices());
  const double h = dt, fastest = 10 * mesh.diagonal() / h, limit = fastest * fastest;
  const double hg[3] = {h * physics.gravity[0], h * physics.gravity[1], h * physics.gravity[2]};
  const double drag = physics.air.drag;
  const Lanes ground = Lanes{} + boundary.ground.value_or(0), zero{};
  Flags flags = all_good();
  for (Index p = first; p < last; ++p) {
    const auto place = static_cast<std::size_t>(p);
    const std::int32_t* slot = slots_of.data() + slot_begin[place];
    const std::int32_t* end = slots_of.data() + slot_begin[place + 1];
    for (int part = 0; part < kParts; ++part) {
      Lanes* x = group.x[place].at[part];
      Lanes* v = group.v[place].at[part];
      if (pinned[place]) {
        for (int i = 0; i < 3; ++i) {
          x[i] = Lanes{} + mesh.rest()(vertex_at[place], i);
          v[i] = Lanes{};
        }
      } else {
        for (int i = 0; i < 3; ++i) {
          Lanes minus_f = group.slots[static_cast<std::size_t>(*slot)].at[part][i];
          for (const std::int32_t* next = slot + 1; next != end; ++next)
            minus_f += group.slots[static_cast<std::size_t>(*next)].at[part][i];
          const Lanes pull = drag > 0 ? h * (drag * (physics.air.wind[i] - v[i])) : zero;
          v[i] += minus_f * minus_h_over_m[place] + hg[i];
          if (drag > 0) v[i] += pull;
        }
        if (boundary.friction) {
          const LaneFlags touching = (x[2] + h * v[2] < ground) & (v[2] < zero);
          rub_lanes(boundary.friction->value()(0, 0), touching, v);
        }
        for (int i = 0; i < 3; ++i) x[i] += h * v[i];
      }
      // A lane that is to be stopped keeps its state: the ground does not hide what went wrong.
      const LaneFlags good = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] <= limit;
      flags.good[part] &= good;
      if (boundary.ground) {
        const LaneFlags below = (x[2] < ground) & good;
        v[2] = (below & (v[2] < zero)) ? zero : v[2];
        x[2] = below ? ground : x[2];
      }
    }
  }
  group.vertex_flags[static_cast<std::size_t>(chunk)] = flags;
}

void LaneSimulator::Impl::accumulate_all(Group& group) {
  parallel_chunks(n_element_chunks, 1,
                  [&](Index begin, Index end) { accumulate_chunks(group, begin, end); });
}

void LaneSimulator::Impl::advance(Index g, Index n_steps) {
  Group& group = groups[static_cast<std::size_t>(g)];
  for (std::size_t p = 0; p < group.x.size(); ++p)  // spare lanes repeat the last trajectory
    for (int i = 0; i < 3; ++i)
      for (Index lane = lanes_in(g); lane < kLanes; ++lane) {
        group.x[p].set(i, lane, group.x[p].get(i, lanes_in(g) - 1));
        group.v[p].set(i, lane, group.v[p].get(i, lanes_in(g) - 1));
      }
  for (Index k = 1; k <= n_steps; ++k) {
    const auto when = [&] {
      return text("step ", steps_done + k, ", time ", static_cast<double>(steps_done + k) * dt,
                  " s");
    };
    accumulate_all(group);
    const Flags elements = all_of(group.element_flags);
    for (Index lane = 0; lane < kLanes; ++lane)
      if (!elements.is_good(lane)) fail_elements(g, lane, when());
    parallel_chunks(n_vertex_chunks, 1, [&](Index begin, Index end) {
      for (Index c = begin; c < end; ++c) move_vertices(group, c);
    });
    const Flags vertices = all_of(group.vertex_flags);
    for (Index lane = 0; lane < kLanes; ++lane)
      if (!vertices.is_good(lane)) fail_vertices(g, lane, steps_done + k);
  }
}

double LaneSimulator::Impl::det_F(const Group& group, Index lane, Index e) const {
  Mat3<double> d;
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i) {
      const auto at = [&](int corner) {
        return static_cast<std::size_t>(place_of[static_cast<std::size_t>(mesh.tets()(e, corner))]);
      };
      d(i, a) = group.x[at(a + 1)].get(i, lane) - group.x[at(0)].get(i, lane);
    }
  return d.determinant() / (6 * mesh.volumes()(e, 0));
}

// Element flags are read before anything moves: the positions are still those that failed.
void LaneSimulator::Impl::fail_elements(Index g, Index lane, const std::string& when) const {
  const Group& group = groups[static_cast<std::size_t>(g)];
  Index worst = 0;
  double J = det_F(group, lane, 0);
  for (Index e = 1; e < mesh.n_tets() && J > 0; ++e) {
    worst = e;
    J = det_F(group, lane, e);
  }
  throw NumericalError(text("trajectory ", g * kLanes + lane, ", ", when,
                            ": the neo-Hookean law needs 0 < det F < inf: element ", worst,
                            " has det F = ", J, "; largest speed ",
                            state_of(g * kLanes + lane).v.rowwise().norm().maxCoeff(), " m/s",
                            name_vertices(mesh, worst)));
}

void LaneSimulator::Impl::fail_vertices(Index g, Index lane, Index step) const {
  const State<double> state = state_of(g * kLanes + lane);
  try {
    check_state<double>(mesh, state.x, state.v, dt, step);
  } catch (const NumericalError& error) {
    throw NumericalError(text("trajectory ", g * kLanes + lane, ", ", error.what()));
  }
}

State<double> LaneSimulator::Impl::state_of(Index trajectory) const {
  const Group& group = groups[static_cast<std::size_t>(trajectory / kLanes)];
  const Index lane = trajectory % kLanes;
  State<double> state{Matrix<double>(mesh.n_vertices(), 3), Matrix<double>(mesh.n_vertices(), 3)};
  for (std::size_t p = 0; p < group.x.size(); ++p)
    for (int i = 0; i < 3; ++i) {
      state.x(vertex_at[p], i) = group.x[p].get(i, lane);
      state.v(vertex_at[p], i) = group.v[p].get(i, lane);
    }
  return state;
}

LaneSimulator::LaneSimulator(const TetMesh<double>& mesh, const Physics& physics, double dt,
                             Index n_trajectories)
    : impl_(std::make_unique<Impl>(mesh, physics, dt, n_trajectories)) {}

LaneSimulator::~LaneSimulator() = default;

Index LaneSimulator::n_trajectories() const { return impl_->n_trajectories; }

void LaneSimulator::set_state(Index trajectory, const State<double>& state) {
  Impl& impl = *impl_;
  impl.check_trajectory(trajectory);
  const Index n = impl.mesh.n_vertices();
  NMP_CHECK(state.x.rows() == n && state.x.cols() == 3,
            text("x must be ", n, " x 3, got ", shape(state.x)));
  NMP_CHECK(state.v.rows() == n && state.v.cols() == 3,
            text("v must be ", n, " x 3, got ", shape(state.v)));
  Impl::Group& group = impl.groups[static_cast<std::size_t>(trajectory / kLanes)];
  for (std::size_t p = 0; p < group.x.size(); ++p)
    for (int i = 0; i < 3; ++i) {
      group.x[p].set(i, trajectory % kLanes, state.x(impl.vertex_at[p], i));
      group.v[p].set(i, trajectory % kLanes, state.v(impl.vertex_at[p], i));
    }
}

State<double> LaneSimulator::state(Index trajectory) const {
  impl_->check_trajectory(trajectory);
  return impl_->state_of(trajectory);
}

Matrix<double> LaneSimulator::internal_force(Index trajectory) {
  Impl& impl = *impl_;
  impl.check_trajectory(trajectory);
  const Index g = trajectory / kLanes, lane = trajectory % kLanes;
  Impl::Group& group = impl.groups[static_cast<std::size_t>(g)];
  impl.accumulate_all(group);
  if (!all_of(group.element_flags).is_good(lane))
    impl.fail_elements(g, lane, text("after step ", impl.steps_done));
  Matrix<double> f_int = Matrix<double>::Zero(impl.mesh.n_vertices(), 3);
  for (std::size_t p = 0; p < group.x.size(); ++p)
    for (std::int32_t k = impl.slot_begin[p]; k < impl.slot_begin[p + 1]; ++k)
      for (int i = 0; i < 3; ++i)
        f_int(impl.vertex_at[p], i) -=
            group.slots[static_cast<std::size_t>(impl.slots_of[static_cast<std::size_t>(k)])].get(
                i, lane);
  return f_int;
}

// Whole rounds of one group per thread, which never wait for each other; then the remaining groups
// one after another, all threads on each. Neither choice changes a bit.
void LaneSimulator::advance(Index n_steps) {
  Impl& impl = *impl_;
  const auto n_groups = static_cast<Index>(impl.groups.size());
  const Index n_whole = n_groups / threads() * threads();
  parallel_chunks(n_whole, 1, [&](Index begin, Index end) {
    for (Index g = begin; g < end; ++g) impl.advance(g, n_steps);
  });
  for (Index g = n_whole; g < n_groups; ++g) impl.advance(g, n_steps);
  impl.steps_done += n_steps;
}

}  // namespace nmp::fem
