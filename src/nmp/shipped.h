#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace nmp {

/// A text file built into the library; `name` is its file name, of scenes and configurations
/// without the extension.
struct ShippedFile {
  const char* name;
  const char* text;
};

/// The TOML scenes of scenes/, training configurations of models/, the styles and scripts of a
/// report's page, src/nmp/page/, and the pages of docs/, in alphabetical order. The build writes
/// these tables (cmake/embed.cmake).
extern const ShippedFile kShippedScenes[];
extern const std::size_t kShippedSceneCount;
extern const ShippedFile kShippedConfigs[];
extern const std::size_t kShippedConfigCount;
extern const ShippedFile kPageFiles[];
extern const std::size_t kPageFileCount;
extern const ShippedFile kDocs[];
extern const std::size_t kDocCount;

/// Text of scenes/<name>.toml, or nullptr if no scene of that name ships.
const char* find_shipped_scene(const std::string& name);
/// Text of models/<name>.toml, or nullptr if no configuration of that name ships.
const char* find_shipped_config(const std::string& name);
/// Text of src/nmp/page/<name>, or nullptr if there is none.
const char* find_page_file(const std::string& name);
/// Text of docs/<name>.md, or nullptr if there is none.
const char* find_doc(const std::string& name);

/// The names that find_shipped_scene knows, in alphabetical order.
std::vector<std::string> shipped_scene_names();
/// The names that find_shipped_config knows, in alphabetical order.
std::vector<std::string> shipped_config_names();
/// The names that find_doc knows, in alphabetical order.
std::vector<std::string> doc_names();

}  // namespace nmp
