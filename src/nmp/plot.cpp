#include "nmp/plot.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace nmp {

namespace {

// One decimal is a tenth of a pixel.
std::string px(double value) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.1f", value);
  return digits;
}

std::string general(double value, int significant) {
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.*g", significant, value);
  return digits;
}

// Three significant digits, the last ones kept if they are 0.
std::string fixed3(double value) {
  const double size = std::abs(value);
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.*f",
                size >= 99.95    ? 0
                : size >= 9.995  ? 1
                : size >= 0.9995 ? 2
                                 : 3,
                value);
  return digits;
}

std::string superscript(int n) {
  static const char* const kDigits[] = {"⁰", "¹", "²", "³", "⁴", "⁵", "⁶", "⁷", "⁸", "⁹"};
  std::string text = n < 0 ? "⁻" : "";
  for (const char digit : std::to_string(std::abs(n))) text += kDigits[digit - '0'];
  return text;
}

std::string power_of_ten(int n) { return "10" + superscript(n); }

bool drawable(double y) { return std::isfinite(y) && y > 0; }

std::string stroke_of(const Stroke& stroke) {
  std::string text = "stroke=\"var(--c" + std::to_string(stroke.colour) + ")\" stroke-width=\"" +
                     general(stroke.width, 3) + "\"";
  if (stroke.opacity < 1) text += " stroke-opacity=\"" + general(stroke.opacity, 2) + "\"";
  if (!stroke.dash.empty()) text += " stroke-dasharray=\"" + stroke.dash + "\"";
  return text;
}

std::string line(double x1, double y1, double x2, double y2, const std::string& attributes) {
  return "<line x1=\"" + px(x1) + "\" y1=\"" + px(y1) + "\" x2=\"" + px(x2) + "\" y2=\"" + px(y2) +
         "\" " + attributes + "/>";
}

std::string label(double x, double y, const std::string& anchor, const std::string& text,
                  const std::string& attributes = "") {
  return "<text x=\"" + px(x) + "\" y=\"" + px(y) + "\" text-anchor=\"" + anchor + "\" " +
         attributes + ">" + escape_html(text) + "</text>";
}

// A linear map of [from, to] to [begin, end].
struct Axis {
  double from = 0, to = 1, begin = 0, end = 1;
  double operator()(double value) const {
    const double part = to > from ? (value - from) / (to - from) : 0.5;
    return begin + (end - begin) * std::clamp(part, -1e3, 1e3);
  }
};

struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
  bool empty() const { return !(low <= high); }
};

// Range of log10 with a little air, at least a third of a decade.
Range log_range(Range values) {
  if (values.empty()) return {-1, 0};
  Range logs{std::log10(values.low), std::log10(values.high)};
  const double air =
      std::max(0.04 * (logs.high - logs.low), (1.0 / 3 - (logs.high - logs.low)) / 2);
  return {logs.low - air, logs.high + air};
}

// The same with a little air; 0 belongs to it if it is near.
Range linear_range(Range values) {
  if (values.empty()) return {0, 1};
  const double extent = values.high - values.low;
  const double air = extent > 0 ? 0.05 * extent : std::max(1e-3, 0.05 * std::abs(values.high));
  Range range{values.low - air, values.high + air};
  if (values.low >= 0 && values.low < 0.25 * extent) range.low = 0;
  return range;
}

struct Tick {
  double at;
  std::string label;
};

// Of an axis of log10: whole decades, and 2 and 5 between them where there is room.
std::vector<Tick> log_ticks(const Range& range) {
  std::vector<Tick> ticks;
  const double decades = range.high - range.low;
  const int step = std::max(1, static_cast<int>(std::ceil(decades / 8)));
  for (int n = static_cast<int>(std::floor(range.low)); n <= range.high; ++n) {
    for (const int m : {1, 2, 5}) {
      const double at = n + std::log10(m);
      if (at < range.low || at > range.high) continue;
      if (m == 1 ? n % step != 0 : decades > 2) continue;
      ticks.push_back({at, m == 1 ? power_of_ten(n) : std::to_string(m) + " × " + power_of_ten(n)});
    }
  }
  return ticks;
}

