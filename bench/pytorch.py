#!/usr/bin/python3
"""Times PyTorch against nmp: same sizes, same threads, in turns.

    bench/pytorch.py --nmp build/release/tools/nmp
    bench/pytorch.py --nmp build/release/tools/nmp --meshes meshes --json > pytorch.json

Ratios are PyTorch's time / nmp's, so more is better for nmp: the median over rounds, and their
interquartile range over it. In every round each side runs its repetitions after the other. The
opponents: eager PyTorch as one writes it first (torch.linalg.svd), eager PyTorch with an operator
of its own for the polar decomposition and the singular values, and the products of the MLP alone,
by OpenBLAS (torch.mm) and by oneDNN, without biases, activations or a tape.

Needs Debian's python3-torch and libopenblas0-pthread, and the system's Python.
"""

import argparse
import ctypes
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time


def use_whole_processor():
    """PyTorch 1.13 uses 16 floats at a time only where it is asked to; OpenBLAS does by itself,
    unless the environment keeps it from that. Both look at it when they are loaded."""
    os.environ.pop("OPENBLAS_CORETYPE", None)
    with open("/proc/cpuinfo", encoding="utf-8") as cpus:
        flags = next((line.split() for line in cpus if line.startswith("flags")), [])
    if {"avx512f", "avx512bw", "avx512dq", "avx512vl"} <= set(flags):
        os.environ.setdefault("ATEN_CPU_CAPABILITY", "avx512")


early = argparse.ArgumentParser(add_help=False)
early.add_argument("--threads", type=int, default=1, help="of both (default: 1)")
early.add_argument("--as-installed", action="store_true", help="leave PyTorch's AVX-512 off")
early_options = early.parse_known_args()[0]
if not early_options.as_installed:
    use_whole_processor()
# OpenBLAS has threads of its own, of which torch.set_num_threads() knows nothing.
os.environ["OPENBLAS_NUM_THREADS"] = str(early_options.threads)
try:
    import torch
    import torch.nn.functional as nnf
except ImportError:
    sys.exit("bench/pytorch.py: needs PyTorch: apt-get install python3-torch libopenblas0-pthread")

BATCH = 4096  # elements, where there is no mesh
STEPS = 60
WIDTHS = (13, 80, 96, 9)
E, NU, DENSITY, GRAVITY = 5e5, 0.45, 1000.0, -9.8
MU = E / (2 * (1 + NU))
LAMBDA = E * NU / ((1 + NU) * (1 - 2 * NU))


# ---- the operator: R and Sigma of F = U Sigma V^T, vectorised over the elements


