#include "nmp/config.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <list>
#include <map>
#include <numeric>
#include <set>
#include <system_error>
#include <tuple>
#include <utility>

#include "base/file.h"

#define TOML_EXCEPTIONS 1
#define TOML_ENABLE_FORMATTERS 0
#define TOML_MAX_NESTED_VALUES 64
#include <toml++/impl/preprocessor.h>
// Two places where the parser promises the compiler what a file need not keep. That what follows a
// '[' begins a key ("[="): an abort in debug builds; without the assertion it is refused. And that
// letters beyond ASCII fall into certain ranges when it looks for blanks: they are none.
#undef TOML_ASSERT
#undef TOML_ASSERT_ASSUME
#define TOML_ASSERT(condition) static_assert(true)
#define TOML_ASSERT_ASSUME(condition) static_assert(true)
#include <toml++/impl/forward_declarations.h>
#undef TOML_UNREACHABLE
#define TOML_UNREACHABLE return false
#include <toml++/impl/unicode.h>
#undef TOML_UNREACHABLE
#define TOML_UNREACHABLE __builtin_unreachable()
#include <toml++/toml.h>

namespace nmp {
namespace {

constexpr std::size_t kMaxText = 1u << 20;
constexpr std::size_t kMaxDepth = 64;
constexpr std::size_t kMaxKey = 256;  // bytes of a whole dotted key
static_assert(TOML_MAX_NESTED_VALUES == kMaxDepth);

bool is_control(char c) {
  const auto byte = static_cast<unsigned char>(c);
  return byte < 0x20 || byte == 0x7f;
}

bool is_bare_key_char(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
         c == '-';
}

bool is_bare_key(std::string_view part) {
  return !part.empty() && std::all_of(part.begin(), part.end(), is_bare_key_char);
}

std::string hex_byte(char c) { return hex(static_cast<unsigned char>(c)).substr(14); }

// Unlike operator<<, of no locale.
std::string place(const std::string& name, std::size_t line, std::size_t column) {
  return name + ":" + std::to_string(line) + ":" + std::to_string(column);
}

std::string place(const std::string& name, const toml::source_region& region) {
  return place(name, region.begin.line, region.begin.column);
}

std::size_t skip_string(const std::string& text, std::size_t i) {
  const char quote = text[i];
  const std::string fence(3, quote);
  const bool multi_line = text.compare(i, 3, fence) == 0;
  i += multi_line ? 3 : 1;
  for (; i < text.size(); ++i) {
    if (text[i] == '\\' && quote == '"') {
      ++i;
    } else if (multi_line && text.compare(i, 3, fence) == 0) {
      i += 3;
      for (int extra = 0; extra < 2 && i < text.size() && text[i] == quote; ++extra) ++i;
      return i;
    } else if (!multi_line && (text[i] == quote || text[i] == '\n')) {
      return i + 1;
    }
  }
  return i;
}

// Every part of a dotted key is a table inside a table: the parser, and the end of what it built,
// would recurse as deep as a hostile key is long. So keys are measured before anything is parsed.
void check_keys(const std::string& text, const std::string& name) {
  std::size_t dots = 0, line = 1, line_begin = 0;
  for (std::size_t i = 0; i < text.size();) {
    const char c = text[i];
    if (c == '"' || c == '\'') {
      const std::size_t end = std::min(skip_string(text, i), text.size());
      for (; i < end; ++i) {
        if (text[i] != '\n') continue;
        ++line;
        line_begin = i + 1;
        dots = 0;
      }
      continue;
    }
    if (c == '#') {
      i = std::min(text.find('\n', i), text.size());
      continue;
    }
    if (c == '.' && ++dots == kMaxDepth) {
      throw ConfigError(place(name, line, i - line_begin + 1) + ": expected a key of at most " +
                        std::to_string(kMaxDepth) + " parts, found more");
    }
    if (c == '\n' || c == '=' || c == ',' || c == '[' || c == ']' || c == '{' || c == '}') dots = 0;
    ++i;
    if (c == '\n') {
      ++line;
      line_begin = i;
    }
  }
}

toml::table parse_toml(const std::string& text, const std::string& name) {
  if (text.size() > kMaxText) {
    throw ConfigError(name + ": expected at most " + std::to_string(kMaxText) + " bytes, found " +
                      std::to_string(text.size()));
  }
  check_keys(text, name);
  try {
    return toml::parse(std::string_view(text));
  } catch (const toml::parse_error& error) {
    throw ConfigError(place(name, error.source()) + ": " + printable(error.description()));
  }
}

std::string describe(const toml::node& node) {
  switch (node.type()) {
    case toml::node_type::string:
      return "the string " + in_quotes(node.ref<std::string>());
    case toml::node_type::integer:
      return std::to_string(node.ref<std::int64_t>());
    case toml::node_type::floating_point:
      return decimal(node.ref<double>());
    case toml::node_type::boolean:
      return node.ref<bool>() ? "true" : "false";
    case toml::node_type::array:
      return "an array";
    case toml::node_type::table:
      return "a table";
    default:
      return "a date or time";
  }
}

std::string range_text(const std::string& kind, const std::string& low, const std::string& high) {
  return kind + " from " + low + " to " + high;
}

std::string joined(const std::vector<std::string>& names) {
  std::string out;
  for (const std::string& name : names) out += (out.empty() ? "" : ", ") + name;
  return out.empty() ? "none" : out;
}

std::string last_part(const std::string& key) { return key.substr(key.rfind('.') + 1); }

// Levenshtein's distance, or `limit` + 1 if it is larger.
std::size_t edit_distance(const std::string& a, const std::string& b, std::size_t limit) {
  if (std::max(a.size(), b.size()) - std::min(a.size(), b.size()) > limit) return limit + 1;
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i + 1;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i] == b[j] ? 0 : 1);
      diagonal = row[j + 1];
      row[j + 1] = std::min({replaced, row[j] + 1, diagonal + 1});
    }
  }
  return std::min(row.back(), limit + 1);
}

