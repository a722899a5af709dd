#pragma once

#include <functional>
#include <vector>

#include "autodiff/tape.h"

namespace nmp::ad {

template <class Real>
using Vars = std::vector<Var<Real>>;

/// A piece of a computation: from values on a tape to values on the same tape. It is called twice
/// and must do the same both times.
template <class Real>
using Piece = std::function<Vars<Real>(Tape<Real>& tape, const Vars<Real>& inputs)>;

/// Runs `piece` and keeps its inputs and results only; the backward pass runs it again, on the
/// tape's inner tape, and differentiates that. Values, adjoints and parameter gradients are bitwise
/// those of the stored computation, because the inner leaves share the outer values and adjoints,
/// so that everything is added in the same order. Memory: inputs and results on this tape, one
/// piece on the inner one.
template <class Real>
Vars<Real> checkpoint(const Piece<Real>& piece, const Vars<Real>& inputs);

}  // namespace nmp::ad
