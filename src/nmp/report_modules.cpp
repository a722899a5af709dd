#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp::report {

namespace {

constexpr std::size_t kShown = 2;  // trajectories that need no click

std::string frames_of(long n) { return text(n, n == 1 ? " frame" : " frames"); }

std::string row(const std::string& module, const std::string& what, const ModuleError& error,
                const char* unit) {
  return "<tr><td>" + module + "<small>" + what + "</small></td><td>" + percent(error.relative) +
         "</td><td>" + pretty(error.rms) + " " + unit + "</td><td>" +
         (std::isfinite(error.reference) ? percent(error.reference) : "–") + "</td></tr>\n";
}

std::string table(const Modules& modules) {
  std::string html =
      "<div class=\"scroll\"><table>\n<thead><tr><th>module</th><th>relative error</th>"
      "<th>rms error<small>per vertex</small></th><th>the true module<small>leaves</small></th>"
      "</tr></thead>\n<tbody>\n" +
      row("stress net", "internal force, every 10th frame", modules.stress, "N");
  for (const auto& [n, error] : modules.integrator)
    html += row("integrator", "change of velocity over " + frames_of(n), error, "m/s");
  return html + "</tbody></table></div>\n";
}

struct Line {
  std::string label;
  Stroke stroke;
  const std::vector<double>* y;
};

std::string figure(const std::string& title, const std::string& what, const ModuleCurves& curves,
                   const std::vector<Line>& lines) {
  LinePlot plot;
  plot.name = title + ", " + what;
  plot.x_label = "frame";
  plot.y_label = "relative error";
  plot.width = 440;
  plot.height = 290;
  plot.labels = false;
  Readout data{"frame", "", false, curves.frame, {}};
  std::vector<LegendItem> items;
  for (const Line& line : lines) {
    if (line.y->empty()) continue;
    plot.curves.push_back({line.label, line.stroke, curves.frame, *line.y, {}, {}});
    data.series.push_back({line.label, line.stroke.colour, *line.y});
    items.push_back({line.stroke, line.label});
  }
  plot.background = curves.touching;
  plot.background_peak = 3 * *std::max_element(curves.touching.begin(), curves.touching.end());
  return "<figure data-plot><figcaption>" + title + "<small>" + what + "</small></figcaption>" +
         draw(plot) + legend(items) + data_script(data) + "</figure>\n";
}

std::string figures(const ModuleCurves& curves) {
  const std::string name = escape_html(short_name(curves.trajectory));
  std::vector<Line> stress{{"stress net", {1, "", 2}, &curves.stress.relative},
                           {"true law", {6, "4 3", 1.6}, &curves.stress.reference}};
  std::vector<Line> integrator;
  const Stroke strokes[] = {{3, "", 1.4}, {2, "", 2.2}, {0, "", 2.2}};
  std::size_t k = 0;
  for (const auto& [n, curve] : curves.integrator) {
    Stroke stroke = strokes[std::min<std::size_t>(k++, 2)];
    integrator.push_back({"over " + frames_of(n), stroke, &curve.relative});
    stroke.dash = "4 3";
    stroke.width = 1.4;
    integrator.push_back({"true, over " + frames_of(n), stroke, &curve.reference});
  }
  return "<div class=\"pair\">\n" +
         figure(name, "error of the stress net's forces", curves, stress) +
         figure(name, "error of the integrator's velocity change", curves, integrator) + "</div>\n";
}

}  // namespace

std::string modules_section(const Result& result, bool name_model) {
  const Modules& modules = result.modules;
  if (modules.trajectories.empty()) return "";
  std::string html =
      "<section>\n<h2>The modules by themselves" +
      (name_model ? ": " + escape_html(result.model) : "") +
      "</h2>\n<p>Each module is fed with recorded states, so no error builds up. Errors are "
      "relative to the root sum of squares of the recorded quantity.</p>\n" +
      table(modules) +
      "<p class=\"note\">Integrator: the change of the recorded velocity over a window of frames "
      "against the sum of the predicted dv, from recorded positions, velocities and forces, in the "
      "velocity convention of the rollouts; without pinned vertices, and without the vertical "
      "component of vertices that touch the ground inside the window. The dv of a single frame is "
      "dominated by waves faster than a frame, which no state of one moment foretells: the true "
      "integrator misses them too. What accumulates in a rollout is the error over windows.</p>\n";
  for (std::size_t i = 0; i < std::min(kShown, modules.trajectories.size()); ++i)
    html += figures(modules.trajectories[i]);
  if (modules.trajectories.size() > kShown) {
    html += text("<details><summary>", modules.trajectories.size() - kShown, " more</summary>\n");
    for (std::size_t i = kShown; i < modules.trajectories.size(); ++i)
      html += figures(modules.trajectories[i]);
    html += "</details>\n";
  }
  return html +
         "<p class=\"note\">Grey area: how many vertices touch the ground. Dashed: the true module "
         "on the same recording, whose positions are rounded to 32 bits. Left out: frames whose "
         "forces are below a thousandth of the largest, as in free flight, where they are little "
         "more than that rounding.</p>\n</section>\n";
}

}  // namespace nmp::report
