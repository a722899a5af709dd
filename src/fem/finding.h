#pragma once

#include <algorithm>
#include <string>
#include <vector>

#include "autodiff/types.h"
#include "base/check.h"

namespace nmp::fem {

/// What repair does about a defect.
enum class MeshRule { refuse, repair, warn };

/// A defect of a mesh or surface that was found.
template <class Defect>
struct Finding {
  Defect defect;
  Index count = 0;
  /// The first of them (10 unless told otherwise), from 0 in the order of the file. Empty where the
  /// defect is the whole mesh's.
  std::vector<Index> first;
};

/// What was found, in the order of the enumeration; only counts above 0. `rule` of a defect is
/// looked up beside it.
template <class Defect>
struct Findings {
  std::vector<Finding<Defect>> all;

  const Finding<Defect>* find(Defect defect) const {
    for (const Finding<Defect>& finding : all)
      if (finding.defect == defect) return &finding;
    return nullptr;
  }
  Index count(Defect defect) const {
    const Finding<Defect>* finding = find(defect);
    return finding == nullptr ? 0 : finding->count;
  }
  /// Whether repair would refuse the mesh.
  bool refused() const {
    return std::any_of(all.begin(), all.end(), [](const Finding<Defect>& finding) {
      return rule(finding.defect) == MeshRule::refuse;
    });
  }
  void add(Defect defect, Index count, std::vector<Index> first = {}) {
    if (count > 0) all.push_back({defect, count, std::move(first)});
  }
};

/// How a defect is spoken of.
struct DefectWords {
  MeshRule rule;
  const char* name;        // "inverted_tets": for programs
  const char *one, *many;  // behind the count; alone where there are no numbers
  const char* remedy;      // or what is done about it; may be empty
};
/// "12 tets are inverted (0, 5, 7, ...): turned by exchanging two corners"
std::string describe(const DefectWords& words, Index count, const std::vector<Index>& first);

/// What was found in words, if nothing is refused.
/// @throws InputError  with all that is refused: "name: expected `wanted`, found: ..."
template <class Defect>
std::vector<std::string> warnings_or_refusal(const Findings<Defect>& findings,
                                             const std::string& name, const std::string& wanted) {
  std::vector<std::string> warnings;
  std::string refused;
  for (const Finding<Defect>& finding : findings.all) {
    if (rule(finding.defect) == MeshRule::refuse) {
      refused += (refused.empty() ? "" : "; ") + describe(finding);
    } else {
      warnings.push_back(describe(finding));
    }
  }
  if (!refused.empty()) throw InputError(name + ": expected " + wanted + ", found: " + refused);
  return warnings;
}

/// Marks of things by number, counted into a finding.
struct Marks {
  explicit Marks(Index n) : set(static_cast<std::size_t>(n), 0) {}
  void mark(Index i) { set[static_cast<std::size_t>(i)] = 1; }
  bool operator[](Index i) const { return set[static_cast<std::size_t>(i)] != 0; }
  Index count() const { return std::count(set.begin(), set.end(), 1); }
  /// The numbers of the first n.
  std::vector<Index> first(std::size_t n) const;
  std::vector<char> set;
};

/// Sets of numbers that grow together (union-find); a set is known by its lowest member.
class Groups {
 public:
  explicit Groups(Index n);
  std::int32_t root(std::int32_t i);
  void join(std::int32_t i, std::int32_t j);

 private:
  std::vector<std::int32_t> parent_;
};

}  // namespace nmp::fem
