/* nmp: simulate elastic tetrahedral bodies with learned or analytic modules, from C11 or C++.
 *
 *   nmp_mesh* mesh;
 *   nmp_sim* sim;
 *   nmp_sim_desc desc = nmp_sim_desc_default();
 *   if (nmp_mesh_load("bob.msh", NULL, &mesh) != NMP_OK) puts(nmp_last_error());
 *   if (nmp_sim_create(mesh, NULL, &desc, &sim) != NMP_OK) puts(nmp_last_error());
 *   nmp_sim_step(sim, 100);
 *
 * Rules
 *  - Every function that can fail returns a status. On an error nothing has changed: outputs are as
 *    they were, objects are as usable as before, and nmp_last_error() tells this thread what was
 *    wrong. Nothing is thrown, printed, or ended.
 *  - Numbers are SI units in double. An array of vectors holds x, y, z of item 0, then of item 1;
 *    of 3 x 3 matrices the rows of item 0, then of item 1. `n` is the number of doubles or ints in
 *    the buffer, and must be the one that is wanted.
 *  - Handles are not addresses: one that was freed, never made or of another kind is an error.
 *  - Results do not depend on the host's rounding mode, traps or flushing of subnormal numbers, and
 * a call leaves them as they were. A thread cannot be cancelled inside a call.
 *  - Meshes and models never change: any number of threads and simulations share them, and they may
 *    be freed while simulations use them. A simulation serves one thread at a time; a call while
 *    another one is under way is an error.
 */
#ifndef NMP_H
#define NMP_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define NMP_API __attribute__((visibility("default")))
#else
#define NMP_API
#endif

/* The enumerations are ints in both languages: a number that none of them has is then an error and
 * not undefined behaviour of C++. */
#ifdef __cplusplus
#define NMP_INT_ENUM : int
#else
#define NMP_INT_ENUM
#endif

/* -- errors ------------------------------------------------------ */

typedef enum nmp_status NMP_INT_ENUM {
  NMP_OK = 0,
  NMP_ERROR_INTERNAL = 1,  /* should not happen */
  NMP_ERROR_ARGUMENT = 2,  /* an argument that is wrong */
  NMP_ERROR_INPUT = 3,     /* a file or buffer whose content is not what its format promises */
  NMP_ERROR_NUMERICAL = 4, /* a state that is no longer that of a simulation */
  NMP_ERROR_IO = 5,        /* reading or writing that failed */
  NMP_ERROR_MEMORY = 6,    /* not enough of it */
  NMP_ERROR_CALLBACK = 7,  /* a callback that returned non-zero or threw */
  NMP_ERROR_ORDER = 8      /* a call that is not possible now */
} nmp_status;

/* "NMP_ERROR_INPUT". */
NMP_API const char* nmp_status_name(nmp_status status);
/* What the last failing call of this thread found wrong, "" before the first; until the next one.
 */
NMP_API const char* nmp_last_error(void);

/* -- library ----------------------------------------------------- */

/* Major version * 10000 + minor * 100 + patch: compare with that of the header. */
#define NMP_VERSION_NUMBER 100
NMP_API uint32_t nmp_version(void);
NMP_API const char* nmp_version_string(void);
/* Threads that a call may use, in this process; 0: as many as the machine has. Results have the
 * same bits for any number. Every thread of a host has a team of its own: where many simulations
 * step at the same time, 1 is best. A child of fork() goes on with 1. */
NMP_API nmp_status nmp_set_threads(int32_t n);

/* -- meshes ------------------------------------------------------ */

typedef struct nmp_mesh nmp_mesh;

typedef struct nmp_mesh_options {
  size_t struct_size; /* sizeof(nmp_mesh_options) */
  double scale;       /* metres in a unit of the file; 1 */
  int32_t y_up;       /* not 0: turned by (x, y, z) -> (x, -z, y); 0 */
} nmp_mesh_options;
NMP_API nmp_mesh_options nmp_mesh_options_default(void);

/* Gmsh .msh, TetGen .node + .ele, VTK .vtk, .vtu. What can be repaired is: see nmp_mesh_report.
 * options: NULL for the defaults. */
NMP_API nmp_status nmp_mesh_load(const char* path, const nmp_mesh_options* options,
                                 nmp_mesh** mesh);
/* Positions at rest, 3 n_vertices, and corners, 4 n_tets, from 0: each tetrahedron with
 * (x1 - x0) x (x2 - x0) . (x3 - x0) > 0, each vertex in one of them at least. */
NMP_API nmp_status nmp_mesh_from_arrays(const double* vertices, size_t n_vertices,
                                        const int32_t* tets, size_t n_tets, nmp_mesh** mesh);
