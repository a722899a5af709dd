#include "common.h"

#include <nlohmann/json.hpp>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <limits>
#include <set>

#include "base/check.h"
#include "base/file.h"
#include "base/parallel.h"

namespace nmp::common {

namespace {

// -- signals

std::atomic<int> signal_seen{0};
static_assert(std::atomic<int>::is_always_lock_free, "a signal handler may touch nothing else");

void on_signal(int signal) {
  if (signal_seen.exchange(signal) != 0) ::_exit(128 + signal);
}

// -- progress

Progress* bar_on_terminal = nullptr;

std::string duration(double seconds) {
  char words[32];
  const auto s = static_cast<long long>(std::min(seconds, 3.6e8) + 0.5);
  if (s < 60) {
    std::snprintf(words, sizeof words, "%lld s", s);
  } else if (s < 3600) {
    std::snprintf(words, sizeof words, "%lld min %02lld s", s / 60, s % 60);
  } else {
    std::snprintf(words, sizeof words, "%lld h %02lld min", s / 3600, s / 60 % 60);
  }
  return words;
}

// Characters, not bytes.
std::size_t width(const std::string& utf8) {
  return static_cast<std::size_t>(
      std::count_if(utf8.begin(), utf8.end(), [](char c) { return (c & 0xC0) != 0x80; }));
}

}  // namespace

void catch_signals() {
  struct sigaction action {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART;
  for (const int signal : {SIGINT, SIGTERM}) ::sigaction(signal, &action, nullptr);
  struct sigaction hang_up {};
  ::sigaction(SIGHUP, nullptr, &hang_up);
  if (hang_up.sa_handler != SIG_IGN) ::sigaction(SIGHUP, &action, nullptr);  // not under nohup
  for (const int signal : {SIGPIPE, SIGXFSZ}) std::signal(signal, SIG_IGN);
}

bool stop_requested() { return signal_seen != 0; }
int stop_signal() { return signal_seen; }
void stop_if_requested() {
  if (stop_requested()) throw Interrupted("stopped on request");
}

void open_standard_streams() {
  for (int stream = 0; stream <= 2; ++stream) {
    if (::fcntl(stream, F_GETFD) >= 0) continue;
    // Read-only even for stdout: a result that cannot be delivered is an error. The lowest free
    // descriptor is `stream` itself.
    if (::open("/dev/null", stream == 2 ? O_WRONLY : O_RDONLY) != stream) ::_exit(5);
  }
}

std::string dump(const nlohmann::ordered_json& json) {
  return json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

void print(const std::string& text) {
  if (bar_on_terminal) bar_on_terminal->clear();
  const bool done = std::fwrite(text.data(), 1, text.size(), stdout) == text.size();
  if (!done || std::fflush(stdout) != 0)
    throw IoError(std::string("cannot write to standard output: ") + std::strerror(errno));
}

std::string harmless(const std::string& text) {
  std::string out;
  for (const char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if ((byte < 0x20 && c != '\n') || byte == 0x7f) {
      out += "\\x" + hex(byte).substr(14);
    } else {
      out += c;
    }
  }
  return out;
}

void note(const std::string& line) {
  if (bar_on_terminal) bar_on_terminal->clear();
  std::fprintf(stderr, "%s\n", harmless(line).c_str());
}

std::string table(const std::vector<std::vector<std::string>>& rows) {
  std::vector<std::size_t> widths;
  for (const auto& row : rows) {
    widths.resize(std::max(widths.size(), row.size()));
    for (std::size_t k = 0; k < row.size(); ++k) widths[k] = std::max(widths[k], width(row[k]));
  }
  std::string text;
  for (const auto& row : rows) {
    std::string line;
    for (std::size_t k = 0; k < row.size(); ++k) {
      const std::string space(widths[k] - width(row[k]), ' ');
      line += k == 0 ? row[k] + space : "  " + space + row[k];
    }
    line.erase(line.find_last_not_of(' ') + 1);
    text += line + "\n";
  }
  return text;
}

std::string number(double value, int digits) {
  char words[64];
  std::snprintf(words, sizeof words, "%.*g", digits, value);
  return words;
}

std::string count(Index n, const char* one, const char* many) {
  return text(n, " ", n == 1 ? one : many);
}

Progress::Progress(std::string what)
    : what_(std::move(what)),
      terminal_(::isatty(2) == 1),
      begin_(Clock::now()),
      last_(terminal_ ? begin_ - std::chrono::seconds(1) : begin_) {}

Progress::~Progress() { clear(); }

void Progress::update(double part, const std::string& detail) {
  const auto now = Clock::now();
  part = std::clamp(part, 0.0, 1.0);
  if (steps_ == 0 || part < part_) {
    begin_ = now;
    begin_part_ = part;
    steps_ = 0;
  }
  part_ = part;
  ++steps_;
  if (now - last_ < (terminal_ ? std::chrono::milliseconds(100) : std::chrono::milliseconds(10000)))
    return;
  last_ = now;
  const double elapsed = std::chrono::duration<double>(now - begin_).count();
  std::string line = what_;
  if (terminal_) {
    const auto filled = static_cast<std::size_t>(part * 24);
    line += " [" + std::string(filled, '=') + std::string(24 - filled, ' ') + "]";
  }
  char percent[16];
  std::snprintf(percent, sizeof percent, " %3.0f %%", 100 * part);
  line += percent;
  constexpr Index kTimed = 5;
  const double gained = part - begin_part_;
  if (steps_ > kTimed && gained > 0.001 && elapsed > 0.5)
    line += ", " + duration(elapsed * (1 - part) / gained) + " left";
  if (!detail.empty()) line += "  " + detail;
  if (terminal_) {
    std::fprintf(stderr, "\r\033[K%s", line.c_str());
    drawn_ = true;
    bar_on_terminal = this;
  } else {
    std::fprintf(stderr, "%s\n", line.c_str());
  }
  std::fflush(stderr);
}

void Progress::clear() {
  if (drawn_) std::fputs("\r\033[K", stderr);
  drawn_ = false;
  if (bar_on_terminal == this) bar_on_terminal = nullptr;
}

CLI::Validator whole_number(std::int64_t low, std::int64_t high) {
  const auto check = [low, high](std::string& word) {
    std::int64_t n = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), n);
    const bool ok =
        error == std::errc() && end == word.data() + word.size() && n >= low && n <= high;
    return ok ? std::string()
              : text("expected an integer from ", low, " to ", high, ", found ", in_quotes(word));
  };
  return CLI::Validator(check, "");
}

CLI::Validator real_number(double low, double high) {
  const auto check = [low, high](std::string& word) {
    double x = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), x);
    const bool ok =
        error == std::errc() && end == word.data() + word.size() && x >= low && x <= high;
    return ok ? std::string()
              : text("expected a number from ", low, " to ", high, ", found ", in_quotes(word));
  };
  return CLI::Validator(check, "");
}

