#pragma once

#include <string>
#include <vector>

#include "nmp/plot.h"

/// Pieces that the sections of a report share.
namespace nmp::report {

/// A whole page that needs no network, in the style of a report.
/// @param sections  HTML   @param styles, scripts  more of them, without their elements
std::string page(const std::string& title, const std::string& sections,
                 const std::string& styles = "", const std::vector<std::string>& scripts = {});
/// Text of a file of page/.
std::string page_file(const char* name);

/// A length in the unit that people would use.
std::string length(double metres);
/// "%.3g"
std::string plain(double value);
/// Without powers of ten where a reader expects a part of the whole.
std::string percent(double part);
/// "3.1 times"
std::string times(double ratio);

/// A short piece of the stroke, as a legend shows it.
std::string key(const Stroke& stroke);
struct LegendItem {
  Stroke stroke;
  std::string label;
};
std::string legend(const std::vector<LegendItem>& items);

/// Name of a trajectory's file without its extension.
std::string short_name(const std::string& trajectory);

/// A plot twice: wide with labels, and narrow for a phone.
std::string both_widths(LinePlot plot);
std::string both_widths(DotPlot plot);

/// What the read-out of a plot shows: the value of every series at each x.
struct Readout {
  std::string label, unit;  // of x; of the values
  bool sorted = false;      // by value
  std::vector<double> x;
  struct Series {
    std::string label;
    int colour = 0;
    std::vector<double> y;
  };
  std::vector<Series> series;
};
/// As data for page/report.js, which finds it inside <figure data-plot>.
std::string data_script(const Readout& readout);
/// A JSON document as data for a script; '<' cannot end the element.
std::string data_script(const std::string& json);

/// At most about `n_points` of `n` places, the first and the last among them.
std::vector<std::size_t> thinned(std::size_t n, std::size_t n_points);

}  // namespace nmp::report
