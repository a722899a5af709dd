#include "autodiff/gradient_check.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "base/random.h"

namespace nmp::ad {

namespace {

// f at the current point, as a plain matrix.
using Evaluate = std::function<Matrix<double>()>;

// +-[0.5, 1.5]: no entry is weighted so little that an error in its adjoint could hide.
Matrix<double> random_weights(Index rows, Index cols, std::uint64_t seed) {
  const Random random = Random(seed).split("gradient_check");
  Matrix<double> w(rows, cols);
  for (Index i = 0; i < w.size(); ++i) {
    const double u = random.uniform(static_cast<std::uint64_t>(i), -1, 1);
    w.data()[i] = u + std::copysign(0.5, u);
  }
  return w;
}

// Changes one number for as long as it lives.
class Perturbed {
 public:
  explicit Perturbed(double& x) : x_(x), original_(x) {}
  ~Perturbed() { x_ = original_; }
  Perturbed(const Perturbed&) = delete;
  Perturbed& operator=(const Perturbed&) = delete;

  double original() const { return original_; }
  void set(double value) { x_ = value; }

 private:
  double& x_;
  double original_;
};

// dL/dx = <w, f(x + h) - f(x - h)> / 2h + O(h^2). The results are subtracted before they are
// summed: what does not depend on x cancels exactly.
double central_difference(const Evaluate& f, const Matrix<double>& w, Perturbed& x, double h) {
  const double high = x.original() + h, low = x.original() - h;
  x.set(high);
  const Matrix<double> at_high = f();
  x.set(low);
  const Matrix<double> at_low = f();
  for (const auto* y : {&at_high, &at_low}) {
    NMP_CHECK(y->rows() == w.rows() && y->cols() == w.cols(),
              "the function changed the shape of its result from " + shape(w) + " to " + shape(*y));
  }
  return w.cwiseProduct(at_high - at_low).sum() / (high - low);
}

// Richardson: D_k,0 = D(h / 2^k),   D_k,j = (4^j D_k,j-1 - D_k-1,j-1) / (4^j - 1).
double difference(const Evaluate& f, const Matrix<double>& w, double& entry,
                  const GradientCheckOptions& options) {
  Perturbed x(entry);
  double h = options.step * std::max(1.0, std::abs(x.original()));
  std::vector<double> row;  // D_k,0 ... D_k,k
  for (int k = 0; k <= options.richardson; ++k, h /= 2) {
    double power = 1;
    double d = central_difference(f, w, x, h);
    for (double& before : row) {
      power *= 4;
      const double better = (power * d - before) / (power - 1);
      before = d;
      d = better;
    }
    row.push_back(d);
  }
  return row.back();
}

struct Entry {
  Index index;
  double analytic, difference;
};

// Adds the entries of one input to the result.
void compare(const std::string& name, const Matrix<double>& gradient,
             const std::vector<Entry>& entries, double floor, GradientCheck& check) {
  double scale = 0;
  for (Index i = 0; i < gradient.size(); ++i) scale = std::max(scale, std::abs(gradient.data()[i]));
  for (const Entry& entry : entries) scale = std::max(scale, std::abs(entry.difference));
  check.largest = std::max(check.largest, scale);

  for (const Entry& entry : entries) {
    if (entry.analytic != entry.difference) check.identical = false;
    const double error = std::abs(entry.analytic - entry.difference);
    if (error <= floor) continue;
    const double relative =
        std::isfinite(error) ? error / scale : std::numeric_limits<double>::infinity();
    if (relative > check.relative) {
      check.relative = relative;
      check.worst =
          text(name, " (", entry.index % gradient.rows(), ", ", entry.index / gradient.rows(),
               "): adjoint ", entry.analytic, ", difference ", entry.difference);
    }
  }
}

}  // namespace

GradientCheck check_gradient(const Function<double>& f, const std::vector<Matrix<double>>& inputs,
                             const GradientCheckOptions& options) {
  std::vector<Matrix<double>> x = inputs;
  const auto run = [&f, &x](Tape<double>& tape, Vars<double>& vars) {
    tape.clear();
    vars.clear();
    for (const Matrix<double>& each : x) vars.push_back(tape.input(each));
    return f(tape, vars);
  };

  Tape<double> tape;
  Vars<double> vars;
  const Var<double> y = run(tape, vars);
  const Matrix<double> w = random_weights(y.rows(), y.cols(), options.seed);
  tape.backward(y, w);

  Tape<double> plain(Tape<double>::Mode::inference);
  Vars<double> plain_vars;
  const Evaluate evaluate = [&]() -> Matrix<double> { return run(plain, plain_vars).value(); };
  GradientCheck check;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const Matrix<double> gradient = vars[i].bar();
    std::vector<Entry> entries;
    for (Index k = 0; k < x[i].size(); ++k)
      entries.push_back({k, gradient.data()[k], difference(evaluate, w, x[i].data()[k], options)});
    compare(text("input ", i), gradient, entries, options.floor, check);
  }
  return check;
}

GradientCheck check_gradient(const std::function<Var<double>(Tape<double>&)>& loss,
                             const std::vector<Parameter<double>*>& parameters, Index per_parameter,
                             const GradientCheckOptions& options) {
  Tape<double> tape;
  for (Parameter<double>* parameter : parameters) parameter->zero_bar();
  const Var<double> y = loss(tape);
  const Matrix<double> w = random_weights(y.rows(), y.cols(), options.seed);
  tape.backward(y, w);

  Tape<double> plain(Tape<double>::Mode::inference);
  const Evaluate evaluate = [&]() -> Matrix<double> {
    plain.clear();
    return loss(plain).value();
  };
  GradientCheck check;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const Random draw = Random(options.seed).split("entries").split(i);
    const Matrix<double>& gradient = parameters[i]->bar();
    Matrix<double>& value = parameters[i]->mutable_value();
    const bool all = value.size() <= per_parameter;
    std::vector<Entry> entries;
    for (Index k = 0; k < (all ? value.size() : per_parameter); ++k) {
      const Index index =
          all ? k
              : static_cast<Index>(draw.below(static_cast<std::uint64_t>(k),
                                              static_cast<std::uint64_t>(value.size())));
      entries.push_back(
          {index, gradient.data()[index], difference(evaluate, w, value.data()[index], options)});
    }
    compare(parameters[i]->name(), gradient, entries, options.floor, check);
  }
  return check;
}

}  // namespace nmp::ad
