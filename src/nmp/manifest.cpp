#include "nmp/manifest.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "base/check.h"
#include "base/json_text.h"
#include "nmp/config.h"
#include "nmp/dataset_format.h"

namespace nmp {
namespace {

using ParsedJson = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

constexpr const char* kFormat = "nmp-dataset";
constexpr std::size_t kMaxManifest = 64u << 20;
constexpr std::size_t kMaxRecords = 200'000;  // as many as a scene may ask for

// A value of the manifest and where it stands there.
class Entry {
 public:
  Entry(const ParsedJson& value, const std::string& file, const std::string& place)
      : value_(value), file_(file), place_(place) {}

  Entry operator[](const std::string& key) const {
    const std::string place = place_.empty() ? key : place_ + "." + key;
    if (!value_.is_object()) fail("an object");
    const auto found = value_.find(key);
    if (found == value_.end()) refuse(file_, place, "a value", "none");
    return Entry(*found, file_, place);
  }
  template <class Visit>
  void for_each(std::size_t limit, Visit&& visit) const {
    if (!value_.is_array() || value_.size() > limit) fail(text("an array of at most ", limit));
    for (std::size_t i = 0; i < value_.size(); ++i) {
      visit(Entry(value_[i], file_, text(place_, "[", i, "]")));
    }
  }
  bool has(const std::string& key) const { return value_.is_object() && value_.contains(key); }
  /// There is a value, and it is not null.
  bool tells(const std::string& key) const { return has(key) && !(*this)[key].is_null(); }
  bool is_null() const { return value_.is_null(); }
  void check_object() const {
    if (!value_.is_object()) fail("an object");
  }
  bool boolean() const {
    if (!value_.is_boolean()) fail("true or false");
    return value_.get<bool>();
  }

  double number(double low, double high) const {
    const bool ok = value_.is_number() && std::isfinite(value_.get<double>()) &&
                    value_.get<double>() >= low && value_.get<double>() <= high;
    if (!ok) fail("a number from " + decimal(low) + " to " + decimal(high));
    return value_.get<double>();
  }
  std::int64_t integer(std::int64_t low, std::int64_t high) const {
    // A parsed integer is unsigned unless it has a minus sign.
    const bool ok = value_.is_number_integer() &&
                    (!value_.is_number_unsigned() ||
                     value_.get<std::uint64_t>() <=
                         static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) &&
                    value_.get<std::int64_t>() >= low && value_.get<std::int64_t>() <= high;
    if (!ok) fail(text("an integer from ", low, " to ", high));
    return value_.get<std::int64_t>();
  }
  std::uint64_t seed() const {
    if (!value_.is_number_unsigned()) fail("an integer from 0 to 2^64 - 1");
    return value_.get<std::uint64_t>();
  }
  std::string word() const {
    if (!value_.is_string()) fail("a string");
    return value_.get<std::string>();
  }
  std::string checksum() const {
    std::string digits = word();
    if (digits.size() != 16 || digits.find_first_not_of("0123456789abcdef") != std::string::npos) {
      fail("16 lower-case hexadecimal digits");
    }
    return digits;
  }
  std::string file_name() const {
    if (!stays_inside(word())) fail("the name of a file inside the folder");
    return word();
  }

  [[noreturn]] void fail(const std::string& expected) const {
    std::string found = value_.type_name();
    if (value_.is_string()) found = in_quotes(value_.get_ref<const std::string&>());
    if (value_.is_number() || value_.is_boolean()) found = value_.dump();
    refuse(file_, place_, expected, found);
  }

