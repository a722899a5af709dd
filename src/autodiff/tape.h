#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <new>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "autodiff/parameter.h"
#include "autodiff/types.h"
#include "base/check.h"

namespace nmp::ad {

template <class Real>
class Tape;

/// Handle to a value on a tape. Cheap to copy; valid until the tape is cleared, an error after.
template <class Real>
class Var {
 public:
  Var() = default;

  ConstMatrixMap<Real> value() const;
  Index rows() const { return value().rows(); }
  Index cols() const { return value().cols(); }

  /// Adjoint dL/dvalue, shape of value(): zero when first asked for. Adjoints of operators add to
  /// it, never assign, since a value may be used more than once.
  MatrixMap<Real> bar() const;
  /// False if nothing has flowed back to this value.
  bool has_bar() const;
  /// False for constants and what depends on constants alone: no adjoint is wanted.
  bool needs_grad() const;

  /// Write access to a leaf or a result. Counts as a change: a backward pass through an operator
  /// that has read the value before is an error that names the operator.
  MatrixMap<Real> mutable_value() const;

  Tape<Real>& tape() const;
  /// True for a handle that was never given a value.
  bool empty() const { return tape_ == nullptr; }

 private:
  friend class Tape<Real>;
  Var(Tape<Real>* tape, std::int32_t id, std::uint32_t epoch)
      : tape_(tape), id_(id), epoch_(epoch) {}
  Tape<Real>* tape_ = nullptr;
  std::int32_t id_ = -1;
  std::uint32_t epoch_ = 0;
};

/// Memory handed out by bumping a pointer; reset() keeps it for the next round.
class Arena {
 public:
  Arena() = default;
  Arena(const Arena&) = delete;
  Arena& operator=(const Arena&) = delete;

  /// 64-byte aligned, uninitialised (NaN bytes in debug builds).
  void* allocate(std::size_t bytes);
  /// Where memory is short it gives back what it has; allocate() then says so.
  void reset() noexcept;
  std::size_t used() const { return used_; }
  /// Most bytes in use at any time since construction.
  std::size_t peak() const { return peak_; }

 private:
  struct Release {
    void operator()(std::byte* block) const { ::operator delete(block, std::align_val_t(64)); }
  };
  struct Block {
    std::unique_ptr<std::byte, Release> bytes;
    std::size_t size = 0;
  };
  void add_block(std::size_t at_least);
  std::vector<Block> blocks_;
  std::size_t block_ = 0, offset_ = 0, used_ = 0, peak_ = 0;
};

/// Records coarse operators, one node per mesh-wide operation, and runs their adjoints in reverse.
///
///     Tape<double> tape;
///     const Var<double> x = tape.input(x0);
///     tape.backward(squared_norm(silu(x)));
///     x.bar();                                       // dL/dx
///
/// Values, adjoints, saved data and closures live in the tape's arena and die with clear(), which
/// keeps the memory. One tape belongs to one thread; operators use threads inside.
///
/// In `inference` mode nothing is recorded and only values are kept: the same operators give the
/// same bits, without adjoints.
template <class Real>
class Tape {
 public:
  enum class Mode { record, inference };
  explicit Tape(Mode mode = Mode::record) : mode_(mode) {}
  ~Tape() { destroy_closures(); }
  Tape(const Tape&) = delete;
  Tape& operator=(const Tape&) = delete;

  // -- leaves

  /// A copy of `value` whose adjoint is wanted.
  Var<Real> input(const ConstView<Real>& value);
  /// A copy of `value` whose adjoint is not.
  Var<Real> constant(const ConstView<Real>& value);
  /// The parameter itself: its value is read in place and its `bar` is added to.
  Var<Real> parameter(const Parameter<Real>& parameter);
  /// A leaf that shares value and adjoint with a value of another tape, which must outlive this
  /// round of the tape (checkpoint).
  Var<Real> alias(Var<Real> outer);

  // -- for operators

  MatrixMap<Real> allocate(Index rows, Index cols);
  /// `n` objects for the adjoint to find, uninitialised.
  template <class T>
  T* keep(Index n) {
    static_assert(std::is_trivially_destructible_v<T>);
    return static_cast<T*>(arena_.allocate(static_cast<std::size_t>(n) * sizeof(T)));
  }
  /// `n` objects that fill(T*) computes, for an operator that would rather keep them than compute
  /// them again: in the second run of a checkpointed piece they are those of the first.
  template <class T, class Fill>
  const T* remember(Index n, Fill&& fill) {
    static_assert(std::is_trivially_copyable_v<T>);
    if (second_run_) return static_cast<const T*>(next_remembered());
    T* memory = keeper_ ? keeper_->template keep<T>(n) : keep<T>(n);
    fill(memory);
    if (keeper_) remembered_.push_back(memory);
    return memory;
  }
  /// Appends a node: `value` (from allocate) was computed from `inputs`; `backward(bar)` adds to
  /// the adjoints of those inputs that need one, given the node's own adjoint.
  /// @param op  a name with static lifetime, for messages
  template <class Backward>
  Var<Real> record(const char* op, std::initializer_list<Var<Real>> inputs, MatrixMap<Real> value,
                   Backward&& backward) {
    return record_span(op, inputs.begin(), inputs.size(), value, std::forward<Backward>(backward));
  }
  /// @param wanted  true for an operator that has something to differentiate besides its inputs
  template <class Backward>
  Var<Real> record_span(const char* op, const Var<Real>* inputs, std::size_t n_inputs,
                        MatrixMap<Real> value, Backward&& backward, bool wanted = false) {
    const Var<Real> result =
        add_node(op, inputs, n_inputs, value.data(), value.rows(), value.cols(), wanted);
    if (result.needs_grad()) {
      using Closure = std::decay_t<Backward>;
      set_backward(
          result, new (arena_.allocate(sizeof(Closure))) Closure(std::forward<Backward>(backward)),
          [](void* closure, const ConstMatrixMap<Real>& bar) {
            (*static_cast<Closure*>(closure))(bar);
          },
          [](void* closure) { static_cast<Closure*>(closure)->~Closure(); });
    }
    return result;
  }
  /// For an operator with several results: record the operator first with an empty value, then each
  /// result by this; the operator's adjoint runs after every user of every result.
  Var<Real> result_of(Var<Real> op, MatrixMap<Real> value);

