#pragma once

#include <string>
#include <vector>

namespace nmp {

/// Text for HTML and SVG, elements and attributes.
std::string escape_html(const std::string& text);
/// Three significant digits: "0.535", "12.4", below 0.01 "6.12 × 10⁻⁴".
std::string pretty(double value);
/// The same for a mean and its spread, with one power of ten: "6.12 ± 0.4 × 10⁻⁴".
std::string pretty(double mean, double spread);

/// Colour of the page's palette (a CSS variable, so that it follows light and dark) and dashes.
struct Stroke {
  int colour = 0;    // --c0 ... --c7
  std::string dash;  // as stroke-dasharray; empty: solid
  double width = 1.6;
  double opacity = 1;
};

/// Points that are not finite, or not positive on a logarithmic axis, are gaps.
struct Curve {
  std::string label;
  Stroke stroke;
  std::vector<double> x, y;
  std::vector<double> low, high;  // a band around y; empty: none
};

/// Curves over one x axis as inline SVG. Curves are named at their ends if there is room for it.
struct LinePlot {
  std::string name;  // for people who cannot see it
  std::string x_label, y_label;
  bool log_x = false, log_y = true;
  std::vector<Curve> curves;
  std::vector<double> marks;       // vertical lines
  std::vector<double> background;  // over the first curve's x: a faint area on its own linear axis
  double background_peak = 0;      // top of that axis; 0: a little above the largest value
  double width = 860, height = 420;
  bool labels = true;
};
std::string draw(const LinePlot& plot);

/// One row of dots per method on a logarithmic x axis, with a stroke at their mean.
struct DotRow {
  std::string label;
  Stroke stroke;
  double mean = 0;
  std::vector<double> values;
};
struct DotPlot {
  std::string name, x_label;
  std::vector<DotRow> rows;
  double width = 860;
  bool labels_beside = true;  // else above each row
};
std::string draw(const DotPlot& plot);

}  // namespace nmp
