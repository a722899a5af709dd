#pragma once

namespace nmp {

/// Starts the program again, once, where another start serves better: with polite waiting threads,
/// and as the build for this processor where the package holds one (libexec/nmp/nmp-LEVEL beside
/// bin/nmp). NMP_CPU names a level (x86-64, x86-64-v3, x86-64-v4) to take instead of the best.
/// Returns where nothing is to be changed, or nothing can.
/// @throws ConfigError  for a level that NMP_CPU must not name
void launch(char** argv);

}  // namespace nmp
