#include "nmp/bench_sweep.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "base/parallel.h"
#include "fem/mesh_cube.h"
#include "fem/neo_hookean.h"
#include "fem/projective_dynamics.h"
#include "fem/semi_implicit_euler.h"
#include "nmp/bench_case.h"
#include "nmp/bench_samples.h"
#include "nmp/report_html.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kLeast = 3;
constexpr Index kEdges[] = {10, 14, 18, 22, 28, 36, 46, 58, 73, 92, 116};  // vertices, of cubes
constexpr Index kCube = 10;
constexpr Index kLargestFactor = 28;  // vertices of an edge; larger ones fill gigabytes

void must_hold(const RolloutEnd& end) {
  if (end.diverged) throw NumericalError("the rollout diverged " + end.reason);
}

void roll(const Simulation<float>& simulation, const BenchCase& bench, Index n_steps) {
  must_hold(roll_out<float>(simulation, bench.start(), n_steps, [](const Frame<float>&) {}));
}

// Seconds of a step in the middle of a rollout: its first steps make its memory.
double steady_step(const Simulation<float>& simulation, const BenchCase& bench) {
  constexpr Index kWarm = 2, kLast = 10;
  const Stopwatch watch;
  double begin = 0, end = 0;
  must_hold(roll_out<float>(simulation, bench.start(), kLast, [&](const Frame<float>& frame) {
    (frame.t <= kWarm ? begin : end) = watch.seconds();
  }));
  return (end - begin) / (kLast - kWarm);
}

// A cube that slides over the ground, pressed flat by a hundredth.
class SlidingCube {
 public:
  SlidingCube(Index n, double h) : mesh_(fem::cube_mesh(n, 1)), simulator_(mesh_, physics(), h) {
    state_.x = mesh_.vertices();
    state_.x.col(2) *= 0.99;
    state_.v = Matrix<double>::Zero(mesh_.n_vertices(), 3);
    state_.v.col(0).setOnes();
    simulator_.advance(state_, 2);  // the contacts' columns of the inverse are made once
  }
  // Seconds of a step.
  double step() {
    constexpr Index kSteps = 4;
    const Stopwatch watch;
    simulator_.advance(state_, kSteps);
    return watch.seconds() / kSteps;
  }

 private:
  static fem::Physics physics() {
    fem::Physics physics;
    physics.material = {"projective", 1e5, 0.45, 1000};
    physics.ground = -0.495;
    physics.contact.law = "coulomb";
    physics.contact.friction = 0.5;
    return physics;
  }
  fem::TetMesh<double> mesh_;
  fem::ProjectiveDynamics simulator_;
  fem::State<double> state_;
};

SizePoint at_size(Index n, double seconds, const std::function<void()>& each_round) {
  BenchCase bench(fem::cube_mesh(n, 1), cube_step(n));
  const fem::NeoHookean<float> law(5e5, 0.45);
  const fem::SemiImplicitEuler<float> euler(1000, {0, 0, -9.8});
  const Simulation<float> neural = bench.simulation();
  const Simulation<float> analytic{bench.mesh(), law, euler, neural.boundary, neural.h};
  constexpr Index kDifferentiated = 3;
  ad::Tape<float> tape;
  std::vector<double> neural_steps, analytic_steps, implicit_steps;
  std::vector<std::function<void()>> pieces{
      [&] { neural_steps.push_back(steady_step(neural, bench)); },
      [&] { analytic_steps.push_back(steady_step(analytic, bench)); },
      [&] { bench.gradient(tape, kDifferentiated); }};
  std::optional<SlidingCube> sliding;
  if (n <= kLargestFactor) {
    sliding.emplace(n, cube_step(n) / 2);
    pieces.emplace_back([&] { implicit_steps.push_back(sliding->step()); });
  }
  const auto times = take_turns(pieces, seconds, kLeast, each_round);
  SizePoint point{bench.mesh().n_vertices(), bench.mesh().n_tets(), summarise(neural_steps).median,
                  summarise(analytic_steps).median, summarise(times[2]).median / kDifferentiated};
  if (sliding) point.implicit = summarise(implicit_steps).median;
  return point;
}