def symmetric_eigen(a):
    """Eigenvalues, descending, and eigenvectors of symmetric 3x3 matrices, without iterating: the
    roots of the cubic by angles, the most separate eigenvector by a cross product, the next one in
    the plane across it, so that equal eigenvalues do no harm.

    a: (a00, a01, a02, a11, a12, a22), N each  ->  N x 3, N x 3 x 3 with eigenvectors as columns
    """
    a00, a01, a02, a11, a12, a22 = a
    tiny = torch.finfo(a00.dtype).tiny

    def cross(u, v):
        return (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])

    def dot(u, v):
        return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]

    def pick(where, u, v):
        return tuple(torch.where(where, x, y) for x, y in zip(u, v))

    def times_a(u):
        return (
            a00 * u[0] + a01 * u[1] + a02 * u[2],
            a01 * u[0] + a11 * u[1] + a12 * u[2],
            a02 * u[0] + a12 * u[1] + a22 * u[2],
        )

    q = (a00 + a11 + a22) / 3
    b00, b11, b22 = a00 - q, a11 - q, a22 - q
    p2 = (b00 * b00 + b11 * b11 + b22 * b22 + 2 * (a01 * a01 + a02 * a02 + a12 * a12)) / 6
    p = torch.sqrt(p2)
    det = (
        b00 * (b11 * b22 - a12 * a12)
        - a01 * (a01 * b22 - a12 * a02)
        + a02 * (a01 * a12 - b11 * a02)
    )
    half = (det / (2 * p2 * p).clamp_min(tiny)).clamp(-1, 1)
    angle = torch.acos(half) / 3
    high = 2 * torch.cos(angle)
    low = 2 * torch.cos(angle + 2 * math.pi / 3)
    middle = -(high + low)

    # The eigenvalue that is far from the others: rows of A - e I span the plane across w.
    up = half >= 0
    e = q + p * torch.where(up, high, low)
    r0, r1, r2 = (a00 - e, a01, a02), (a01, a11 - e, a12), (a02, a12, a22 - e)
    best = cross(r0, r1)
    size = dot(best, best)
    for other in (cross(r0, r2), cross(r1, r2)):
        other_size = dot(other, other)
        larger = other_size > size
        best = pick(larger, other, best)
        size = torch.where(larger, other_size, size)
    known = size > 0
    scale = torch.rsqrt(torch.where(known, size, torch.ones_like(size)))
    zero, one = torch.zeros_like(q), torch.ones_like(q)
    w = pick(known, tuple(c * scale for c in best), (one, zero, zero))

    # A basis of that plane, and the middle eigenvalue's vector in it.
    flat = w[0].abs() > w[1].abs()
    u = pick(flat, (-w[2], zero, w[0]), (zero, w[2], -w[1]))
    scale = torch.rsqrt(dot(u, u))
    u = tuple(c * scale for c in u)
    t = cross(w, u)
    e = q + p * middle
    au, at = times_a(u), times_a(t)
    m00, m01, m11 = dot(u, au) - e, dot(u, at), dot(t, at) - e
    first = m00.abs() > m11.abs()
    c, s = torch.where(first, m01, m11), torch.where(first, -m00, -m01)
    length = c * c + s * s
    known = length > 0
    scale = torch.rsqrt(torch.where(known, length, one))
    c, s = torch.where(known, c * scale, one), torch.where(known, s * scale, zero)
    y = tuple(c * u[i] + s * t[i] for i in range(3))
    z = cross(w, y)
    top, bottom = pick(up, w, z), pick(up, z, w)
    values = q.unsqueeze(1) + p.unsqueeze(1) * torch.stack((high, middle, low), 1)
    vectors = torch.stack((*top, *y, *bottom), 1).view(-1, 3, 3).transpose(1, 2)
    return values, vectors


class PolarAndSigma(torch.autograd.Function):
    """F N x 3 x 3  ->  R N x 3 x 3, Sigma N x 3, the last one with the sign of det F. Adjoint, with
    A = U^T R_bar V: F_bar = U (diag(Sigma_bar) + W) V^T, W_ij = (A_ij - A_ji) / (s_i + s_j)."""

    @staticmethod
    def forward(ctx, F):
        # In double: C = F^T F squares what float has lost.
        f = F.double()
        C = f.transpose(1, 2) @ f
        values, V = symmetric_eigen(
            (C[:, 0, 0], C[:, 0, 1], C[:, 0, 2], C[:, 1, 1], C[:, 1, 2], C[:, 2, 2])
        )
        sigma = values.clamp_min(1e-24).sqrt()
        sigma = torch.cat((sigma[:, :2], sigma[:, 2:] * torch.sign(determinant(f))), 1)
        U = f @ V / sigma.unsqueeze(1)
        R = U @ V.transpose(1, 2)
        U, V, sigma = U.to(F.dtype), V.to(F.dtype), sigma.to(F.dtype)
        ctx.save_for_backward(U, V, sigma)
        return R.to(F.dtype), sigma

    @staticmethod
    def backward(ctx, R_bar, sigma_bar):
        U, V, sigma = ctx.saved_tensors
        A = U.transpose(1, 2) @ R_bar @ V
        W = (A - A.transpose(1, 2)) / (sigma.unsqueeze(2) + sigma.unsqueeze(1))
        W = W + torch.diag_embed(sigma_bar)
        return U @ W @ V.transpose(1, 2)


def determinant(F):
    """N x 1, by hand: torch.linalg.det factorises each matrix."""
    f = F.reshape(-1, 9).unbind(1)
    return (
        f[0] * (f[4] * f[8] - f[5] * f[7])
        - f[1] * (f[3] * f[8] - f[5] * f[6])
        + f[2] * (f[3] * f[7] - f[4] * f[6])
    ).unsqueeze(1)


