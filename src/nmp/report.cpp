#include "nmp/report.h"

#include <new>

#include "base/check.h"
#include "nmp/plot.h"
#include "nmp/report_sections.h"
#include "nmp/shipped.h"

namespace nmp {

namespace {

using namespace report;

std::string block(const std::string& name, const std::string& content, bool open) {
  if (content.empty()) return "";
  return std::string("<details") + (open ? " open" : "") + "><summary>" + name + "</summary><pre>" +
         escape_html(content) + "</pre></details>\n";
}

std::string page_file(const char* name) {
  const char* content = find_page_file(name);
  NMP_CHECK(content, text("there is no page file ", name));
  return content;
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

  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
      "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n<title>" +
      escape_html(input.title) + "</title>\n<style>\n" + page_file("report.css") +
      page_file("player.css") +
      "</style>\n</head>\n<body>\n<main>\n<header>\n<p class=\"eyebrow\">Neural Modular "
      "Physics</p>\n<h1>" +
      escape_html(input.title) + "</h1>\n</header>\n";
  const bool several = results.size() > 1;
  for (const Result& result : results) html += headline_section(result, several);
  html += player_section(input.playbacks, input.player);
  for (const Result& result : results) html += errors_section(result, several);
  for (const Result& result : results) html += modules_section(result, several);
  html += states_section(input.playbacks);
  html += training_section(training);
  html += "<section>\n<h2>Settings</h2>\n" + block("Commands", input.commands, true) +
          block("Scene", input.scene_toml, false) +
          block("Training configuration", input.config_toml, false) +
          "</section>\n</main>\n<script>\n" + page_file("report.js") + "</script>\n";
  if (!input.player.empty()) html += "<script>\n" + page_file("player.js") + "</script>\n";
  return html + "</body>\n</html>\n";
}

}  // namespace nmp
