#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "capi/mesh.h"
#include "capi/model.h"
#include "capi/nmp.h"

namespace nmp::capi {

/// What a nmp_sim is, in either precision. Buffers have been checked for NULL and size, and hold
/// finite numbers.
class Sim {
 public:
  virtual ~Sim() = default;

  virtual size_t n_vertices() const = 0;
  virtual size_t n_tets() const = 0;
  virtual double time() const = 0;
  virtual double h() const = 0;  // of a frame [s]
  virtual int32_t substeps() const = 0;

  virtual void step(int32_t n) = 0;
  virtual void get_state(double* x, double* v) = 0;
  virtual void set_state(const double* x, const double* v) = 0;

  virtual void set_pins(const int32_t* vertices, size_t n) = 0;
  virtual size_t n_pins() const = 0;
  virtual void move_pins(const double* x) = 0;
  virtual void set_external_forces(const double* f) = 0;  // nullptr: none
  virtual void set_planes(const nmp_plane* planes, size_t n) = 0;

  /// @throws std::invalid_argument  for a field that there is not
  virtual size_t field_size(nmp_field field) const = 0;
  virtual void get_field(nmp_field field, double* values) = 0;

  virtual std::string save() const = 0;
  /// @throws InputError
  virtual void load(std::string_view bytes) = 0;

  virtual void begin_gradient(uint32_t with) = 0;
  virtual void add_loss(const double* dL_dx, const double* dL_dv) = 0;
  virtual void backward() = 0;
  virtual size_t gradient_size(nmp_gradient gradient) const = 0;
  virtual void get_gradient(nmp_gradient gradient, int32_t frame, double* values) = 0;
  virtual void end_gradient() = 0;

  std::atomic_flag busy = ATOMIC_FLAG_INIT;
};

/// Holds a simulation for one call.
class InUse {
 public:
  /// @throws OrderError  while another call holds it
  explicit InUse(Sim& sim);
  ~InUse();
  InUse(const InUse&) = delete;
  InUse& operator=(const InUse&) = delete;

 private:
  Sim& sim_;
};

/// @param model  nullptr: none   @throws std::invalid_argument  for a description that is wrong
std::shared_ptr<Sim> make_sim(std::shared_ptr<const Mesh> mesh,
                              std::shared_ptr<const ModelFile> model, const nmp_sim_desc& desc);

}  // namespace nmp::capi