def naive_polar_and_sigma(F):
    U, sigma, Vh = torch.linalg.svd(F)
    return U @ Vh, sigma


# ---- the two modules


class StressNet:
    """P = scale R sym(mlp(Sigma - 1, F^T F - I, det F - 1)): nmp's f_theta, with the weights that
    nmp bench gives it, a linear elastic law."""

    def __init__(self, polar, dtype=torch.float32):
        self.polar = polar
        torch.manual_seed(1)
        self.weights = []
        for n_in, n_out in zip(WIDTHS, WIDTHS[1:]):
            a = math.sqrt(6 / (n_in + n_out))
            self.weights.append(torch.empty(n_out, n_in, dtype=dtype).uniform_(-a, a))
        small = 1e-2
        self.weights[0][:9] = 0
        self.weights[1][:9] = 0
        self.weights[2].zero_()
        for i in range(9):
            self.weights[0][i, 3 + i] = small
            if i % 4 == 0:
                for diagonal in (0, 4, 8):
                    self.weights[0][i, 3 + diagonal] += small * LAMBDA / (2 * MU)
            self.weights[1][i, i] = 1
            self.weights[2][i, i] = 4 / small
        for weight in self.weights:
            weight.requires_grad_()
        self.identity = torch.eye(3, dtype=dtype)

    def parameters(self):
        return self.weights

    def mlp(self, z):
        y = nnf.silu(nnf.linear(z, self.weights[0]))
        y = nnf.silu(nnf.linear(y, self.weights[1]))
        y = nnf.linear(y, self.weights[2]).view(-1, 3, 3)
        return 0.5 * (y + y.transpose(1, 2))

    def __call__(self, F):
        R, sigma = self.polar(F)
        C = F.transpose(1, 2) @ F - self.identity
        z = torch.cat((sigma - 1, C.reshape(-1, 9), determinant(F) - 1), 1)
        return MU * (R @ self.mlp(z))


def linear(n_in, n_out, zero=False):
    layer = torch.nn.Linear(n_in, n_out)
    if zero:
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    return layer


class IntegrationNet(torch.nn.Module):
    """a = alpha f/V + b + scale_a net, net with the T-Net of nmp's g_phi, of the same widths."""

    scale_x, scale_v, scale_f, scale_a = 0.5, 3.0, 1e5, 1e3

    def __init__(self):
        super().__init__()
        self.alpha = torch.nn.Parameter(torch.tensor(1 / DENSITY))
        self.b = torch.nn.Parameter(torch.tensor([0, 0, GRAVITY]))
        silu = torch.nn.SiLU
        self.encoder = torch.nn.Sequential(linear(3, 64), silu(), linear(64, 128), silu())
        self.head = torch.nn.Sequential(linear(128, 64), silu(), linear(64, 9, zero=True))
        self.embeddings = torch.nn.ModuleList(linear(3, 32) for _ in range(4))
        self.mlp = torch.nn.Sequential(
            linear(140, 64), silu(), linear(64, 64), silu(), linear(64, 3, zero=True)
        )
        self.register_buffer("identity", torch.eye(3))

    def forward(self, x, v, force):
        centred = (x - x.mean(0)) / self.scale_x
        T = self.head(self.encoder(centred).amax(0)).view(3, 3) + self.identity
        height = torch.cat((centred[:, :2], x[:, 2:] / self.scale_x), 1)
        inputs = (centred @ T.t(), height, v / self.scale_v, force / self.scale_f)
        embedded = [nnf.silu(embed(each)) for embed, each in zip(self.embeddings, inputs)]
        net = self.mlp(torch.cat((*embedded, *inputs), 1))
        return self.alpha * force + self.b + self.scale_a * net


