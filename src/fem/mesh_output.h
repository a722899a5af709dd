#pragma once

#include <algorithm>
#include <charconv>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

namespace nmp::fem {

/// A file in the making: text with the shortest decimals that read back as the same numbers, and
/// binary numbers.
class Output {
 public:
  Output& operator<<(std::string_view words) {
    text_ += words;
    return *this;
  }
  template <class T, class = std::enable_if_t<std::is_arithmetic_v<T>>>
  Output& operator<<(T value) {
    char digits[32];
    text_.append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
    return *this;
  }
  /// Three coordinates or corners, and the end of the line.
  template <class Row>
  Output& line(const Row& row) {
    for (int k = 0; k < row.size(); ++k) *this << (k > 0 ? " " : "") << row(k);
    return *this << "\n";
  }
  template <class T>
  void binary(T value, bool swap = false) {
    char bytes[sizeof(T)];
    std::memcpy(bytes, &value, sizeof(T));
    if (swap) std::reverse(bytes, bytes + sizeof(T));
    text_.append(bytes, sizeof(T));
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

}  // namespace nmp::fem
