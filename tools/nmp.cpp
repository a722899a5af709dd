// nmp: simulate elastic bodies, learn the simulator's modules, and measure how right they are.
//   nmp data gen cube -o data/cube --set time.frames=200 --set dataset.train=4
//   nmp train fast --data data/cube -o cube.safetensors
//   nmp eval --model cube.safetensors --data data/cube
// Exit codes: 0 done, 2 command line or configuration, 3 a file's content, 4 a simulation, training
// or check that failed, 5 reading or writing, 6 memory, 1 anything else; 128 + n after signal n,
// 130 also after --max-minutes.

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <new>
#include <string>
#include <string_view>

#include "base/check.h"
#include "common.h"
#include "launch.h"
#include "nmp/config.h"

namespace nmp {
namespace {

constexpr int kUsage = 2;
// "nmp 0.1.0", of packages "nmp 0.1.0 x86-64-v4".
constexpr const char* kVersion =
    std::string_view(NMP_LEVEL).empty() ? "nmp " NMP_VERSION : "nmp " NMP_VERSION " " NMP_LEVEL;

std::vector<std::string> command_names(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : app.get_subcommands({})) names.push_back(command->get_name());
  return names;
}

const CLI::App* find_command(const CLI::App& app, const std::string& name) {
  for (const CLI::App* command : app.get_subcommands({}))
    if (command->get_name() == name) return command;
  return nullptr;
}

std::vector<std::string> option_names(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::Option* option : app.get_options())
    for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
  return names;
}

// "; did you mean train?", also for swapped letters and for the beginning of a name.
std::string hint(const std::string& word, const std::vector<std::string>& known) {
  std::string nearest = nearest_name(word, known);
  for (const std::string& name : known) {
    const bool begins = word.size() >= 2 && name.compare(0, word.size(), word) == 0;
    const bool swapped =
        word.size() == name.size() && std::is_permutation(word.begin(), word.end(), name.begin());
    if (nearest.empty() && (begins || swapped)) nearest = name;
  }
  return nearest.empty() ? "" : "; did you mean " + nearest + "?";
}

std::string full_name(const CLI::App& app) {
  return app.get_parent() ? full_name(*app.get_parent()) + " " + app.get_name() : "nmp";
}

// What is wrong with a command line that CLI11 refused, in one sentence.
std::string explain(const CLI::App& root, const CLI::ParseError& error, int argc, char** argv) {
  // The deepest command that was named; a word that names none is the mistake itself.
  const CLI::App* app = &root;
  int i = 1;
  for (; i < argc && argv[i][0] != '-' && !command_names(*app).empty(); ++i) {
    const CLI::App* command = find_command(*app, argv[i]);
    if (!command)
      return full_name(*app) + ": there is no command " + in_quotes(argv[i]) +
             hint(argv[i], command_names(*app));
    app = command;
  }
  if (i == argc && !command_names(*app).empty()) {
    std::string names;
    for (const std::string& name : command_names(*app)) names += (names.empty() ? "" : ", ") + name;
    return full_name(*app) + ": a command is missing, one of " + names;
  }
  for (; i < argc; ++i) {
    const std::string word = std::string(argv[i]).substr(0, std::string(argv[i]).find('='));
    const auto options = option_names(*app);
    if (word.size() > 2 && word.compare(0, 2, "--") == 0 &&
        std::find(options.begin(), options.end(), word) == options.end())
      return full_name(*app) + ": there is no option " + in_quotes(word) + hint(word, options);
  }
  constexpr std::size_t kMaxBytes = 400;  // CLI11 quotes the words that it refuses in full
  const std::string what = error.what();
  return full_name(*app) + ": " + what.substr(0, kMaxBytes) +
         (what.size() > kMaxBytes ? "..." : "");
}

int run(int argc, char** argv) {
  CLI::App app{"Neural Modular Physics: elastic bodies, learned and analytic", "nmp"};
  app.set_version_flag("--version", kVersion, "Print the version");
  app.formatter(common::help_format());
  app.set_help_flag("-h,--help", "Print this help");
  app.footer(
      "Examples:\n"
      "  nmp data gen cube -o data/cube\n"
      "  nmp train fast --data data/cube -o cube.safetensors\n"
      "  nmp eval --model cube.safetensors --data data/cube\n"
      "  nmp report --model cube.safetensors --data data/cube -o report.html\n"
      "'nmp COMMAND --help' says more about a command.\n\n"
      "Exit codes:\n"
      "  0  done\n"
      "  1  an error that should not happen\n"
      "  2  a command line, scene or training configuration that is wrong\n"
      "  3  a file whose content is not what its format promises\n"
      "  4  a simulation, training or gradient check that failed\n"
      "  5  reading or writing that failed\n"
      "  6  not enough memory\n"
      "  129, 130, 143  stopped by SIGHUP, Ctrl-C or --max-minutes, SIGTERM");
  app.require_subcommand(1);
  add_data(app);
  add_mesh(app);
  add_train(app);
  add_rollout(app);
  add_export(app);
  add_eval(app);
  add_fit(app);
  add_report(app);
  add_view(app);
  add_grad_check(app);
  add_bench(app);
  add_reproduce(app);
  add_model(app);
  add_config(app);
  add_help(app);
  try {
    app.parse(argc, argv);
  } catch (const CLI::CallForHelp&) {
    common::print(app.help());
  } catch (const CLI::CallForVersion&) {
    common::print(std::string(kVersion) + "\n");
  } catch (const CLI::ParseError& error) {
    common::note(explain(app, error, argc, argv) + " (--help says what there is)");
    return kUsage;
  }
  return 0;
}

}  // namespace
}  // namespace nmp

int main(int argc, char** argv) {
  namespace common = nmp::common;
  common::open_standard_streams();
  try {
    nmp::launch(argv);
    common::catch_signals();
    return nmp::run(argc, argv);
  } catch (const common::Interrupted& stop) {
    common::note(std::string("nmp: ") + stop.what());
    const int signal = common::stop_signal();
    return 128 + (signal != 0 ? signal : SIGINT);
  } catch (const std::bad_alloc&) {
    std::fputs("nmp: out of memory\n", stderr);
    return nmp::exit_code(std::bad_alloc());
  } catch (const std::exception& error) {
    common::note(std::string("nmp: ") + error.what());
    return nmp::exit_code(error);
  }
}