std::string alternatives(const std::vector<std::string>& words) {
  std::string list;
  for (const std::string& word : words) list += (list.empty() ? "" : "|") + word;
  return list;
}

CLI::Option* one_of(CLI::Option* option, const std::vector<std::string>& words) {
  return option->type_name(alternatives(words))->check(CLI::IsMember(words).description(""));
}

void add_json(CLI::App& app, Flags& flags) {
  app.add_flag("--json", flags.json, "Write one JSON document to stdout, and nothing else there");
}

CLI::Option* add_force(CLI::App& app, Flags& flags) {
  return app.add_flag("--force", flags.force, "Replace what exists");
}

void add_threads(CLI::App& app) {
  app.add_option_function<int>(
         "--threads", [](int n) { set_threads(n); },
         "Number of threads; the results are the same for any number (default: all)")
      ->type_name("N")
      ->check(whole_number(1, 1024));
}

void add_seed(CLI::App& app, Flags& flags) {
  app.add_option("--seed", flags.seed, "Seed of everything random")
      ->type_name("N")
      ->check(whole_number(0, std::numeric_limits<std::int64_t>::max()));
}

CLI::Option* add_split(CLI::App& app, std::string& split, const char* what) {
  const auto short_name = [](std::string& word) {
    if (word == "validation") word = "val";
    return std::string();
  };
  return one_of(app.add_option("--split", split, what), {"val", "train", "validation"})
      ->transform(CLI::Validator(short_name, ""));
}

void add_set(CLI::App& app, Flags& flags) {
  app.add_option("--set", flags.set, "Replace a setting, such as time.frames=200; may be repeated")
      ->type_name("KEY=VALUE")
      ->default_str("")
      ->allow_extra_args(false);
}

namespace {

class HelpFormat : public CLI::Formatter {
 public:
  std::string make_option_opts(const CLI::Option* option) const override {
    std::string words;
    if (option->get_type_size() != 0) {
      const std::string type = option->get_type_name();
      if (!type.empty() && !(option->get_positional() && type == "TEXT")) words += " " + type;
      std::string value = option->get_default_str();
      if (value.size() >= 2 && value.front() == '[' && value.back() == ']')
        value = value.substr(1, value.size() - 2);  // a list
      if (!value.empty() && !option->get_required()) words += "=" + value;
      const bool says_more = type.size() >= 3 && type.compare(type.size() - 3, 3, "...") == 0;
      if (option->get_expected_max() == CLI::detail::expected_max_vector_size && !says_more)
        words += " ...";
      if (option->get_required()) words += " REQUIRED";
    }
    if (!option->get_envname().empty()) words += " (Env:" + option->get_envname() + ")";
    const auto add_names = [&](const char* what, const std::set<CLI::Option*>& options) {
      if (options.empty()) return;
      words += what;
      for (const CLI::Option* other : options) words += " " + other->get_name();
    };
    add_names(" Needs:", option->get_needs());
    add_names(" Excludes:", option->get_excludes());
    return words;
  }
};

}  // namespace

std::shared_ptr<CLI::FormatterBase> help_format() { return std::make_shared<HelpFormat>(); }

CLI::App& add_command(CLI::App& parent, const std::string& name, const std::string& summary,
                      const std::string& details, std::initializer_list<const char*> examples) {
  CLI::App& app = *parent.add_subcommand(name, summary);
  std::string footer = details.empty() ? "Examples:" : details + "\n\nExamples:";
  for (const char* example : examples) footer += std::string("\n  ") + example;
  app.footer(footer);
  app.option_defaults()->always_capture_default();
  return app;
}

}  // namespace nmp::common
