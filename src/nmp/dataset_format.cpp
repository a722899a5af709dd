#include "nmp/dataset_format.h"

#include "base/check.h"

namespace nmp {

void refuse(const std::string& file, const std::string& place, const std::string& expected,
            const std::string& found) {
  throw InputError(text(file, ": ", place, ": expected ", expected, ", found ", found));
}

void refuse_newer(const std::string& file, std::int64_t version) {
  if (version <= kDatasetVersion) return;
  throw InputError(text(file, ": has version ", version, ", newer than version ", kDatasetVersion,
                        ", the newest that this program reads"));
}

void check_version(const TensorFile& file) {
  const auto found = file.metadata().find("version");
  if (found == file.metadata().end()) return;
  const std::string& digits = found->second;
  const bool is_number = !digits.empty() && digits.size() <= 9 &&
                         digits.find_first_not_of("0123456789") == std::string::npos;
  if (!is_number) refuse(file.name(), "metadata version", "an integer", in_quotes(digits));
  refuse_newer(file.name(), std::stoi(digits));
}

void check_hash(const std::string& file, const std::string& expected, const std::string& found) {
  if (!expected.empty() && found != expected) {
    throw InputError(text(file, ": expected the checksum ", expected, " of the manifest, found ",
                          found,
                          "; the file is damaged or not the one that belongs here: nmp data ",
                          "verify lists all such files, nmp data gen makes them again"));
  }
}

}  // namespace nmp