/* By the path's ending, as nmp_mesh_load reads; an existing file is replaced. */
NMP_API nmp_status nmp_mesh_save(const nmp_mesh* mesh, const char* path);
/* NULL is no error. */
NMP_API nmp_status nmp_mesh_free(nmp_mesh* mesh);

/* Any of the three may be NULL. Triangles: of the surface. */
NMP_API nmp_status nmp_mesh_counts(const nmp_mesh* mesh, size_t* n_vertices, size_t* n_tets,
                                   size_t* n_triangles);
NMP_API nmp_status nmp_mesh_vertices(const nmp_mesh* mesh, double* vertices, size_t n);
NMP_API nmp_status nmp_mesh_tets(const nmp_mesh* mesh, int32_t* corners, size_t n);
/* Counter-clockwise from outside, as vertices of the mesh. */
NMP_API nmp_status nmp_mesh_triangles(const nmp_mesh* mesh, int32_t* corners, size_t n);
/* A vertex's part of the volume, n = n_vertices [m3]: its mass is the density times it. */
NMP_API nmp_status nmp_mesh_vertex_volumes(const nmp_mesh* mesh, double* volumes, size_t n);
/* The vertex of the file, from 0, that each vertex is, n = n_vertices: loading drops those that
 * belong to no tetrahedron. Of nmp_mesh_from_arrays the same numbers. */
NMP_API nmp_status nmp_mesh_file_vertices(const nmp_mesh* mesh, int32_t* vertices, size_t n);
/* What loading found and did about it, one line each. `*size` is set to the bytes of the text with
 * its final 0; they are written if capacity is at least that, nothing otherwise. */
NMP_API nmp_status nmp_mesh_report(const nmp_mesh* mesh, char* text, size_t capacity, size_t* size);

/* -- models ------------------------------------------------------ */

typedef struct nmp_model nmp_model;

/* A file of `nmp train`. */
NMP_API nmp_status nmp_model_load(const char* path, nmp_model** model);
/* The same from its bytes, which are copied. */
NMP_API nmp_status nmp_model_load_memory(const void* data, size_t size, nmp_model** model);
/* In single precision; an existing file is replaced. */
NMP_API nmp_status nmp_model_save(const nmp_model* model, const char* path);
NMP_API nmp_status nmp_model_free(nmp_model* model);

typedef struct nmp_model_info {
  size_t struct_size; /* set it before the call */
  double h;           /* time between frames that it was trained with [s] */
  int32_t substeps;   /* steps it makes of that */
  double stagger;     /* its velocities inside stand this part of a step early; 0: they do not */
  size_t n_weights;
} nmp_model_info;
NMP_API nmp_status nmp_model_get_info(const nmp_model* model, nmp_model_info* info);
/* All learned numbers in the order of gradients. */
NMP_API nmp_status nmp_model_weights(const nmp_model* model, double* weights, size_t n);
/* Another model of the same architecture. */
NMP_API nmp_status nmp_model_with_weights(const nmp_model* model, const double* weights, size_t n,
                                          nmp_model** other);

/* -- simulations ------------------------------------------------- */

typedef struct nmp_sim nmp_sim;

typedef enum nmp_precision NMP_INT_ENUM { NMP_SINGLE = 0, NMP_DOUBLE = 1 } nmp_precision;
typedef enum nmp_law NMP_INT_ENUM {
  NMP_LAW_NEO_HOOKEAN = 0,
  NMP_LAW_STVK = 1,
  NMP_LAW_PROJECTIVE = 2,
  NMP_LAW_NEURAL = 3,  /* the model's */
  NMP_LAW_CALLBACK = 4 /* stress_callback */
} nmp_law;
typedef enum nmp_integrator NMP_INT_ENUM {
  NMP_INTEGRATOR_SEMI_IMPLICIT = 0,
  NMP_INTEGRATOR_NEURAL = 1,  /* the model's */
  NMP_INTEGRATOR_CALLBACK = 2 /* integrator_callback */
} nmp_integrator;

/* Stress laws and integrators of your own. They are called by the thread that steps, for the whole
 * body at once, and return 0 if all is well. They must not use the simulation that calls them, and
 * be functions of their inputs alone: gradients run each step again, and fields, states and
 * velocities may ask once more. They end by returning: a thread that is ended or jumps out of one
 * leaves the simulation locked. The _vjp of each is its reverse: it is given the inputs again and
 * dL/d(output), and fills dL/d(input). It may be NULL if no gradients are asked for. */
/* F, P: 9 n.  P = P(F), first Piola-Kirchhoff stress [Pa]. */
typedef int (*nmp_stress_fn)(void* user, size_t n, const double* F, double* P);
typedef int (*nmp_stress_vjp_fn)(void* user, size_t n, const double* F, const double* P_bar,
                                 double* F_bar);
