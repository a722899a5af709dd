#include "nmp/dataset_summary.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "nmp/metrics.h"

namespace nmp {

namespace {

using Json = nlohmann::ordered_json;

MotionSummary motion(const Dataset& dataset, const std::vector<Trajectory>& trajectories,
                     const std::function<void()>& one_done) {
  const std::optional<double> ground = dataset.manifest().physics.ground;
  const double near = 1e-6 * dataset.mesh().diagonal();  // positions are stored as float
  const Index n_vertices = dataset.mesh().n_vertices();
  Matrix<double> start(n_vertices, 3), x(n_vertices, 3), v(n_vertices, 3);
  MotionSummary summary;
  double sum = 0, n = 0, max_speed2 = 0;
  for (const Trajectory& trajectory : trajectories) {
    trajectory.read_x<double>(0, start);
    bool touches = false;
    for (Index t = 0; t <= trajectory.frames(); ++t) {
      trajectory.read_x<double>(t, x);
      trajectory.read_v<double>(t, v);
      max_speed2 = std::max(max_speed2, v.rowwise().squaredNorm().maxCoeff());
      sum += v.squaredNorm();
      n += static_cast<double>(n_vertices);
      touches = touches || (ground && x.col(2).minCoeff() <= *ground + near);
    }
    const double end = rmse(x, start);
    summary.min_displacement =
        summary.n_trajectories == 0 ? end : std::min(summary.min_displacement, end);
    summary.max_displacement = std::max(summary.max_displacement, end);
    summary.touched += touches;
    ++summary.n_trajectories;
    if (const std::optional<Slide>& slide = trajectory.info().slide) {
      summary.at_rest = summary.at_rest.value_or(0) + slide->at_rest;
      summary.stuck += slide->stuck;
      summary.path += slide->path;
      summary.contacts += slide->contacts;
    }
    one_done();
  }
  if (summary.at_rest) {
    summary.path /= static_cast<double>(summary.n_trajectories);
    summary.contacts /= static_cast<double>(summary.n_trajectories);
  }
  summary.max_speed = std::sqrt(max_speed2);
  summary.rms_speed = n > 0 ? std::sqrt(sum / n) : 0;
  return summary;
}

Json describe(const MotionSummary& s) {
  Json json{{"trajectories", s.n_trajectories},
            {"touch_ground", s.touched},
            {"rms_speed", s.rms_speed},
            {"max_speed", s.max_speed},
            {"displacement", {s.min_displacement, s.max_displacement}}};
  if (s.at_rest) {
    json["at_rest"] = *s.at_rest;
    json["stuck"] = s.stuck;
    json["path"] = s.path;
    json["contacts"] = s.contacts;
  }
  return json;
}

std::string digits(double value) {
  char words[32];
  std::snprintf(words, sizeof words, "%.3g", value);
  return words;
}

std::string sentence(const MotionSummary& s) {
  return text(s.n_trajectories, " trajectories, ", s.touched, " touch the ground; speed rms ",
              digits(s.rms_speed), ", at most ", digits(s.max_speed),
              " m/s; rms displacement at the end ", digits(s.min_displacement), " to ",
              digits(s.max_displacement), " m\n",
              s.at_rest ? text("              ", *s.at_rest, " end at rest, ", s.stuck,
                               " stuck to the ground, after ", digits(s.path), " m on the ground, ",
                               digits(s.contacts), " vertices on it, on average\n")
                        : "");
}

}  // namespace

DatasetSummary summarise(const Dataset& dataset, const std::function<void(double)>& progress) {
  DatasetSummary summary;
  summary.manifest = dataset.manifest();
  summary.volume = dataset.mesh().total_volume();
  for (const auto* files : {&summary.manifest.train, &summary.manifest.validation})
    for (const RecordInfo& file : *files)
      summary.bytes +=
          static_cast<double>(std::filesystem::file_size(dataset.folder() / file.name));
  double done = 0;
  const auto all = static_cast<double>(dataset.train().size() + dataset.validation().size());
  const auto one_done = [&] {
    done += 1;
    if (progress) progress(done / all);
  };
  summary.train = motion(dataset, dataset.train(), one_done);
  summary.validation = motion(dataset, dataset.validation(), one_done);
  return summary;
}

std::string to_json(const DatasetSummary& summary) {
  const Manifest& m = summary.manifest;
  const fem::Physics& physics = m.physics;
  const auto& g = physics.gravity;
  const Json json{{"scene", m.scene_name},
                  {"seed", m.seed},
                  {"n_vertices", m.n_vertices},
                  {"n_tets", m.n_tets},
                  {"volume", summary.volume},
                  {"frames", m.frames},
                  {"h", m.h},
                  {"dt", m.dt},
                  {"substeps", m.substeps},
                  {"bytes", summary.bytes},
                  {"law", m.law_known ? Json(physics.material.law) : Json()},
                  {"E", m.law_known ? Json(physics.material.E) : Json()},
                  {"nu", m.law_known ? Json(physics.material.nu) : Json()},
                  {"density", physics.material.density},
                  {"gravity", {g[0], g[1], g[2]}},
                  {"ground", physics.ground ? Json(*physics.ground) : Json()},
                  {"n_pinned", physics.pinned.size()},
                  {"train", describe(summary.train)},
                  {"validation", describe(summary.validation)}};
  return json.dump(1);
}

std::string to_text(const DatasetSummary& summary) {
  const Manifest& m = summary.manifest;
  const fem::Physics& physics = m.physics;
  const fem::Material& material = physics.material;
  const auto& g = physics.gravity;
  return text("scene         ", m.scene_name, ", seed ", m.seed, "\n",                   //
              "body          ", m.n_vertices, " vertices, ", m.n_tets, " tetrahedra, ",  //
              digits(summary.volume), " m3, ", physics.pinned.size(), " pinned\n",       //
              "material      ",
              m.law_known ? text(material.law, ", E ", material.E, " Pa, nu ", material.nu)
                          : std::string("law unknown"),
              ", density ", material.density, " kg/m3\n",  //
              "surroundings  gravity (", g[0], ", ", g[1], ", ", g[2], ") m/s2, ",
              physics.ground ? text("ground at z = ", *physics.ground, " m\n") : "no ground\n",
              "time          ", m.frames, " frames of h = ", m.h, " s",
              m.dt > 0 ? text(", simulated at dt = ", m.dt, " s\n") : "\n",  //
              "size          ", digits(summary.bytes / 1e6), " MB\n",        //
              "train         ", sentence(summary.train), "validation    ",
              sentence(summary.validation));
}

}  // namespace nmp
