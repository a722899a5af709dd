#define DOCTEST_CONFIG_IMPLEMENT_WITH_MAIN
#include <doctest/doctest.h>

#ifdef __SANITIZE_ADDRESS__
#define NMP_LEAKS_ARE_FOUND
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define NMP_LEAKS_ARE_FOUND
#endif
#endif

#ifdef NMP_LEAKS_ARE_FOUND
// What LLVM's OpenMP keeps for its threads is not ours.
extern "C" const char* __lsan_default_suppressions();
extern "C" const char* __lsan_default_suppressions() { return "leak:libomp.so"; }
#endif