/* x, v, f, dv: 3 n.  The change of velocity in a step of h seconds; f is the force on every vertex,
 * external ones included [N]. */
typedef int (*nmp_integrator_fn)(void* user, size_t n, double h, const double* x, const double* v,
                                 const double* f, double* dv);
typedef int (*nmp_integrator_vjp_fn)(void* user, size_t n, double h, const double* x,
                                     const double* v, const double* f, const double* dv_bar,
                                     double* x_bar, double* v_bar, double* f_bar);

typedef struct nmp_sim_desc {
  size_t struct_size; /* sizeof(nmp_sim_desc) */
  nmp_precision precision;
  nmp_law law;
  nmp_integrator integrator;
  /* A call of nmp_sim_step(sim, 1) goes on by h seconds in `substeps` equal steps. 0: the model's,
   * without a model h is 5e-4 and the substeps are as many as are stable. */
  double h;
  int32_t substeps;
  /* Of the velocities, see nmp_model_info; < 0: the model's where its integrator is used, else 0.
   */
  double stagger;
  /* The analytic modules' world: a neural law has learned its own stiffness and reads no E and nu,
   * a neural integrator its own density and gravity. */
  double E;          /* Young's modulus [Pa]; 5e5 */
  double nu;         /* Poisson's ratio; 0.45 */
  double density;    /* [kg/m3]; 1000 */
  double gravity[3]; /* [m/s2]; 0, 0, -9.8 */
  double drag;       /* air drags by drag (wind - v) [1/s]; 0 */
  double wind[3];    /* [m/s]; 0 */
  /* Both modules' world. */
  int32_t has_ground; /* not 0: a level ground; 0 */
  double ground; /* at this height z [m]; a body must not begin a twentieth of its size below; 0 */
  double friction; /* Coulomb's, of the ground; 0 */
  int32_t strict;  /* not 0: an element that is inside out is an error; 0 */
  nmp_stress_fn stress_callback;
  nmp_stress_vjp_fn stress_vjp;
  void* stress_user;
  nmp_integrator_fn integrator_callback;
  nmp_integrator_vjp_fn integrator_vjp;
  void* integrator_user;
} nmp_sim_desc;
NMP_API nmp_sim_desc nmp_sim_desc_default(void);

/* At rest, with velocity 0, at time 0. model: NULL if no module is neural. */
NMP_API nmp_status nmp_sim_create(const nmp_mesh* mesh, const nmp_model* model,
                                  const nmp_sim_desc* desc, nmp_sim** sim);
NMP_API nmp_status nmp_sim_free(nmp_sim* sim);

/* Goes on by n times h. An error ends at the last whole h before it. */
NMP_API nmp_status nmp_sim_step(nmp_sim* sim, int32_t n);
/* [s] since the simulation was made. */
NMP_API nmp_status nmp_sim_time(const nmp_sim* sim, double* time);
/* Seconds and steps of nmp_sim_step(sim, 1), where they were left to the library. */
NMP_API nmp_status nmp_sim_step_size(const nmp_sim* sim, double* h, int32_t* substeps);

/* Positions and velocities, n = 3 n_vertices; one of them may be NULL. Velocities of a learned
 * integrator stand at the time of the positions. */
NMP_API nmp_status nmp_sim_get_state(nmp_sim* sim, double* x, double* v, size_t n);
/* NULL leaves that one as it is. Velocities are understood as nmp_sim_get_state tells them, under
 * the external forces that are set: set these first. Pinned vertices go back to where they are
 * held. */
NMP_API nmp_status nmp_sim_set_state(nmp_sim* sim, const double* x, const double* v, size_t n);

/* Holds these vertices where they are now, and no others; n = 0 lets all go. */
NMP_API nmp_status nmp_sim_set_pins(nmp_sim* sim, const int32_t* vertices, size_t n);
/* Where they are at the end of the next h, n = 3 times their number, in the order in which they
 * were given. They move at constant speed and then rest. */
NMP_API nmp_status nmp_sim_move_pins(nmp_sim* sim, const double* x, size_t n);
/* Forces on the vertices from now on, n = 3 n_vertices [N]; n = 0: none. A learned integrator takes
 * them together with the body's own. */
NMP_API nmp_status nmp_sim_set_external_forces(nmp_sim* sim, const double* f, size_t n);
/* Half-spaces that vertices stay in, besides the ground: normal . x >= height. Learned integrators
 * are not told of them; contact acts after them all the same. Any number, also none. */
