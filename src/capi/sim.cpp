#include "capi/sim.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "autodiff/ops_mat3.h"
#include "base/check.h"
#include "capi/callbacks.h"
#include "capi/rows.h"
#include "capi/snapshot.h"
#include "capi/status.h"
#include "fem/air.h"
#include "fem/deformation_gradient.h"
#include "fem/laws.h"
#include "fem/semi_implicit_euler.h"
#include "fem/stability.h"
#include "nmp/recording.h"

namespace nmp::capi {

namespace {

const char* law_name(nmp_law law) {
  switch (law) {
    case NMP_LAW_NEO_HOOKEAN:
      return "neo-hookean";
    case NMP_LAW_STVK:
      return "stvk";
    case NMP_LAW_PROJECTIVE:
      return "projective";
    case NMP_LAW_NEURAL:
    case NMP_LAW_CALLBACK:
      break;
  }
  return nullptr;
}

// Everything in a description besides its callbacks, as far as the modules use it.
fem::Physics physics_of(const nmp_sim_desc& desc) {
  fem::Physics physics;
  if (const char* law = law_name(desc.law)) physics.material.law = law;
  physics.material.E = desc.E;
  physics.material.nu = desc.nu;
  physics.material.density = desc.density;
  physics.gravity = Vec3<double>(desc.gravity);
  if (desc.has_ground) physics.ground = desc.ground;
  if (desc.friction != 0) physics.contact.law = "coulomb";
  physics.contact.friction = desc.friction;
  physics.air = {desc.drag, Vec3<double>(desc.wind)};
  return physics;
}

constexpr int32_t kMostSubsteps = 1'000'000;

void check(const nmp_sim_desc& desc, bool has_model) {
  const auto in_range = [](int value, int last, const char* name) {
    if (value < 0 || value > last)
      throw std::invalid_argument(text("desc->", name, " is ", value, ", expected 0 ... ", last));
  };
  in_range(desc.precision, NMP_DOUBLE, "precision");
  in_range(desc.law, NMP_LAW_CALLBACK, "law");
  in_range(desc.integrator, NMP_INTEGRATOR_CALLBACK, "integrator");
  if ((desc.law == NMP_LAW_NEURAL || desc.integrator == NMP_INTEGRATOR_NEURAL) && !has_model)
    throw std::invalid_argument("a neural module needs a model");
  if (desc.law == NMP_LAW_CALLBACK)
    need(reinterpret_cast<const void*>(desc.stress_callback), "desc->stress_callback");
  if (desc.integrator == NMP_INTEGRATOR_CALLBACK)
    need(reinterpret_cast<const void*>(desc.integrator_callback), "desc->integrator_callback");
  if (!(desc.h >= 0 && std::isfinite(desc.h)))
    throw std::invalid_argument(text("desc->h must be >= 0 s and finite, got ", desc.h));
  if (desc.substeps < 0 || desc.substeps > kMostSubsteps)
    throw std::invalid_argument(
        text("desc->substeps must be 0 ... ", kMostSubsteps, ", got ", desc.substeps));
  if (!(desc.stagger <= 1))
    throw std::invalid_argument(text("desc->stagger must be <= 1, got ", desc.stagger));
  fem::check_explicit(physics_of(desc));
}

// What a description leaves to the library.
struct Stepping {
  double h = 0, stagger = 0;
  Index substeps = 1;
};

Stepping choose_stepping(const nmp_sim_desc& desc, const fem::TetMesh<double>& mesh,
                         const ModelFile* model) {
  const bool neural = desc.integrator == NMP_INTEGRATOR_NEURAL;
  Stepping s;
  s.h = desc.h > 0 ? desc.h : model ? model->info().h : 5e-4;
  if (!(s.h > 0)) throw std::invalid_argument("the model does not tell its step: set desc->h");
  s.stagger = desc.stagger >= 0 ? desc.stagger : neural ? model->info().stagger : 0;
  s.substeps = desc.substeps;
  if (s.substeps > 0) return s;
  if (neural) {
    s.substeps = model->info().substeps;
  } else if (law_name(desc.law)) {
    constexpr double kRoom = 0.75;  // compression lowers the limit
    const double limit = fem::stable_time_step(mesh, physics_of(desc).material);
    const double wanted = std::max(1.0, std::ceil(s.h / (kRoom * limit)));
    if (!(wanted <= kMostSubsteps))
      throw std::invalid_argument(
          text("steps of at most ", limit, " s are stable for this mesh and material, which is ",
               wanted, " steps in h = ", s.h,
               " s: are the mesh in metres, E in Pa and the density in kg/m3? (desc->substeps > 0 "
               "takes that many whatever is stable)"));
    s.substeps = static_cast<Index>(wanted);
  } else {
    s.substeps = model ? model->info().substeps : 1;
  }
  return s;
}

template <class Real>
class SimOf : public Sim {
 public:
  SimOf(std::shared_ptr<const Mesh> mesh, const ModelFile* file, const nmp_sim_desc& desc,
        const Stepping& stepping)
      : held_(std::move(mesh)),
        mesh_(held_->in<Real>()),
        physics_(physics_of(desc)),
        h_(stepping.h),
        euler_(desc.density, physics_.gravity) {
    if (file) {
      model_.emplace(file->make<Real>());
      n_weights_ = file->weights().size();
    }
    choose_law(desc);
    choose_integrator(desc);
    fem::Boundary<Real> boundary;
    if (desc.has_ground) {
      boundary.ground = to_real<Real>(desc.ground);
      friction_ = fem::make_friction<Real>(desc.friction);
      if (desc.friction > 0 || desc.integrator == NMP_INTEGRATOR_SEMI_IMPLICIT)
        boundary.friction = friction_;
    }
    const Simulation<Real> simulation{
        mesh_,
        *law_,
        *integrator_,
        boundary,
        static_cast<Real>(stepping.h / static_cast<double>(stepping.substeps)),
        stepping.substeps,
        static_cast<Real>(stepping.stagger),
        desc.strict != 0};
    motion_.emplace(simulation, fem::State<Real>{mesh_.rest(), 0 * mesh_.rest()});
    check_precision();
  }