std::string did_you_mean(const std::string& name) {
  return name.empty() ? "" : "; did you mean '" + name + "'?";
}

}  // namespace

struct ConfigReader::State {
  // A value that is no table, or an empty table.
  struct Leaf {
    const toml::node* node;
    std::string name;  // of the file, or "--set key=value"
    bool in_file;      // or an override
    toml::source_region key_region;

    std::string place_of(const toml::node& part) const {
      return in_file ? place(name, part.source()) : name;
    }
  };

  void add(const toml::node& node, const std::string& key, std::size_t depth,
           const toml::source_region& key_region, const std::string& name, bool in_file) {
    const std::string where = in_file ? place(name, key_region) : name;
    if (depth > kMaxDepth) {
      throw ConfigError(where + ": expected tables at most " + std::to_string(kMaxDepth) +
                        " deep, found more");
    }
    if (key.size() > kMaxKey) {
      throw ConfigError(where + ": expected a key of at most " + std::to_string(kMaxKey) +
                        " bytes, found " + in_quotes(key));
    }
    const toml::table* table = node.as_table();
    if (table == nullptr || table->empty()) {
      leaves[key] = Leaf{&node, name, in_file, key_region};
      return;
    }
    for (const auto& [part, value] : *table) {
      const std::string_view raw = part.str();
      std::string child = key.empty() ? "" : key + ".";
      child += is_bare_key(raw) ? std::string(raw) : '"' + printable(raw) + '"';
      add(value, child, depth + 1, in_file ? part.source() : key_region, name, in_file);
    }
  }

