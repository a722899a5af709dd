// nmp bench: how fast this build is on this machine, as ratios to what is measured beside it.
//   nmp bench
//   nmp bench --json --meshes meshes > bench.json
//   nmp bench --only svd --only gradient
//   nmp bench --sweep -o bench.html

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>

#include "base/check.h"
#include "base/file.h"
#include "base/parallel.h"
#include "common.h"
#include "heap_meter.h"
#include "nmp/bench.h"
#include "nmp/bench_sweep.h"

namespace nmp {
namespace {

struct Options {
  int threads = 1;
  std::vector<std::string> only;
  double seconds = 2;            // for each row
  std::size_t repetitions = 15;  // of each row, at least
  std::string meshes;            // folder of bob.msh
  bool sweep = false;
  Index vertices = 100'000, steps = 1000;  // largest of the sweep
  std::string out;                         // page of the sweep
  common::Flags flags;
};

std::string to_table(const BenchResult& result) {
  std::vector<std::vector<std::string>> lines{
      {"row", "value", "spread", "good", "great", "verdict"}};
  std::string notes;
  for (const BenchRow& row : result.rows) {
    const std::string than = row.less_is_better ? "<= " : ">= ";
    const std::string unit = row.unit.empty() ? "" : " " + row.unit;
    lines.push_back({row.what, std::isfinite(row.value) ? common::number(row.value) + unit : "-",
                     common::number(100 * row.spread) + " %",
                     than + common::number(row.good) + unit,
                     than + common::number(row.great) + unit, row.verdict});
    notes += row.name + ": " + row.note + "\n";
  }
  std::string all = result.rows.empty() ? "" : common::table(lines) + "\n" + notes;
  lines.clear();
  for (const BenchTime& time : result.times)
    lines.push_back({time.what, common::number(1e3 * time.seconds) + " ms",
                     "+- " + common::number(100 * time.spread) + " %"});
  return all + common::table(lines) +
         text(result.threads, result.threads == 1 ? " thread" : " threads",
              ", built for vectors of ", result.simd_bits, " bits\n");
}

// Empty if a folder that is there lacks it: the rows say so.
std::string find_bob(const std::string& folder) {
  if (folder.empty()) return "";
  if (!std::filesystem::is_directory(folder)) throw IoError("no folder " + in_quotes(folder));
  const Path bob = Path(folder) / "bob.msh";
  return std::filesystem::exists(bob) ? bob.string() : "";
}

void run_sweep(const Options& o) {
  if (!o.out.empty()) refuse_to_overwrite(o.out, o.flags.force);
  common::Progress progress("bench");
  SweepOptions options;
  options.seconds = o.seconds;
  options.max_vertices = o.vertices;
  options.max_steps = o.steps;
  options.progress = [&](double part, const std::string& what) {
    common::stop_if_requested();
    progress.update(part, what);
  };
  const Sweep result = sweep(options);
  progress.clear();
  if (!o.out.empty()) write_text(o.out, sweep_page(result));
  if (o.flags.json) return common::print(to_json(result) + "\n");
  std::string all;
  for (const auto& rows : sweep_tables(result)) all += common::table(rows) + "\n";
  common::print(all + (o.out.empty() ? "" : o.out + "\n"));
}

void run(const Options& o) {
  set_threads(o.threads);
  if (o.sweep) return run_sweep(o);
  common::Progress progress("bench");
  BenchOptions options;
  options.only = o.only;
  options.seconds = o.seconds;
  options.repetitions = o.repetitions;
  options.bob = find_bob(o.meshes);
  options.heap = common::heap_meter();
  const std::vector<std::string> names = o.only.empty() ? bench_row_names() : o.only;
  options.progress = [&](const std::string& row) {
    common::stop_if_requested();
    const auto done = std::find(names.begin(), names.end(), row) - names.begin();
    progress.update(static_cast<double>(done) / static_cast<double>(names.size()), row);
  };
  const BenchResult result = bench(options);
  progress.clear();
  common::print(o.flags.json ? to_json(result) + "\n" : to_table(result));
}

}  // namespace

void add_bench(CLI::App& app) {
  std::string names;
  for (const std::string& name : bench_row_names()) names += " " + name;
  names += "\nTimes, measured if asked for by --only:";
  for (const std::string& name : bench_time_names()) names += " " + name;
  CLI::App& bench = common::add_command(
      app, "bench", "Measure how fast this build is, against references measured beside it",
      "Every row is a median over repetitions, taking turns with its reference; the "
      "spread\nis the interquartile range over the median. Leave the machine alone meanwhile.\n"
      "Rows:" +
          names,
      {"nmp bench", "nmp bench --json --meshes meshes > bench.json",
       "nmp bench --only svd --only gradient", "nmp bench --sweep -o bench.html"});
  const auto o = std::make_shared<Options>();
  bench.add_option("--only", o->only, "Measure this row alone; may be repeated")
      ->type_name("NAME")
      ->default_str("")
      ->allow_extra_args(false);
  bench.add_option("--seconds", o->seconds, "Time to spend on a row")
      ->type_name("S")
      ->check(common::real_number(0, 86400));
  bench
      .add_option("--repetitions", o->repetitions, "Repetitions of a row, if need be in more time")
      ->type_name("N")
      ->check(common::whole_number(1, 1'000'000));
  bench.add_option("--meshes", o->meshes, "Folder that holds bob.msh")
      ->type_name("DIR")
      ->envname("NMP_MESHES");
  CLI::Option* sweep = bench.add_flag(
      "--sweep", o->sweep, "Measure cost against the size of a cube and the length of a rollout");
  bench.add_option("--vertices", o->vertices, "Largest cube of the sweep")
      ->type_name("N")
      ->needs(sweep)
      ->check(common::whole_number(1000, 100'000'000));
  bench.add_option("--steps", o->steps, "Longest rollout of the sweep")
      ->type_name("N")
      ->needs(sweep)
      ->check(common::whole_number(1, 1'000'000));
  bench.add_option("-o,--output", o->out, "HTML file for the plots of the sweep")
      ->type_name("FILE")
      ->needs(sweep);
  bench.add_option("--threads", o->threads, "Number of threads; the goals are meant for one")
      ->type_name("N")
      ->check(common::whole_number(1, 1024));
  common::add_force(bench, o->flags);
  common::add_json(bench, o->flags);
  bench.callback([o] { run(*o); });
}

}  // namespace nmp