 private:
  const ParsedJson& value_;
  const std::string& file_;
  std::string place_;
};

// A manifest's last entry is its own checksum: the XXH3 of the file with these 16 digits left out.
// Where the digits are; npos if there are none.
constexpr std::size_t kChecksumDigits = 16;
std::size_t own_checksum_at(const std::string& content) {
  const std::string key = "\"checksum\": \"";
  const std::size_t at = content.rfind(key);
  if (at == std::string::npos || content.size() - at < key.size() + kChecksumDigits)
    return std::string::npos;
  return at + key.size();
}

std::string own_checksum(const std::string& content, std::size_t at) {
  return hex(hash_without(content.data(), content.size(), at, kChecksumDigits));
}

// null: written by hand or by another program, nothing is known about its bytes.
void check_own_checksum(const Entry& checksum, const std::string& content) {
  if (checksum.is_null()) return;
  const std::string digits = checksum.checksum();
  const std::size_t at = own_checksum_at(content);
  if (at == std::string::npos || content.compare(at, kChecksumDigits, digits) != 0)
    checksum.fail("it to be the last entry of the file");
  const std::string found = own_checksum(content, at);
  if (found != digits)
    checksum.fail("the file's XXH3 " + found +
                  " (it is damaged, or was edited: then write null in its place)");
}

ParsedJson parse_json(const std::string& content, const std::string& file) {
  JsonLimits limits;
  limits.values = 12 * kMaxRecords;
  check_json_text(content, file, limits);
  try {
    return ParsedJson::parse(content);
  } catch (const ParsedJson::parse_error& error) {
    const std::size_t end = std::min(error.byte, content.size());
    const auto begin = content.begin();
    const auto line = 1 + std::count(begin, begin + static_cast<std::ptrdiff_t>(end), '\n');
    refuse(file, text("line ", line), "JSON text in UTF-8", in_quotes(error.what()));
  } catch (const ParsedJson::exception& error) {
    refuse(file, "text", "JSON", in_quotes(error.what()));
  }
}

Slide read_slide(const Entry& entry, Index n_frames) {
  Slide slide;
  if (!entry["first_contact"].is_null())
    slide.first_contact = entry["first_contact"].integer(0, n_frames);
  slide.path = entry["path"].number(0, 1e9);
  slide.at_rest = entry["at_rest"].boolean();
  slide.stuck = entry["stuck"].boolean();
  slide.contacts = entry["contacts"].number(0, 1e9);
  return slide;
}

std::vector<RecordInfo> read_records(const Entry& list, Index n_frames,
                                     std::set<std::string>& names) {
  std::vector<RecordInfo> records;
  list.for_each(kMaxRecords, [&](const Entry& entry) {
    RecordInfo record;
    record.name = entry["name"].file_name();
    if (!names.insert(record.name).second) entry["name"].fail("every file once");
    if (entry.tells("seed")) record.seed = entry["seed"].seed();
    record.frames = entry.tells("frames") ? entry["frames"].integer(1, n_frames) : n_frames;
    if (entry.tells("checksum")) record.checksum = entry["checksum"].checksum();
    if (entry.has("slide")) record.slide = read_slide(entry["slide"], record.frames);
    records.push_back(std::move(record));
  });
  return records;
}

OrderedJson json_records(const std::vector<RecordInfo>& records) {
  OrderedJson list = OrderedJson::array();
  for (const RecordInfo& record : records) {
    OrderedJson& entry = list.emplace_back(OrderedJson{{"name", record.name},
                                                       {"seed", record.seed},
                                                       {"frames", record.frames},
                                                       {"checksum", nullptr}});
    if (!record.checksum.empty()) entry["checksum"] = record.checksum;
    if (!record.slide) continue;
    const Slide& slide = *record.slide;
    entry["slide"] = {{"first_contact", nullptr},
                      {"path", slide.path},
                      {"at_rest", slide.at_rest},
                      {"stuck", slide.stuck},
                      {"contacts", slide.contacts}};
    if (slide.first_contact) entry["slide"]["first_contact"] = *slide.first_contact;
  }
  return list;
}

}  // namespace

std::string record_name(const char* split, Index index) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%03lld", static_cast<long long>(index));
  return text(split, "/", digits, ".safetensors");
}

bool stays_inside(const std::string& name) {
  if (name.empty() || name.size() > 1024) return false;
  const bool plain = std::all_of(name.begin(), name.end(), [](char c) {
    return static_cast<unsigned char>(c) >= 0x20 && c != 0x7f && c != '\\' && c != ':';
  });
  if (!plain) return false;
  const Path path(name);
  return path.is_relative() && std::all_of(path.begin(), path.end(), [](const Path& part) {
           return !part.empty() && part != "." && part != "..";
         });
}

void write_manifest(const Path& path, const Manifest& manifest) {
  const fem::Physics& physics = manifest.physics;
  const fem::Material& material = physics.material;
  OrderedJson json;
  json["format"] = kFormat;
  json["version"] = kDatasetVersion;
  json["scene"] = {{"name", manifest.scene_name}, {"toml", manifest.scene_toml}};
  json["gravity"] = {physics.gravity(0), physics.gravity(1), physics.gravity(2)};
  json["ground"] = nullptr;
  if (physics.ground) json["ground"] = *physics.ground;
  if (manifest.law_known)
    json["material"] = {{"law", material.law}, {"E", material.E}, {"nu", material.nu}};
  json["material"]["density"] = material.density;
  const fem::GroundContact& contact = physics.contact;
  const bool projective = manifest.law_known && material.law == "projective";
  if (projective || contact.law != "frictionless")
    json["contact"] = {{"law", contact.law}, {"friction", contact.friction}};
  if (projective) {
    json["material"]["volume_weight"] = material.volume_weight;
    json["contact"]["k_n"] = contact.k_n;
    json["contact"]["k_f"] = contact.k_f;
    json["contact"]["penalty_friction"] = contact.penalty_friction;
  }
  if (physics.air.drag > 0) {
    const Vec3<double>& wind = physics.air.wind;
    json["air"] = {{"drag", physics.air.drag}, {"wind", {wind(0), wind(1), wind(2)}}};
  }
  json["dt"] = manifest.dt;
  json["substeps"] = manifest.substeps;
  json["h"] = manifest.h;
  json["frames"] = manifest.frames;
  json["n_vertices"] = manifest.n_vertices;
  json["n_tets"] = manifest.n_tets;
  json["seed"] = manifest.seed;
  json["mesh"] = {{"name", kMeshName}, {"checksum", nullptr}};
  if (!manifest.mesh_checksum.empty()) json["mesh"]["checksum"] = manifest.mesh_checksum;
  json["train"] = json_records(manifest.train);
  json["validation"] = json_records(manifest.validation);
  json["checksum"] = std::string(kChecksumDigits, '0');
  std::string content = json.dump(2) + "\n";
  const std::size_t at = own_checksum_at(content);
  content.replace(at, kChecksumDigits, own_checksum(content, at));
  write_text(path, content);
}

