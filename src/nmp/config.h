#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "autodiff/types.h"
#include "base/check.h"

namespace nmp {

/// A TOML file read strictly: every key must be asked for by the program, or it is an error with
/// its line and the nearest known name. Overrides ("table.key=value", the value in TOML's syntax,
/// or a bare word for a string) replace or add keys before anything is read.
///
///     ConfigReader config = ConfigReader::parse(text, "cube.toml", {"time.frames=200"});
///     scene.frames = config.integer("time.frames", 1000, 1, 100'000'000);
///     config.finish();
///
/// Errors are ConfigError with file:line:column (or "--set"), what was expected and what was found.
class ConfigReader {
 public:
  /// @param name  stands in messages; text of at most 1 MB, nested at most 64 deep
  static ConfigReader parse(const std::string& text, const std::string& name,
                            const std::vector<std::string>& overrides = {});
  ~ConfigReader();
  ConfigReader(ConfigReader&&) noexcept;

  /// Whether there is a value; from then on the key is one that the program knows.
  bool has(const std::string& key) const;
  /// Whether its value comes from an override.
  bool is_override(const std::string& key) const;
  /// Takes a value out of the file as if it had not been there; overrides stay.
  void drop(const std::string& key);
  /// The value at a dotted key, or `fallback` if it is absent; outside [low, high] is an error.
  double number(const std::string& key, double fallback, double low, double high);
  /// A number, or the word "none".
  std::optional<double> number_or_none(const std::string& key, std::optional<double> fallback,
                                       double low, double high);
  std::int64_t integer(const std::string& key, std::int64_t fallback, std::int64_t low,
                       std::int64_t high);
  bool boolean(const std::string& key, bool fallback);
  std::string word(const std::string& key, const std::string& fallback);
  /// One of `allowed`; the error lists them.
  std::string choice(const std::string& key, const std::string& fallback,
                     const std::vector<std::string>& allowed);
  /// Three numbers.
  Vec3<double> vector(const std::string& key, const Vec3<double>& fallback);
  std::vector<std::int64_t> integers(const std::string& key,
                                     const std::vector<std::int64_t>& fallback, std::int64_t low,
                                     std::int64_t high);
  /// An array of arrays of `n_columns` numbers each: #rows x n_columns.
  Matrix<double> rows(const std::string& key, const Matrix<double>& fallback, Index n_columns);

  /// @throws ConfigError  at the first key of the file that nobody has asked for
  void finish() const;
  /// @throws ConfigError  at the place of `key`, if it is given, with what is wrong about it
  [[noreturn]] void fail(const std::string& key, const std::string& what) const;

 private:
  struct State;
  explicit ConfigReader(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// Writes what ConfigReader reads. It has the reader's functions; each writes `fallback` and
/// returns it, so that one list of keys serves both directions. Keys of a table must follow each
/// other, those without a table come first.
class ConfigWriter {
 public:
  double number(const std::string& key, double value, double low, double high);
  std::optional<double> number_or_none(const std::string& key, std::optional<double> value,
                                       double low, double high);
  std::int64_t integer(const std::string& key, std::int64_t value, std::int64_t low,
                       std::int64_t high);
  bool boolean(const std::string& key, bool value);
  std::string word(const std::string& key, const std::string& value);
  std::string choice(const std::string& key, const std::string& value,
                     const std::vector<std::string>& allowed);
  Vec3<double> vector(const std::string& key, const Vec3<double>& value);
  std::vector<std::int64_t> integers(const std::string& key, const std::vector<std::int64_t>& value,
                                     std::int64_t low, std::int64_t high);
  /// Nothing if there are no rows, so that scenes without them keep their text.
  Matrix<double> rows(const std::string& key, const Matrix<double>& value, Index n_columns);

  const std::string& text() const { return text_; }

 private:
  void write(const std::string& key, const std::string& value);
  std::string text_, table_;
};

/// The text of a configuration: the one that ships under `name`, or else a file. A path with a
/// folder ("./cube") is always a file.
/// @param shipped  text of the one that ships under this name, or nullptr
/// @throws ConfigError  listing `shipped_names` if there is no such file; IoError
std::string read_config_text(const std::string& name, const char* shipped, const std::string& kind,
                             const std::vector<std::string>& shipped_names);

/// The name in `known` with the smallest edit distance to `word`; empty if none is near.
std::string nearest_name(const std::string& word, const std::vector<std::string>& known);

/// A string as TOML writes it, in quotes.
std::string toml_string(const std::string& value);

/// The shortest decimal that reads back as the same double, in any locale.
std::string decimal(double value);

/// Whether a file has a key that is left out of the text of what does without it: such keys came
/// later, and the text of older files, by whose hash results are found again, stays as it was.
inline bool asked(const ConfigReader& config, const char* key) { return config.has(key); }
inline bool asked(const ConfigWriter&, const char*) { return false; }

}  // namespace nmp
