#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "fem/tet_mesh.h"

namespace nmp {

/// One row of the speed table: a ratio to something measured in turns with it, or a count.
struct BenchRow {
  std::string name;             // as BenchOptions::only takes it
  std::string what, unit;       // in words; of value, empty for a ratio
  double value = 0;             // median; NaN if the row was skipped
  double spread = 0;            // interquartile range / median; 0 for what is counted once
  double good = 0, great = 0;   // goals
  bool less_is_better = false;  // which side of them is wanted
  std::string verdict;          // "great", "good", "short", "skipped"
  std::string note;             // what was measured, in numbers; why it was skipped
};

/// A time that another program may be compared with (bench/pytorch.py).
struct BenchTime {
  std::string name, what;
  double seconds = 0, spread = 0;  // as in BenchRow
};

/// Heap use between a start and a reading.
struct HeapUse {
  std::size_t allocations = 0;
  std::size_t peak_bytes = 0;  // most bytes held at once of what was allocated since the start
};
/// The host program's counter; without one, rows that count are skipped.
struct HeapMeter {
  std::function<void()> start;
  std::function<HeapUse()> read;  // and stop counting
};

struct BenchOptions {
  std::vector<std::string> only;  // names of rows and times; empty: every row, no time
  double seconds = 2;             // to spend on a row, however many repetitions that makes
  std::size_t repetitions = 15;   // that are made anyway
  std::string bob;                // mesh file of BOB; empty: a cube takes its place where one may
  HeapMeter heap;
  /// Called before every repetition with the name of its row; may throw to end it all.
  std::function<void(const std::string&)> progress;
};

struct BenchResult {
  std::vector<BenchRow> rows;
  std::vector<BenchTime> times;
  // What they were measured on.
  int threads = 0, simd_bits = 0;
  std::string peak_instructions;
  std::string body;  // of the rows that move one: "bob", or "cube"
  Index n_vertices = 0, n_tets = 0;
  double h = 0;  // its step [s]
};

/// Names of the rows, then of the times.
std::vector<std::string> bench_row_names();
std::vector<std::string> bench_time_names();

/// A row with its goals, not measured yet. @throws std::invalid_argument  for an unknown name
BenchRow bench_row(const std::string& name);

/// "great", "good" or "short".
std::string bench_verdict(double value, double good, double great, bool less_is_better);

/// The rows of the speed table that need no other software. Repetitions of a row and of its
/// reference take turns; a row is judged by the median of their ratios.
/// @throws ConfigError  for an unknown name, with the nearest known one; InputError, IoError for
///         the mesh file; NumericalError if what was measured is wrong
BenchResult bench(const BenchOptions& options);

std::string to_json(const BenchResult& result);

}  // namespace nmp
