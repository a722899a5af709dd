#include "nmp/view_sources.h"

#include <algorithm>
#include <filesystem>

#include "base/check.h"
#include "fem/material.h"

namespace nmp {

namespace {

namespace fs = std::filesystem;

constexpr std::size_t kLongestLabel = 60;
const char* const kExtension = ".safetensors";

bool exists(const std::string& path) {
  std::error_code error;
  return fs::exists(path, error);
}
bool is_folder(const std::string& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

// What a word says, its label taken off; a path that exists has none.
std::string take_label(const std::string& word, std::string& label) {
  const std::size_t equals = word.find('=');
  if (exists(word) || equals == std::string::npos) return word;
  label = word.substr(0, equals);
  if (label.empty() || label.size() > kLongestLabel)
    throw ConfigError(text(in_quotes(word), ": a label has 1 to ", kLongestLabel, " bytes"));
  return word.substr(equals + 1);
}

// The last part of a path, shortened to what a pane has room for.
std::string label_of(const Path& path) {
  const Path clean = fs::path(path).lexically_normal();
  const Path last = clean.has_filename() ? clean : clean.parent_path();
  const std::string name =
      (last.extension() == kExtension ? last.stem() : last.filename()).string();
  return name.size() > kLongestLabel ? name.substr(0, kLongestLabel) : name;
}

bool is_law(const std::string& name) {
  const std::vector<std::string>& names = fem::law_names();
  return name == "neural" || std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

ViewSource parse_view_source(const std::string& word) {
  ViewSource source;
  const std::string path = take_label(word, source.label);
  const std::size_t colon = path.rfind(':');
  source.path = path;
  if (is_folder(path)) {
    source.dataset = true;
  } else if (!exists(path)) {
    if (colon == std::string::npos || !is_folder(path.substr(0, colon)))
      throw IoError(printable(path) + ": there is no such file or folder");
    source.dataset = true;
    source.path = path.substr(0, colon);
    source.record = path.substr(colon + 1);
  }
  if (source.label.empty())
    source.label = label_of(source.path) + (source.record.empty() ? "" : " " + source.record);
  return source;
}

ViewMethod parse_view_method(const std::string& word, const Path& model) {
  ViewMethod method;
  const std::string pairing = take_label(word, method.label);
  const std::size_t plus = exists(pairing) ? std::string::npos : pairing.rfind('+');
  const std::string law = pairing.substr(0, plus);
  const bool analytic = is_law(law) && law != "neural";
  const std::string integrator = plus != std::string::npos ? pairing.substr(plus + 1)
                                 : analytic                ? "semi-implicit"
                                                           : law;
  // A module's kind; what is learned names its model.
  std::string label;
  const auto module = [&](const std::string& name, bool known, const char* kinds) -> std::string {
    const bool file = !known && exists(name);
    if (!known && !file)
      throw ConfigError(text("method ", in_quotes(word), ": expected ", kinds,
                             " or the file of a model, found ", in_quotes(name)));
    const std::string shown = file ? label_of(name) : name;
    if (label.empty() || plus != std::string::npos) label += (label.empty() ? "" : " + ") + shown;
    if (known && name != "neural") return name;
    const Path from = file ? Path(name) : model;
    if (from.empty())
      throw ConfigError("method " + in_quotes(word) +
                        " has a neural module: --model names its file");
    if (!method.model.empty() && method.model != from)
      throw ConfigError("method " + in_quotes(word) + ": both learned modules come from one model");
    method.model = from;
    return "neural";
  };
  std::string laws = "neural";
  for (const std::string& name : fem::law_names()) laws += ", " + name;
  method.constitutive = module(law, is_law(law), laws.c_str());
  method.integrator = module(integrator, integrator == "neural" || integrator == "semi-implicit",
                             "neural, semi-implicit");
  if (method.label.empty()) method.label = label;
  return method;
}

constexpr std::size_t kNamed = 12;

const Trajectory& find_record(const Dataset& dataset, const std::string& name) {
  for (const std::vector<Trajectory>* split : {&dataset.train(), &dataset.validation()})
    for (const Trajectory& record : *split)
      if (record.name() == name || record.name() == name + kExtension) return record;
  std::string names;
  std::size_t n = 0;
  for (const std::vector<Trajectory>* split : {&dataset.train(), &dataset.validation()})
    for (const Trajectory& record : *split)
      if (++n <= kNamed)
        names += (names.empty() ? "" : ", ") +
                 printable(Path(record.name()).replace_extension().string());
  if (n > kNamed) names += text(" and ", n - kNamed, " more");
  throw ConfigError(text(dataset.folder().string(), " has no record ", in_quotes(name), "; it has ",
                         names.empty() ? "none" : names));
}

}  // namespace nmp