  size_t n_vertices() const override { return static_cast<size_t>(mesh_.n_vertices()); }
  size_t n_tets() const override { return static_cast<size_t>(mesh_.n_tets()); }
  double time() const override { return static_cast<double>(motion_->frame()) * h_; }
  double h() const override { return h_; }
  int32_t substeps() const override { return static_cast<int32_t>(motion_->simulation().substeps); }

  void step(int32_t n) override {
    if (placed_ && n > 0) refuse_below_ground();
    for (int32_t k = 0; k < n; ++k) {
      if (recording_)
        recording_->advance();
      else
        motion_->advance();
    }
  }

  void get_state(double* x, double* v) override {
    if (v) write_rows(motion_->v(), v);  // first: it may fail
    if (x) write_rows(motion_->x(), x);
  }

  void set_state(const double* x, const double* v) override {
    refuse_while_recording();
    const Index n = mesh_.n_vertices();
    motion_->set_state({x ? read_rows<Real>(x, n, 3) : Matrix<Real>(motion_->x()),
                        v ? read_rows<Real>(v, n, 3) : Matrix<Real>(motion_->v())});
    placed_ = true;
  }

  void set_pins(const int32_t* vertices, size_t n) override {
    refuse_while_recording();
    std::vector<int> pinned(vertices, vertices + n);
    fem::Boundary<Real> boundary =
        fem::make_boundary<Real>(mesh_, pinned, motion_->boundary().ground);
    if (boundary.pinned.size() != n)
      throw std::invalid_argument("a vertex stands among the pins twice");
    boundary.friction = motion_->boundary().friction;
    boundary.planes = motion_->boundary().planes;
    // Their places in what hosts give, by their places in what is kept.
    std::vector<Index> order(n);
    for (std::size_t i = 0; i < n; ++i)
      order[static_cast<std::size_t>(
          std::lower_bound(boundary.pinned.begin(), boundary.pinned.end(), vertices[i]) -
          boundary.pinned.begin())] = static_cast<Index>(i);
    Matrix<Real> here(static_cast<Index>(n), 3);
    for (Index i = 0; i < here.rows(); ++i)
      here.row(i) = motion_->x().row(boundary.pinned[static_cast<std::size_t>(i)]);
    fem::move_pins<Real>(boundary, here, Matrix<Real>::Zero(here.rows(), 3));
    motion_->set_boundary(std::move(boundary));
    pin_order_ = std::move(order);
  }
  size_t n_pins() const override { return motion_->boundary().pinned.size(); }
  void move_pins(const double* x) override {
    const Matrix<Real> given = read_rows<Real>(x, static_cast<Index>(n_pins()), 3);
    Matrix<Real> to(given.rows(), 3);
    for (Index i = 0; i < to.rows(); ++i)
      to.row(i) = given.row(pin_order_[static_cast<std::size_t>(i)]);
    motion_->move_pins(std::move(to));
  }

