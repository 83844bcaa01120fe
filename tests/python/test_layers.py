"""Stiffness matrices with memory: ordinary equations, dense matrices, elements."""

import numpy as np
import pytest
import scipy.sparse as sp
import viscovib as vv
from referee.integration import solve_ivp

PRONY = vv.PronyKernel(weights=[0.2, 0.05], rates=[1.0, 0.2])
FRACTIONAL = vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=0.8)
N = 6


def parts(seed: int = 1, rank: int = 3):
    """K, a layer of low rank, and C with coupled modes."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(N, N)), rng.normal(size=(N, rank))
    return a @ a.T + np.eye(N), b @ b.T, 0.05 * np.diag(rng.uniform(0.5, 2, N))


def body(kernel=PRONY, law="0.7*d^3", *, cut=False, **more):
    """A body with a layer; ``cut``: as elements along its eigenvectors."""
    k, layer, c = parts()
    elements = [vv.Spring(on="x3", law=law)]
    if cut:
        sizes, vectors = np.linalg.eigh(layer)
        elements += [
            vv.Spring(on=vectors[:, j], stiffness=sizes[j], kernel=kernel)
            for j in np.flatnonzero(sizes > 1e-9)
        ]
    else:
        more["layers"] = [(layer, kernel)]
    return vv.Structure(mass=np.ones(N), stiffness=k, damping=c, elements=elements, **more)


def ordinary(push, held):
    """Ordinary equations with memory states, and their initial values."""
    k, layer, c = parts()
    w, r = PRONY.weights[:, None], PRONY.rates[:, None]

    def right(t, y):
        u, v, z = y[:N], y[N : 2 * N], y[2 * N :].reshape(2, N)
        force = push(t) - c @ v - k @ u - layer @ (u - z.sum(axis=0))
        force[2] -= 0.7 * u[2] ** 3
        return np.concatenate([v, force, (w * u - r * z).ravel()])

    return right, (w / r * held).ravel()


@pytest.mark.parametrize("held", [False, True])
def test_motion_as_ordinary_equations(held):
    rng = np.random.default_rng(3)
    start = rng.normal(size=2 * N)
    given = {"load": {"x1": 1.0}, "nu": 1.3, "tolerance": 1e-12}
    past = start[::2] if held else np.zeros(N)
    run = vv.simulate(
        body(), 12, initial=start, held=past if held else None,
        force=vv.LoadTable(times=[0, 2, 5], values=[0, 0.7, 0], on="x2"), **given,
    )  # fmt: skip

    def push(t):
        total = np.zeros(N)
        total[0], total[1] = np.sin(1.3 * t), np.interp(t, [0, 2, 5], [0, 0.7, 0])
        return total

    right, y = ordinary(push, past)
    y = np.concatenate([start[::2], start[1::2], y])
    for begin, end in ((0, 2), (2, 5), (5, 12)):
        found = solve_ivp(right, (begin, end), y, method="DOP853", rtol=2.3e-14, atol=1e-14)
        y = found.y[:, -1]
    assert np.abs(run.state[-1, ::2] - y[:N]).max() < 2e-12
    assert np.abs(run.state[-1, 1::2] - y[N : 2 * N]).max() < 6e-12
    assert run.error < 1e-11


def test_any_past_and_going_on():
    rng = np.random.default_rng(4)
    past = vv.Past(times=[-3, -1.2, -1, 0], displacements=rng.normal(size=(4, N)))
    given = {"held": past, "tolerance": 1e-11, "load": {"x1": 1.0}, "nu": 1.3}
    whole = vv.simulate(body(), 10, **given)
    other = vv.simulate(body(cut=True), 10, **given)
    assert np.abs(whole.state[-1] - other.state[-1]).max() < 1e-11
    steps = {"held": past, "dt": 0.05, "load": {"x1": 1.0}, "nu": 1.3}
    system = body()
    half = vv.simulate(system, 5, **steps)
    once, twice = vv.simulate(system, 10, **steps), vv.simulate(system, 10, resume=half)
    assert (once.state[-1] == twice.state[-1]).all()


@pytest.mark.parametrize("kernel", [PRONY, FRACTIONAL, vv.SumKernel(parts=[PRONY, PRONY])])
def test_periodic_motions_as_with_elements(kernel):
    """Also their stability: memory of the layer against memory of elements."""
    nu = np.linspace(0.3, 3, 8)
    given = {"load": {"x1": 3.0}, "method": "newton", "harmonics": 31, "stability": True}
    a, b = (vv.forced_response(body(kernel, cut=cut), nu, **given) for cut in (False, True))
    assert a.complete
    assert np.abs(a.coefficients - b.coefficients).max() < 1e-11
    assert (a.stable == b.stable).all()


def test_settles_on_the_periodic_motion():
    run = vv.simulate(body(), 120 * 2 * np.pi / 1.3, load={"x1": 1.0}, nu=1.3, tolerance=1e-11)
    found = vv.forced_response(
        body(), [1.3], load={"x1": 1.0}, method="newton", harmonics=19
    )  # fmt: skip
    assert np.abs(run.state[-1, ::2] - found.coefficients[0].imag.sum(axis=1)).max() < 1e-9


@pytest.mark.parametrize("case", ["proportional", "free", "gyroscopic", "massless"])
def test_linear_response_as_by_matrices(case):
    n = 24
    cuts = np.diff(np.eye(n), axis=0)
    chain, layer = cuts.T @ cuts, cuts[:9].T @ cuts[:9]
    mass, c, k = np.diag(1 + np.arange(n) / n), np.zeros((n, n)), 0.5 * chain
    more = vv.PronyKernel(weights=[2.0], rates=[7.0])
    layers = [(layer, PRONY), (layer @ layer, more)]
    if case == "proportional":
        mass, layers = np.eye(n), [(chain, PRONY), (0.5 * chain, more)]
    elif case == "gyroscopic":
        k, c = k + np.eye(n), 0.1 * (np.eye(n, k=1) - np.eye(n, k=-1))
    elif case == "massless":
        k, mass = k + np.eye(n), np.diag((np.arange(n) % 3 != 1).astype(float))
    body = vv.Structure(mass=mass, stiffness=k, damping=c, layers=layers)
    load = np.zeros(n)
    load[1] = 1.0
    nu = np.array([0.11, 0.4, 1.3, 2.2])
    names = list(body.dof_names)
    found = vv.forced_response(body, nu, load=load, method="linear", coordinates=names)
    for i, s in enumerate(1j * nu):
        full = s**2 * mass + s * c + k
        full = full + sum(m * (1 - kernel.laplace(s)) for m, kernel in layers)
        u = np.linalg.solve(full, load)
        assert np.abs(found.coefficients[i, :, 0] - u).max() < 1e-11 * np.abs(u).max()


def test_free_bodies_move_on():
    """A rigid-body mode without resistance is not affected by the layer."""
    n, end = 5, 9.0
    cuts = np.diff(np.eye(n), axis=0)
    body = vv.Structure(
        mass=np.ones(n), stiffness=0 * np.eye(n), layers=[(cuts.T @ cuts, PRONY)],
    )  # fmt: skip
    start = np.zeros(2 * n)
    start[1] = 1.0
    run = vv.simulate(body, end, initial=start, tolerance=1e-12)
    assert abs(run.state[-1, ::2].sum() - end) < 1e-12 * end
    assert abs(run.state[-1, 1::2].sum() - 1) < 1e-12


def test_sparse_layers_are_reduced():
    n = 2000
    k = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsc()
    big = vv.Structure(
        mass=sp.eye_array(n), stiffness=0.5 * k, layers=[(0.5 * k, PRONY)], rayleigh=(0.0, 0.01),
        elements=[vv.Spring(on="x2000", law="0.5*d^3")],
    )  # fmt: skip
    small = big.reduce(frequency=0.04, loads=["x1"])
    assert small.reduction.largest_error < 1e-6
    nu, load = np.array([0.006, 0.022]), np.eye(n)[0] * 1e-3
    found = vv.forced_response(small, nu, load=load, method="linear", coordinates=["x1", "x40"])
    for i, s in enumerate(1j * nu):
        full = sp.csc_array(s**2 * sp.eye_array(n) + (0.5 + 0.01 * s) * k)
        full = full + 0.5 * (1 - PRONY.laplace(s)) * k
        u = sp.linalg.spsolve(full, load.astype(complex))[[0, 39]]
        assert np.abs(found.coefficients[i, :, 0] / u - 1).max() < 1e-6
    run = vv.simulate(small, 400, load=load, nu=0.01, tolerance=1e-8, coordinates=["x1"])
    assert run.error < 1e-8
    again = big.characteristic_roots(2).oscillatory
    rest = small._rest.poles
    for s in again:
        assert np.abs(rest / s - 1).min() < 1e-6


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        ("x", "must be a list of"),
        ([(np.eye(3), PRONY)], r"layers\[0\]\[0\]"),
        ([(np.eye(N), "rubber")], r"layers\[0\]\[1\]"),
        ([np.eye(N)], r"layers\[0\] = "),
        ([(np.eye(N) + np.eye(N, k=1), FRACTIONAL)], "must be symmetric"),
    ],
)
def test_bad_layers(layers, words):
    with pytest.raises(vv.InputError, match=words):
        vv.Structure(mass=np.ones(N), stiffness=np.eye(N), layers=layers)


def test_what_layers_do_not_have():
    with pytest.raises(vv.InputError, match="loss_factor: must be 0 with layers"):
        vv.forced_response(body(loss_factor=0.1), [1.0], load={"x1": 1.0})
    big = np.eye(80)
    with pytest.raises(vv.InputError, match="acts in 80 directions"):
        vv.Structure(mass=np.ones(80), stiffness=big, layers=[(big, FRACTIONAL)])
    slow = vv.PronyKernel(weights=[0.2], rates=[0.0])
    with pytest.warns(vv.StabilityWarning):
        creeping = body(slow)
    with (
        pytest.warns(vv.StabilityWarning),
        pytest.raises(vv.InputError, match="held: must be None, because a kernel has no"),
    ):
        vv.simulate(creeping, 1.0, held=np.ones(N))