Manifest read_manifest(const Path& path) {
  return parse_manifest(read_text(path, kMaxManifest), path.string());
}

Manifest parse_manifest(const std::string& content, const std::string& file) {
  const ParsedJson json = parse_json(content, file);
  const Entry root(json, file, "");
  if (root["format"].word() != kFormat) {
    root["format"].fail(text("\"", kFormat, "\""));
  }
  refuse_newer(file, root["version"].integer(1, std::numeric_limits<std::int64_t>::max()));
  check_own_checksum(root["checksum"], content);

  Manifest manifest;
  if (root.tells("scene")) {
    const Entry scene = root["scene"];
    manifest.scene_name = scene["name"].word();
    if (scene.tells("toml")) manifest.scene_toml = scene["toml"].word();
  }

  fem::Physics& physics = manifest.physics;
  const auto vector = [](const Entry& entry) {
    std::vector<double> numbers;
    entry.for_each(3, [&](const Entry& each) { numbers.push_back(each.number(-1e9, 1e9)); });
    if (numbers.size() != 3) entry.fail("an array of three numbers");
    return Vec3<double>(numbers[0], numbers[1], numbers[2]);
  };
  physics.gravity = vector(root["gravity"]);
  if (!root["ground"].is_null()) physics.ground = root["ground"].number(-1e9, 1e9);
  const bool has_material = root.tells("material");
  const auto material = [&] { return root["material"]; };
  if (has_material) material().check_object();
  manifest.law_known = has_material && material().tells("law");
  if (manifest.law_known) {
    physics.material.law = material()["law"].word();
    physics.material.E = material()["E"].number(0, 1e18);
    physics.material.nu = material()["nu"].number(-1, 0.5);
  }
  if (manifest.law_known || (has_material && material().tells("density")))
    physics.material.density = material()["density"].number(0, 1e18);
  const bool projective = physics.material.law == "projective";
  if (projective || root.has("contact")) {
    physics.contact.law = root["contact"]["law"].word();
    physics.contact.friction = root["contact"]["friction"].number(0, 1e3);
  }
  if (root.has("air")) {
    physics.air.drag = root["air"]["drag"].number(0, 1e6);
    physics.air.wind = vector(root["air"]["wind"]);
  }
  if (projective) {
    const Entry contact = root["contact"];
    physics.material.volume_weight = material()["volume_weight"].number(0, 1e6);
    physics.contact.k_n = contact["k_n"].number(0, 1e15);
    physics.contact.k_f = contact["k_f"].number(0, 1e15);
    physics.contact.penalty_friction = contact["penalty_friction"].number(0, 1e15);
  }
  const auto check = [&](const char* table, const auto& values) {
    try {
      fem::check(values);
    } catch (const std::invalid_argument& error) {
      throw InputError(text(file, ": ", table, ": ", error.what()));
    }
  };
  check("material", physics.material);
  check("contact", physics.contact);

  if (root.tells("dt")) manifest.dt = root["dt"].number(0, 1e6);
  if (root.tells("substeps")) manifest.substeps = root["substeps"].integer(0, kMaxCount);
  manifest.h = root["h"].number(1e-15, 1e6);
  const double steps = manifest.dt * static_cast<double>(manifest.substeps);
  if (steps > 0 && std::abs(steps - manifest.h) > 1e-9 * manifest.h) {
    root["h"].fail("dt * substeps = " + decimal(steps));
  }
  if (manifest.dt > manifest.h) root["dt"].fail("a step of at most h = " + decimal(manifest.h));
  manifest.frames = root["frames"].integer(1, kMaxCount - 1);
  manifest.n_vertices = root["n_vertices"].integer(4, kMaxCount);
  manifest.n_tets = root["n_tets"].integer(1, kMaxCount / 4);
  if (root.tells("seed")) manifest.seed = root["seed"].seed();

  if (root.tells("mesh")) {
    const Entry mesh = root["mesh"];
    if (mesh["name"].word() != kMeshName) mesh["name"].fail(text("\"", kMeshName, "\""));
    if (mesh.tells("checksum")) manifest.mesh_checksum = mesh["checksum"].checksum();
  }
  std::set<std::string> names;
  manifest.train = read_records(root["train"], manifest.frames, names);
  manifest.validation = read_records(root["validation"], manifest.frames, names);
  return manifest;
}

}  // namespace nmp
