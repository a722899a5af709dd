#pragma once

#include <algorithm>
#include <charconv>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

namespace nmp::fem {

/// What the mesh writers share: text with the shortest decimals that read back as the same doubles,
/// and binary numbers.
class MeshOutput {
 public:
  MeshOutput& operator<<(std::string_view words) {
    text_ += words;
    return *this;
  }
  MeshOutput& operator<<(double value) { return append(value); }
  template <class T, class = std::enable_if_t<std::is_integral_v<T>>>
  MeshOutput& operator<<(T value) {
    return append(value);
  }
  /// Three coordinates or corners, and the end of the line.
  template <class Row>
  MeshOutput& line(const Row& row) {
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
  template <class T>
  MeshOutput& append(T value) {
    char digits[32];
    text_.append(digits, std::to_chars(digits, digits + sizeof digits, value).ptr);
    return *this;
  }
  std::string text_;
};

}  // namespace nmp::fem