class Simulation:
    """The step of Alg. 1 and the loss of nmp's joint stage, over tetrahedra of a body at rest."""

    def __init__(self, vertices, tets, h, polar):
        X = torch.tensor(vertices, dtype=torch.float64)
        tets = torch.tensor(tets)
        corners = X[tets]
        inverse = torch.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(1, 2))
        grad_N = torch.cat((-inverse.sum(1, keepdim=True), inverse), 1)  # #T x 4 x 3
        volumes = 1 / (6 * torch.linalg.det(inverse))
        if not bool((volumes > 0).all()):
            sys.exit("bench/pytorch.py: a tetrahedron is inside out")
        self.tets = tets
        self.index = tets.reshape(-1)
        vertex_volumes = torch.zeros(len(X), dtype=torch.float64)
        vertex_volumes.index_add_(0, self.index, (volumes / 4).repeat_interleave(4))
        self.grad_N = grad_N.float()
        self.minus_V_grad_N = (-volumes.view(-1, 1, 1) * grad_N).float()
        self.reciprocal_V = (1 / vertex_volumes).float().unsqueeze(1)
        self.h = h
        self.law = StressNet(polar)
        self.integrator = IntegrationNet()
        edge = (corners[:, 1] - corners[:, 0]).norm(dim=1).mean()
        self.x, self.v = falling(X, float(edge))
        self.optimiser = torch.optim.Adam(
            [*self.law.parameters(), *self.integrator.parameters()], lr=1e-6
        )

    def deformation_gradient(self, x):
        corners = x.index_select(0, self.index).view(-1, 4, 3)
        return corners.transpose(1, 2) @ self.grad_N

    def internal_force(self, F):
        forces = self.minus_V_grad_N @ self.law(F).transpose(1, 2)  # #T x 4 x 3
        zero = torch.zeros_like(self.x)
        return zero.index_add(0, self.index, forces.reshape(-1, 3))

    def step(self, x, v):
        F = self.deformation_gradient(x)
        f = self.internal_force(F)
        dv = self.h * self.integrator(x, v, f * self.reciprocal_V)
        n = len(x)
        loss = 1e-6 / n * f.square().sum() + (x - self.x).square().sum() / n
        loss = loss + (v + 0.5 * dv - self.v).square().sum() / n
        hinge = ((determinant(F) - 1).abs() - 0.05).clamp_min(0)
        loss = loss + 0.1 * hinge.square().mean()
        v = v + dv
        x = x + self.h * v
        below = x[:, 2:] < 0
        v = torch.cat((v[:, :2], torch.where(below, v[:, 2:].clamp_min(0), v[:, 2:])), 1)
        x = torch.cat((x[:, :2], x[:, 2:].clamp_min(0)), 1)
        return x, v, loss

    def loss(self, n_steps):
        x, v, loss = self.x, self.v, 0
        for _ in range(n_steps):
            x, v, term = self.step(x, v)
            loss = loss + term
        return loss

    def training_iteration(self):
        self.optimiser.zero_grad()
        loss = self.loss(STEPS)
        loss.backward()
        self.optimiser.step()
        return loss


def falling(X, edge):
    """The start of nmp bench: stretched, turned, shaken by a hundredth of an edge."""
    generator = torch.Generator().manual_seed(1)
    axis = torch.tensor([1.0, 2, 3], dtype=torch.float64)
    axis /= axis.norm()
    K = torch.linalg.cross(axis.expand(3, 3), torch.eye(3, dtype=torch.float64)).t()
    turn = torch.eye(3, dtype=torch.float64) + math.sin(0.7) * K + (1 - math.cos(0.7)) * K @ K
    stretch = torch.tensor([1.05, 0.97, 1.01], dtype=torch.float64)
    x = X * stretch @ turn.t()
    x = x + 0.01 * edge * torch.randn(x.shape, generator=generator, dtype=torch.float64)
    x[:, 2] += 0.05 - x[:, 2].min()
    v = torch.tensor([0.5, 0.2, -1]).repeat(len(x), 1)
    return x.float(), v


def cube(n):
    """nmp's regular cube: vertices, tets."""
    vertices = [
        (i / (n - 1) - 0.5, j / (n - 1) - 0.5, k / (n - 1) - 0.5)
        for k in range(n)
        for j in range(n)
        for i in range(n)
    ]
    tets = []
    for k in range(n - 1):
        for j in range(n - 1):
            for i in range(n - 1):
                parity = (i + j + k) % 2

                def vertex(c):
                    c ^= parity
                    return i + (c & 1) + n * (j + (c >> 1 & 1) + n * (k + (c >> 2)))

                for tet in ((0, 3, 6, 5), (1, 0, 5, 3), (2, 3, 6, 0), (4, 0, 6, 5), (7, 3, 5, 6)):
                    a, b, c, d = (vertex(t) for t in tet)
                    tets.append((a, b, d, c) if parity else (a, b, c, d))
    return vertices, tets


