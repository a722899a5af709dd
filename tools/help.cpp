// nmp help: the pages of the documentation; nmp completion: for a shell's Tab key.
//   nmp help                  which pages there are
//   nmp help formats | less
//   source <(nmp completion bash)

#include <algorithm>
#include <cctype>
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

// The words that a value may be, from the name of its type: "y z" of "y|z" and of "TEXT:{y,z}",
// "cube spot" of "cube|spot|FILE".
std::string value_words(const CLI::Option& option) {
  std::string type = option.get_type_name();
  if (const std::size_t brace = type.find('{'); brace != std::string::npos) {
    type = type.substr(brace + 1, type.find('}') - brace - 1);
    std::replace(type.begin(), type.end(), ',', '|');
  }
  std::istringstream alternatives(type);
  std::string words;
  for (std::string word; std::getline(alternatives, word, '|');)
    if (!word.empty() && std::islower(static_cast<unsigned char>(word[0])))
      words += (words.empty() ? "" : " ") + word;
  return words;
}

// A branch of _nmp_words below.
std::string branch(const std::string& patterns, const std::string& words,
                   const std::string& options) {
  return "    " + patterns + ") words='" + words + "'" +
         (options.empty() ? "" : " options='" + options + "'") + " ;;\n";
}

// Of a command and those below it: "data gen" itself, what each of its options takes ("data gen
// --seed"; none of a flag), and its arguments ("data gen #1").
std::string branches(const CLI::App& app, const std::string& name) {
  std::string commands, options, below;
  const auto add = [](std::string& list, const std::string& word) {
    list += (list.empty() ? "" : " ") + word;
  };
  const std::string before = name.empty() ? "" : name + " ";
  for (const CLI::App* command : app.get_subcommands({})) {
    add(commands, command->get_name());
    below += branches(*command, before + command->get_name());
  }
  Index n_arguments = 0;
  for (const CLI::Option* option : app.get_options()) {
    std::string patterns;
    const auto add_pattern = [&](const std::string& word) {
      patterns += (patterns.empty() ? "'" : " | '") + before + word + "'";
    };
    for (const std::string& each : option->get_lnames()) add(options, "--" + each);
    if (option->get_items_expected_max() == 0) continue;  // a flag
    if (option->get_positional()) add_pattern(text("#", ++n_arguments));
    for (const std::string& each : option->get_lnames()) add_pattern("--" + each);
    for (const std::string& each : option->get_snames()) add_pattern("-" + each);
    below += branch(patterns, value_words(*option), "");
  }
  return branch("'" + name + "'", commands, options) + below;
}

// Options are offered for words that begin with a dash, else what the place takes; where none of
// that fits, the shell completes files and folders.
std::string completion_for(const std::string& shell, const CLI::App& root) {
  return "# Completion of nmp for " + shell + ": source <(nmp completion " + shell + ")\n" +
         (shell == "zsh" ? "autoload -U +X bashcompinit && bashcompinit\n" : "") +
         "_nmp_words() {\n"
         "  words='' options=''\n"
         "  case \"$1\" in\n" +
         branches(root, "") +
         "    *) return 1 ;;\n"
         "  esac\n"
         "}\n"
         "_nmp() {\n"
         "  local words='' options='' command='' last='' each i arguments=0\n"
         "  local word=${COMP_WORDS[COMP_CWORD]}\n"
         "  for ((i = 1; i < COMP_CWORD; ++i)); do\n"
         "    each=${COMP_WORDS[i]}\n"
         "    if [ \"$each\" = '=' ]; then\n"
         "      last=${last:-=}\n"  // bash splits --split=val and time.frames=20 into three words
         "    elif [ -n \"$last\" ]; then\n"
         "      last=''\n"
         "    elif [ \"${each#-}\" != \"$each\" ]; then\n"
         "      if _nmp_words \"$command${command:+ }$each\"; then last=$each; fi\n"
         "    elif [ $arguments = 0 ] && _nmp_words \"$command${command:+ }$each\"; then\n"
         "      command=\"$command${command:+ }$each\"\n"
         "    else\n"
         "      arguments=$((arguments + 1))\n"
         "    fi\n"
         "  done\n"
         "  if [ \"$word\" = '=' ]; then word=''; fi\n"
         "  if [ -n \"$last\" ]; then\n"
         "    _nmp_words \"$command${command:+ }$last\"\n"
         "  elif [ \"${word#-}\" != \"$word\" ]; then\n"
         "    _nmp_words \"$command\"\n"
         "    words=$options\n"
         "  elif ! _nmp_words \"$command${command:+ }#$((arguments + 1))\"; then\n"
         "    _nmp_words \"$command\"\n"
         "  fi\n"
         "  COMPREPLY=($(compgen -W \"$words\" -- \"$word\"))\n"
         "}\n"
         "complete -o default -F _nmp nmp\n";
}

}  // namespace

void add_help(CLI::App& app) {
  CLI::App& help =
      common::add_command(app, "help", "Print a page of the documentation",
                          "Without a topic it lists the pages.", {"nmp help", "nmp help formats"});
  const auto topic = std::make_shared<std::string>();
  help.add_option("TOPIC", *topic, "Name of a page")->type_name(common::alternatives(doc_names()));
  help.callback([topic] { show_page(*topic); });

  CLI::App& completion = common::add_command(
      app, "completion", "Print what a shell needs to complete nmp's command lines", "",
      {"source <(nmp completion bash)", "nmp completion bash > /etc/bash_completion.d/nmp"});
  const auto shell = std::make_shared<std::string>("bash");
  common::one_of(completion.add_option("SHELL", *shell, "Which shell"), {"bash", "zsh"})
      ->required();
  completion.callback([&app, shell] { common::print(completion_for(*shell, app)); });
}

}  // namespace nmp
