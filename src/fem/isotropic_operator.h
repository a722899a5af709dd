#pragma once

#include "autodiff/tape.h"
#include "base/check.h"
#include "fem/block.h"

namespace nmp::fem {

/// What a law's plain functions ask of their arguments.   F #T x 9  ->  result #T x cols
template <class Real>
void check_result(const ConstView<Real>& F, Index cols, const View<Real>& result) {
  NMP_CHECK(F.cols() == 9, "F must be #T x 9, got " + shape(F));
  NMP_CHECK(result.rows() == F.rows() && result.cols() == cols,
            text("the result must be ", F.rows(), " x ", cols, ", got ", shape(result)));
}

/// Records what an isotropic law makes of (F, mu, lambda), its stress or its energy.
/// @param value   #T x columns, computed already
/// @param adjoint  adjoint(F, mu, lambda, begin, count, bar, F_bar, sums) for a block of elements:
///        from their bar, fills their F_bar, and sums[0], sums[1] with their terms of the adjoints
///        of mu and lambda
template <int columns, class Real, class Adjoint>
ad::Var<Real> record_isotropic(const char* op, ad::Var<Real> F, ad::Var<Real> mu,
                               ad::Var<Real> lambda, MatrixMap<Real> value, Adjoint adjoint) {
  return F.tape().record(
      op, {F, mu, lambda}, value, [F, mu, lambda, adjoint](const ConstMatrixMap<Real>& bar) {
        const Real mu_value = mu.value()(0, 0), lambda_value = lambda.value()(0, 0);
        const Index blocks = n_blocks(F.rows());
        Real* mu_sums = F.tape().template keep<Real>(blocks);
        Real* lambda_sums = F.tape().template keep<Real>(blocks);
        const bool F_wanted = F.needs_grad();
        MatrixMap<Real> F_bar = F_wanted ? F.bar() : MatrixMap<Real>(nullptr, 0, 9);
        const ConstMatrixMap<Real> F_value = F.value();
        for_each_block(F_value.rows(), [&](Index begin, Index count) {
          Block<Real, columns> bar_block;
          Block<Real, 9> F_bar_block;
          Block<Real, 2> sums;
          load(bar, 0, begin, count, bar_block);
          adjoint(F_value, mu_value, lambda_value, begin, count, bar_block, F_bar_block, sums);
          if (F_wanted) add(F_bar_block, Real(1), begin, count, F_bar);
          mu_sums[begin / kBlock] = sum_in_order(sums[0], count);
          lambda_sums[begin / kBlock] = sum_in_order(sums[1], count);
        });
        if (mu.needs_grad()) mu.bar()(0, 0) += sum_in_order(mu_sums, blocks);
        if (lambda.needs_grad()) lambda.bar()(0, 0) += sum_in_order(lambda_sums, blocks);
      });
}

}  // namespace nmp::fem