LengthPoint at_length(BenchCase& bench, Index n_steps, double seconds,
                      const std::function<void()>& each_round) {
  ad::Tape<float> tape;
  const auto times = take_turns(
      {[&] { roll(bench.simulation(), bench, n_steps); }, [&] { bench.gradient(tape, n_steps); }},
      seconds, kLeast, each_round);
  return {n_steps, summarise(times[0]).median, summarise(times[1]).median,
          static_cast<double>(tape.peak_bytes())};
}

std::string ms(double seconds) { return report::plain(1e3 * seconds); }
std::string mb(double bytes) { return report::plain(bytes / 1e6); }

using Table = std::vector<std::vector<std::string>>;

Table size_table(const Sweep& sweep) {
  Table rows{{"vertices", "tetrahedra", "neural step [ms]", "analytic step [ms]",
              "gradient of a step [ms]", "implicit step [ms]", "µs per tetrahedron"}};
  for (const SizePoint& p : sweep.sizes)
    rows.push_back({text(p.n_vertices), text(p.n_tets), ms(p.neural), ms(p.analytic),
                    ms(p.gradient), p.implicit ? ms(*p.implicit) : "-",
                    report::plain(1e6 * p.neural / double(p.n_tets))});
  return rows;
}

Table length_table(const Sweep& sweep) {
  Table rows{{"steps", "rollout [ms]", "gradient [ms]", "gradient, ms per step", "tape [MB]"}};
  for (const LengthPoint& p : sweep.lengths)
    rows.push_back({text(p.n_steps), ms(p.neural), ms(p.gradient),
                    ms(p.gradient / double(p.n_steps)), mb(p.tape_bytes)});
  return rows;
}

std::string to_html(const Table& table) {
  std::string html = "<div class=\"scroll\"><table>\n<thead>";
  for (std::size_t i = 0; i < table.size(); ++i) {
    const std::string cell = i == 0 ? "th" : "td";
    html += "<tr>";
    for (const std::string& word : table[i])
      html += "<" + cell + ">" + escape_html(word) + "</" + cell + ">";
    html += i == 0 ? "</tr></thead>\n<tbody>\n" : "</tr>\n";
  }
  return html + "</tbody></table></div>\n";
}

struct Line {
  std::string label;
  int colour;
  std::function<double(std::size_t)> y;
};

std::string figure(const std::string& title, const std::string& x_label, const std::string& y_label,
                   const std::vector<double>& x, const std::vector<Line>& lines,
                   bool log_y = true) {
  LinePlot plot;
  plot.name = title;
  plot.x_label = x_label;
  plot.y_label = y_label;
  plot.log_x = true;
  plot.log_y = log_y;
  for (const Line& line : lines) {
    Curve curve{line.label, {line.colour, "", 2}, x, {}, {}, {}};
    for (std::size_t i = 0; i < x.size(); ++i) curve.y.push_back(line.y(i));
    plot.curves.push_back(curve);
  }
  std::vector<report::LegendItem> items;
  for (const Curve& curve : plot.curves) items.push_back({curve.stroke, curve.label});
  return "<figure><figcaption>" + escape_html(title) + "</figcaption>" + report::both_widths(plot) +
         report::legend(items) + "</figure>\n";
}

}  // namespace