  void set_external_forces(const double* f) override {
    motion_->set_external_force(f ? read_rows<Real>(f, mesh_.n_vertices(), 3) : Matrix<Real>());
  }

  void set_planes(const nmp_plane* planes, size_t n) override {
    refuse_while_recording();
    std::vector<fem::Plane<Real>> made;
    for (size_t i = 0; i < n; ++i) {
      const Vec3<double> normal(planes[i].normal);
      const double length = normal.norm();
      if (!(length > 0) || !std::isfinite(length) || !std::isfinite(planes[i].height) ||
          !(planes[i].friction >= 0) || !std::isfinite(planes[i].friction))
        throw std::invalid_argument(text(
            "planes[", i, "] needs a normal that is not 0, a finite height and friction >= 0"));
      made.push_back({(normal / length).cast<Real>(), to_real<Real>(planes[i].height),
                      to_real<Real>(planes[i].friction)});
    }
    motion_->set_planes(std::move(made));
  }

  size_t field_size(nmp_field field) const override {
    switch (field) {
      case NMP_FIELD_F:
      case NMP_FIELD_P:
        return 9 * n_tets();
      case NMP_FIELD_F_INT:
        return 3 * n_vertices();
      case NMP_FIELD_DET_F:
      case NMP_FIELD_ENERGY:
        return n_tets();
    }
    throw std::invalid_argument(text("field is ", static_cast<int>(field), ", expected 0 ... 4"));
  }

  void get_field(nmp_field field, double* values) override {
    if (field == NMP_FIELD_F_INT) return write_rows(motion_->f_int(), values);
    ad::Tape<Real> tape(ad::Tape<Real>::Mode::inference);
    const ad::Var<Real> F = fem::deformation_gradient(mesh_, tape.constant(motion_->x()));
    if (field == NMP_FIELD_F) return write_rows(F.value(), values);
    if (field == NMP_FIELD_P) return write_rows(law_->stress(F).value(), values);
    if (field == NMP_FIELD_ENERGY) return write_energy(F, values);
    write_rows(ad::mat3_det(F).value(), values);
  }

  std::string save() const override {
    return encode<Real>({motion_->snapshot(), pin_order_}, motion_->simulation());
  }
  void load(std::string_view bytes) override {
    refuse_while_recording();
    SavedState<Real> saved = decode<Real>(bytes, motion_->simulation());
    motion_->restore(std::move(saved.motion));
    pin_order_ = std::move(saved.pin_order);
    placed_ = true;
  }

  void begin_gradient(uint32_t with) override {
    refuse_while_recording();
    if (with > (NMP_WITH_FORCES | NMP_WITH_MATERIAL | NMP_WITH_WEIGHTS))
      throw std::invalid_argument(text("with is ", with, ", expected 0 ... 7"));
    if ((with & NMP_WITH_WEIGHTS) && !model_)
      throw std::invalid_argument("without a model there are no weights");
    std::vector<ad::Parameter<Real>*> opened;
    if (with & NMP_WITH_MATERIAL) opened = material();
    if (with & NMP_WITH_WEIGHTS)
      for (ad::Parameter<Real>* p : model_->parameters()) opened.push_back(p);
    with_ = with;
    end_gradient();  // of a beginning that failed
    opened_ = std::move(opened);
    for (ad::Parameter<Real>* p : opened_) {
      p->set_frozen(false);
      p->zero_bar();
    }
    recording_ = std::make_unique<Recording<Real>>(*motion_, (with & NMP_WITH_FORCES) != 0);
    differentiated_ = false;
  }

  void add_loss(const double* dL_dx, const double* dL_dv) override {
    need_recording();
    const Index n = mesh_.n_vertices();
    const Matrix<Real> zero = Matrix<Real>::Zero(n, 3);
    recording_->add_loss(dL_dx ? read_rows<Real>(dL_dx, n, 3) : zero,
                         dL_dv ? read_rows<Real>(dL_dv, n, 3) : zero);
    differentiated_ = false;
  }

