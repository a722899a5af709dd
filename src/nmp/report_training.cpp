#include <algorithm>
#include <cmath>
#include <limits>

#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp::report {

namespace {

// Loss in at most so many bins of iterations: median, smallest and largest of each.
LinePlot loss_plot(const Stage& stage) {
  constexpr std::size_t kBins = 160;
  const std::size_t n = stage.iteration.size(), bins = std::min(n, kBins);
  LinePlot plot;
  plot.name = "loss of the stage " + stage.name;
  plot.x_label = "iteration";
  plot.width = 380;
  plot.height = 270;
  plot.labels = false;
  Curve curve{"loss", {0, "", 2}, {}, {}, {}, {}};
  for (std::size_t b = 0; b < bins; ++b) {
    const std::size_t begin = b * n / bins, end = (b + 1) * n / bins;
    std::vector<double> finite;
    for (std::size_t i = begin; i < end; ++i)
      if (std::isfinite(stage.loss[i])) finite.push_back(stage.loss[i]);
    std::sort(finite.begin(), finite.end());
    const double none = std::numeric_limits<double>::quiet_NaN();
    curve.x.push_back(stage.iteration[(begin + end) / 2]);
    curve.y.push_back(finite.empty() ? none : finite[finite.size() / 2]);
    curve.low.push_back(finite.empty() ? none : finite.front());
    curve.high.push_back(finite.empty() ? none : finite.back());
    plot.background.push_back(std::isfinite(stage.rate[begin]) ? stage.rate[begin] : 0);
  }
  plot.curves.push_back(std::move(curve));
  return plot;
}

std::string stage_table(const Training& training) {
  if (training.reports.empty()) return "";
  std::string html =
      "<div class=\"scroll\"><table>\n<thead><tr><th>stage</th><th>steps</th><th>RMSE before "
      "[m]</th><th>at its end</th><th>kept<small>after step</small></th><th>weights "
      "moved<small>at its end</small></th><th>seconds</th></tr></thead>\n<tbody>\n";
  const auto count = [](double value) { return std::to_string(std::lround(value)); };
  for (const StageReport& r : training.reports) {
    html += "<tr><td>" + escape_html(r.stage) + "<small>" + escape_html(r.pairing) +
            "</small></td><td>" + count(r.iterations) +
            (r.iterations < r.planned ? "<small>of " + count(r.planned) + "</small>" : "") +
            "</td><td>" + pretty(r.rmse_before) + "</td><td>" + pretty(r.rmse_after) + "</td><td>" +
            pretty(r.rmse_kept) + "<small>" + count(r.kept) + "</small></td><td>" +
            percent(r.change) + "<small>" + percent(r.change_end) + "</small></td><td>" +
            pretty(r.seconds) + "</td></tr>\n";
  }
  return html +
         "</tbody></table></div>\n<p class=\"note\">RMSE over whole rollouts of the stage's "
         "pairing "
         "on training trajectories that were set aside; the best weights tried are kept. Weights "
         "moved: relative to where the stage began.</p>\n";
}

}  // namespace

std::string training_section(const Training& training) {
  if (training.stages.empty() && training.reports.empty() && !training.fit) return "";
  std::string html = "<section>\n<h2>Training</h2>\n";
  if (training.fit) {
    const auto& b = training.fit->b;
    html +=
        "<p>The affine part of the integrator, a = α f/V + b, was fitted in closed form: 1/α = " +
        pretty(1 / training.fit->alpha) + " kg/m³, b = (" + pretty(b[0]) + ", " + pretty(b[1]) +
        ", " + pretty(b[2]) + ") m/s²; it leaves " + pretty(training.fit->residual) +
        " m/s² (rms).</p>\n";
  }
  html += stage_table(training) + "<div class=\"stages\">\n";
  for (const Stage& stage : training.stages) {
    const LinePlot plot = loss_plot(stage);
    const Curve& loss = plot.curves.front();
    const Readout data{"iteration",
                       "",
                       false,
                       loss.x,
                       {{"loss", 0, loss.y}, {"learning rate", 7, plot.background}}};
    html += "<figure data-plot><figcaption>" + escape_html(stage.name) + "<small>learning rate " +
            plain(stage.rate.front()) + " to " + plain(stage.rate.back()) + " (grey area)</small>" +
            "</figcaption>" + draw(plot) + data_script(data) + "</figure>\n";
  }
  return html +
         "</div>\n<p class=\"note\">Median loss; the band spans the smallest and the largest of "
         "the "
         "iterations that share a point.</p>\n</section>\n";
}

}  // namespace nmp::report
