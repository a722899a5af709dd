#pragma once

#include <string>
#include <vector>

#include "base/file.h"
#include "nmp/dataset.h"

namespace nmp {

/// A motion as the command line of `nmp view` names it: "[LABEL=]PATH" with the path of a
/// trajectory file or of a dataset, or "[LABEL=]DIR:val/000", one record of a dataset.
struct ViewSource {
  std::string label;  // as given, or made from the path
  Path path;          // of the file or the dataset's folder
  bool dataset = false;
  std::string record;  // of a dataset; empty: the one that is chosen for all
};
/// @throws ConfigError  for a label that is empty or too long; IoError  if nothing is there
ViewSource parse_view_source(const std::string& word);

/// A pairing of modules: "[LABEL=]LAW[+INTEGRATOR]". LAW: neural, one of fem::law_names(), or the
/// path of a model; INTEGRATOR: neural, semi-implicit, or the path of a model, by default the one
/// of the law's model or semi-implicit.
struct ViewMethod {
  std::string label, constitutive, integrator;  // as in ReplayOptions
  Path model;                                   // empty: both modules are analytic
};
/// @param model  what "neural" means; may be empty
/// @throws ConfigError  naming what there is
ViewMethod parse_view_method(const std::string& word, const Path& model);

/// The record of a dataset that is called so, with or without its extension.
/// @throws ConfigError  if there is none
const Trajectory& find_record(const Dataset& dataset, const std::string& name);

}  // namespace nmp