  void apply_override(const std::string& option) {
    const std::string name = "--set " + printable(option);
    const std::size_t equals = option.find('=');
    if (equals == std::string::npos) {
      throw ConfigError(name + ": expected key=value, found no '='");
    }
    const std::string key = option.substr(0, equals), value = option.substr(equals + 1);
    std::size_t n_parts = 0;
    for (std::size_t begin = 0; begin <= key.size();) {
      const std::size_t end = std::min(key.find('.', begin), key.size());
      if (!is_bare_key(std::string_view(key).substr(begin, end - begin)) || ++n_parts > kMaxDepth) {
        throw ConfigError(name + ": expected a key such as table.key before the '=', found " +
                          in_quotes(key));
      }
      begin = end + 1;
    }
    if (std::any_of(value.begin(), value.end(), is_control)) {
      throw ConfigError(name + ": expected a value without control characters");
    }

    // Everything at the key, below it or in the place of its tables gives way.
    leaves.erase(key);
    const std::string below = key + ".";
    for (auto leaf = leaves.lower_bound(below);
         leaf != leaves.end() && leaf->first.compare(0, below.size(), below) == 0;) {
      leaf = leaves.erase(leaf);
    }
    for (std::size_t dot = key.find('.'); dot != std::string::npos; dot = key.find('.', dot + 1)) {
      leaves.erase(key.substr(0, dot));
    }
    add(parse_value(value, name), key, n_parts, toml::source_region{}, name, false);
  }

  // A value in TOML's syntax, or a bare word for a string.
  const toml::node& parse_value(const std::string& value, const std::string& name) {
    const auto is_word_char = [](char c) {
      return is_bare_key_char(c) || c == '.' || c == '/' || c == ':' || c == '+' || c == '@';
    };
    try {
      documents.push_back(parse_toml("value = " + value, name));
    } catch (const ConfigError&) {
      if (value.empty() || !std::all_of(value.begin(), value.end(), is_word_char)) {
        throw ConfigError(name + ": expected a TOML value or a bare word, found " +
                          in_quotes(value));
      }
      documents.push_back(toml::table{{"value", value}});
    }
    return *documents.back().get("value");
  }

  // The value at a key that the program knows.
  const Leaf* find(const std::string& key) {
    known.insert(key);
    const auto found = leaves.find(key);
    return found == leaves.end() ? nullptr : &found->second;
  }

  [[noreturn]] static void fail(const Leaf& leaf, const toml::node& part, const std::string& key,
                                const std::string& expected) {
    throw ConfigError(leaf.place_of(part) + ": " + (leaf.in_file ? key + ": " : "") + "expected " +
                      expected + ", found " + describe(part));
  }

  static double number(const Leaf& leaf, const toml::node& part, const std::string& key, double low,
                       double high, const char* or_else = "") {
    const bool is_integer = part.is_integer();
    const bool in_range = [&] {
      if (!is_integer && !part.is_floating_point()) return false;
      const double value =
          is_integer ? static_cast<double>(part.ref<std::int64_t>()) : part.ref<double>();
      return std::isfinite(value) && value >= low && value <= high;
    }();
    if (!in_range) {
      const bool bounded = std::isfinite(low) && std::isfinite(high);
      fail(leaf, part, key,
           (bounded ? range_text("a number", decimal(low), decimal(high))
                    : std::string("a finite number")) +
               or_else);
    }
    return is_integer ? static_cast<double>(part.ref<std::int64_t>()) : part.ref<double>();
  }

  static std::int64_t integer(const Leaf& leaf, const toml::node& part, const std::string& key,
                              std::int64_t low, std::int64_t high) {
    if (!part.is_integer() || part.ref<std::int64_t>() < low || part.ref<std::int64_t>() > high) {
      fail(leaf, part, key, range_text("an integer", std::to_string(low), std::to_string(high)));
    }
    return part.ref<std::int64_t>();
  }

