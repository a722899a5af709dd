#include "nmp/player_html.h"

#include <algorithm>
#include <set>

#include "base/check.h"
#include "nmp/plot.h"
#include "nmp/report_html.h"

namespace nmp::report {

namespace {

// The parts of the script, what others use first.
constexpr const char* kParts[] = {"player_shaders.js", "player_tools.js",   "player_motion.js",
                                  "player_scene.js",   "player_picture.js", "player_hands.js",
                                  "player.js"};

std::string ordinal(Index n) {
  const Index last = n % 100 >= 11 && n % 100 <= 13 ? 0 : n % 10;
  return text(n, last == 1 ? "st" : last == 2 ? "nd" : last == 3 ? "rd" : "th");
}

std::string stored_frames(const PlayerDocument& document) {
  std::set<Index> strides, ends;
  double interval = 0;
  for (const PlayerTrack& track : document.tracks) {
    for (const PlayerMotion& motion : track.motions) {
      if (!motion.diverged) ends.insert(motion.frames.back().t);
      if (motion.frames.size() < 2) continue;
      strides.insert(motion.frames[1].t);
      interval = std::max(interval, static_cast<double>(motion.frames[1].t) * motion.h);
    }
  }
  const std::string of = ends.size() == 1 ? text(" of the ", *ends.begin(), " frames") : " frame";
  if (strides.empty() || (strides.size() == 1 && *strides.begin() == 1))
    return (ends.size() == 1 ? "Every one" : "Every") + of + " is stored";
  if (strides.size() == 1)
    return "Every " + ordinal(*strides.begin()) + of + " is stored, those between are interpolated";
  return text("Frames are stored at most ", pretty(1e3 * interval),
              " ms apart, those between are interpolated");
}

// Half a step of the coarsest box.
double rounding(const PlayerDocument& document) {
  double size = 0;
  for (const PlayerTrack& track : document.tracks)
    for (const PlayerMotion& motion : track.motions)
      size = std::max(size, player_box(motion, track.motions.front()).size.maxCoeff());
  return size / 65535 / 2;
}

std::string note(const PlayerDocument& document) {
  std::string words = stored_frames(document) + ". Positions are rounded by at most " +
                      length(rounding(document)) +
                      "; the colours are computed from the unrounded ones. det F at a vertex is "
                      "the mean over the elements around it, weighted with their volumes";
  std::set<std::string> laws;
  for (const PlayerBody& body : document.bodies)
    if (!body.stress_law.empty()) laws.insert(body.stress_law);
  if (!laws.empty()) {
    words += ", and so is the von Mises stress, of the Cauchy stress that ";
    words += laws.size() == 1 ? "this law has" : "these laws have, each in its own body";
    words += ":";
    for (const std::string& law : laws) words += (law == *laws.begin() ? " " : "; ") + law;
    words += ", the same for all motions";
  }
  words += ".";
  for (const PlayerTrack& track : document.tracks)
    for (const PlayerMotion& motion : track.motions)
      if (motion.diverged)
        words += " " + motion.label + " of " + short_name(track.name) +
                 " diverged and stands still from there on.";
  return words;
}

}  // namespace

std::string player_figure(const PlayerDocument& document) {
  return "<div class=\"player\" data-player>" + data_script(to_json(document)) +
         "<noscript><p>The player needs JavaScript.</p></noscript></div>\n<p class=\"note\">" +
         escape_html(note(document)) + "</p>\n";
}

std::string player_styles() { return page_file("player.css"); }

std::string player_script() {
  std::string script = "(function () {\n'use strict';\n";
  for (const char* part : kParts) script += page_file(part);
  return script + "})();\n";
}

std::string view_page(const std::string& title, const PlayerDocument& document) {
  return page(title, "<p class=\"about\" data-about></p>\n" + player_figure(document),
              player_styles() + page_file("view.css"), {player_script()});
}

}  // namespace nmp::report
