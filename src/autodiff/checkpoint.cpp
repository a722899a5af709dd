#include "autodiff/checkpoint.h"

#include <algorithm>
#include <memory>

namespace nmp::ad {

namespace {

template <class Real>
Vars<Real> run_inside(Tape<Real>& inner, const Piece<Real>& piece, const Vars<Real>& inputs) {
  Vars<Real> leaves;
  for (const Var<Real>& input : inputs) leaves.push_back(inner.alias(input));
  return piece(inner, leaves);
}

}  // namespace

template <class Real>
Vars<Real> checkpoint(const Piece<Real>& piece, const Vars<Real>& inputs) {
  NMP_CHECK(!inputs.empty(), "checkpoint needs at least one input");
  Tape<Real>& tape = inputs.front().tape();
  Tape<Real>& inner = tape.inner();

  inner.begin_first_run(tape);
  const Vars<Real> inside = run_inside(inner, piece, inputs);
  const std::size_t n_results = inside.size();
  Var<Real>* results = tape.template keep<Var<Real>>(static_cast<Index>(n_results));
  std::uninitialized_fill_n(results, n_results, Var<Real>());
  const std::size_t n_parameters = inner.n_parameters_read();
  auto* versions = tape.template keep<std::uint64_t>(static_cast<Index>(n_parameters));
  for (std::size_t i = 0; i < n_parameters; ++i) versions[i] = inner.parameter_version(i);
  tape.add_parameters_read(inner);
  const std::size_t n_remembered = inner.remembered().size();
  auto* remembered = tape.template keep<const void*>(static_cast<Index>(n_remembered));
  std::copy_n(inner.remembered().data(), n_remembered, remembered);
  bool wanted = false;  // parameters that the piece reads count, even if no input needs an adjoint
  for (const Var<Real>& result : inside) wanted |= inner.depends_on_leaves(result);

  const Var<Real> op = tape.record_span(
      "checkpoint", inputs.data(), inputs.size(), tape.allocate(0, 0),
      [&tape, piece, inputs, results, n_results, versions, n_parameters, remembered,
       n_remembered](const auto&) {
        bool used = false;
        for (std::size_t i = 0; i < n_results; ++i) {
          if (results[i].empty()) return;  // memory ran out before the piece was recorded
          used |= results[i].has_bar();
        }
        if (!used) return;

        Tape<Real>& again = tape.inner();
        again.begin_second_run(remembered, n_remembered);
        const Vars<Real> inside_again = run_inside(again, piece, inputs);
        NMP_CHECK(inside_again.size() == n_results && again.n_parameters_read() == n_parameters &&
                      again.recalled_all(),
                  "a checkpointed piece did something else when it was run again");
        for (std::size_t i = 0; i < n_parameters; ++i)
          if (again.parameter_version(i) != versions[i])
            throw std::logic_error(text("parameter ", again.parameter_name(i),
                                        ", read inside a checkpoint, was changed before backward"));

        Vars<Real> y;
        std::vector<ConstMatrixMap<Real>> y_bar;
        for (std::size_t i = 0; i < n_results; ++i) {
          if (!results[i].has_bar()) continue;
          const MatrixMap<Real> bar = results[i].bar();
          y.push_back(inside_again[i]);
          y_bar.emplace_back(bar.data(), bar.rows(), bar.cols());
        }
        again.backward(y.data(), y_bar.data(), y.size());
        again.clear();
      },
      wanted);

  Vars<Real> outputs;
  for (std::size_t i = 0; i < n_results; ++i) {
    MatrixMap<Real> value = tape.allocate(inside[i].rows(), inside[i].cols());
    value = inside[i].value();
    results[i] = tape.result_of(op, value);
    outputs.push_back(results[i]);
  }
  inner.clear();
  return outputs;
}

#define NMP_INSTANTIATE(Real) template Vars<Real> checkpoint(const Piece<Real>&, const Vars<Real>&);

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
