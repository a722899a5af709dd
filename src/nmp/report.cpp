#include "nmp/report.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "base/check.h"
#include "nmp/evaluate.h"
#include "nmp/plot.h"
#include "nmp/report_page.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

// -- what the parts say
// ----------------------------------------------------------------------------

// Our writers put null where a number is not finite.
double number(const Json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

std::vector<double> numbers(const Json& json) {
  if (!json.is_array()) throw InputError("a list of numbers was expected");
  std::vector<double> values;
  for (const Json& value : json) values.push_back(number(value));
  return values;
}

struct Error {
  double mean = 0, std = 0, relative = 0;
  std::vector<double> each;
  long touched = 0;
};

struct Method {
  std::string name;
  std::map<long, Error> horizons;
  long diverged = 0, clamped = 0;
  std::vector<std::string> reasons;
  double seconds = 0;
  std::vector<double> mean, std;  // at every frame
};

struct Result {
  std::string scene, model, split;
  long trajectories = 0, frames = 0;
  double force_error = 0;
  std::vector<Method> methods;  // in the order in which they are shown
  std::vector<long> horizons;

  const Method* find(const std::string& name) const {
    for (const Method& method : methods)
      if (method.name == name) return &method;
    return nullptr;
  }
};

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

std::size_t rank(const std::string& name) {
  for (std::size_t i = 0; i < looks().size(); ++i)
    if (looks()[i].name == name) return i;
  return looks().size();
}

Look look(const std::string& name) {
  const std::size_t i = rank(name);
  return i < looks().size() ? looks()[i] : Look{name, name, "", {7, "5 2", 1.8}};
}

Result parse_evaluation(const std::string& text_of_it) {
  const Json json = Json::parse(text_of_it);
  Result result;
  result.scene = json.at("scene").get<std::string>();
  result.model = json.at("model").get<std::string>();
  result.split = json.at("split").get<std::string>();
  result.trajectories = json.at("trajectories").get<long>();
  result.frames = json.at("frames").get<long>();
  result.force_error = number(json.at("force_error"));
  for (const auto& [name, horizons] : json.at("methods").items()) {
    Method method;
    method.name = name;
    for (const auto& [frame, error] : horizons.items()) {
      Error& e = method.horizons[std::stol(frame)];
      e.mean = number(error.at("rmse_mean"));
      e.std = number(error.at("rmse_std"));
      e.relative = number(error.at("relative_mean"));
      e.each = numbers(error.at("rmse_each"));
      e.touched = error.at("touched_ground").get<long>();
    }
    const Json& details = json.at("details").at(name);
    method.diverged = details.at("diverged").get<long>();
    method.clamped = details.at("clamped").get<long>();
    method.reasons = details.at("reasons").get<std::vector<std::string>>();
    method.seconds = number(details.at("seconds"));
    method.mean = numbers(details.at("curve_mean"));
    method.std = numbers(details.at("curve_std"));
    if (method.mean.size() != static_cast<std::size_t>(result.frames) + 1 ||
        method.std.size() != method.mean.size())
      throw InputError(text("the curves of ", name, " have ", method.mean.size(), " and ",
                            method.std.size(), " values, expected ", result.frames + 1));
    if (result.methods.empty())
      for (const auto& entry : method.horizons) result.horizons.push_back(entry.first);
    if (method.horizons.size() != result.horizons.size() ||
        !std::all_of(result.horizons.begin(), result.horizons.end(),
                     [&](long frame) { return method.horizons.count(frame) > 0; }))
      throw InputError("the methods have different horizons");
    result.methods.push_back(method);
  }
  if (result.methods.empty() || result.horizons.empty()) throw InputError("it holds no error");
  std::stable_sort(result.methods.begin(), result.methods.end(),
                   [](const Method& a, const Method& b) { return rank(a.name) < rank(b.name); });
  return result;
}

// Steps of one stage of a training run, in the order of the file.
struct Stage {
  std::string name;
  std::vector<double> iteration, loss, rate;
};

struct Training {
  std::vector<Stage> stages;
  std::vector<Json> reports;
  Json fit;
};

Training parse_metrics(const std::string& lines) {
  Training training;
  std::istringstream in(lines);
  std::string line;
  for (long n = 1; std::getline(in, line); ++n) {
    if (line.empty()) continue;
    try {
      const Json json = Json::parse(line);
      const auto event = json.at("event").get<std::string>();
      if (event == "step") {
        const auto name = json.at("stage").get<std::string>();
        const double iteration = json.at("iteration").get<double>();
        auto& stages = training.stages;
        if (stages.empty() || stages.back().name != name ||
            (!stages.back().iteration.empty() && iteration <= stages.back().iteration.back()))
          stages.push_back({name, {}, {}, {}});
        stages.back().iteration.push_back(iteration);
        stages.back().loss.push_back(number(json.at("loss")));
        stages.back().rate.push_back(number(json.at("lr")));
      } else if (event == "stage") {
        for (const char* key : {"stage", "pairing"}) json.at(key).get<std::string>();
        for (const char* key : {"iterations", "planned", "rmse_before", "rmse_after", "kept",
                                "rmse_kept", "change", "change_end", "seconds"})
          number(json.at(key));
        training.reports.push_back(json);
      } else if (event == "fit") {
        number(json.at("alpha"));
        number(json.at("residual"));
        if (numbers(json.at("b")).size() != 3) throw InputError("b must have three numbers");
        training.fit = json;
      } else {
        throw InputError("unknown event '" + event + "'");
      }
    } catch (const nlohmann::json::exception& error) {
      throw InputError(text("metrics, line ", n, ": ", error.what()));
    } catch (const InputError& error) {
      throw InputError(text("metrics, line ", n, ": ", error.what()));
    }
  }
  return training;
}

// -- words
// -----------------------------------------------------------------------------------------

// A length in the unit that people would use.
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

// Without powers of ten where a reader expects a part of the whole.
std::string percent(double part) {
  const double value = 100 * part;
  if (value == 0 || value >= 0.01 || !std::isfinite(value)) return pretty(value) + " %";
  if (value < 1e-4) return "below 0.0001 %";
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.4f %%", value);
  return digits;
}

// "3.1 times"
std::string times(double ratio) {
  if (!std::isfinite(ratio)) return "not comparable to";
  char digits[32];
  std::snprintf(digits, sizeof digits, "%.1f times", ratio);
  return ratio < 10 ? digits : pretty(ratio) + " times";
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
  if (const double paper = paper_rmse(result.scene, last).value_or(0); paper > 0)
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

// -- parts of the page
// -----------------------------------------------------------------------------

std::string key(const Stroke& stroke) {
  return "<svg class=\"key\" viewBox=\"0 0 26 8\" aria-hidden=\"true\"><path d=\"M0 4H26\" "
         "stroke=\"var(--c" +
         std::to_string(stroke.colour) + ")\" stroke-width=\"" +
         std::to_string(std::lround(stroke.width)) + "\" stroke-dasharray=\"" + stroke.dash +
         "\"/></svg>";
}

// Data for the read-out; '<' cannot end the script element.
std::string data_script(const Json& json) {
  std::string data;
  for (const char c : json.dump(-1, ' ', false, Json::error_handler_t::replace))
    c == '<' ? data += "\\u003c" : data += c;
  return "<script type=\"application/json\">" + data + "</script>";
}

// Three digits are enough for a read-out.
Json rounded(const std::vector<double>& values) {
  Json list = Json::array();
  for (const double value : values) {
    std::ostringstream digits;
    digits.precision(4);
    digits << value;
    list.push_back(std::isfinite(value) ? Json(std::strtod(digits.str().c_str(), nullptr))
                                        : Json());
  }
  return list;
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
    const double value = paper_rmse(result.scene, frame).value_or(0);
    in_paper = in_paper || value > 0;
    paper += "<td>" + (value > 0 ? pretty(value) : std::string("–")) + "</td>";
  }
  if (in_paper) html += paper + "<td>–</td><td>–</td></tr>\n";
  return html +
         "</tbody></table></div>\n<p class=\"note\">Mean ± standard deviation over the "
         "trajectories; below it, relative to the rms displacement of the recorded motion from "
         "its start.</p>\n";
}

std::string legend(const Result& result) {
  std::string html = "<ul class=\"legend\">";
  for (const Method& method : result.methods) {
    const Look l = look(method.name);
    html += "<li>" + key(l.stroke) + escape_html(l.label) + "</li>";
  }
  return html + "</ul>";
}

// Wide with labels, and narrow for a phone.
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

std::string curves_figure(const Result& result) {
  constexpr long kPoints = 300;
  const long stride = std::max(1L, (result.frames + kPoints - 1) / kPoints);
  std::vector<double> frames;
  for (long t = 0; t < result.frames; t += stride) frames.push_back(static_cast<double>(t));
  frames.push_back(static_cast<double>(result.frames));

  LinePlot plot;
  plot.name = "RMSE over time of every method";
  plot.x_label = "frame";
  plot.y_label = "RMSE [m]";
  for (const long frame : result.horizons) plot.marks.push_back(static_cast<double>(frame));
  Json data{{"label", "frame"},
            {"unit", "m"},
            {"sorted", true},
            {"x", frames},
            {"series", Json::array()}};
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
    data["series"].push_back(
        {{"label", l.label}, {"colour", l.stroke.colour}, {"y", rounded(curve.y)}});
    plot.curves.push_back(std::move(curve));
  }
  return "<h3>Error over time</h3>\n<figure data-plot>" + both_widths(plot) + legend(result) +
         data_script(data) +
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

std::string evaluation_section(const Result& result, bool name_model) {
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
    html +=
        "<div class=\"tiles\">\n" + tile(length(error.mean), text("RMSE at frame ", last)) +
        tile(percent(error.relative), "of the recorded displacement") +
        tile(percent(result.force_error), "error of the learned law's forces along the recording") +
        tile(text(neural->diverged, " of ", result.trajectories), "rollouts diverged") + "</div>\n";
  }
  return html + findings(result) + error_table(result) + curves_figure(result) +
         dots_figure(result) + "</section>\n";
}

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
  for (const Json& r : training.reports) {
    const auto value = [&](const char* name) { return number(r.at(name)); };
    const auto count = [&](const char* name) { return std::to_string(std::lround(value(name))); };
    html += "<tr><td>" + escape_html(r.at("stage").get<std::string>()) + "<small>" +
            escape_html(r.at("pairing").get<std::string>()) + "</small></td><td>" +
            count("iterations") +
            (value("iterations") < value("planned") ? "<small>of " + count("planned") + "</small>"
                                                    : "") +
            "</td><td>" + pretty(value("rmse_before")) + "</td><td>" + pretty(value("rmse_after")) +
            "</td><td>" + pretty(value("rmse_kept")) + "<small>" + count("kept") +
            "</small></td><td>" + percent(value("change")) + "<small>" +
            percent(value("change_end")) + "</small></td><td>" + pretty(value("seconds")) +
            "</td></tr>\n";
  }
  return html +
         "</tbody></table></div>\n<p class=\"note\">RMSE over whole rollouts of the stage's "
         "pairing "
         "on training trajectories that were set aside; the best weights tried are kept. Weights "
         "moved: relative to where the stage began.</p>\n";
}

