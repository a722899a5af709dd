#include "fuzz/fuzz.h"

#include "base/parallel.h"

namespace nmp::fuzz {

bool accepted = false;

namespace {
const bool kOneThread = (set_threads(1), true);  // threads would hide which input did it
}  // namespace

}  // namespace nmp::fuzz
