#include "nmp/report_html.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "base/check.h"
#include "nmp/shipped.h"

namespace nmp::report {

namespace {

using Json = nlohmann::ordered_json;

// Four digits are enough for a read-out.
Json rounded(const std::vector<double>& values) {
  Json list = Json::array();
  for (const double value : values) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.4g", value);
    list.push_back(std::isfinite(value) ? Json(std::strtod(digits, nullptr)) : Json());
  }
  return list;
}

}  // namespace

std::string page_file(const char* name) {
  const char* content = find_page_file(name);
  NMP_CHECK(content, text("there is no page file ", name));
  return content;
}

std::string page(const std::string& title, const std::string& sections, const std::string& styles,
                 const std::vector<std::string>& scripts) {
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
      "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n<title>" +
      escape_html(title) + "</title>\n<style>\n" + page_file("report.css") + styles +
      "</style>\n</head>\n<body>\n<main>\n<header>\n<p class=\"eyebrow\">Neural Modular "
      "Physics</p>\n<h1>" +
      escape_html(title) + "</h1>\n</header>\n" + sections + "</main>\n";
  for (const std::string& script : scripts) html += "<script>\n" + script + "</script>\n";
  return html + "</body>\n</html>\n";
}

std::string length(double metres) {
  if (!std::isfinite(metres)) return "not finite";
  const double size = std::abs(metres);
  const auto with = [](double value, const char* unit) { return pretty(value) + " " + unit; };
  if (size == 0 || size >= 0.1) return with(metres, "m");
  if (size >= 1e-4) return with(metres * 1e3, "mm");
  if (size >= 1e-7) return with(metres * 1e6, "µm");
  return with(metres * 1e9, "nm");
}

std::string plain(double value) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.3g", value);
  return digits;
}

std::string percent(double part) {
  const double value = 100 * part;
  if (value == 0 || value >= 0.01 || !std::isfinite(value)) return pretty(value) + " %";
  if (value < 1e-4) return "below 0.0001 %";
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.4f %%", value);
  return digits;
}

std::string times(double ratio) {
  if (!std::isfinite(ratio)) return "not comparable to";
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.1f times", ratio);
  return ratio < 10 ? digits : pretty(ratio) + " times";
}

std::string key(const Stroke& stroke) {
  return "<svg class=\"key\" viewBox=\"0 0 26 8\" aria-hidden=\"true\"><path d=\"M0 4H26\" "
         "stroke=\"var(--c" +
         std::to_string(stroke.colour) + ")\" stroke-width=\"" +
         std::to_string(std::lround(stroke.width)) + "\" stroke-opacity=\"" +
         plain(stroke.opacity) + "\" stroke-dasharray=\"" + stroke.dash + "\"/></svg>";
}

std::string legend(const std::vector<LegendItem>& items) {
  std::string html = "<ul class=\"legend\">";
  for (const LegendItem& item : items)
    html += "<li>" + key(item.stroke) + escape_html(item.label) + "</li>";
  return html + "</ul>";
}

std::string short_name(const std::string& trajectory) {
  const std::string extension = ".safetensors";
  const bool ends =
      trajectory.size() > extension.size() &&
      trajectory.compare(trajectory.size() - extension.size(), extension.size(), extension) == 0;
  return ends ? trajectory.substr(0, trajectory.size() - extension.size()) : trajectory;
}

std::string both_widths(LinePlot plot) {
  std::string html = "<div class=\"wide\">" + draw(plot) + "</div>";
  plot.width = 380;
  plot.height = 340;
  plot.labels = false;
  return html + "<div class=\"narrow\">" + draw(plot) + "</div>";
}
std::string both_widths(DotPlot plot) {
  std::string html = "<div class=\"wide\">" + draw(plot) + "</div>";
  plot.width = 380;
  plot.labels_beside = false;
  return html + "<div class=\"narrow\">" + draw(plot) + "</div>";
}

std::string data_script(const Readout& readout) {
  Json json{{"label", readout.label},
            {"unit", readout.unit},
            {"sorted", readout.sorted},
            {"x", rounded(readout.x)},
            {"series", Json::array()}};
  for (const Readout::Series& each : readout.series)
    json["series"].push_back(
        {{"label", each.label}, {"colour", each.colour}, {"y", rounded(each.y)}});
  return data_script(json.dump(-1, ' ', false, Json::error_handler_t::replace));
}

std::string data_script(const std::string& json) {
  std::string data;
  data.reserve(json.size());
  for (const char c : json) c == '<' ? data += "\\u003c" : data += c;
  return "<script type=\"application/json\">" + data + "</script>";
}

std::vector<std::size_t> thinned(std::size_t n, std::size_t n_points) {
  std::vector<std::size_t> places;
  if (n == 0) return places;
  const std::size_t stride = std::max<std::size_t>(1, (n - 1 + n_points - 1) / n_points);
  for (std::size_t i = 0; i + 1 < n; i += stride) places.push_back(i);
  places.push_back(n - 1);
  return places;
}

}  // namespace nmp::report