std::string training_section(const Training& training) {
  if (training.stages.empty() && training.reports.empty() && training.fit.is_null()) return "";
  std::string html = "<section>\n<h2>Training</h2>\n";
  if (!training.fit.is_null()) {
    const auto b = numbers(training.fit.at("b"));
    html +=
        "<p>The affine part of the integrator, a = α f/V + b, was fitted in closed form: 1/α = " +
        pretty(1 / number(training.fit.at("alpha"))) + " kg/m³, b = (" + pretty(b[0]) + ", " +
        pretty(b[1]) + ", " + pretty(b[2]) + ") m/s²; it leaves " +
        pretty(number(training.fit.at("residual"))) + " m/s² (rms).</p>\n";
  }
  html += stage_table(training) + "<div class=\"stages\">\n";
  for (const Stage& stage : training.stages) {
    const LinePlot plot = loss_plot(stage);
    const Curve& loss = plot.curves.front();
    const Json data{
        {"label", "iteration"},
        {"unit", ""},
        {"sorted", false},
        {"x", loss.x},
        {"series",
         {{{"label", "loss"}, {"colour", 0}, {"y", rounded(loss.y)}},
          {{"label", "learning rate"}, {"colour", 7}, {"y", rounded(plot.background)}}}}};
    html += "<figure data-plot><figcaption>" + escape_html(stage.name) + "<small>learning rate " +
            plain(stage.rate.front()) + " to " + plain(stage.rate.back()) + " (grey area)</small>" +
            "</figcaption>" + draw(plot) + data_script(data) + "</figure>\n";
  }
  return html +
         "</div>\n<p class=\"note\">Median loss; the band spans the smallest and the largest of "
         "the "
         "iterations that share a point.</p>\n</section>\n";
}

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
      throw InputError(name + "not what nmp eval --json writes: " + error.what());
    }
  }
  const Training training = parse_metrics(input.metrics);

  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
      "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">\n<title>" +
      escape_html(input.title) + "</title>\n<style>" + kReportStyle +
      "</style>\n</head>\n<body>\n<main>\n<header>\n<p class=\"eyebrow\">Neural Modular "
      "Physics</p>\n<h1>" +
      escape_html(input.title) + "</h1>\n</header>\n";
  for (const Result& result : results) html += evaluation_section(result, results.size() > 1);
  html += training_section(training);
  html += "<section>\n<h2>Settings</h2>\n" + block("Commands", input.commands, true) +
          block("Scene", input.scene_toml, false) +
          block("Training configuration", input.config_toml, false) +
          "</section>\n</main>\n<script>" + kReportScript + "</script>\n</body>\n</html>\n";
  return html;
}

}  // namespace nmp