Sweep sweep(const SweepOptions& options) {
  std::vector<Index> edges, lengths;
  for (const Index n : kEdges)
    if (n * n * n <= options.max_vertices || n == kCube) edges.push_back(n);
  for (Index decade = 1; decade <= options.max_steps; decade *= 10)
    for (const Index n : {decade, 3 * decade})
      if (n <= options.max_steps) lengths.push_back(n);
  // Progress by points; the last ones are the long ones.
  const double all = static_cast<double>(edges.size() + lengths.size());
  const auto tell = [&](std::size_t done, const std::string& what) {
    return [&options, part = static_cast<double>(done) / all, what] {
      if (options.progress) options.progress(part, what);
    };
  };
  Sweep result;
  result.threads = threads();
  for (const Index n : edges)
    result.sizes.push_back(
        at_size(n, options.seconds, tell(result.sizes.size(), text(n * n * n, " vertices"))));
  BenchCase bench(fem::cube_mesh(kCube, 1), cube_step(kCube));
  for (const Index n : lengths)
    result.lengths.push_back(at_length(
        bench, n, options.seconds, tell(edges.size() + result.lengths.size(), text(n, " steps"))));
  return result;
}

std::string to_json(const Sweep& sweep) {
  Json sizes = Json::array(), lengths = Json::array();
  for (const SizePoint& p : sweep.sizes)
    sizes.push_back({{"n_vertices", p.n_vertices},
                     {"n_tets", p.n_tets},
                     {"neural_step_seconds", p.neural},
                     {"analytic_step_seconds", p.analytic},
                     {"gradient_step_seconds", p.gradient},
                     {"implicit_step_seconds", p.implicit ? Json(*p.implicit) : Json()}});
  for (const LengthPoint& p : sweep.lengths)
    lengths.push_back({{"n_steps", p.n_steps},
                       {"rollout_seconds", p.neural},
                       {"gradient_seconds", p.gradient},
                       {"tape_bytes", p.tape_bytes}});
  return Json{{"threads", sweep.threads}, {"sizes", sizes}, {"lengths", lengths}}.dump(1);
}

std::vector<Table> sweep_tables(const Sweep& sweep) {
  return {size_table(sweep), length_table(sweep)};
}

std::string sweep_page(const Sweep& sweep) {
  std::vector<double> vertices, steps;
  for (const SizePoint& p : sweep.sizes) vertices.push_back(double(p.n_vertices));
  for (const LengthPoint& p : sweep.lengths) steps.push_back(double(p.n_steps));
  const auto size = [&](double SizePoint::*member, double unit) {
    return [&sweep, member, unit](std::size_t i) { return unit * sweep.sizes[i].*member; };
  };
  const auto length = [&](double LengthPoint::*member, double unit) {
    return [&sweep, member, unit](std::size_t i) { return unit * sweep.lengths[i].*member; };
  };
  const std::string threads = text(sweep.threads, sweep.threads == 1 ? " thread" : " threads");
  return report::page(
      "nmp: cost of a step",
      "<section>\n<h2>Size</h2>\n<p>One step of cubes, " + threads +
          "; medians. The analytic step is the same loop with the neo-Hookean law and "
          "semi-implicit Euler. The gradient is that of loss and step, checkpointed. The "
          "implicit step is projective dynamics in double, sliding with friction, up to " +
          text(kLargestFactor * kLargestFactor * kLargestFactor) +
          " vertices: its cost grows with the factor of its matrix.</p>\n" +
          to_html(size_table(sweep)) +
          figure("Time of a step", "vertices", "ms", vertices,
                 {{"gradient", 1, size(&SizePoint::gradient, 1e3)},
                  {"neural", 0, size(&SizePoint::neural, 1e3)},
                  {"analytic", 2, size(&SizePoint::analytic, 1e3)}}) +
          "</section>\n<section>\n<h2>Length</h2>\n<p>Whole rollouts of a cube of 1000 "
          "vertices.</p>\n" +
          to_html(length_table(sweep)) +
          figure("Time of a rollout", "steps", "ms", steps,
                 {{"gradient", 1, length(&LengthPoint::gradient, 1e3)},
                  {"neural", 0, length(&LengthPoint::neural, 1e3)}}) +
          figure("Memory of the tape", "steps", "MB", steps,
                 {{"tape", 3, length(&LengthPoint::tape_bytes, 1e-6)}}, false) +
          "</section>\n");
}

}  // namespace nmp
