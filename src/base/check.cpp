#include "base/check.h"

#include <cstdint>
#include <filesystem>
#include <new>

namespace nmp {

int exit_code(const std::exception& error) {
  if (dynamic_cast<const ConfigError*>(&error)) return 2;
  if (dynamic_cast<const InputError*>(&error)) return 3;
  if (dynamic_cast<const NumericalError*>(&error)) return 4;
  if (dynamic_cast<const IoError*>(&error)) return 5;
  if (dynamic_cast<const std::filesystem::filesystem_error*>(&error)) return 5;
  if (dynamic_cast<const std::bad_alloc*>(&error)) return 6;
  return 1;
}

std::size_t shown_bytes(std::string_view text) {
  if (text.empty()) return 0;
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned first = byte(0);
  if (first < 0x80) return first >= 0x20 && first < 0x7f ? 1 : 0;
  const std::size_t n = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
  if (first < 0xc2 || first > 0xf4 || text.size() < n) return 0;
  std::uint32_t code = first & (0xffu >> (n + 1));
  for (std::size_t i = 1; i < n; ++i) {
    if ((byte(i) & 0xc0u) != 0x80) return 0;
    code = code << 6 | (byte(i) & 0x3fu);
  }
  constexpr std::uint32_t kFirstOf[] = {0x80, 0x800, 0x10000};  // of 2, 3, 4 bytes
  const bool well_formed =
      code >= kFirstOf[n - 2] && code <= 0x10ffff && (code < 0xd800 || code > 0xdfff);
  const bool hidden = code < 0xa0 || (code >= 0x200b && code <= 0x200f) ||
                      (code >= 0x2028 && code <= 0x202e) || (code >= 0x2060 && code <= 0x206f) ||
                      code == 0xfeff;
  return well_formed && !hidden ? n : 0;
}

std::string printable(std::string_view raw) {
  constexpr std::size_t kMaxBytes = 120;
  constexpr char kDigits[] = "0123456789abcdef";
  std::string out;
  std::size_t i = 0;
  while (i < raw.size() && i < kMaxBytes) {
    if (const std::size_t n = shown_bytes(raw.substr(i))) {
      out += raw.substr(i, n);
      i += n;
    } else {
      const auto byte = static_cast<unsigned char>(raw[i++]);
      out += {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]};
    }
  }
  return i < raw.size() ? out + "..." : out;
}

std::string in_quotes(std::string_view raw) { return "'" + printable(raw) + "'"; }

namespace detail {

void fail_check(const std::string& message) { throw std::invalid_argument(message); }

}  // namespace detail
}  // namespace nmp
