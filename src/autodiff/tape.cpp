#include "autodiff/tape.h"

#include <algorithm>
#include <cstring>

namespace nmp::ad {

#ifndef NMP_TEST_SCALAR  // what is no template is defined once

namespace {

constexpr std::size_t kAlignment = 64;
constexpr std::size_t kFirstBlock = std::size_t(1) << 20;

std::size_t round_up(std::size_t bytes) {
  return (bytes + kAlignment - 1) / kAlignment * kAlignment;
}

}  // namespace

void* Arena::allocate(std::size_t bytes) {
  const std::size_t size = round_up(std::max<std::size_t>(bytes, 1));
  while (block_ < blocks_.size() && offset_ + size > blocks_[block_].size) {
    ++block_;
    offset_ = 0;
  }
  if (block_ == blocks_.size()) add_block(size);
  std::byte* memory = blocks_[block_].bytes.get() + offset_;
  offset_ += size;
  used_ += size;
  peak_ = std::max(peak_, used_);
#ifndef NDEBUG
  std::memset(memory, 0xff, size);
#endif
  return memory;
}

void Arena::add_block(std::size_t at_least) {
  const std::size_t size =
      std::max({at_least, kFirstBlock, blocks_.empty() ? 0 : 2 * blocks_.back().size});
  Block block;
  block.bytes.reset(static_cast<std::byte*>(::operator new(size, std::align_val_t(kAlignment))));
  block.size = size;
  blocks_.push_back(std::move(block));
}

void Arena::reset() noexcept {
  // One block from now on, so that rounds of the same size never search or allocate.
  if (blocks_.size() > 1) {
    std::size_t total = 0;
    for (const Block& block : blocks_) total += block.size;
    blocks_.clear();
    try {
      add_block(total);
    } catch (const std::bad_alloc&) {
    }
  }
  block_ = offset_ = used_ = 0;
}

#endif

template <class Real>
Tape<Real>& Var<Real>::tape() const {
  NMP_CHECK(tape_ != nullptr, "an empty Var was used: it belongs to no tape");
  return *tape_;
}

template <class Real>
ConstMatrixMap<Real> Var<Real>::value() const {
  const auto& n = tape().node(*this);
  return ConstMatrixMap<Real>(n.value, n.rows, n.cols);
}

template <class Real>
MatrixMap<Real> Var<Real>::bar() const {
  auto& n = tape().node(*this);
  NMP_CHECK(tape_->needs_grad(n),
            text("the adjoint of '", n.op, "' was asked for, but it depends on no input"));
  return tape_->bar_of(n);
}

template <class Real>
bool Var<Real>::has_bar() const {
  const auto& n = tape().node(*this);
  return n.outer.tape_ ? n.outer.has_bar() : n.bar_live;
}

template <class Real>
bool Var<Real>::needs_grad() const {
  return tape().needs_grad(tape_->node(*this));
}

template <class Real>
MatrixMap<Real> Var<Real>::mutable_value() const {
  auto& n = tape().node(*this);
  NMP_CHECK(n.parameter < 0, "a parameter is changed by Parameter::mutable_value, not on the tape");
  NMP_CHECK(n.outer.tape_ == nullptr, "a value shared with another tape cannot be changed here");
  ++n.version;
  return MatrixMap<Real>(n.value, n.rows, n.cols);
}

template <class Real>
typename Tape<Real>::Node& Tape<Real>::node(Var<Real> var) {
  NMP_CHECK(var.tape_ == this, "a Var of another tape was used");
  NMP_CHECK(var.epoch_ == epoch_, "a Var was used after its tape was cleared");
  return nodes_[static_cast<std::size_t>(var.id_)];
}

template <class Real>
MatrixMap<Real> Tape<Real>::allocate(Index rows, Index cols) {
  const auto bytes = static_cast<std::size_t>(rows * cols) * sizeof(Real);
  return MatrixMap<Real>(static_cast<Real*>(arena_.allocate(bytes)), rows, cols);
}

template <class Real>
Var<Real> Tape<Real>::add_node(const char* op, const Var<Real>* inputs, std::size_t n_inputs,
                               Real* value, Index rows, Index cols, bool wanted) {
  Node n;
  n.depends = wanted;
  n.op = op;
  n.value = value;
  n.rows = rows;
  n.cols = cols;
  for (std::size_t i = 0; i < n_inputs; ++i) n.depends |= node(inputs[i]).depends;
  if (needs_grad(n)) {
    n.inputs = keep<Input>(static_cast<Index>(n_inputs));
    n.n_inputs = static_cast<std::int32_t>(n_inputs);
    for (std::size_t i = 0; i < n_inputs; ++i)
      n.inputs[i] = {inputs[i].id_, version(node(inputs[i]))};
  }
  nodes_.push_back(n);
  return Var<Real>(this, static_cast<std::int32_t>(nodes_.size()) - 1, epoch_);
}

template <class Real>
void Tape<Real>::set_backward(Var<Real> result, void* closure, BackwardCall call,
                              DestroyCall destroy) {
  Node& n = node(result);
  n.closure = closure;
  n.call = call;
  n.destroy = destroy;
}

template <class Real>
Var<Real> Tape<Real>::constant(const ConstView<Real>& value) {
  MatrixMap<Real> copy = allocate(value.rows(), value.cols());
  copy = value;
  return add_node("constant", nullptr, 0, copy.data(), copy.rows(), copy.cols());
}

template <class Real>
Var<Real> Tape<Real>::input(const ConstView<Real>& value) {
  const Var<Real> leaf = constant(value);
  Node& n = node(leaf);
  n.op = "input";
  n.depends = true;
  return leaf;
}

template <class Real>
Var<Real> Tape<Real>::parameter(const Parameter<Real>& parameter) {
  NMP_CHECK(parameter.data_ != nullptr, "a parameter was used after it was moved from");
  typename Parameter<Real>::Data& data = *parameter.data_;
  const Var<Real> leaf =
      add_node("parameter", nullptr, 0, data.value.data(), data.value.rows(), data.value.cols());
  parameters_.push_back(parameter.data_);
  Node& n = node(leaf);
  n.parameter = static_cast<std::int32_t>(parameters_.size()) - 1;
  n.depends = !data.frozen;
  return leaf;
}

template <class Real>
Var<Real> Tape<Real>::alias(Var<Real> outer) {
  const auto& source = outer.tape().node(outer);
  const Var<Real> leaf = add_node("alias", nullptr, 0, source.value, source.rows, source.cols);
  Node& n = node(leaf);
  n.outer = outer;
  n.depends = source.depends;
  return leaf;
}

template <class Real>
Var<Real> Tape<Real>::result_of(Var<Real> op, MatrixMap<Real> value) {
  return add_node(node(op).op, &op, 1, value.data(), value.rows(), value.cols());
}

template <class Real>
std::uint64_t Tape<Real>::version(const Node& n) const {
  if (n.parameter >= 0) return parameters_[static_cast<std::size_t>(n.parameter)]->version;
  if (n.outer.tape_) return n.outer.tape_->version(n.outer.tape_->node(n.outer));
  return n.version;
}

template <class Real>
MatrixMap<Real> Tape<Real>::bar_of(Node& n) {
  if (n.parameter >= 0) {
    auto& bar = parameters_[static_cast<std::size_t>(n.parameter)]->bar;
    return MatrixMap<Real>(bar.data(), n.rows, n.cols);
  }
  if (n.outer.tape_) return n.outer.bar();
  if (!n.bar) n.bar = allocate(n.rows, n.cols).data();
  MatrixMap<Real> bar(n.bar, n.rows, n.cols);
  if (!n.bar_live) bar.setZero();
  n.bar_live = true;
  return bar;
}

template <class Real>
void Tape<Real>::backward(Var<Real> loss) {
  NMP_CHECK(loss.rows() == 1 && loss.cols() == 1,
            "backward starts from a 1 x 1 loss, got " + shape(loss.value()));
  backward(loss, Matrix<Real>::Ones(1, 1));
}

template <class Real>
void Tape<Real>::backward(Var<Real> y, const ConstView<Real>& y_bar) {
  const Matrix<Real> copy = y_bar;
  const ConstMatrixMap<Real> seed(copy.data(), copy.rows(), copy.cols());
  backward(&y, &seed, 1);
}

template <class Real>
void Tape<Real>::backward(const Var<Real>* y, const ConstMatrixMap<Real>* y_bar, std::size_t n) {
  NMP_CHECK(mode_ == Mode::record, "an inference tape records nothing to go back through");
  for (Node& each : nodes_) each.bar_live = false;
  for (std::size_t i = 0; i < n; ++i) {
    Node& start = node(y[i]);
    NMP_CHECK(y_bar[i].rows() == start.rows && y_bar[i].cols() == start.cols,
              "the adjoint must be " + shape(y[i].value()) + ", got " + shape(y_bar[i]));
    if (start.depends) bar_of(start) += y_bar[i];
  }
  for (std::size_t id = nodes_.size(); id-- > 0;) {
    Node& each = nodes_[id];
    const bool result = each.n_inputs > 0;  // of an operator, and not a leaf
    if (result && each.bar_live && each.version != 0)
      throw std::logic_error(
          text("the result of '", each.op, "' was changed after it was recorded"));
    if (!each.call) continue;
    // An operator without a value of its own runs if any of its results was used.
    if (each.rows * each.cols > 0 && !each.bar_live) continue;
    for (std::int32_t i = 0; i < each.n_inputs; ++i) {
      const Input& input = each.inputs[i];
      const Node& read = nodes_[static_cast<std::size_t>(input.id)];
      if (version(read) != input.version)
        throw std::logic_error(text("input ", i, " of '", each.op, "' (", name_of(read),
                                    ") was changed after it was recorded"));
    }
    each.call(each.closure, ConstMatrixMap<Real>(each.bar, each.rows, each.cols));
  }
}

template <class Real>
std::string Tape<Real>::name_of(const Node& n) const {
  if (n.parameter < 0) return n.op;
  return "parameter " + parameters_[static_cast<std::size_t>(n.parameter)]->name;
}

template <class Real>
void Tape<Real>::destroy_closures() noexcept {
  for (Node& n : nodes_)
    if (n.destroy) n.destroy(n.closure);
  nodes_.clear();
}

template <class Real>
void Tape<Real>::clear() {
  destroy_closures();
  parameters_.clear();
  remembered_.clear();
  keeper_ = nullptr;
  second_run_ = false;
  arena_.reset();
  ++epoch_;
}

template <class Real>
std::size_t Tape<Real>::peak_bytes() const {
  return arena_.peak() + (inner_ ? inner_->peak_bytes() : 0);
}

template <class Real>
Tape<Real>& Tape<Real>::inner() {
  if (!inner_) inner_ = std::make_unique<Tape>(mode_);
  return *inner_;
}

template <class Real>
void Tape<Real>::begin_first_run(Tape& keeper) {
  clear();
  mode_ = Mode::inference;
  keeper_ = &keeper;
}

template <class Real>
void Tape<Real>::begin_second_run(const void* const* remembered, std::size_t n) {
  clear();
  mode_ = Mode::record;
  second_run_ = true;
  remembered_.assign(remembered, remembered + n);
  n_recalled_ = 0;
}

template <class Real>
const void* Tape<Real>::next_remembered() {
  NMP_CHECK(n_recalled_ < remembered_.size(),
            "a checkpointed piece did something else when it was run again");
  return remembered_[n_recalled_++];
}

#define NMP_INSTANTIATE(Real) \
  template class Var<Real>;   \
  template class Tape<Real>;

#include "autodiff/instantiate.h"

}  // namespace nmp::ad
