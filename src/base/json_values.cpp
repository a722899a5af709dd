#include "base/json_values.h"

#include <limits>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>
#include <vector>

#include "base/check.h"

namespace nmp {

using Json = nlohmann::json;

struct JsonValues::Builder : nlohmann::json_sax<Json> {
  explicit Builder(JsonValues& into) : result(into) {}

  JsonValues& result;
  struct Level {
    std::string place;
    bool array;
    std::size_t n = 0;  // items so far
  };
  std::vector<Level> levels;
  std::string key_;

  // Of the value that comes next.
  std::string place() {
    if (levels.empty()) return "";
    Level& level = levels.back();
    return level.place + "/" + (level.array ? std::to_string(level.n++) : key_);
  }
  bool add(Value value) {
    std::string where = place();
    if (!result.values_.emplace(where, std::move(value)).second) twice(where);
    return true;
  }
  [[noreturn]] static void twice(const std::string& where) {
    throw std::runtime_error(printable(where) + " is there twice");
  }
  bool open(bool array) {
    std::string where = place();
    if (result.sizes_.count(where)) twice(where);
    result.sizes_[where] = 0;
    levels.push_back({std::move(where), array});
    return true;
  }
  bool close() {
    result.sizes_[levels.back().place] = levels.back().n;
    levels.pop_back();
    return true;
  }

  bool null() override { return add(nullptr); }
  bool boolean(bool value) override { return add(value); }
  bool number_integer(number_integer_t value) override { return add(std::int64_t{value}); }
  bool number_unsigned(number_unsigned_t value) override {
    if (value > static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max()))
      return add(static_cast<double>(value));
    return add(static_cast<std::int64_t>(value));
  }
  bool number_float(number_float_t value, const string_t&) override { return add(value); }
  bool string(string_t& value) override { return add(std::move(value)); }
  bool binary(binary_t&) override { return false; }
  bool start_object(std::size_t) override { return open(false); }
  bool key(string_t& value) override {
    key_.clear();
    for (const char c : value) key_ += c == '/' ? std::string("~1") : std::string(1, c);
    return true;
  }
  bool end_object() override { return close(); }
  bool start_array(std::size_t) override { return open(true); }
  bool end_array() override { return close(); }
  bool parse_error(std::size_t, const std::string&, const Json::exception& error) override {
    throw std::runtime_error(error.what());
  }
};

JsonValues JsonValues::parse(std::string_view text) {
  JsonValues values;
  Builder builder(values);
  Json::sax_parse(text.begin(), text.end(), &builder);
  return values;
}

bool JsonValues::has(const std::string& place) const {
  return values_.count(place) > 0 || sizes_.count(place) > 0;
}

std::size_t JsonValues::size(const std::string& place) const {
  const auto found = sizes_.find(place);
  if (found == sizes_.end()) throw std::runtime_error("there is no list " + place);
  return found->second;
}

const JsonValues::Value& JsonValues::at(const std::string& place) const {
  const auto found = values_.find(place);
  if (found == values_.end()) throw std::runtime_error("there is no value " + place);
  return found->second;
}

double JsonValues::number(const std::string& place) const {
  const Value& value = at(place);
  if (const double* number = std::get_if<double>(&value)) return *number;
  return static_cast<double>(integer(place));
}

std::int64_t JsonValues::integer(const std::string& place) const {
  if (const auto* integer = std::get_if<std::int64_t>(&at(place))) return *integer;
  throw std::runtime_error(place + " is of another type than expected");
}

bool JsonValues::boolean(const std::string& place) const {
  if (const bool* value = std::get_if<bool>(&at(place))) return *value;
  throw std::runtime_error(place + " is not true or false");
}

const std::string& JsonValues::string(const std::string& place) const {
  if (const auto* value = std::get_if<std::string>(&at(place))) return *value;
  throw std::runtime_error(place + " is not a text");
}

}  // namespace nmp