  // -- reverse

  /// Adds dL/d(leaf) to every leaf's adjoint and parameter's bar, for the 1 x 1 value `loss`.
  /// Adjoints of inputs and intermediate values start from zero at each call.
  /// @throws std::logic_error  naming the operator, if a value it has read was changed since
  void backward(Var<Real> loss);
  /// The same for <y_bar, y>, and for the sum of several such products.
  void backward(Var<Real> y, const ConstView<Real>& y_bar);
  void backward(const Var<Real>* y, const ConstMatrixMap<Real>* y_bar, std::size_t n);

  /// Forgets everything recorded; keeps the memory.
  void clear();

  /// The versions of the parameters read since the last clear(), in the order of reading, those
  /// read inside checkpoints included.
  std::size_t n_parameters_read() const { return parameters_.size(); }
  std::uint64_t parameter_version(std::size_t i) const { return parameters_[i]->version; }
  const std::string& parameter_name(std::size_t i) const { return parameters_[i]->name; }

  Mode mode() const { return mode_; }
  std::size_t n_nodes() const { return nodes_.size(); }
  /// Most bytes of arena memory ever in use, this tape's inner tape included.
  std::size_t peak_bytes() const;

  // -- for checkpoint

  /// A tape for the inner work of checkpoint, made when first asked for.
  Tape& inner();
  /// Clears, for a run that keeps values only; what is remembered stays with `keeper`.
  void begin_first_run(Tape& keeper);
  /// Clears, for a run that is recorded and finds what the first one remembered.
  void begin_second_run(const void* const* remembered, std::size_t n);
  const std::vector<const void*>& remembered() const { return remembered_; }
  bool recalled_all() const { return n_recalled_ == remembered_.size(); }
  /// Whether an input or a parameter that is not frozen is behind this value: needs_grad() of a
  /// tape that records.
  bool depends_on_leaves(Var<Real> var) { return node(var).depends; }
  /// Counts what `inner` has read as read by this tape.
  void add_parameters_read(const Tape& inner) {
    parameters_.insert(parameters_.end(), inner.parameters_.begin(), inner.parameters_.end());
  }

 private:
  friend class Var<Real>;
  using BackwardCall = void (*)(void* closure, const ConstMatrixMap<Real>& bar);
  using DestroyCall = void (*)(void* closure);
  struct Input {
    std::int32_t id;
    std::uint64_t version;
  };
  struct Node {
    const char* op;
    Real* value;
    Real* bar = nullptr;
    Index rows, cols;
    Input* inputs = nullptr;
    std::int32_t n_inputs = 0;
    std::int32_t parameter = -1;  // position in parameters_
    std::uint64_t version = 0;
    bool depends = false;   // on leaves whose adjoint is wanted
    bool bar_live = false;  // bar holds something of this backward pass
    Var<Real> outer;        // set for alias()
    void* closure = nullptr;
    BackwardCall call = nullptr;
    DestroyCall destroy = nullptr;
  };

  Var<Real> add_node(const char* op, const Var<Real>* inputs, std::size_t n_inputs, Real* value,
                     Index rows, Index cols, bool wanted = false);
  void set_backward(Var<Real> result, void* closure, BackwardCall call, DestroyCall destroy);
  Node& node(Var<Real> var);
  bool needs_grad(const Node& n) const { return n.depends && mode_ == Mode::record; }
  const void* next_remembered();
  std::uint64_t version(const Node& n) const;
  MatrixMap<Real> bar_of(Node& n);
  std::string name_of(const Node& n) const;

  Mode mode_;
  void destroy_closures() noexcept;
  Arena arena_;
  std::vector<Node> nodes_;
  std::vector<std::shared_ptr<typename Parameter<Real>::Data>> parameters_;
  std::uint32_t epoch_ = 0;
  std::unique_ptr<Tape> inner_;
  // Of a run inside a checkpoint.
  Tape* keeper_ = nullptr;
  bool second_run_ = false;
  std::vector<const void*> remembered_;
  std::size_t n_recalled_ = 0;
};

}  // namespace nmp::ad
