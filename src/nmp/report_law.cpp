#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp::report {

namespace {
std::vector<double> in_kPa(std::vector<double> stresses) {
  for (double& each : stresses) each /= 1e3;
  return stresses;
}
}  // namespace

std::string law_section(const std::vector<StressCurve>& curves) {
  if (curves.empty()) return "";
  std::string html =
      "<section>\n<h2>The learned law</h2>\n<p>First Piola-Kirchhoff stress along three families "
      "of deformations. The band is the spread over 24 orientations of the body's reference frame, "
      "which an isotropic law does not have; shaded: what the training has seen.</p>\n<div "
      "class=\"stages\">\n";
  for (const StressCurve& each : curves) {
    LinePlot plot;
    plot.name = each.name;
    plot.x_label = each.x_label;
    plot.y_label = each.component + " [kPa]";
    plot.log_y = false;
    plot.labels = false;
    plot.width = 360;
    plot.height = 280;
    Curve learned{"learned",         {0, "", 2, 1},    each.x,
                  in_kPa(each.mean), in_kPa(each.low), in_kPa(each.high)};
    Readout data{each.x_label, "kPa", false, each.x, {{"learned", 0, learned.y}}};
    std::vector<LegendItem> items{{{0, "", 2, 1}, "learned"}};
    plot.curves = {learned};
    if (!each.truth.empty()) {
      plot.curves.push_back({"true", {6, "5 3", 1.6, 1}, each.x, in_kPa(each.truth), {}, {}});
      data.series.push_back({"true", 6, in_kPa(each.truth)});
      items.push_back({{6, "5 3", 1.6, 1}, "true"});
    }
    if (each.range_high > each.range_low)
      for (const double x : each.x)
        plot.background.push_back(x >= each.range_low && x <= each.range_high ? 1 : 0);
    plot.background_peak = 1;
    html += "<figure data-plot><figcaption>" + escape_html(each.name) + "</figcaption>" +
            draw(plot) + legend(items) + data_script(data) + "</figure>\n";
  }
  return html + "</div>\n</section>\n";
}

}  // namespace nmp::report
