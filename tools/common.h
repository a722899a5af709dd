#pragma once

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "autodiff/types.h"

/// What the commands of nmp share: flags, standard streams, signals, progress. Results go to
/// stdout, everything else to stderr.
namespace nmp::common {

/// Ends a command that a signal has stopped, or the time that it was given. Exit code 128 + the
/// signal's number; where there was none, that of SIGINT.
struct Interrupted : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// From then on SIGINT, SIGTERM and SIGHUP ask for a stop; a second one ends the program at once.
/// SIGPIPE and SIGXFSZ are ignored: a reader that is gone, and a file as large as it may be, are
/// errors of writing.
void catch_signals();
/// True once a stop has been asked for.
bool stop_requested();
/// The signal that asked for it; 0 if none has.
int stop_signal();
/// @throws Interrupted  if a stop has been asked for
void stop_if_requested();

/// Puts /dev/null where a standard stream is closed, so that no file is ever opened in its place.
void open_standard_streams();
/// A JSON document for people who read it; bytes that are not UTF-8 become U+FFFD.
std::string dump(const nlohmann::ordered_json& json);
/// Writes to stdout, now. @throws IoError  if it cannot be written
void print(const std::string& text);
/// Text without what a terminal would obey: control characters but for line feeds as \xNN.
std::string harmless(const std::string& text);
/// A line on stderr, made harmless, above the progress bar if there is one.
void note(const std::string& line);

/// Columns padded to their widest cell: the first one to the left, the others to the right.
std::string table(const std::vector<std::vector<std::string>>& rows);
/// With so many significant digits.
std::string number(double value, int digits = 3);

/// "1 trajectory", "2 trajectories".
std::string count(Index n, const char* one, const char* many);

/// How far a command has come, on stderr: a bar on a terminal, else a line at most every 10 s.
/// A part that is smaller than the one before begins another piece of work. The time left is told
/// once some steps have been timed; the first is not, it makes what the others find.
class Progress {
 public:
  explicit Progress(std::string what);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// @param part  of the work that is done, in [0, 1]   @param detail  what is going on
  void update(double part, const std::string& detail = "");
  /// Says what is being done from now on.
  void rename(const std::string& what) { what_ = what; }
  /// Takes the bar off the terminal until the next update.
  void clear();

 private:
  using Clock = std::chrono::steady_clock;
  std::string what_;
  bool terminal_, drawn_ = false;
  Clock::time_point begin_, last_;
  double begin_part_ = 0, part_ = 0;
  Index steps_ = 0;  // since then
};

/// Flags that several commands have; each command takes those that do something there.
struct Flags {
  bool json = false;                  // one JSON document on stdout and nothing else there
  bool force = false;                 // replace what exists
  int threads = 0;                    // 0: as many as the machine has
  std::optional<std::uint64_t> seed;  // none: what the configuration says
  std::vector<std::string> set;       // "table.key=value"
};
/// Checks of option values. Unlike CLI11's own they refuse what does not fit an integer, and NaN.
CLI::Validator whole_number(std::int64_t low, std::int64_t high);
CLI::Validator real_number(double low, double high);

/// An option with one of these values. Its type is named "one|two": words in small letters are
/// meant as they stand, others are place holders; help says so, and nmp completion reads it.
CLI::Option* one_of(CLI::Option* option, const std::vector<std::string>& words);
/// "one|two".
std::string alternatives(const std::vector<std::string>& words);

void add_json(CLI::App& app, Flags& flags);
CLI::Option* add_force(CLI::App& app, Flags& flags);
void add_threads(CLI::App& app);
void add_seed(CLI::App& app, Flags& flags);
void add_set(CLI::App& app, Flags& flags);
/// --split: "val" or "train"; "validation" is the former.
CLI::Option* add_split(CLI::App& app, std::string& split, const char* what);

/// How help is written: no default where a value must be given, and none that is an empty list.
std::shared_ptr<CLI::FormatterBase> help_format();

/// @param summary   a sentence for the list of commands   @param details  more of them, for its
/// help
/// @param examples  command lines that work
CLI::App& add_command(CLI::App& parent, const std::string& name, const std::string& summary,
                      const std::string& details, std::initializer_list<const char*> examples);

}  // namespace nmp::common

namespace nmp {

void add_data(CLI::App& app);
/// Adds `nmp data import` to `nmp data`.
void add_data_import(CLI::App& data);
void add_mesh(CLI::App& app);
void add_train(CLI::App& app);
void add_rollout(CLI::App& app);
void add_export(CLI::App& app);
void add_eval(CLI::App& app);
void add_fit(CLI::App& app);
void add_report(CLI::App& app);
void add_view(CLI::App& app);
void add_grad_check(CLI::App& app);
void add_bench(CLI::App& app);
void add_reproduce(CLI::App& app);
void add_model(CLI::App& app);
void add_config(CLI::App& app);
void add_help(CLI::App& app);

}  // namespace nmp