std::vector<Tick> linear_ticks(double low, double high, int at_most) {
  std::vector<Tick> ticks;
  if (!(high > low)) return {{low, general(low, 6)}};
  const double raw = (high - low) / at_most, power = std::pow(10, std::floor(std::log10(raw)));
  double step = 10 * power;
  for (const double m : {5.0, 2.0, 1.0})
    if (m * power >= raw) step = m * power;
  for (double at = std::ceil(low / step) * step; at <= high + 1e-9 * step; at += step)
    ticks.push_back({at, general(std::abs(at) < 1e-9 * step ? 0 : at, 6)});
  return ticks;
}

std::string open_svg(const std::string& name, double width, double height,
                     const std::string& data) {
  return "<svg viewBox=\"0 0 " + px(width) + " " + px(height) + "\" role=\"img\" aria-label=\"" +
         escape_html(name) + "\" " + data + ">";
}

// The y axis: of values, or of their logarithms.
struct Heights {
  Axis axis;
  bool logarithmic;
  bool drawable(double y) const { return std::isfinite(y) && (y > 0 || !logarithmic); }
  double operator()(double y) const { return axis(logarithmic ? std::log10(y) : y); }
};

// The points of a curve as path data, with gaps.
std::string path(const std::vector<double>& x, const std::vector<double>& y, const Axis& to_x,
                 const Heights& to_y) {
  std::string d;
  bool pen_down = false;
  for (std::size_t i = 0; i < std::min(x.size(), y.size()); ++i) {
    if (to_y.drawable(y[i])) {
      d += (pen_down ? "L" : "M") + px(to_x(x[i])) + " " + px(to_y(y[i]));
      pen_down = true;
    } else {
      pen_down = false;
    }
  }
  return d;
}

// The area between two curves, as one polygon; what is below the axis is cut off by the clip path.
std::string band(const Curve& curve, const Axis& to_x, const Heights& to_y) {
  std::string d;
  const std::size_t n = std::min({curve.x.size(), curve.low.size(), curve.high.size()});
  const auto height = [&](double y) { return px(to_y.drawable(y) ? to_y(y) : to_y.axis.begin); };
  for (std::size_t i = 0; i < n; ++i)
    if (to_y.drawable(curve.high[i]))
      d += (d.empty() ? "M" : "L") + px(to_x(curve.x[i])) + " " + height(curve.high[i]);
  for (std::size_t i = n; i-- > 0;)
    if (to_y.drawable(curve.high[i])) d += "L" + px(to_x(curve.x[i])) + " " + height(curve.low[i]);
  return d + "Z";
}

struct EndLabel {
  double at, y;  // where the curve ends, where its label goes
  const Curve* curve;
};

// Pushes labels apart until none is closer than `gap` to the next, inside [top, bottom].
void spread(std::vector<EndLabel>& labels, double gap, double top, double bottom) {
  std::sort(labels.begin(), labels.end(),
            [](const EndLabel& a, const EndLabel& b) { return a.at < b.at; });
  double lowest = top;
  for (EndLabel& each : labels) {
    each.y = std::max(each.at, lowest);
    lowest = each.y + gap;
  }
  double highest = bottom;
  for (std::size_t i = labels.size(); i-- > 0;) {
    labels[i].y = std::min(labels[i].y, highest);
    highest = labels[i].y - gap;
  }
}

}  // namespace

std::string escape_html(const std::string& text) {
  std::string result;
  for (const char c : text) {
    switch (c) {
      case '&':
        result += "&amp;";
        break;
      case '<':
        result += "&lt;";
        break;
      case '>':
        result += "&gt;";
        break;
      case '"':
        result += "&quot;";
        break;
      case '\'':
        result += "&#39;";
        break;
      default:
        result += c;
    }
  }
  return result;
}

std::string pretty(double value) {
  if (!std::isfinite(value)) return "not finite";
  if (value == 0) return "0";
  const int power = static_cast<int>(std::floor(std::log10(std::abs(value)) + 1e-3));
  if (power >= -2 && power <= 4) return fixed3(value);
  return fixed3(value / std::pow(10, power)) + " × " + power_of_ten(power);
}

std::string pretty(double mean, double spread) {
  if (!std::isfinite(mean) || !std::isfinite(spread) || mean == 0)
    return pretty(mean) + " ± " + pretty(spread);
  const int power = static_cast<int>(std::floor(std::log10(std::abs(mean)) + 1e-3));
  const bool plain = power >= -2 && power <= 4;
  const double unit = plain ? 1 : std::pow(10, power);
  // The spread to as many decimals as the mean.
  const std::string digits = fixed3(mean / unit);
  const auto dot = digits.find('.');
  const int decimals = dot == std::string::npos ? 0 : static_cast<int>(digits.size() - dot - 1);
  char spread_digits[400];
  std::snprintf(spread_digits, sizeof spread_digits, "%.*f", decimals, spread / unit);
  return digits + " ± " + spread_digits + (plain ? "" : " × " + power_of_ten(power));
}

