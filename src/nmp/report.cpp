#include "nmp/report.h"

#include <new>

#include "base/check.h"
#include "nmp/player_html.h"
#include "nmp/plot.h"
#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp {

namespace {

using namespace report;

std::string block(const std::string& name, const std::string& content, bool open) {
  if (content.empty()) return "";
  return std::string("<details") + (open ? " open" : "") + "><summary>" + name + "</summary><pre>" +
         escape_html(content) + "</pre></details>\n";
}

}  // namespace

std::string make_report(const ReportInput& input) {
  std::vector<Result> results;
  for (std::size_t i = 0; i < input.evaluations.size(); ++i) {
    const std::string name = text("evaluation ", i + 1, ": ");
    try {
      results.push_back(parse_evaluation(input.evaluations[i]));
    } catch (const InputError& error) {
      throw InputError(name + error.what());
    } catch (const std::bad_alloc&) {
      throw;
    } catch (const std::exception& error) {
      throw InputError(name + "not what nmp eval --json writes: " + printable(error.what()));
    }
  }
  const Training training = parse_metrics(input.metrics);

  std::string html;
  const bool several = results.size() > 1;
  for (const Result& result : results) html += headline_section(result, several);
  html += player_section(input.player);
  for (const Result& result : results) html += errors_section(result, several);
  for (const Result& result : results) html += modules_section(result, several);
  html += law_section(input.law);
  html += states_section(input.playbacks);
  html += training_section(training);
  html += "<section>\n<h2>Settings</h2>\n" + block("Commands", input.commands, true) +
          block("Scene", input.scene_toml, false) +
          block("Training configuration", input.config_toml, false) + "</section>\n";
  std::vector<std::string> scripts{page_file("report.js")};
  if (!input.player.tracks.empty()) scripts.push_back(player_script());
  return page(input.title, html, player_styles(), scripts);
}

}  // namespace nmp
