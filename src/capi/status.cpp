#include "capi/status.h"

#include <algorithm>
#include <cmath>
#include <new>
#include <string_view>

#include "base/check.h"

namespace nmp::capi {

namespace {

constexpr std::size_t kMaxBytes = 1024;
thread_local char last_error[kMaxBytes] = "";

// What printable() shows, and line feeds, as they are; other bytes as \xNN: paths may hold
// anything.
void append(std::string_view text, std::size_t& end) {
  constexpr char kDigits[] = "0123456789abcdef";
  while (!text.empty() && end + 5 < kMaxBytes) {
    const std::size_t n = text[0] == '\n' ? 1 : shown_bytes(text);
    if (n > 0) {
      end += text.copy(last_error + end, n);
    } else {
      const auto byte = static_cast<unsigned char>(text[0]);
      for (const char c : {'\\', 'x', kDigits[byte >> 4], kDigits[byte & 15]})
        last_error[end++] = c;
    }
    text.remove_prefix(std::max<std::size_t>(n, 1));
  }
  last_error[end] = 0;
}

// Of a message that is too long, the beginning and the end: the reason stands behind a path.
nmp_status keep(nmp_status status, const char* function, std::string_view message) {
  constexpr std::size_t kHead = 300, kTail = 500;
  std::size_t end = 0;
  append(function, end);
  append(": ", end);
  if (message.size() > kHead + kTail) {
    append(message.substr(0, kHead), end);
    append(" ... ", end);
    message.remove_prefix(message.size() - kTail);
  }
  append(message, end);
  return status;
}

}  // namespace

nmp_status keep_error(const char* function) noexcept {
  try {
    throw;
  } catch (const CallbackError& error) {
    return keep(NMP_ERROR_CALLBACK, function, error.what());
  } catch (const OrderError& error) {
    return keep(NMP_ERROR_ORDER, function, error.what());
  } catch (const std::bad_alloc&) {
    return keep(NMP_ERROR_MEMORY, function, "out of memory");
  } catch (const std::length_error&) {
    return keep(NMP_ERROR_MEMORY, function, "out of memory");
  } catch (const std::exception& error) {
    const int code = exit_code(error);
    const bool argument =
        code == 1 && dynamic_cast<const std::invalid_argument*>(&error) != nullptr;
    return keep(argument ? NMP_ERROR_ARGUMENT : static_cast<nmp_status>(code), function,
                error.what());
  } catch (...) {
    return keep(NMP_ERROR_INTERNAL, function, "an error of unknown kind");
  }
}

void need(const void* pointer, const char* name) {
  if (!pointer) throw std::invalid_argument(text(name, " is NULL"));
}

void need_size(std::size_t n, std::size_t wanted, const char* name) {
  if (n != wanted) throw std::invalid_argument(text(name, " has ", n, " items, expected ", wanted));
}

void need_struct(std::size_t size, std::size_t wanted, const char* name, const char* origin) {
  if (size != wanted)
    throw std::invalid_argument(text(name, "->struct_size is ", size, ", expected ", wanted,
                                     ": begin with ", origin, " of the same nmp.h"));
}

void need_buffer(const void* pointer, std::size_t n, std::size_t wanted, const char* name) {
  need_size(n, wanted, name);
  if (wanted > 0) need(pointer, name);
}

void need_finite(const double* values, std::size_t n, const char* name) {
  for (std::size_t i = 0; i < n; ++i)
    if (!std::isfinite(values[i]))
      throw std::invalid_argument(text(name, "[", i, "] is not finite: ", values[i]));
}

}  // namespace nmp::capi

extern "C" {

const char* nmp_status_name(nmp_status status) {
  switch (status) {
    case NMP_OK:
      return "NMP_OK";
    case NMP_ERROR_INTERNAL:
      return "NMP_ERROR_INTERNAL";
    case NMP_ERROR_ARGUMENT:
      return "NMP_ERROR_ARGUMENT";
    case NMP_ERROR_INPUT:
      return "NMP_ERROR_INPUT";
    case NMP_ERROR_NUMERICAL:
      return "NMP_ERROR_NUMERICAL";
    case NMP_ERROR_IO:
      return "NMP_ERROR_IO";
    case NMP_ERROR_MEMORY:
      return "NMP_ERROR_MEMORY";
    case NMP_ERROR_CALLBACK:
      return "NMP_ERROR_CALLBACK";
    case NMP_ERROR_ORDER:
      return "NMP_ERROR_ORDER";
  }
  return "no nmp_status";
}

const char* nmp_last_error(void) { return nmp::capi::last_error; }
}