  void backward() override {
    need_recording();
    differentiated_ = false;  // until it has worked
    for (ad::Parameter<Real>* p : material()) p->zero_bar();
    if (model_) nn::zero_bars(model_->parameters());
    recording_->backward();
    differentiated_ = true;
  }

  size_t gradient_size(nmp_gradient gradient) const override {
    switch (gradient) {
      case NMP_GRAD_X0:
      case NMP_GRAD_V0:
      case NMP_GRAD_FORCE:
        return 3 * n_vertices();
      case NMP_GRAD_MATERIAL:
        return NMP_N_MATERIAL;
      case NMP_GRAD_WEIGHTS:
        return n_weights_;
    }
    throw std::invalid_argument(
        text("gradient is ", static_cast<int>(gradient), ", expected 0 ... 4"));
  }

  void get_gradient(nmp_gradient gradient, int32_t frame, double* values) override {
    need_recording();
    if (!differentiated_) throw OrderError("nmp_grad_backward has not been called");
    const auto asked = [&](unsigned what, const char* name) {
      if (!(with_ & what))
        throw OrderError(text("nmp_grad_begin was not asked for gradients in the ", name));
    };
    switch (gradient) {
      case NMP_GRAD_X0:
        return write_rows(recording_->x0_bar(), values);
      case NMP_GRAD_V0:
        return write_rows(recording_->v0_bar(), values);
      case NMP_GRAD_FORCE:
        asked(NMP_WITH_FORCES, "external forces");
        if (frame < 0 || frame >= recording_->frames())
          throw std::invalid_argument(text("frame is ", frame, ", the recording has ",
                                           recording_->frames(), ", counted from 0"));
        return write_rows(recording_->f_ext_bar(frame), values);
      case NMP_GRAD_MATERIAL:
        asked(NMP_WITH_MATERIAL, "material");
        return write_material(values);
      case NMP_GRAD_WEIGHTS:
        asked(NMP_WITH_WEIGHTS, "weights");
        const std::vector<double> bars = flat_bars(model_->parameters());
        std::copy(bars.begin(), bars.end(), values);
        return;
    }
  }

  void end_gradient() override {  // takes no memory
    recording_.reset();
    for (ad::Parameter<Real>* p : opened_) p->set_frozen(true);
    opened_.clear();
  }

 private:
  void choose_law(const nmp_sim_desc& desc) {
    if (desc.law == NMP_LAW_NEURAL) {
      law_ = &model_->stress;
    } else if (desc.law == NMP_LAW_CALLBACK) {
      callback_law_.emplace(desc);
      law_ = &*callback_law_;
    } else {
      analytic_law_ = fem::make_law<Real>(physics_.material);
      law_ = analytic_law_.get();
    }
  }

  void choose_integrator(const nmp_sim_desc& desc) {
    const fem::Integrator<Real>* base = &euler_;
    if (desc.integrator == NMP_INTEGRATOR_NEURAL) base = &model_->integration;
    if (desc.integrator == NMP_INTEGRATOR_CALLBACK) base = &callback_integrator_.emplace(desc);
    integrator_ = base;
    if (desc.integrator != NMP_INTEGRATOR_SEMI_IMPLICIT && desc.drag == 0) return;
    integrator_ = &in_air_.emplace(*base, physics_.air);
  }

  // Far from the origin there are too few digits for the differences of positions.
  void check_precision() const {
    ad::Tape<Real> tape(ad::Tape<Real>::Mode::inference);
    const ad::Var<Real> F = fem::deformation_gradient(mesh_, tape.constant(mesh_.rest()));
    if (((ad::mat3_det(F).value().array() - Real(1)).abs() <= Real(0.01)).all()) return;
    throw std::invalid_argument(
        "the mesh is so far from the origin, for its size, that its elements are lost to rounding: "
        "move it to the origin or use NMP_DOUBLE");
  }

  // Contact would lift what is deep in the ground at once, and press the body flat.
  void refuse_below_ground() {
    const fem::Boundary<Real>& boundary = motion_->boundary();
    if (boundary.ground) {
      const Real lowest = *boundary.ground - static_cast<Real>(0.05) * mesh_.diagonal();
      const Matrix<Real>& x = motion_->x();
      for (Index i = 0; i < x.rows(); ++i) {
        if (x(i, 2) >= lowest ||
            std::binary_search(boundary.pinned.begin(), boundary.pinned.end(), static_cast<int>(i)))
          continue;
        throw std::invalid_argument(text(
            "vertex ", i, " is at z = ", x(i, 2), " m, deep below the ground at ", *boundary.ground,
            " m: place the body above it (nmp_sim_set_state), or set desc->ground lower"));
      }
    }
    placed_ = false;
  }

