#include "nmp/shipped.h"

namespace nmp {
namespace {

const char* find(const ShippedFile* files, std::size_t count, const std::string& name) {
  for (std::size_t i = 0; i < count; ++i) {
    if (name == files[i].name) return files[i].text;
  }
  return nullptr;
}

std::vector<std::string> names(const ShippedFile* files, std::size_t count) {
  std::vector<std::string> result;
  result.reserve(count);
  for (std::size_t i = 0; i < count; ++i) result.emplace_back(files[i].name);
  return result;
}

}  // namespace

const char* find_shipped_scene(const std::string& name) {
  return find(kShippedScenes, kShippedSceneCount, name);
}

const char* find_shipped_config(const std::string& name) {
  return find(kShippedConfigs, kShippedConfigCount, name);
}

const char* find_page_file(const std::string& name) {
  return find(kPageFiles, kPageFileCount, name);
}

const char* find_doc(const std::string& name) { return find(kDocs, kDocCount, name); }

std::vector<std::string> shipped_scene_names() { return names(kShippedScenes, kShippedSceneCount); }

std::vector<std::string> shipped_config_names() {
  return names(kShippedConfigs, kShippedConfigCount);
}

std::vector<std::string> doc_names() { return names(kDocs, kDocCount); }

}  // namespace nmp