def read_tetgen(stem):
    def lines(name):
        with open(name, encoding="ascii") as file:
            words = [line.split("#")[0].split() for line in file]
        return [w for w in words if w][1:]

    vertices = [tuple(float(x) for x in w[1:4]) for w in lines(stem + ".node")]
    first = int(lines(stem + ".node")[0][0])
    tets = [tuple(int(i) - first for i in w[1:5]) for w in lines(stem + ".ele")]
    return vertices, tets


# ---- what is known of the code above must hold before anything is timed


def check(condition, what):
    if not condition:
        sys.exit("bench/pytorch.py: a check failed: " + what)


def rough_F(n, dtype=torch.float32):
    generator = torch.Generator().manual_seed(2)
    F = torch.eye(3, dtype=torch.float64) + 0.3 * torch.randn(
        (n, 3, 3), generator=generator, dtype=torch.float64
    )
    usual = torch.eye(3, dtype=torch.float64) * 1.1
    return torch.where((determinant(F) < 0.1).unsqueeze(2), usual, F).to(dtype)


def checks():
    op = PolarAndSigma.apply
    F = rough_F(512, torch.float64)
    F[0] = torch.eye(3)
    F[1] = torch.diag(torch.tensor([1.3, 1.3, 0.6]))
    F[2] = torch.diag(torch.tensor([1.2, 0.7, 0.7]))
    R, sigma = op(F)
    R_svd, sigma_svd = naive_polar_and_sigma(F)
    # Where eigenvalues are equal an angle keeps half of the digits; R does not feel that.
    error = float((sigma - sigma_svd).abs().max())
    check(error < 1e-7, f"singular values, against torch.linalg.svd, {error}")
    check(float((R - R_svd).abs().max()) < 1e-7, "rotations, against torch.linalg.svd")
    generic = F[3:9].clone().requires_grad_()
    check(torch.autograd.gradcheck(op, (generic,)), "adjoint, against central differences")
    law = StressNet(op, torch.float64)
    P = law(F)
    check(float(P[0].abs().max()) < 1e-9 * MU, "no stress at rest")
    Q = naive_polar_and_sigma(rough_F(1, torch.float64))[0]
    check(float((law(Q @ F) - Q @ P).norm() / P.norm()) < 1e-6, "P(Q F) = Q P(F)")
    for polar in (op, naive_polar_and_sigma):
        single = StressNet(polar)
        for weight, exact in zip(single.weights, law.weights):
            weight.data.copy_(exact.data)
        error = float((single(F.float()).double() - P).norm() / P.norm())
        check(error < 1e-4, f"float against double, {error}")


# ---- times


def seconds(work, repetitions):
    times = []
    for _ in range(repetitions):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def gemm_chain(weights, z, backward):
    """The products of the MLP, forward and, if asked for, of its adjoint, into memory that is there
    already."""
    transposed = [w.detach().t() for w in weights]
    plain = [w.detach() for w in weights]
    values = [z] + [torch.empty(len(z), w.shape[0]) for w in plain]
    bars = [torch.ones_like(v) for v in values]
    weight_bars = [torch.empty_like(w) for w in plain]

    def run():
        for k in range(3):
            torch.mm(values[k], transposed[k], out=values[k + 1])
        if backward:
            for k in reversed(range(3)):
                torch.mm(bars[k + 1].t(), values[k], out=weight_bars[k])
                torch.mm(bars[k + 1], plain[k], out=bars[k])

    return run


def onednn_chain(weights, z):
    """Inner products of oneDNN on tensors in its own layout, forward; None if there are none."""
    try:
        layers = [w.detach().to_mkldnn() for w in weights]
        x = z.to_mkldnn()

        def run():
            y = x
            for layer in layers:
                y = torch._C._nn.mkldnn_linear(y, layer)
            return y

        run()
        return run
    except (AttributeError, RuntimeError):
        return None


