// Runs a fuzz target over the kept corpus, with any compiler and without libFuzzer.
//   fuzz_safetensors tests/fuzz/corpus/safetensors
// Files named ok-* must be accepted, bad-* refused, others only read without harm.

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <vector>

#include "fuzz/fuzz.h"

int main(int argc, char** argv) {
  namespace fs = std::filesystem;
  if (argc != 2) {
    std::fputs("usage: fuzz_READER FOLDER\n", stderr);
    return 2;
  }
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(argv[1])) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  int n_accepted = 0, n_wrong = 0;
  for (const fs::path& path : files) {
    std::ifstream in(path, std::ios::binary);
    const std::vector<char> bytes(std::istreambuf_iterator<char>(in), {});
    // A copy whose end is the end of its allocation: a sanitizer sees any overrun.
    const std::vector<std::uint8_t> input(bytes.begin(), bytes.end());
    std::fprintf(stderr, "%s\n", path.filename().c_str());  // the last line of a crash names it
    LLVMFuzzerTestOneInput(input.data(), input.size());
    n_accepted += nmp::fuzz::accepted;
    const std::string name = path.filename();
    const bool wrong = (name.rfind("ok-", 0) == 0 && !nmp::fuzz::accepted) ||
                       (name.rfind("bad-", 0) == 0 && nmp::fuzz::accepted);
    if (wrong) std::fprintf(stderr, "  was %s\n", nmp::fuzz::accepted ? "accepted" : "refused");
    n_wrong += wrong;
  }
  std::printf("%zu files, %d accepted, %d wrong\n", files.size(), n_accepted, n_wrong);
  return files.empty() || n_wrong > 0 ? 1 : 0;
}
