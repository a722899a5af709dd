#include "nmp/paper_results.h"

#include <map>

namespace nmp {

namespace {

struct Row {
  PaperResult paper;
  double goal;
};

const std::map<std::string, std::map<Index, Row>>& rows() {
  static const std::map<std::string, std::map<Index, Row>> values{
      {"cube",
       {{100, {{0.019, 0.010}, 2e-4}},
        {500, {{0.159, 0.046}, 2e-3}},
        {1000, {{0.535, 0.161}, 5e-3}}}},
      {"cubexl",
       {{100, {{0.020, 0.010}, 2e-4}},
        {500, {{0.253, 0.149}, 2.5e-3}},
        {1000, {{0.440, 0.107}, 5e-3}}}},
      {"spot",
       {{100, {{0.061, 0.001}, 6e-4}},
        {500, {{0.217, 0.135}, 2e-3}},
        {1000, {{0.449, 0.162}, 4.5e-3}}}},
      {"bob",
       {{100, {{0.050, 0.021}, 5e-4}},
        {500, {{0.316, 0.136}, 3e-3}},
        {1000, {{0.579, 0.348}, 6e-3}}}}};
  return values;
}

const Row* find(const std::string& scene, Index frame) {
  const auto of_scene = rows().find(scene);
  if (of_scene == rows().end()) return nullptr;
  const auto row = of_scene->second.find(frame);
  return row == of_scene->second.end() ? nullptr : &row->second;
}

}  // namespace

std::optional<PaperResult> paper_result(const std::string& scene, Index frame) {
  const Row* row = find(scene, frame);
  return row ? std::optional<PaperResult>(row->paper) : std::nullopt;
}

std::optional<double> rmse_goal(const std::string& scene, Index frame) {
  const Row* row = find(scene, frame);
  return row ? std::optional<double>(row->goal) : std::nullopt;
}

}  // namespace nmp
