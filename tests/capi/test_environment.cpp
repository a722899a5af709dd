// What else lives in a host's process: other floating-point environments, cancelled threads, forks
// (verification.md DT6).
#include <fenv.h>
#include <pthread.h>
#include <sys/wait.h>
#include <unistd.h>
#if defined(__SSE2__)
#include <xmmintrin.h>
#endif

#include <functional>

#include "capi/body.h"

using namespace nmp;
using namespace nmp::test;

namespace {

nmp_status advance(const MadeSim& sim) {
  const nmp_status status = nmp_sim_step(sim.handle, 20);
  return status == NMP_OK ? nmp_grad_begin(sim.handle, 0) : status;
}

// Frames and a gradient of a body of several ranges of elements, whose corners barely move: small
// numbers, too.
std::string life(const std::function<void()>& enter, const std::function<void()>& leave) {
  const Cube cube(8);
  const LoadedModel model;
  const MadeSim sim(cube, neural_desc(), model.handle);
  Buffer v(cube.n(), 0), bar(cube.n(), 0);
  v[0] = 1e-300;
  bar[4] = 1;
  ok(nmp_sim_set_state(sim.handle, nullptr, v.data(), cube.n()));
  enter();
  const nmp_status stepped = advance(sim);
  const nmp_status recorded = nmp_sim_step(sim.handle, 3);
  const nmp_status added = nmp_grad_add_loss(sim.handle, bar.data(), nullptr, cube.n());
  const nmp_status differentiated = nmp_grad_backward(sim.handle);
  leave();
  for (const nmp_status status : {stepped, recorded, added, differentiated}) ok(status);
  Buffer gradient(cube.n());
  ok(nmp_grad_get(sim.handle, NMP_GRAD_X0, 0, gradient.data(), cube.n()));
  ok(nmp_grad_end(sim.handle));
  return sim.saved() + std::string(reinterpret_cast<const char*>(gradient.data()),
                                   gradient.size() * sizeof(double));
}

}  // namespace

TEST_SUITE("capi/environment") {
  TEST_CASE("rounding, traps and flushing of a host change no bit, and are left as they were") {
    const std::string plain = life([] {}, [] {});
    for (const int threads : {1, 2}) {
      CAPTURE(threads);
      ok(nmp_set_threads(threads));
      int rounding = -1, traps = -1, flags = -1;
      CHECK(life([] { fesetround(FE_UPWARD); },
                 [&] {
                   rounding = fegetround();
                   fesetround(FE_TONEAREST);
                 }) == plain);
      CHECK(rounding == FE_UPWARD);
      const int all = FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW;
      CHECK(life(
                [&] {
                  feclearexcept(FE_ALL_EXCEPT);
                  feenableexcept(all);
                },
                [&] {
                  traps = fegetexcept();
                  flags = fetestexcept(FE_ALL_EXCEPT);
                  fedisableexcept(FE_ALL_EXCEPT);
                }) == plain);
      CHECK(traps == all);
      CHECK(flags == 0);
#if defined(__SSE2__)
      unsigned before = 0, after = 0;
      CHECK(life(
                [&] {
                  before = _mm_getcsr() | 0x8040;  // flush to zero, denormals are zero
                  _mm_setcsr(before);
                },
                [&] {
                  after = _mm_getcsr();
                  _mm_setcsr(after & ~0x8040u);
                }) == plain);
      CHECK(after == before);
#endif
    }
    ok(nmp_set_threads(0));
  }

  TEST_CASE("a callback has its host's environment") {
    const Cube cube(2);
    nmp_sim_desc desc = analytic_desc(NMP_LAW_CALLBACK);
    desc.stress_callback = [](void*, std::size_t n, const double* F, double* P) {
      for (std::size_t i = 0; i < 9 * n; ++i) P[i] = F[i] - (i % 9 % 4 == 0);
      return fegetround() == FE_DOWNWARD ? 0 : 1;
    };
    const MadeSim sim(cube, desc);
    fesetround(FE_DOWNWARD);
    const nmp_status status = nmp_sim_step(sim.handle, 2);
    const int rounding = fegetround();
    fesetround(FE_TONEAREST);
    ok(status);
    CHECK(rounding == FE_DOWNWARD);
  }

  TEST_CASE("a thread that is cancelled ends between calls") {
    const Cube cube(3);
    const MadeSim sim(cube, analytic_desc());
    pthread_t thread;
    REQUIRE(pthread_create(
                &thread, nullptr,
                [](void* handle) -> void* {
                  for (;;) {
                    nmp_model* model = nullptr;
                    if (nmp_model_load(cube_model().c_str(), &model) != NMP_OK ||
                        nmp_model_free(model) != NMP_OK ||
                        nmp_sim_step(static_cast<nmp_sim*>(handle), 1) != NMP_OK)
                      return handle;
                    pthread_testcancel();
                  }
                },
                sim.handle) == 0);
    usleep(50'000);
    REQUIRE(pthread_cancel(thread) == 0);
    void* result = nullptr;
    REQUIRE(pthread_join(thread, &result) == 0);
    CHECK(result == PTHREAD_CANCELED);
    ok(nmp_sim_step(sim.handle, 1));
  }

  TEST_CASE("a child of fork goes on by itself, to the same bits") {
    ok(nmp_set_threads(2));
    const Cube cube(8);
    const LoadedModel model;
    const MadeSim sim(cube, neural_desc(), model.handle);
    ok(nmp_sim_step(sim.handle, 2));  // a team of threads is there
    int ends[2];
    REQUIRE(pipe(ends) == 0);
    const pid_t child = fork();
    REQUIRE(child >= 0);
    if (child == 0) {
      alarm(60);
      Buffer x(cube.n());
      const std::size_t bytes = x.size() * sizeof(double);
      const bool good = nmp_sim_step(sim.handle, 3) == NMP_OK &&
                        nmp_sim_get_state(sim.handle, x.data(), nullptr, x.size()) == NMP_OK &&
                        write(ends[1], x.data(), bytes) == static_cast<ssize_t>(bytes);
      _exit(good ? 0 : 1);
    }
    close(ends[1]);
    Buffer x(cube.n());
    std::size_t got = 0;
    for (ssize_t n = 1; n > 0; got += static_cast<std::size_t>(n))
      n = read(ends[0], reinterpret_cast<char*>(x.data()) + got, x.size() * sizeof(double) - got);
    close(ends[0]);
    int status = 0;
    REQUIRE(waitpid(child, &status, 0) == child);
    REQUIRE(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 0);
    ok(nmp_sim_step(sim.handle, 3));
    CHECK(sim.x() == x);
    ok(nmp_set_threads(0));
  }
}