  // Those that there are, in no order.
  std::vector<ad::Parameter<Real>*> material() {
    std::vector<ad::Parameter<Real>*> all{&euler_.density};
    if (analytic_law_) {
      all.push_back(&analytic_law_->parameters.log_E);
      all.push_back(&analytic_law_->parameters.nu);
    }
    if (friction_) all.push_back(friction_.get());
    if (in_air_) {
      all.push_back(&in_air_->drag);
      all.push_back(&in_air_->wind);
    }
    return all;
  }

  void write_material(double* values) const {
    std::fill_n(values, NMP_N_MATERIAL, 0.0);
    const auto bar = [](const ad::Parameter<Real>& p, Index k = 0) {
      return static_cast<double>(p.bar()(0, k));
    };
    if (analytic_law_) {
      values[NMP_MATERIAL_E] = bar(analytic_law_->parameters.log_E) / physics_.material.E;
      values[NMP_MATERIAL_NU] = bar(analytic_law_->parameters.nu);
    }
    values[NMP_MATERIAL_DENSITY] = bar(euler_.density);
    if (friction_) values[NMP_MATERIAL_FRICTION] = bar(*friction_);
    if (!in_air_) return;
    values[NMP_MATERIAL_DRAG] = bar(in_air_->drag);
    for (int k = 0; k < 3; ++k) values[NMP_MATERIAL_WIND_X + k] = bar(in_air_->wind, k);
  }

  void write_energy(ad::Var<Real> F, double* values) {
    Matrix<Real> Psi(F.rows(), 1);
    if (analytic_law_)
      fem::energy_density<Real>(physics_.material, F.value(), Psi);
    else if (model_ && law_ == &model_->stress && model_->stress.has_energy())
      Psi = model_->stress.energy_density(F).value();
    else
      throw std::invalid_argument("this law has no energy");
    write_rows(Psi.cwiseProduct(mesh_.volumes()), values);
  }

  void refuse_while_recording() const {
    if (recording_) throw OrderError("not possible between nmp_grad_begin and nmp_grad_end");
  }
  void need_recording() const {
    if (!recording_) throw OrderError("nmp_grad_begin has not been called");
  }

  std::shared_ptr<const Mesh> held_;
  const fem::TetMesh<Real>& mesh_;
  fem::Physics physics_;
  double h_;
  std::optional<Model<Real>> model_;
  size_t n_weights_ = 0;
  std::unique_ptr<fem::IsotropicLaw<Real>> analytic_law_;
  std::optional<CallbackLaw<Real>> callback_law_;
  fem::SemiImplicitEuler<Real> euler_;
  std::optional<CallbackIntegrator<Real>> callback_integrator_;
  std::optional<fem::InAir<Real>> in_air_;
  std::shared_ptr<ad::Parameter<Real>> friction_;
  const fem::ConstitutiveLaw<Real>* law_ = nullptr;
  const fem::Integrator<Real>* integrator_ = nullptr;
  std::optional<Motion<Real>> motion_;
  std::vector<Index> pin_order_;  // a pin's place in what hosts give
  std::unique_ptr<Recording<Real>> recording_;
  bool placed_ = true;                        // and has made no step since
  std::vector<ad::Parameter<Real>*> opened_;  // those that the recording differentiates in
  uint32_t with_ = 0;
  bool differentiated_ = false;
};

}  // namespace

InUse::InUse(Sim& sim) : sim_(sim) {
  if (sim.busy.test_and_set(std::memory_order_acquire))
    throw OrderError("another call is using this simulation");
}

InUse::~InUse() { sim_.busy.clear(std::memory_order_release); }

std::shared_ptr<Sim> make_sim(std::shared_ptr<const Mesh> mesh,
                              std::shared_ptr<const ModelFile> model, const nmp_sim_desc& desc) {
  check(desc, model != nullptr);
  const Stepping stepping = choose_stepping(desc, mesh->double_precision, model.get());
  if (desc.precision == NMP_DOUBLE)
    return std::make_shared<SimOf<double>>(std::move(mesh), model.get(), desc, stepping);
  return std::make_shared<SimOf<float>>(std::move(mesh), model.get(), desc, stepping);
}

}  // namespace nmp::capi
