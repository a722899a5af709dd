#include "fem/finding.h"

#include <numeric>

#include "base/check.h"

namespace nmp::fem {

std::string describe(const DefectWords& words, Index count, const std::vector<Index>& first) {
  std::string line = words.one;
  if (!first.empty()) {
    line = text(count, " ", count == 1 ? words.one : words.many, " (");
    for (std::size_t i = 0; i < first.size(); ++i) {
      line += (i > 0 ? ", " : "") + std::to_string(first[i]);
    }
    line += count > static_cast<Index>(first.size()) ? ", ...)" : ")";
  }
  return *words.remedy == 0 ? line : line + ": " + words.remedy;
}

std::vector<Index> Marks::first(std::size_t n) const {
  std::vector<Index> numbers;
  for (std::size_t i = 0; i < set.size() && numbers.size() < n; ++i) {
    if (set[i] != 0) numbers.push_back(static_cast<Index>(i));
  }
  return numbers;
}

Groups::Groups(Index n) : parent_(static_cast<std::size_t>(n)) {
  std::iota(parent_.begin(), parent_.end(), 0);
}

std::int32_t Groups::root(std::int32_t i) {
  while (parent_[static_cast<std::size_t>(i)] != i) {
    auto& up = parent_[static_cast<std::size_t>(i)];
    up = parent_[static_cast<std::size_t>(up)];
    i = up;
  }
  return i;
}

void Groups::join(std::int32_t i, std::int32_t j) {
  i = root(i);
  j = root(j);
  parent_[static_cast<std::size_t>(std::max(i, j))] = std::min(i, j);
}

}  // namespace nmp::fem
