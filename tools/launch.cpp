#include "launch.h"

#if defined(__x86_64__)
#include <cpuid.h>
#endif
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "base/check.h"
#include "installation.h"

namespace nmp {
namespace {

// Of this build; the one that chooses is the one that runs everywhere.
constexpr const char* kLevel = NMP_LEVEL;
constexpr const char* kChooser = "x86-64";

#if defined(__x86_64__)
// What x86-64-v3 has and __builtin_cpu_supports of some compilers does not know. A processor
// without LZCNT runs it as another instruction, with another result.
bool has_lzcnt_movbe_f16c() {
  unsigned a = 0, b = 0, c = 0, d = 0, c_extended = 0;
  return __get_cpuid(1, &a, &b, &c, &d) && __get_cpuid(0x80000001, &a, &b, &c_extended, &d) &&
         (c & bit_MOVBE) && (c & bit_F16C) && (c_extended & bit_LZCNT);
}
#endif

bool runs_here(const std::string& level) {
#if defined(__x86_64__)
  __builtin_cpu_init();
  const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                  __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
                  has_lzcnt_movbe_f16c();
  if (level == "x86-64-v3") return v3;
  if (level == "x86-64-v4")
    return v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
           __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512vl");
#endif
  return level == kChooser;
}

// The build of `level` in the package that this program belongs to; empty if there is none.
std::string program_of(const std::string& level) {
  const Path program = installed(Path("libexec/nmp") / ("nmp-" + level));
  return !program.empty() && access(program.c_str(), X_OK) == 0 ? program.string() : "";
}

// Empty: this one.
std::string best_program() {
  if (std::string(kLevel) != kChooser) return "";
  if (const char* asked = std::getenv("NMP_CPU")) {
    const std::string level = asked;
    if (level == kChooser) return "";
    if (level != "x86-64-v3" && level != "x86-64-v4")
      throw ConfigError("NMP_CPU is " + in_quotes(level) +
                        ", expected x86-64, x86-64-v3 or x86-64-v4");
    if (!runs_here(level))
      throw ConfigError("NMP_CPU asks for " + level + ", which this processor does not support");
    const std::string program = program_of(level);
    if (program.empty())
      throw ConfigError("NMP_CPU asks for " + level + ", which is not installed beside nmp");
    return program;
  }
  for (const char* level : {"x86-64-v4", "x86-64-v3"})
    if (runs_here(level)) {
      const std::string program = program_of(level);
      if (!program.empty()) return program;
    }
  return "";
}

}  // namespace

void launch(char** argv) {
  std::string program = best_program();
  // GNU's OpenMP lets waiting threads spin, for longer than a step takes: beside any other load on
  // the machine a step then waits for whole time slices (measured: 14 times slower on two busy
  // cores). It reads its settings before main.
  if (!std::getenv("OMP_WAIT_POLICY") && !std::getenv("GOMP_SPINCOUNT") &&
      setenv("OMP_WAIT_POLICY", "passive", 1) == 0 && program.empty())
    program = "/proc/self/exe";
  if (!program.empty()) execv(program.c_str(), argv);
}

}  // namespace nmp