  // The known key that an unknown one may stand for: near as a whole, or the same in another table.
  std::string nearest_key(const std::string& key) const {
    const std::vector<std::string> names(known.begin(), known.end());
    std::string near = nearest_name(key, names);
    if (!near.empty()) return near;
    std::vector<std::string> last_parts;
    last_parts.reserve(names.size());
    for (const std::string& name : names) last_parts.push_back(last_part(name));
    const std::string last = nearest_name(last_part(key), last_parts);
    const auto found = std::find(last_parts.begin(), last_parts.end(), last);
    return last.empty() ? "" : names[static_cast<std::size_t>(found - last_parts.begin())];
  }

  bool is_known_table(const std::string& key) const {
    const auto after = known.lower_bound(key + ".");
    return after != known.end() && after->compare(0, key.size() + 1, key + ".") == 0;
  }

  std::list<toml::table> documents;  // own the nodes
  std::map<std::string, Leaf> leaves;
  std::set<std::string> known;
};

ConfigReader::ConfigReader(std::unique_ptr<State> state) : state_(std::move(state)) {}
ConfigReader::~ConfigReader() = default;
ConfigReader::ConfigReader(ConfigReader&&) noexcept = default;

ConfigReader ConfigReader::parse(const std::string& text, const std::string& name,
                                 const std::vector<std::string>& overrides) {
  auto state = std::make_unique<State>();
  state->documents.push_back(parse_toml(text, name));
  const toml::table& root = state->documents.back();
  if (!root.empty()) state->add(root, "", 0, root.source(), name, true);
  for (const std::string& option : overrides) state->apply_override(option);
  return ConfigReader(std::move(state));
}

bool ConfigReader::has(const std::string& key) const { return state_->find(key) != nullptr; }

bool ConfigReader::is_override(const std::string& key) const {
  const State::Leaf* leaf = state_->find(key);
  return leaf != nullptr && !leaf->in_file;
}

void ConfigReader::drop(const std::string& key) {
  if (has(key) && !is_override(key)) state_->leaves.erase(key);
}

double ConfigReader::number(const std::string& key, double fallback, double low, double high) {
  const State::Leaf* leaf = state_->find(key);
  return leaf == nullptr ? fallback : State::number(*leaf, *leaf->node, key, low, high);
}

std::optional<double> ConfigReader::number_or_none(const std::string& key,
                                                   std::optional<double> fallback, double low,
                                                   double high) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  if (leaf->node->is_string() && leaf->node->ref<std::string>() == "none") return std::nullopt;
  return State::number(*leaf, *leaf->node, key, low, high, " or \"none\"");
}

std::int64_t ConfigReader::integer(const std::string& key, std::int64_t fallback, std::int64_t low,
                                   std::int64_t high) {
  const State::Leaf* leaf = state_->find(key);
  return leaf == nullptr ? fallback : State::integer(*leaf, *leaf->node, key, low, high);
}

bool ConfigReader::boolean(const std::string& key, bool fallback) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  if (!leaf->node->is_boolean()) State::fail(*leaf, *leaf->node, key, "true or false");
  return leaf->node->ref<bool>();
}

std::string ConfigReader::word(const std::string& key, const std::string& fallback) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  if (!leaf->node->is_string()) State::fail(*leaf, *leaf->node, key, "a string");
  return leaf->node->ref<std::string>();
}

std::string ConfigReader::choice(const std::string& key, const std::string& fallback,
                                 const std::vector<std::string>& allowed) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  const bool is_allowed =
      leaf->node->is_string() &&
      std::find(allowed.begin(), allowed.end(), leaf->node->ref<std::string>()) != allowed.end();
  if (!is_allowed) {
    State::fail(*leaf, *leaf->node, key,
                (allowed.size() > 1 ? "one of the strings " : "the string ") + joined(allowed));
  }
  return leaf->node->ref<std::string>();
}

