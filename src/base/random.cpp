#include "base/random.h"

#include <cmath>

#include "base/check.h"

namespace nmp {
namespace {

__extension__ typedef unsigned __int128 Uint128;

// 2^64 / golden ratio, odd: consecutive counters land far apart.
constexpr std::uint64_t kGolden = 0x9e3779b97f4a7c15u;

// What a key is used for. Each use draws under its own key, so that none repeats another's bits.
constexpr std::uint64_t kSplitNumber = 0x5851f42d4c957f2du;
constexpr std::uint64_t kSplitName = 0xd1342543de82ef95u;
constexpr std::uint64_t kNormalRadius = 0xaef17502108ef2d9u;
constexpr std::uint64_t kNormalAngle = 0xf1357aea2e62a9c5u;
constexpr std::uint64_t kRetry = 0x2545f4914f6cdd1du;

// Bijection of 64-bit words in which every input bit changes every output bit with probability
// close to 1/2 (the finaliser of SplitMix64: Steele, Lea, Flood, OOPSLA 2014; Stafford's mix 13).
std::uint64_t mix(std::uint64_t x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

// Two rounds, the key added before each: for one key a bijection of the counter.
std::uint64_t keyed_mix(std::uint64_t key, std::uint64_t counter) {
  const std::uint64_t turned = (key << 32) | (key >> 32);
  return mix(mix(counter * kGolden + key) ^ turned);
}

// FNV-1a, 64 bits.
std::uint64_t hash_name(std::string_view name) {
  std::uint64_t hash = 0xcbf29ce484222325u;
  for (const char c : name) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3u;
  return hash;
}

double unit_interval(std::uint64_t bits) { return static_cast<double>(bits >> 11) * 0x1p-53; }

}  // namespace

Random::Random(std::uint64_t seed) : key_(mix(seed + kGolden)) {}

Random Random::split(std::uint64_t stream) const {
  Random child(*this);
  child.key_ = keyed_mix(key_ ^ kSplitNumber, stream);
  return child;
}

Random Random::split(std::string_view name) const {
  Random child(*this);
  child.key_ = keyed_mix(key_ ^ kSplitName, hash_name(name));
  return child;
}

std::uint64_t Random::bits(std::uint64_t index) const { return keyed_mix(key_, index); }

double Random::uniform(std::uint64_t index) const { return unit_interval(bits(index)); }

double Random::uniform(std::uint64_t index, double low, double high) const {
  return low + (high - low) * uniform(index);
}

// sqrt(-2 ln u) cos(2 pi w), with u in (0, 1] so that the logarithm is finite.
double Random::normal(std::uint64_t index) const {
  constexpr double kTwoPi = 6.283185307179586476925;
  const double u = 1.0 - unit_interval(keyed_mix(key_ ^ kNormalRadius, index));
  const double w = unit_interval(keyed_mix(key_ ^ kNormalAngle, index));
  return std::sqrt(-2.0 * std::log(u)) * std::cos(kTwoPi * w);
}

// x n / 2^64, rounded down, hits some values once more often than others; dropping the x whose
// low product word is below 2^64 mod n leaves each value equally many (Lemire, TOMACS 2019).
std::uint64_t Random::below(std::uint64_t index, std::uint64_t n) const {
  NMP_CHECK(n > 0, "the bound of a random integer must be > 0, got 0");
  const std::uint64_t excess = (0 - n) % n;  // 2^64 mod n
  Uint128 product = static_cast<Uint128>(bits(index)) * n;
  for (std::uint64_t retry = 0; static_cast<std::uint64_t>(product) < excess; ++retry) {
    product = static_cast<Uint128>(keyed_mix(key_ ^ (kRetry + retry), index)) * n;
  }
  return static_cast<std::uint64_t>(product >> 64);
}

}  // namespace nmp
