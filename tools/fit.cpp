// nmp fit: physical parameters of a body and its surroundings from positions alone.
//   nmp fit --params E,nu --data data/cube
//   nmp fit --params E,nu,friction --data data/friction --guess E=3e5,nu=0.4 --length 200
//   nmp fit --params drag,wind --data data/windy --json > fit.json

#include <memory>

#include "common.h"
#include "fem/material.h"
#include "nmp/identify.h"

namespace nmp {
namespace {

struct Options {
  std::string data;
  IdentifyOptions identify;
  std::vector<std::string> guess;  // NAME=VALUE
  common::Flags flags;
};

void run(Options& o) {
  for (const std::string& each : o.guess) {
    const std::size_t equals = each.find('=');
    std::size_t used = 0;
    double value = 0;
    try {
      if (equals != std::string::npos) value = std::stod(each.substr(equals + 1), &used);
    } catch (const std::logic_error&) {
    }
    if (used == 0 || equals + 1 + used != each.size())
      throw ConfigError("--guess: expected NAME=VALUE, such as E=1e5, found '" + each + "'");
    o.identify.guess[each.substr(0, equals)] = value;
  }
  if (o.flags.seed) o.identify.seed = *o.flags.seed;
  const Dataset dataset = Dataset::open(o.data);
  common::Progress progress("fit");
  o.identify.progress = [&](const std::string& what, double part) {
    common::stop_if_requested();
    progress.update(part, what);
  };
  const Identified found = identify(dataset, o.identify);
  progress.clear();
  common::print(o.flags.json ? to_json(found) + "\n" : to_table(found));
}

}  // namespace

void add_fit(CLI::App& app) {
  CLI::App& fit = common::add_command(
      app, "fit", "Find physical parameters from recorded positions",
      "An explicit simulator is rolled out over short segments of the training trajectories, and\n"
      "its parameters follow the gradient of the error through every step. Velocities and forces\n"
      "of the recording are not read. The +- is the uncertainty from the scatter of the segments\n"
      "and from the size of the step; it does not include the error of a wrong law. Parameters "
      "that\n"
      "are not fitted are the recording's, friction and drag 0, unless --guess says otherwise.",
      {"nmp fit --params E,nu --data data/cube",
       "nmp fit --params E,nu,friction --data data/friction --guess E=3e5,nu=0.4 --length 200",
       "nmp fit --params drag,wind --data data/windy --json > fit.json"});
  const auto o = std::make_shared<Options>();
  fit.add_option("--data", o->data, "Folder of the dataset")->type_name("DIR")->required();
  fit.add_option("--params", o->identify.params,
                 "What to find, of E, nu, density, friction, drag, wind")
      ->type_name("NAME,...")
      ->delimiter(',')
      ->allow_extra_args(false);
  fit.add_option("--guess", o->guess,
                 "Where to begin, and values of what is not fitted: E=1e5,nu=0.4,density=1000")
      ->type_name("NAME=VALUE,...")
      ->delimiter(',')
      ->allow_extra_args(false);
  fit.add_option("--law", o->identify.law, "The law (default: the dataset's, or neo-hookean)")
      ->type_name(common::alternatives(fem::law_names()));
  fit.add_option("--segments", o->identify.segments, "Segments that are simulated")
      ->type_name("N")
      ->check(common::whole_number(1, 100'000))
      ->capture_default_str();
  fit.add_option("--length", o->identify.length, "Frames of a segment")
      ->type_name("N")
      ->check(common::whole_number(1, 100'000'000))
      ->capture_default_str();
  fit.add_option("--iterations", o->identify.max_iterations, "At most so many iterations")
      ->type_name("N")
      ->check(common::whole_number(1, 100'000))
      ->capture_default_str();
  common::add_seed(fit, o->flags);
  common::add_threads(fit);
  common::add_json(fit, o->flags);
  fit.callback([o] { run(*o); });
}

}  // namespace nmp
