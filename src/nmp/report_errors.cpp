#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "nmp/evaluate.h"
#include "nmp/paper_results.h"
#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp::report {

namespace {

// How a method is named and drawn; in the order of the table.
struct Look {
  std::string name, label, what;
  Stroke stroke;
};
const std::vector<Look>& looks() {
  static const std::vector<Look> all{
      {"neural", "neural simulator", "learned law, learned integrator", {0, "", 3}},
      {"residual_zeroed", "its net set to zero", "learned law, affine part alone", {5, "7 3", 1.8}},
      {"neural_law", "learned law", "with semi-implicit Euler", {1, "", 1.8}},
      {"neural_integrator", "learned integrator", "with the true law", {2, "", 1.8}},
      {"affine_only", "affine only", "true law, two fitted numbers", {3, "9 3 2 3", 1.8}},
      {"coarse_physics", "coarse physics", "true law, semi-implicit Euler", {6, "", 1.8}},
      {"staggered_physics",
       "coarse, staggered start",
       "true law, semi-implicit Euler",
       {6, "4 3", 1.8}},
      {"ballistic", "ballistic flight", "no elasticity", {4, "2 3", 1.8}},
      {"rest", "standing still", "nothing moves", {7, "2 3", 1.8}}};
  return all;
}

// RMSE of the paper's own method, 0 if it has none.
double paper_of(const std::string& scene, Index frame) {
  const std::optional<PaperResult> result = paper_result(scene, frame);
  return result ? result->rmse : 0;
}

Look look(const std::string& name) {
  const std::size_t i = rank(name);
  return i < looks().size() ? looks()[i] : Look{name, name, "", {7, "5 2", 1.8}};
}

std::string finding(const std::string& bold, const std::string& rest, bool plain_speech = false) {
  return std::string("<li") + (plain_speech ? " class=\"plain\"" : "") + "><b>" + bold + "</b> " +
         rest + "</li>\n";
}

std::string findings(const Result& result) {
  const Method* neural = result.find("neural");
  if (!neural) return "";
  const long last = result.horizons.back();
  const auto at_end = [&](const Method* method) { return method->horizons.at(last).mean; };
  const double error = at_end(neural);
  std::string list;

  if (const Method* zeroed = result.find("residual_zeroed")) {
    constexpr double kNoticeable = 1.05;
    const std::string both = "with the net " + length(error) + ", without it " +
                             length(at_end(zeroed)) + " at frame " + std::to_string(last) + ".";
    if (!(at_end(zeroed) > kNoticeable * error))
      list +=
          finding("Identified, not learned.",
                  "Setting the integrator's residual net to zero does not raise the error "
                  "noticeably: " +
                      both +
                      " The accuracy of the integrator comes from the numbers of its affine part, "
                      "fitted in closed form.",
                  true);
    else
      list += finding("The residual net matters:", both);
  }
  if (const Method* physics = result.find("staggered_physics")) {
    const double reference = at_end(physics);
    list += finding("Beside physics:",
                    "the true law with semi-implicit Euler at the same step and a "
                    "staggered start is off by " +
                        length(reference) + "; the neural simulator's error is " +
                        times(error / reference) + " that.");
  }
  if (const Method* rest = result.find("rest")) {
    const double relative = error / at_end(rest);
    list += relative > 0.9 ? finding("No better than standing still:",
                                     length(at_end(rest)) + " without any motion.", true)
                           : finding("Beside doing nothing:",
                                     "standing still is off by " + length(at_end(rest)) + ", " +
                                         times(1 / relative) + " as much.");
  }
  if (const double paper = paper_of(result.scene, last); paper > 0)
    list +=
        finding("Beside the paper:",
                "its NMP is off by " + length(paper) + " at frame " + std::to_string(last) +
                    " on its own recording of this scene. The recordings differ: compare orders of "
                    "magnitude, not digits.");
  if (neural->diverged > 0) {
    std::string reasons;
    for (const std::string& reason : neural->reasons) reasons += "<br>" + escape_html(reason);
    list += finding(std::to_string(neural->diverged) + " of " +
                        std::to_string(result.trajectories) + " rollouts diverged",
                    "and count with their last finite frame." + reasons, true);
  }
  if (neural->clamped > 0)
    list += finding("The speed limit acted",
                    std::to_string(neural->clamped) + " times on a vertex.", true);
  return "<ul class=\"findings\">\n" + list + "</ul>\n";
}

std::string error_table(const Result& result) {
  std::string html = "<div class=\"scroll\"><table>\n<thead><tr><th>RMSE [m]</th>";
  for (const long frame : result.horizons)
    html += text("<th>frame ", frame, "<small>", result.methods.front().horizons.at(frame).touched,
                 " of ", result.trajectories, " have landed</small></th>");
  html += "<th>diverged</th><th>seconds</th></tr></thead>\n<tbody>\n";
  for (const Method& method : result.methods) {
    const Look l = look(method.name);
    html += std::string("<tr") + (method.name == "neural" ? " class=\"us\"" : "") + "><td>" +
            key(l.stroke) + escape_html(l.label) + "<small>" + l.what + "</small></td>";
    for (const long frame : result.horizons) {
      const Error& error = method.horizons.at(frame);
      html += "<td>" + pretty(error.mean, error.std) + "<small>" + percent(error.relative) +
              " of the motion</small></td>";
    }
    html += std::string("<td") + (method.diverged > 0 ? " class=\"bad\"" : "") + ">" +
            text(method.diverged, " / ", result.trajectories) + "</td><td>" +
            plain(method.seconds) + "</td></tr>\n";
  }
  bool in_paper = false;
  std::string paper =
      "<tr class=\"paper\"><td>the paper's NMP<small>on its own recording</small></td>";
  for (const long frame : result.horizons) {
    const double value = paper_of(result.scene, frame);
    in_paper = in_paper || value > 0;
    paper += "<td>" + (value > 0 ? pretty(value) : std::string("–")) + "</td>";
  }
  if (in_paper) html += paper + "<td>–</td><td>–</td></tr>\n";
  return html +
         "</tbody></table></div>\n<p class=\"note\">Mean ± standard deviation over the "
         "trajectories; below it, relative to the rms displacement of the recorded motion from "
         "its start.</p>\n";
}

std::string methods_legend(const Result& result) {
  std::vector<LegendItem> items;
  for (const Method& method : result.methods) {
    const Look l = look(method.name);
    items.push_back({l.stroke, l.label});
  }
  return legend(items);
}

std::string curves_figure(const Result& result) {
  std::vector<double> frames;
  for (const std::size_t t : thinned(static_cast<std::size_t>(result.frames) + 1, 300))
    frames.push_back(static_cast<double>(t));

  LinePlot plot;
  plot.name = "RMSE over time of every method";
  plot.x_label = "frame";
  plot.y_label = "RMSE [m]";
  for (const long frame : result.horizons) plot.marks.push_back(static_cast<double>(frame));
  Readout data{"frame", "m", true, frames, {}};
  for (const Method& method : result.methods) {
    const Look l = look(method.name);
    Curve curve{l.label, l.stroke, frames, {}, {}, {}};
    for (const double frame : frames) {
      const auto t = static_cast<std::size_t>(frame);
      curve.y.push_back(method.mean[t]);
      if (method.name != "neural") continue;
      curve.low.push_back(method.mean[t] - method.std[t]);
      curve.high.push_back(method.mean[t] + method.std[t]);
    }
    data.series.push_back({l.label, l.stroke.colour, curve.y});
    plot.curves.push_back(std::move(curve));
  }
  return "<h3>Error over time</h3>\n<figure data-plot>" + both_widths(plot) +
         methods_legend(result) + data_script(data) +
         "</figure>\n<p class=\"note\">Mean over the trajectories; the band of the neural "
         "simulator is ± "
         "one standard deviation, cut off where it reaches zero. Dotted lines: the horizons of the "
         "table.</p>\n";
}

std::string dots_figure(const Result& result) {
  const long last = result.horizons.back();
  DotPlot plot;
  plot.name = text("RMSE of each trajectory at frame ", last);
  plot.x_label = text("RMSE at frame ", last, " [m]");
  for (const Method& method : result.methods) {
    const Look l = look(method.name);
    const Error& error = method.horizons.at(last);
    plot.rows.push_back({l.label, l.stroke, error.mean, error.each});
  }
  return "<h3>Each trajectory</h3>\n<figure>" + both_widths(plot) +
         "</figure>\n<p class=\"note\">A dot is a trajectory, the stroke their mean.</p>\n";
}

std::string tile(const std::string& value, const std::string& what) {
  return "<div class=\"tile\"><b>" + value + "</b><span>" + what + "</span></div>\n";
}

}  // namespace

