#!/usr/bin/env python3
"""libnmp.so from Python through ctypes and NumPy, without a build step.

    nmp_numpy.py libnmp.so body.msh

Drops a body, then asks how its end depends on where it began: the gradient through all steps, checked
against a difference of two simulations.
"""
import ctypes
import sys

import numpy as np

c_double_p = ctypes.POINTER(ctypes.c_double)


class SimDesc(ctypes.Structure):
    """nmp_sim_desc, field by field."""

    _fields_ = (
        [("struct_size", ctypes.c_size_t)]
        + [(name, ctypes.c_int) for name in ("precision", "law", "integrator")]
        + [("h", ctypes.c_double), ("substeps", ctypes.c_int32)]
        + [(name, ctypes.c_double) for name in ("stagger", "E", "nu", "density")]
        + [("gravity", ctypes.c_double * 3), ("drag", ctypes.c_double)]
        + [("wind", ctypes.c_double * 3), ("has_ground", ctypes.c_int32)]
        + [("ground", ctypes.c_double), ("friction", ctypes.c_double)]
        + [("strict", ctypes.c_int32)]
        + [(name, ctypes.c_void_p) for name in
           ("stress_callback", "stress_vjp", "stress_user",
            "integrator_callback", "integrator_vjp", "integrator_user")])


class Library:
    """Calls by name, a status that is not NMP_OK raises its message."""

    def __init__(self, path):
        self._lib = ctypes.CDLL(path)
        self._lib.nmp_last_error.restype = ctypes.c_char_p
        self._lib.nmp_sim_desc_default.restype = SimDesc

    def desc(self, **values):
        desc = self._lib.nmp_sim_desc_default()
        assert desc.struct_size == ctypes.sizeof(SimDesc), "another version of nmp.h"
        for name, value in values.items():
            setattr(desc, name, value)
        return desc

    def __call__(self, name, *arguments):
        if getattr(self._lib, name)(*arguments) != 0:
            raise RuntimeError(self._lib.nmp_last_error().decode(errors="replace"))


def pointer(array):
    """A C-contiguous float64 array and its length, as two arguments."""
    assert array.dtype == np.float64 and array.flags.c_contiguous
    return array.ctypes.data_as(c_double_p), ctypes.c_size_t(array.size)


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    nmp = Library(sys.argv[1])
    mesh, sim = ctypes.c_void_p(), ctypes.c_void_p()
    n_vertices = ctypes.c_size_t()
    nmp("nmp_mesh_load", sys.argv[2].encode(), None, ctypes.byref(mesh))
    nmp("nmp_mesh_counts", mesh, ctypes.byref(n_vertices), None, None)
    rest = np.zeros((n_vertices.value, 3))
    nmp("nmp_mesh_vertices", mesh, *pointer(rest))

    desc = nmp.desc(precision=1, has_ground=1, ground=rest[:, 2].min() - 0.01, h=1e-3, E=1e5)
    nmp("nmp_sim_create", mesh, None, ctypes.byref(desc), ctypes.byref(sim))
    x, v = rest.copy(), np.zeros_like(rest)
    v[:, 0] = 0.5
    direction = np.random.default_rng(1).normal(size=v.shape)
    weight = np.random.default_rng(2).normal(size=v.shape)

    def end(velocity):
        nmp("nmp_sim_set_state", sim, pointer(rest)[0], *pointer(velocity))
        nmp("nmp_sim_step", sim, 100)
        nmp("nmp_sim_get_state", sim, pointer(x)[0], None, ctypes.c_size_t(x.size))
        return np.sum(weight * x)

    difference = (end(v + 1e-5 * direction) - end(v - 1e-5 * direction)) / 2e-5

    nmp("nmp_sim_set_state", sim, pointer(rest)[0], *pointer(v))
    nmp("nmp_grad_begin", sim, 0)
    nmp("nmp_sim_step", sim, 100)
    nmp("nmp_grad_add_loss", sim, pointer(weight)[0], None, ctypes.c_size_t(weight.size))
    nmp("nmp_grad_backward", sim)
    gradient = np.zeros_like(v)
    nmp("nmp_grad_get", sim, 1, 0, *pointer(gradient))
    slope = np.sum(gradient * direction)
    print(f"lowest vertex at {x[:, 2].min():.4f} m; slope {slope:.6g}, by differences {difference:.6g}")
    nmp("nmp_sim_free", sim)
    nmp("nmp_mesh_free", mesh)
    sys.exit(int(abs(slope - difference) > 1e-4 * abs(slope)))


main()
