#include "nmp/study.h"

#include <filesystem>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "nmp/report_html.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kLimit = std::size_t{1} << 28;  // bytes of a study that was kept

std::string section(const Json& study) {
  std::string html = "<section id=\"" + escape_html(study.at("name").get<std::string>()) +
                     "\">\n<h2>" + escape_html(study.at("title").get<std::string>()) + "</h2>\n";
  for (const auto& note : study.at("notes"))
    html += "<p>" + escape_html(note.get<std::string>()) + "</p>\n";
  html += "<div class=\"scroll\"><table>\n";
  bool header = true;
  for (const auto& row : study.at("rows")) {
    html += header ? "<thead><tr>" : "<tr>";
    for (const auto& cell : row)
      html += (header ? "<th>" : "<td>") + escape_html(cell.get<std::string>()) +
              (header ? "</th>" : "</td>");
    html += header ? "</tr></thead>\n<tbody>\n" : "</tr>\n";
    header = false;
  }
  return html + "</tbody></table></div>\n" + study.at("figures").get<std::string>() +
         "</section>\n";
}

}  // namespace

const std::vector<StudyKind>& study_kinds() {
  static const std::vector<StudyKind> all{
      {"trajectories", "The 40 recorded trajectories of CUBE, drawn", study_trajectories},
      {"unseen", "Velocities, spins and heights beyond those of the training", study_unseen},
      {"resolution", "Weights of CUBEXL (22^3 vertices) on a cube of 28^3", study_resolution},
      {"interchange", "One module swapped for another, on SPOT", study_interchange},
      {"volume", "Violations of volume with and without the hinge, on CUBE", study_volume},
      {"collapse", "Joint training from scratch beside two stages, on BOB", study_collapse},
      {"model-size", "A smaller and a larger stress net, on CUBE", study_model_size},
      {"laws", "A law that is the derivative of an energy, beside the paper's", study_laws},
      {"efficiency", "Seconds for 1000 frames of BOB, and the error they buy", study_efficiency},
      {"failure", "The worst rollout on BOB", study_failure},
      {"friction", "Friction that nobody tells of: learned, and by simulators", study_friction},
      {"sysid", "E and nu of CUBE from positions alone", study_sysid},
      {"transfer", "CUBE's model on a softer cube in wind, from positions", study_transfer},
      {"volume-weight", "The volume loss at four weights, on that cube", study_volume_weight}};
  return all;
}

Path add_to_report(const Study& study, const Path& work) {
  const Path folder = work / "studies";
  std::filesystem::create_directories(folder);
  const Json json{{"name", study.name},       {"title", study.title},
                  {"notes", study.notes},     {"rows", study.rows},
                  {"figures", study.figures}, {"json", Json::parse(study.json)}};
  write_text(folder / (study.name + ".json"), json.dump(1) + "\n");

  std::string sections;
  for (const StudyKind& kind : study_kinds()) {
    const Path file = folder / (std::string(kind.name) + ".json");
    if (!std::filesystem::exists(file)) continue;
    try {
      sections += section(Json::parse(read_text(file, kLimit)));
    } catch (const Json::exception& error) {
      throw InputError(file.string() + ": not a study that nmp reproduce has kept (" +
                       error.what() + "); remove it");
    }
  }
  const Path report = work / "report.html";
  write_text(report, report::page("nmp: studies of the paper", sections));
  return report;
}

}  // namespace nmp
