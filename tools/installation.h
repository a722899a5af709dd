#pragma once

#include "base/file.h"

namespace nmp {

/// A file or folder below the prefix that this program is installed in, as PREFIX/bin/nmp or
/// PREFIX/libexec/nmp/nmp-LEVEL. Empty where there is none, or where the system does not tell the
/// program's place.
Path installed(const Path& relative);

}  // namespace nmp
