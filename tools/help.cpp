// nmp help: the pages of the documentation; nmp completion: for a shell's Tab key.
//   nmp help                  which pages there are
//   nmp help formats | less
//   source <(nmp completion bash)

#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "base/check.h"
#include "common.h"
#include "nmp/config.h"
#include "nmp/shipped.h"

namespace nmp {
namespace {

// "# Embedding nmp" -> "Embedding nmp"
std::string title(const std::string& page) {
  const std::string line = page.substr(0, page.find('\n'));
  return line.substr(line.find_first_not_of("# "));
}

// A page without what only its test reads: hidden commands, and words after a fence's language.
std::string for_terminal(const std::string& page) {
  std::istringstream lines(page);
  std::string result;
  bool hidden = false, was_hidden = false;
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind("<!--", 0) == 0) hidden = true;
    if (!hidden && !(was_hidden && line.empty())) {
      const bool fence = line.rfind("```", 0) == 0;
      result += (fence ? line.substr(0, line.find(' ')) : line) + "\n";
    }
    was_hidden = hidden;
    if (line.rfind("-->", 0) == 0) hidden = false;
  }
  return result;
}

void show_page(const std::string& topic) {
  if (topic.empty()) {
    std::string text = "nmp help TOPIC prints a page, nmp COMMAND --help a command's options:\n";
    for (const std::string& name : doc_names())
      text += "  " + name + std::string(name.size() < 12 ? 12 - name.size() : 1, ' ') +
              title(find_doc(name)) + "\n";
    return common::print(text);
  }
  const char* page = find_doc(topic);
  if (!page) {
    const std::string nearest = nearest_name(topic, doc_names());
    throw ConfigError("there is no page " + in_quotes(topic) +
                      (nearest.empty() ? "" : "; did you mean " + nearest + "?") +
                      " (nmp help names them)");
  }
  common::print(for_terminal(page));
}

// Of a command and those below it, what may follow: "data gen) words='...' ;;".
std::string cases(const CLI::App& app, const std::string& name) {
  std::string words;
  const auto add = [&](const std::string& word) { words += (words.empty() ? "" : " ") + word; };
  std::string below;
  for (const CLI::App* command : app.get_subcommands({})) {
    add(command->get_name());
    below += cases(*command, name + (name.empty() ? "" : " ") + command->get_name());
  }
  for (const CLI::Option* option : app.get_options())
    for (const std::string& option_name : option->get_lnames()) add("--" + option_name);
  return "    '" + name + "') words='" + words + "' ;;\n" + below;
}

std::string completion_for(const std::string& shell, const CLI::App& root) {
  return "# Completion of nmp for " + shell + ": source <(nmp completion " + shell + ")\n" +
         (shell == "zsh" ? "autoload -U +X bashcompinit && bashcompinit\n" : "") +
         "_nmp_words() {\n"
         "  case \"$1\" in\n" +
         cases(root, "") +
         "    *) return 1 ;;\n"
         "  esac\n"
         "}\n"
         "_nmp() {\n"
         "  local words='' known='' command='' i word=${COMP_WORDS[COMP_CWORD]}\n"
         "  for ((i = 1; i < COMP_CWORD; ++i)); do\n"
         "    _nmp_words \"$command${command:+ }${COMP_WORDS[i]}\" || break\n"
         "    command+=\"${command:+ }${COMP_WORDS[i]}\"\n"
         "  done\n"
         "  _nmp_words \"$command\"\n"
         "  COMPREPLY=($(compgen -W \"$words\" -- \"$word\"))\n"
         "}\n"
         "complete -o default -F _nmp nmp\n";
}

}  // namespace

void add_help(CLI::App& app) {
  CLI::App& help = common::add_command(app, "help", "Pages of the documentation",
                                       "Without a topic it names those that there are.",
                                       {"nmp help", "nmp help formats"});
  const auto topic = std::make_shared<std::string>();
  help.add_option("topic", *topic, "Name of a page")->type_name("TOPIC");
  help.callback([topic] { show_page(*topic); });

  CLI::App& completion = common::add_command(
      app, "completion", "What a shell's Tab key needs to know", "",
      {"source <(nmp completion bash)", "nmp completion bash > /etc/bash_completion.d/nmp"});
  const auto shell = std::make_shared<std::string>("bash");
  completion.add_option("shell", *shell, "Which shell")
      ->check(CLI::IsMember({"bash", "zsh"}))
      ->required();
  completion.callback([&app, shell] { common::print(completion_for(*shell, app)); });
}

}  // namespace nmp