std::string draw(const LinePlot& given) {
  // 0. A logarithmic x axis is a linear one of logarithms.
  LinePlot plot = given;
  if (plot.log_x) {
    for (Curve& curve : plot.curves)
      for (double& x : curve.x) x = std::log10(x);
    for (double& mark : plot.marks) mark = std::log10(mark);
  }

  // 1. What is shown: the first hundredth of x does not widen the y axis, where errors start at 0.
  Range x_range, y_values;
  for (const Curve& curve : plot.curves)
    for (const double x : curve.x) x_range.add(x);
  if (x_range.empty()) x_range = {0, 1};
  const double settled =
      plot.log_x ? x_range.low : x_range.low + 0.01 * (x_range.high - x_range.low);
  for (const Curve& curve : plot.curves)
    for (std::size_t i = 0; i < std::min(curve.x.size(), curve.y.size()); ++i)
      if ((curve.x[i] >= settled || !plot.log_y) && std::isfinite(curve.y[i]) &&
          (curve.y[i] > 0 || !plot.log_y))
        y_values.add(curve.y[i]);
  const Range y_range = plot.log_y ? log_range(y_values) : linear_range(y_values);

  const double left = 62, right = plot.width - (plot.labels ? 190 : 20);
  const double top = 16, bottom = plot.height - 44;
  const Axis to_x{x_range.low, x_range.high, left, right};
  const Heights to_y{{y_range.low, y_range.high, bottom, top}, plot.log_y};

  // 2. Frame, grid, ticks.
  std::string svg =
      open_svg(plot.name, plot.width, plot.height,
               "data-left=\"" + px(left) + "\" data-right=\"" + px(right) + "\" data-top=\"" +
                   px(top) + "\" data-bottom=\"" + px(bottom) + "\" data-from=\"" +
                   general(x_range.low, 9) + "\" data-to=\"" + general(x_range.high, 9) + "\"");
  for (const Tick& tick :
       plot.log_y ? log_ticks(y_range) : linear_ticks(y_range.low, y_range.high, 6)) {
    const double y = to_y.axis(tick.at);
    svg += line(left, y, right, y, "class=\"grid\"");
    svg += label(left - 8, y + 4, "end", tick.label);
  }
  for (const Tick& tick : plot.log_x
                              ? log_ticks(x_range)
                              : linear_ticks(x_range.low, x_range.high, plot.width < 500 ? 4 : 8)) {
    svg += line(to_x(tick.at), bottom, to_x(tick.at), bottom + 5, "class=\"axis\"");
    svg += label(to_x(tick.at), bottom + 19, "middle", tick.label);
  }
  for (const double mark : plot.marks)
    if (mark > x_range.low && mark < x_range.high)
      svg += line(to_x(mark), top, to_x(mark), bottom, "class=\"mark\"");
  svg += line(left, bottom, right, bottom, "class=\"axis\"");
  svg += label((left + right) / 2, plot.height - 6, "middle", plot.x_label, "class=\"title\"");
  if (!plot.y_label.empty())
    svg += "<text transform=\"translate(13 " + px((top + bottom) / 2) +
           ") rotate(-90)\" text-anchor=\"middle\" class=\"title\">" + escape_html(plot.y_label) +
           "</text>";

  // 3. Background, bands, curves; a nested svg clips them. Dashed curves come last, so that
  //    one on a solid one is seen; of each kind the first.
  svg += "<svg x=\"" + px(left) + "\" y=\"" + px(top) + "\" width=\"" + px(right - left) +
         "\" height=\"" + px(bottom - top) + "\" viewBox=\"" + px(left) + " " + px(top) + " " +
         px(right - left) + " " + px(bottom - top) + "\" overflow=\"hidden\">";
  if (!plot.background.empty() && !plot.curves.empty()) {
    const double peak = *std::max_element(plot.background.begin(), plot.background.end());
    const double full = plot.background_peak > 0 ? plot.background_peak : 1.25 * peak;
    const Axis to_height{0, full > 0 ? full : 1, bottom, top};
    const auto& x = plot.curves.front().x;
    const std::size_t n = std::min(x.size(), plot.background.size());
    std::string d = "M" + px(to_x(x.front())) + " " + px(bottom);
    for (std::size_t i = 0; i < n; ++i)
      d += "L" + px(to_x(x[i])) + " " + px(to_height(plot.background[i]));
    svg += "<path class=\"background\" d=\"" + d + "L" + px(to_x(x[n - 1])) + " " + px(bottom) +
           "Z\"/>";
  }
  for (std::size_t i = plot.curves.size(); i-- > 0;) {
    const Curve& curve = plot.curves[i];
    if (!curve.high.empty())
      svg += "<path class=\"band\" fill=\"var(--c" + std::to_string(curve.stroke.colour) +
             ")\" d=\"" + band(curve, to_x, to_y) + "\"/>";
  }
  for (const bool dashed : {false, true})
    for (std::size_t i = plot.curves.size(); i-- > 0;)
      if (plot.curves[i].stroke.dash.empty() != dashed)
        svg += "<path fill=\"none\" stroke-linejoin=\"round\" " + stroke_of(plot.curves[i].stroke) +
               " d=\"" + path(plot.curves[i].x, plot.curves[i].y, to_x, to_y) + "\"/>";
  svg += "</svg>";

  // 4. Names at the ends.
  if (plot.labels) {
    std::vector<EndLabel> labels;
    for (const Curve& curve : plot.curves) {
      const auto last = std::find_if(curve.y.rbegin(), curve.y.rend(),
                                     [&](double y) { return to_y.drawable(y); });
      if (last == curve.y.rend()) continue;
      const double at = std::clamp(to_y(*last), top, bottom);
      labels.push_back({at, at, &curve});
    }
    spread(labels, 16, top + 4, bottom - 2);
    for (const EndLabel& each : labels) {
      svg += line(
          right + 2, each.at, right + 14, each.y,
          "class=\"leader\" stroke=\"var(--c" + std::to_string(each.curve->stroke.colour) + ")\"");
      svg += label(right + 18, each.y + 4, "start", each.curve->label,
                   "style=\"fill:var(--c" + std::to_string(each.curve->stroke.colour) + ")" +
                       (each.curve == &plot.curves.front() ? ";font-weight:650\"" : "\""));
    }
  }
  return svg + "</svg>";
}

