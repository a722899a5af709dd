#pragma once

#include "nmp/bench.h"

namespace nmp::common {

/// Counts what this program allocates between start and read: every call of malloc and its
/// relatives that the program's own code makes, operator new and Eigen included; not those inside
/// the system's shared libraries. Without its functions under the sanitizers, which have their own
/// allocator.
HeapMeter heap_meter();

}  // namespace nmp::common