typedef struct nmp_plane {
  double normal[3]; /* of any length but 0 */
  double height;    /* along the normal of length 1 [m] */
  double friction;  /* Coulomb's */
} nmp_plane;
NMP_API nmp_status nmp_sim_set_planes(nmp_sim* sim, const nmp_plane* planes, size_t n);

typedef enum nmp_field NMP_INT_ENUM {
  NMP_FIELD_F = 0,     /* deformation gradients, 9 n_tets */
  NMP_FIELD_P = 1,     /* first Piola-Kirchhoff stresses, 9 n_tets [Pa] */
  NMP_FIELD_F_INT = 2, /* internal forces, 3 n_vertices [N] */
  NMP_FIELD_DET_F = 3, /* n_tets */
  NMP_FIELD_ENERGY = 4 /* elastic, n_tets [J]; of laws that have one */
} nmp_field;
NMP_API nmp_status nmp_sim_get_field(nmp_sim* sim, nmp_field field, double* values, size_t n);

/* All that the next steps depend on but what nmp_sim_create was given, as bytes: a simulation of
 * the same mesh and description goes on from them with the same bits. One of another mesh,
 * precision, h, substeps or stagger refuses them. */
NMP_API nmp_status nmp_sim_save_size(const nmp_sim* sim, size_t* size);
NMP_API nmp_status nmp_sim_save(const nmp_sim* sim, void* data, size_t size);
NMP_API nmp_status nmp_sim_load(nmp_sim* sim, const void* data, size_t size);

/* -- gradients --------------------------------------------------- */

/* Of any sum of functions of the states, through every step between nmp_grad_begin and
 * nmp_grad_backward:
 *
 *   nmp_grad_begin(sim, NMP_WITH_MATERIAL);
 *   nmp_sim_step(sim, 200);
 *   nmp_sim_get_state(sim, x, v, n);            from which you compute dL/dx, dL/dv
 *   nmp_grad_add_loss(sim, dL_dx, dL_dv, n);    of this state; there may be more, on the way
 *   nmp_grad_backward(sim);
 *   nmp_grad_get(sim, NMP_GRAD_V0, 0, dL_dv0, n);
 *   nmp_grad_end(sim);
 *
 * Memory: a few states per step, and for a learned law 0.1 MB. nmp_sim_set_state, _set_pins,
 * _set_planes and _load are not possible in between; pins may move and forces may change. */
enum {
  NMP_WITH_FORCES = 1,   /* gradients in the external forces, too */
  NMP_WITH_MATERIAL = 2, /* in the numbers of nmp_material */
  NMP_WITH_WEIGHTS = 4   /* in the model's weights */
};
/* Begins at the present state. `with`: a sum of the above; x0 and v0 always are. */
NMP_API nmp_status nmp_grad_begin(nmp_sim* sim, uint32_t with);
/* dL/dx and dL/dv of a loss of the present state, n = 3 n_vertices; either may be NULL. */
NMP_API nmp_status nmp_grad_add_loss(nmp_sim* sim, const double* dL_dx, const double* dL_dv,
                                     size_t n);
NMP_API nmp_status nmp_grad_backward(nmp_sim* sim);

typedef enum nmp_gradient NMP_INT_ENUM {
  NMP_GRAD_X0 = 0, /* n = 3 n_vertices, as V0 */
  NMP_GRAD_V0 = 1,
  NMP_GRAD_FORCE = 2,    /* in the external forces during call `frame` of nmp_sim_step(sim, 1) */
  NMP_GRAD_MATERIAL = 3, /* n = NMP_N_MATERIAL */
  NMP_GRAD_WEIGHTS = 4   /* n = n_weights */
} nmp_gradient;
/* Places in NMP_GRAD_MATERIAL: derivatives in the numbers of nmp_sim_desc. Those that the modules
 * do not use are 0; so is that in drag or friction of 0 beside an integrator that is not analytic.
 */
enum nmp_material {
  NMP_MATERIAL_E = 0,
  NMP_MATERIAL_NU = 1,
  NMP_MATERIAL_DENSITY = 2,
  NMP_MATERIAL_FRICTION = 3,
  NMP_MATERIAL_DRAG = 4,
  NMP_MATERIAL_WIND_X = 5,
  NMP_MATERIAL_WIND_Y = 6,
  NMP_MATERIAL_WIND_Z = 7,
  NMP_N_MATERIAL = 8
};
/* After nmp_grad_backward. frame: from 0, of NMP_GRAD_FORCE alone. */
NMP_API nmp_status nmp_grad_get(nmp_sim* sim, nmp_gradient gradient, int32_t frame, double* values,
                                size_t n);
/* Forgets the steps; the simulation goes on from where it is. */
NMP_API nmp_status nmp_grad_end(nmp_sim* sim);

#ifdef __cplusplus
}
#endif

#endif /* NMP_H */