def opponents(simulations):
    """(name, nmp's time, good, great, work): goals are those of the project, where it has some."""
    naive, custom = simulations["naive"], simulations["custom"]
    generator = torch.Generator().manual_seed(3)
    z = 0.2 * torch.randn((BATCH, WIDTHS[0]), generator=generator)
    F, y_bar = rough_F(BATCH), torch.ones(BATCH, 3, 3)

    def gradient(law, f, at):
        def run():
            for weight in law.parameters():
                weight.grad = None
            f(at.detach().requires_grad_()).backward(y_bar)

        return run

    def forward():
        with torch.inference_mode():
            custom.law.mlp(z)

    weights = custom.law.weights
    rows = [
        ("stress MLP forward: eager", "stress_mlp_forward", None, None, forward),
        (
            "stress MLP forward: products alone, torch.mm",
            "stress_mlp_forward",
            None,
            None,
            gemm_chain(weights, z, backward=False),
        ),
        (
            "stress MLP forward: products alone, oneDNN",
            "stress_mlp_forward",
            None,
            None,
            onednn_chain(weights, z),
        ),
        (
            "stress MLP forward and backward: eager",
            "stress_mlp_gradient",
            2.0,
            3.5,
            gradient(custom.law, custom.law.mlp, z),
        ),
        (
            "stress MLP forward and backward: products alone, torch.mm",
            "stress_mlp_gradient",
            None,
            None,
            gemm_chain(weights, z, backward=True),
        ),
        (
            "stress module forward and backward: torch.linalg.svd",
            "stress_module_gradient",
            None,
            None,
            gradient(naive.law, naive.law, F),
        ),
        (
            "stress module forward and backward: own polar operator",
            "stress_module_gradient",
            None,
            None,
            gradient(custom.law, custom.law, F),
        ),
        (
            "training iteration of 60 steps: torch.linalg.svd",
            "training_iteration",
            6.0,
            15.0,
            naive.training_iteration,
        ),
        (
            "training iteration of 60 steps: own polar operator",
            "training_iteration",
            None,
            None,
            custom.training_iteration,
        ),
    ]
    return [row for row in rows if row[4]]


def run_nmp(options, arguments):
    command = [options.nmp, "bench", "--json", "--threads", str(options.threads), *arguments]
    if options.meshes:
        command += ["--meshes", options.meshes]
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, check=False)
    except OSError as error:
        sys.exit(f"bench/pytorch.py: {options.nmp}: {error.strerror}")
    if done.returncode:
        sys.exit(f"bench/pytorch.py: {' '.join(command)}: exit code {done.returncode}")
    return json.loads(done.stdout)


def nmp_seconds(options):
    names = ["stress_mlp_forward", "stress_mlp_gradient"]
    names += ["stress_module_gradient", "training_iteration"]
    arguments = ["--seconds", "0", "--repetitions", str(options.repetitions)]
    for name in names:
        arguments += ["--only", name]
    document = run_nmp(options, arguments)
    return document, {each["name"]: each["seconds"] for each in document["times"]}


def loaded_blas():
    with open("/proc/self/maps", encoding="utf-8") as maps:
        paths = {line.split()[-1] for line in maps if "blas" in line}
    return sorted({os.path.basename(os.path.realpath(path)) for path in paths})


def openblas(function, result):
    """What OpenBLAS says of itself."""
    try:
        call = getattr(ctypes.CDLL("libopenblas.so.0"), function)
    except (OSError, AttributeError):
        return None
    call.restype = result
    return call()


def facts(options, document):
    shown = [line.strip(" -") for line in torch.__config__.show().split("\n")]
    config = dict(line.split(": ", 1) for line in shown if ": " in line)
    return {
        "torch": torch.__version__,
        "cpu_capability": config.get("CPU capability usage", "?"),
        "blas": loaded_blas(),
        "openblas_core": (openblas("openblas_get_corename", ctypes.c_char_p) or b"?").decode(),
        "openblas_threads": openblas("openblas_get_num_threads", ctypes.c_int),
        "onednn": next((line for line in shown if "MKL-DNN" in line), "none"),
        "torch_threads": torch.get_num_threads(),
        "nmp_threads": document["threads"],
        "nmp_build_simd_bits": document["build_simd_bits"],
        "body": document["body"],
    }


