#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "autodiff/types.h"

namespace nmp::ad {

template <class Real>
class Tape;

/// A named matrix that is learned. `bar` receives dL/dvalue, added by every backward pass until
/// zero_bar(). A tape that has read the value keeps it alive and notices if it was changed before
/// the backward pass.
template <class Real>
class Parameter {
 public:
  Parameter(std::string name, const Matrix<Real>& value);
  Parameter(Parameter&&) noexcept = default;
  Parameter& operator=(Parameter&&) noexcept = default;
  Parameter(const Parameter&) = delete;
  Parameter& operator=(const Parameter&) = delete;

  const std::string& name() const { return data_->name; }
  const Matrix<Real>& value() const { return data_->value; }
  /// Write access; counts as a change.
  Matrix<Real>& mutable_value() {
    ++data_->version;
    return data_->value;
  }
  const Matrix<Real>& bar() const { return data_->bar; }
  Matrix<Real>& mutable_bar() { return data_->bar; }
  void zero_bar() { data_->bar.setZero(); }

  /// A frozen parameter is a constant to every tape that reads it from then on.
  bool frozen() const { return data_->frozen; }
  void set_frozen(bool frozen) { data_->frozen = frozen; }

 private:
  friend class Tape<Real>;
  struct Data {
    std::string name;
    Matrix<Real> value, bar;
    std::uint64_t version = 0;
    bool frozen = false;
  };
  std::shared_ptr<Data> data_;
};

}  // namespace nmp::ad
