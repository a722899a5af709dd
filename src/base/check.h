#pragma once

#include <cstddef>
#include <exception>
#include <locale>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>

namespace nmp {

/// A value on the command line or in a configuration file that the user can correct. Exit code 2.
struct ConfigError : std::invalid_argument {
  using std::invalid_argument::invalid_argument;
};

/// A file whose content is not what its format promises. The message names the file, the place,
/// what was expected and what was found. Exit code 3.
struct InputError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// A simulation or training state that stopped being a number or left the law's domain. Exit
/// code 4.
struct NumericalError : std::runtime_error {
  using std::runtime_error::runtime_error;
  std::ptrdiff_t element = -1;  // where a law failed, if that is what happened
  std::ptrdiff_t step = -1;     // of a simulation, where the message already tells it
};

/// A system call on a file that failed. Exit code 5.
struct IoError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Process exit code of an error: 2 usage or configuration, 3 bad input, 4 numerical, 5 I/O,
/// 6 memory, 1 anything else.
int exit_code(const std::exception& error);

/// Bytes of the character that `text` begins with: 1 ... 4 if it is well-formed UTF-8 that a
/// message may show as it is; 0 for controls, marks that reorder or hide text, and bytes that are
/// no UTF-8.
std::size_t shown_bytes(std::string_view text);

/// Text of a file or command line as it may stand in a message: of bounded length, without anything
/// that a terminal would obey; bytes that are not shown are written \xNN.
std::string printable(std::string_view raw);
/// The same in single quotes.
std::string in_quotes(std::string_view raw);

namespace detail {
/// Throws std::invalid_argument with `message`; out of line so that checks stay small.
[[noreturn]] void fail_check(const std::string& message);
}  // namespace detail

/// "3 x 4" for anything with rows() and cols().
template <class Shaped>
std::string shape(const Shaped& m) {
  std::ostringstream text;
  text.imbue(std::locale::classic());
  text << m.rows() << " x " << m.cols();
  return text.str();
}

/// Joins the arguments as operator<< prints them, in any locale.
template <class... Parts>
std::string text(const Parts&... parts) {
  std::ostringstream out;
  out.exceptions(std::ios_base::badbit);  // a stream would hide that memory has run out
  out.imbue(std::locale::classic());
  out.precision(9);
  (out << ... << parts);
  return out.str();
}

}  // namespace nmp

/// Guards a public boundary, in every build: throws std::invalid_argument with the message.
#define NMP_CHECK(condition, message)                     \
  do {                                                    \
    if (!(condition)) ::nmp::detail::fail_check(message); \
  } while (false)
