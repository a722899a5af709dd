#include <algorithm>
#include <cmath>

#include "base/check.h"
#include "nmp/player_html.h"
#include "nmp/report_html.h"
#include "nmp/report_sections.h"

namespace nmp::report {

namespace {

struct Quantity {
  std::string label;
  int colour;
  double StateMeasures::*value;
};

// The same quantities of truth (broad, pale) and prediction (thin).
std::string figure(const Playback& playback, const std::string& what, const std::string& y_label,
                   const std::string& unit, const std::vector<Quantity>& quantities) {
  LinePlot plot;
  plot.name = what + " of " + playback.trajectory;
  plot.x_label = "frame";
  plot.y_label = y_label;
  plot.log_y = false;
  plot.width = 440;
  plot.height = 300;
  plot.labels = false;
  const std::vector<std::size_t> places = thinned(playback.truth.size(), 250);
  std::vector<double> frames;
  for (const std::size_t t : places) {
    frames.push_back(static_cast<double>(t));
    plot.background.push_back(playback.touching[t]);
  }
  plot.background_peak = 3 * *std::max_element(plot.background.begin(), plot.background.end());
  Readout data{"frame", unit, false, frames, {}};
  std::vector<LegendItem> items;
  std::vector<Curve> truths;
  for (const Quantity& quantity : quantities) {
    const auto curve = [&](const std::vector<StateMeasures>& states, const Stroke& stroke,
                           const std::string& of) {
      Curve result{of + quantity.label, stroke, {}, {}, {}, {}};
      for (const std::size_t t : places) {
        result.x.push_back(static_cast<double>(t));
        result.y.push_back(t < states.size() ? states[t].*quantity.value : std::nan(""));
      }
      data.series.push_back({result.label, stroke.colour, result.y});
      return result;
    };
    truths.push_back(curve(playback.truth, {quantity.colour, "", 5, 0.32}, "recorded "));
    plot.curves.push_back(curve(playback.prediction, {quantity.colour, "", 1.5}, "predicted "));
    items.push_back({{quantity.colour, "", 3}, quantity.label});
  }
  plot.curves.insert(plot.curves.end(), truths.begin(), truths.end());  // below the predictions
  items.push_back({{6, "", 5, 0.32}, "recorded"});
  items.push_back({{6, "", 1.5}, "predicted"});
  return "<figure data-plot><figcaption>" + escape_html(short_name(playback.trajectory)) +
         "<small>" + what + "</small></figcaption>" + draw(plot) + legend(items) +
         data_script(data) + "</figure>\n";
}

std::string joules(double energy) {
  if (!std::isfinite(energy)) return "–";
  return std::abs(energy) >= 1e4 ? pretty(energy / 1e3) + " kJ" : pretty(energy) + " J";
}

std::string table(const std::vector<Playback>& playbacks) {
  std::string html =
      "<div class=\"scroll\"><table>\n<thead><tr><th>trajectory</th><th>smallest det "
      "F<small>recorded</small></th><th>&nbsp;<small>predicted</small></th><th>energy lost "
      "<small>recorded</small></th><th>&nbsp;<small>predicted</small></th><th>largest "
      "difference<small>of total energy</small></th></tr></thead>\n<tbody>\n";
  const auto smallest = [](const std::vector<StateMeasures>& states) {
    double least = states.front().det_min;
    for (const StateMeasures& state : states) least = std::min(least, state.det_min);
    return least;
  };
  for (const Playback& p : playbacks) {
    double difference = 0;
    for (std::size_t t = 0; t < p.prediction.size(); ++t)
      difference = std::max(difference, std::abs(p.prediction[t].total - p.truth[t].total));
    const bool whole = p.law_known && !p.end.diverged && !p.prediction.empty();
    html += "<tr><td>" + escape_html(short_name(p.trajectory)) + "</td><td>" +
            pretty(smallest(p.truth)) + "</td><td>" +
            (p.prediction.empty() ? "–" : pretty(smallest(p.prediction))) + "</td><td>" +
            (p.law_known ? joules(p.truth.front().total - p.truth.back().total) : "–") +
            "</td><td>" +
            (whole ? joules(p.prediction.front().total - p.prediction.back().total) : "–") +
            "</td><td>" + (p.law_known ? joules(difference) : "–") + "</td></tr>\n";
  }
  return html + "</tbody></table></div>\n";
}

}  // namespace

std::string states_section(const std::vector<Playback>& playbacks) {
  if (playbacks.empty()) return "";
  bool energies = true;
  for (const Playback& playback : playbacks) energies = energies && playback.law_known;
  std::string html =
      "<section>\n<h2>Volume and energy</h2>\n<p>The recorded motion and the fully neural rollout "
      "from the same start.</p>\n" +
      table(playbacks);
  for (const Playback& playback : playbacks) {
    if (playback.truth.empty()) continue;
    std::vector<Quantity> energy{{"kinetic", 1, &StateMeasures::kinetic},
                                 {"gravitational", 2, &StateMeasures::gravitational}};
    if (energies) {
      energy.push_back({"elastic", 3, &StateMeasures::elastic});
      energy.push_back({"total", 0, &StateMeasures::total});
    }
    html += "<div class=\"pair\">\n" +
            figure(playback, "det F of the elements", "det F", "",
                   {{"smallest", 1, &StateMeasures::det_min},
                    {"1 % quantile", 2, &StateMeasures::det_low},
                    {"mean", 0, &StateMeasures::det_mean}}) +
            figure(playback, "energies", "energy [J]", "J", energy) + "</div>\n";
    if (playback.end.diverged)
      html += "<p class=\"note\">The rollout of " + escape_html(short_name(playback.trajectory)) +
              " diverged " + escape_html(playback.end.reason) + "</p>\n";
  }
  return html +
         "<p class=\"note\">Reported velocities on both sides. Gravitational energy is zero with "
         "every vertex at the height of the ground" +
         (energies ? "; elastic energy is that of the true law for both, with a gap where an "
                     "element is inverted"
                   : "; the law of the data is not known, so there is no elastic energy") +
         ". Contact takes energy: a vertex on the ground loses its downward velocity. Grey area: "
         "how many vertices of the recording are on the ground.</p>\n</section>\n";
}

std::string player_section(const PlayerDocument& player) {
  if (player.tracks.empty()) return "";
  return "<section>\n<h2>Recorded and predicted</h2>\n" + player_figure(player) + "</section>\n";
}

}  // namespace nmp::report