Vec3<double> ConfigReader::vector(const std::string& key, const Vec3<double>& fallback) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  const toml::array* array = leaf->node->as_array();
  if (array == nullptr || array->size() != 3) {
    State::fail(*leaf, *leaf->node, key, "an array of three numbers");
  }
  Vec3<double> result;
  for (Index i = 0; i < 3; ++i) {
    result(i) =
        State::number(*leaf, (*array)[static_cast<std::size_t>(i)], key, -HUGE_VAL, HUGE_VAL);
  }
  return result;
}

std::vector<std::int64_t> ConfigReader::integers(const std::string& key,
                                                 const std::vector<std::int64_t>& fallback,
                                                 std::int64_t low, std::int64_t high) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  const toml::array* array = leaf->node->as_array();
  if (array == nullptr) State::fail(*leaf, *leaf->node, key, "an array of integers");
  std::vector<std::int64_t> result;
  result.reserve(array->size());
  for (const toml::node& part : *array) {
    result.push_back(State::integer(*leaf, part, key, low, high));
  }
  return result;
}

Matrix<double> ConfigReader::rows(const std::string& key, const Matrix<double>& fallback,
                                  Index n_columns) {
  const State::Leaf* leaf = state_->find(key);
  if (leaf == nullptr) return fallback;
  const toml::array* array = leaf->node->as_array();
  const std::string expected = "an array of arrays of " + std::to_string(n_columns) + " numbers";
  if (array == nullptr) State::fail(*leaf, *leaf->node, key, expected);
  Matrix<double> result(static_cast<Index>(array->size()), n_columns);
  for (Index i = 0; i < result.rows(); ++i) {
    const toml::node& part = (*array)[static_cast<std::size_t>(i)];
    const toml::array* row = part.as_array();
    if (row == nullptr || static_cast<Index>(row->size()) != n_columns) {
      const std::string size =
          row == nullptr ? "" : " (one has " + std::to_string(row->size()) + ")";
      State::fail(*leaf, part, key, expected + size);
    }
    for (Index k = 0; k < n_columns; ++k) {
      result(i, k) =
          State::number(*leaf, (*row)[static_cast<std::size_t>(k)], key, -HUGE_VAL, HUGE_VAL);
    }
  }
  return result;
}

void ConfigReader::finish() const {
  // The first in the file; overrides after it.
  using Entry = std::pair<const std::string, State::Leaf>;
  const Entry* first = nullptr;
  const auto order = [](const Entry& entry) {
    const auto& begin = entry.second.key_region.begin;
    return std::make_tuple(!entry.second.in_file, begin.line, begin.column);
  };
  for (const Entry& entry : state_->leaves) {
    const auto& [key, leaf] = entry;
    if (state_->known.count(key) > 0) continue;
    if (leaf.node->is_table() && state_->is_known_table(key)) continue;  // empty
    if (first == nullptr || order(entry) < order(*first)) first = &entry;
  }
  if (first == nullptr) return;
  const auto& [key, leaf] = *first;
  const std::string where = leaf.in_file ? place(leaf.name, leaf.key_region) : leaf.name;
  if (state_->is_known_table(key)) {
    throw ConfigError(where + ": expected a table [" + key + "], found " + describe(*leaf.node));
  }
  throw ConfigError(where + ": unknown key " + in_quotes(key) +
                    did_you_mean(state_->nearest_key(key)));
}

void ConfigReader::fail(const std::string& key, const std::string& what) const {
  const auto found = state_->leaves.find(key);
  if (found == state_->leaves.end()) throw ConfigError(key + ": " + what);
  const State::Leaf& leaf = found->second;
  throw ConfigError(leaf.place_of(*leaf.node) + ": " + key + ": " + what);
}

namespace {

// A double as TOML knows it: with a point or an exponent, so that no reader takes it for an
// integer.
std::string toml_number(double value) {
  NMP_CHECK(std::isfinite(value), "a configuration holds finite numbers, got " + decimal(value));
  const std::string digits = decimal(value);
  return digits.find_first_of(".e") == std::string::npos ? digits + ".0" : digits;
}

}  // namespace