std::string headline_section(const Result& result, bool name_model) {
  const long last = result.horizons.back();
  const std::string whole = result.split == "val" ? "validation" : "training";
  const std::string trajectories = text(result.trajectories, " ", whole,
                                        result.trajectories == 1 ? " trajectory" : " trajectories");
  std::string html = "<section>\n<h2>" + escape_html(result.scene) + ", " + trajectories +
                     (name_model ? ": " + escape_html(result.model) : "") + "</h2>\n";
  if (const Method* neural = result.find("neural")) {
    const Error& error = neural->horizons.at(last);
    html += "<p class=\"lead\">After " + std::to_string(last) +
            " frames the neural simulator is <b>" + length(error.mean) +
            "</b> from the recorded motion (root mean square over the vertices).</p>\n";
    html += "<div class=\"tiles\">\n" + tile(length(error.mean), text("RMSE at frame ", last)) +
            tile(percent(error.relative), "of the recorded displacement") +
            (result.force_error ? tile(percent(*result.force_error),
                                       "error of the learned law's forces along the recording")
                                : "") +
            tile(text(neural->diverged, " of ", result.trajectories), "rollouts diverged") +
            "</div>\n";
  }
  return html + findings(result) + "</section>\n";
}

std::string errors_section(const Result& result, bool name_model) {
  return "<section>\n<h2>Errors" + (name_model ? " of " + escape_html(result.model) : "") +
         "</h2>\n" + error_table(result) + curves_figure(result) + dots_figure(result) +
         "</section>\n";
}

}  // namespace nmp::report
