#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>

namespace nmp {

/// The scalars of a small JSON document by their places: "/stress/hidden/0" (RFC 6901). For what a
/// library reads: unlike values of the JSON library, these never allocate when they are destroyed,
/// which would end a process that is out of memory.
class JsonValues {
 public:
  /// @throws std::runtime_error  for what is no JSON, or has a key twice
  static JsonValues parse(std::string_view text);

  /// Whether there is a scalar or an array.
  bool has(const std::string& place) const;
  /// Items of an array.
  std::size_t size(const std::string& place) const;
  /// @throws std::runtime_error  naming the place, if it is missing or of another type. A number
  /// may be
  ///         an integer, an integer no other number
  double number(const std::string& place) const;
  std::int64_t integer(const std::string& place) const;
  bool boolean(const std::string& place) const;
  const std::string& string(const std::string& place) const;

 private:
  struct Builder;
  using Value = std::variant<std::nullptr_t, bool, std::int64_t, double, std::string>;
  const Value& at(const std::string& place) const;
  std::map<std::string, Value> values_;
  std::map<std::string, std::size_t> sizes_;
};

}  // namespace nmp