std::string toml_string(const std::string& value) {
  std::string out = "\"";
  for (const char c : value) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (is_control(c)) {
      out += "\\u00" + hex_byte(c);
    } else {
      out += c;
    }
  }
  return out + '"';
}

void ConfigWriter::write(const std::string& key, const std::string& value) {
  const std::size_t dot = key.rfind('.');
  const std::string table = dot == std::string::npos ? "" : key.substr(0, dot);
  if (table != table_) text_ += (text_.empty() ? "[" : "\n[") + table + "]\n";
  table_ = table;
  text_ += last_part(key) + " = " + value + "\n";
}

double ConfigWriter::number(const std::string& key, double value, double, double) {
  write(key, toml_number(value));
  return value;
}

std::optional<double> ConfigWriter::number_or_none(const std::string& key,
                                                   std::optional<double> value, double, double) {
  write(key, value ? toml_number(*value) : "\"none\"");
  return value;
}

std::int64_t ConfigWriter::integer(const std::string& key, std::int64_t value, std::int64_t,
                                   std::int64_t) {
  write(key, std::to_string(value));
  return value;
}

bool ConfigWriter::boolean(const std::string& key, bool value) {
  write(key, value ? "true" : "false");
  return value;
}

std::string ConfigWriter::word(const std::string& key, const std::string& value) {
  write(key, toml_string(value));
  return value;
}

std::string ConfigWriter::choice(const std::string& key, const std::string& value,
                                 const std::vector<std::string>&) {
  return word(key, value);
}

Vec3<double> ConfigWriter::vector(const std::string& key, const Vec3<double>& value) {
  write(key, "[" + toml_number(value(0)) + ", " + toml_number(value(1)) + ", " +
                 toml_number(value(2)) + "]");
  return value;
}

std::vector<std::int64_t> ConfigWriter::integers(const std::string& key,
                                                 const std::vector<std::int64_t>& value,
                                                 std::int64_t, std::int64_t) {
  std::string list;
  for (const std::int64_t i : value) list += (list.empty() ? "" : ", ") + std::to_string(i);
  write(key, "[" + list + "]");
  return value;
}

Matrix<double> ConfigWriter::rows(const std::string& key, const Matrix<double>& value, Index) {
  if (value.rows() == 0) return value;
  std::string list;
  for (Index i = 0; i < value.rows(); ++i) {
    list += i > 0 ? ", [" : "[";
    for (Index k = 0; k < value.cols(); ++k) list += (k > 0 ? ", " : "") + toml_number(value(i, k));
    list += "]";
  }
  write(key, "[" + list + "]");
  return value;
}

std::string read_config_text(const std::string& name, const char* shipped, const std::string& kind,
                             const std::vector<std::string>& shipped_names) {
  if (shipped != nullptr) return shipped;
  std::error_code ignored;
  if (!std::filesystem::exists(std::filesystem::status(name, ignored))) {
    throw ConfigError(in_quotes(name) + ": expected a file or the name of a " + kind +
                      " that ships (" + joined(shipped_names) + "), found neither" +
                      did_you_mean(nearest_name(name, shipped_names)));
  }
  return read_text(name, kMaxText);
}

std::string nearest_name(const std::string& word, const std::vector<std::string>& known) {
  std::string nearest;
  std::size_t best = 0;
  for (const std::string& name : known) {
    const std::size_t limit = std::max<std::size_t>(1, std::min(name.size(), word.size()) / 3);
    const std::size_t distance = edit_distance(word, name, limit);
    if (distance > limit || (!nearest.empty() && distance >= best)) continue;
    nearest = name;
    best = distance;
  }
  return nearest;
}

std::string decimal(double value) {
  char digits[32];
  const std::to_chars_result result = std::to_chars(digits, digits + sizeof digits, value);
  return std::string(digits, result.ptr);
}

}  // namespace nmp