def simulate(options, document):
    body = document["body"]
    if body["name"] == "cube":
        vertices, tets = cube(round(body["n_vertices"] ** (1 / 3)))
    else:
        with tempfile.TemporaryDirectory() as folder:
            stem = os.path.join(folder, "body")
            mesh = os.path.join(options.meshes, "bob.msh")
            subprocess.run(
                [options.nmp, "mesh", "convert", mesh, stem + ".node", "--up", "y", "--fix"],
                stdout=subprocess.DEVNULL,
                check=True,
            )
            vertices, tets = read_tetgen(stem)
    check(len(vertices) == body["n_vertices"] and len(tets) == body["n_tets"], "the same body")
    return {
        "naive": Simulation(vertices, tets, body["h"], naive_polar_and_sigma),
        "custom": Simulation(vertices, tets, body["h"], PolarAndSigma.apply),
    }


def quartiles(samples):
    if len(samples) < 2:
        return samples[0], 0.0
    low, median, high = statistics.quantiles(samples, n=4, method="inclusive")
    return median, (high - low) / median


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0], parents=[early])
    parser.add_argument("--nmp", required=True, help="the program nmp, built for this machine")
    parser.add_argument("--rounds", type=int, default=15, help="of turns (default: 15)")
    parser.add_argument("--repetitions", type=int, default=3, help="in a round (default: 3)")
    parser.add_argument("--meshes", default=os.environ.get("NMP_MESHES"), help="folder of bob.msh")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    checks()
    document, _ = nmp_seconds(options)
    known = facts(options, document)
    if not any("openblas" in name for name in known["blas"]):
        print(
            "warning: PyTorch has no OpenBLAS here (apt-get install libopenblas0-pthread): "
            "its products run on a reference BLAS, and no ratio below is fair",
            file=sys.stderr,
        )
    simulations = simulate(options, document)
    losses = {}
    for name, simulation in simulations.items():
        losses[name] = float(simulation.loss(STEPS))
        simulation.training_iteration()
        known["gradient_finite_" + name] = all(
            bool(torch.isfinite(p.grad).all()) for p in simulation.law.parameters()
        )
    relative = abs(losses["naive"] - losses["custom"]) / losses["custom"]
    check(relative < 1e-3, f"both polar operators give one loss, {losses}")
    rows = opponents(simulations)
    for row in rows:
        row[4]()
    ratios = [[] for _ in rows]
    torch_seconds = [[] for _ in rows]
    for turn in range(options.rounds):
        print(f"round {turn + 1} of {options.rounds}", file=sys.stderr)
        _, ours = nmp_seconds(options)
        for k, (_, time_name, _, _, work) in enumerate(rows):
            taken = seconds(work, options.repetitions)
            torch_seconds[k].append(taken)
            ratios[k].append(taken / ours[time_name])

    result = []
    for (name, time_name, good, great, _), samples, taken in zip(rows, ratios, torch_seconds):
        value, spread = quartiles(samples)
        verdict = None
        if good is not None:
            verdict = "great" if value >= great else "good" if value >= good else "short"
        result.append(
            {
                "name": name,
                "value": value,
                "spread": spread,
                "good": good,
                "great": great,
                "verdict": verdict,
                "torch_seconds": statistics.median(taken),
                "nmp_time": time_name,
            }
        )
    if options.json:
        print(json.dumps({"rows": result, **known}, indent=1))
        return
    for key, value in known.items():
        print(f"{key}: {value}")
    width = max(len(row["name"]) for row in result)
    print(f"\n{'PyTorch / nmp':{width}}   ratio  spread    torch [ms]  goal")
    for row in result:
        goal = f"{row['good']:g}, {row['great']:g}: {row['verdict']}" if row["verdict"] else ""
        print(
            f"{row['name']:{width}}  {row['value']:6.2f}  {100 * row['spread']:4.1f} %"
            f"  {1e3 * row['torch_seconds']:12.2f}  {goal}"
        )


if __name__ == "__main__":
    main()