std::string draw(const DotPlot& plot) {
  Range values;
  for (const DotRow& row : plot.rows)
    for (const double value : row.values)
      if (drawable(value)) values.add(value);
  const Range range = log_range(values);

  const double row_height = plot.labels_beside ? 28 : 42;
  const double left = plot.labels_beside ? 190 : 14, right = plot.width - 16, top = 10;
  const double bottom = top + row_height * static_cast<double>(plot.rows.size()) + 6;
  const Axis to_x{range.low, range.high, left, right};
  std::string svg = open_svg(plot.name, plot.width, bottom + 46, "");
  for (const Tick& tick : log_ticks(range)) {
    svg += line(to_x(tick.at), top, to_x(tick.at), bottom, "class=\"grid\"");
    svg += label(to_x(tick.at), bottom + 18, "middle", tick.label);
  }
  svg += line(left, bottom, right, bottom, "class=\"axis\"");
  svg += label((left + right) / 2, bottom + 40, "middle", plot.x_label, "class=\"title\"");

  double y = top + row_height - 12;
  for (const DotRow& row : plot.rows) {
    const std::string colour = "var(--c" + std::to_string(row.stroke.colour) + ")";
    const std::string name_style = "style=\"fill:" + colour + "\"";
    svg += plot.labels_beside ? label(left - 14, y + 4, "end", row.label, name_style)
                              : label(left, y - 12, "start", row.label, name_style);
    svg += line(left, y, right, y, "class=\"rule\"");
    for (std::size_t i = 0; i < row.values.size(); ++i)
      if (drawable(row.values[i]))
        svg += "<circle cx=\"" + px(to_x(std::log10(row.values[i]))) + "\" cy=\"" + px(y) +
               "\" r=\"4.5\" fill=\"" + colour + "\"><title>" +
               escape_html(row.label + ", trajectory " + std::to_string(i) + ": " +
                           pretty(row.values[i]) + " m") +
               "</title></circle>";
    if (drawable(row.mean)) {
      const double at = to_x(std::log10(row.mean));
      svg += line(at, y - 9, at, y + 9, "stroke=\"" + colour + "\" stroke-width=\"2.5\"");
    }
    y += row_height;
  }
  return svg + "</svg>";
}

}  // namespace nmp
