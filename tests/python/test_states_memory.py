"""Elements with internal states and Prony kernels: motions and multipliers by SciPy."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def drawn(seed):
    """An element of each kind in turn, z' and its force by d, v and z, and other parameters."""
    rng = np.random.default_rng(seed)
    n = {
        "k": rng.uniform(0.8, 2), "c": rng.uniform(0.15, 0.4), "memory": rng.uniform(0.5, 1.5),
        "weight": rng.uniform(0.1, 0.5), "rate": rng.uniform(0.6, 2.0),
        "load": rng.uniform(0.8, 2), "nu": rng.uniform(0.6, 1.8),
    }  # fmt: skip
    s, f = rng.uniform(0.5, 2, 2), rng.uniform(0.1, 0.5, 2)

    def slider(v, z, s, f):
        return np.where(z * np.sign(v) < f, s * v, 0.0)

    match seed % 4:
        case 0:
            element = vv.Jenkins(on="x1", stiffness=s[0], limit=f[0])
            return n, element, lambda v, z: slider(v, z, s[:1], f[:1]), lambda d, z: z[0]
        case 1:
            element = vv.Iwan(on="x1", stiffness=s, limit=f)
            return n, element, lambda v, z: slider(v, z, s, f), lambda d, z: z.sum()
        case 2:
            element = vv.Dahl(on="x1", stiffness=s[0], limit=f[0])
            return (
                n, element, lambda v, z: s[0] * (1 - z / f[0] * np.sign(v)) * v, lambda d, z: z[0]
            )  # fmt: skip
    b, a = rng.uniform(1, 3), rng.uniform(0, 0.5)
    g = rng.uniform(-0.5, 1) * b
    element = vv.BoucWen(on="x1", stiffness=s[0], ratio=a, beta=b, gamma=g)
    return (
        n, element, lambda v, z: (1 - (g + b * np.sign(z * v)) * np.abs(z)) * v,
        lambda d, z: a * s[0] * d + (1 - a) * s[0] * z[0],
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_steady_motions(seed):
    n, element, rates, force = drawn(seed)
    kernel = vv.PronyKernel(weights=[n["weight"]], rates=[n["rate"]])
    system = vv.Structure(
        mass=[[1.0]], stiffness=[[n["k"]]], damping=[[n["c"]]],
        elements=[element, vv.Spring(on="x1", stiffness=n["memory"], kernel=kernel)],
    )  # fmt: skip
    n_states = 2 if seed % 4 == 1 else 1

    def slope(t, y):
        x, v, m, z = y[0], y[1], y[2], y[3:]
        pulled = n["k"] * x + n["memory"] * (x - n["weight"] * m) + force(x, z)
        pushed = n["load"] * np.sin(n["nu"] * t)
        return np.concatenate([[v, pushed - n["c"] * v - pulled, x - n["rate"] * m], rates(v, z)])

    period, samples = 2 * np.pi / n["nu"], 64
    late = period * (25 + np.arange(samples) / samples)
    run = solve_ivp(
        slope, (0, late[-1]), np.zeros(3 + n_states), method="RK45", rtol=1e-7, atol=1e-9,
        max_step=period / 60, t_eval=late,
    )  # fmt: skip
    found = vv.forced_response(
        system, [n["nu"]], load=[n["load"]], method="newton", harmonics=41, stability=True
    )
    assert found.converged.all()
    waves = np.exp(2j * np.pi * np.outer(found.harmonics, np.arange(samples) / samples))
    x = (found.coefficients[0, 0] @ waves).imag
    size = np.abs(x - x.mean()).max()
    # Sliders settle with offsets that depend on the past: motions about the mean agree.
    np.testing.assert_allclose(x - x.mean(), run.y[0] - run.y[0].mean(), atol=2e-5 * size)
    if seed % 4 < 2:
        return
    # For smooth states also the perturbations after a period.
    columns = []
    for j in range(run.y.shape[0]):
        ends = []
        for nearby in (1e-5, -1e-5):
            begun = run.y[:, 0].copy()
            begun[j] += nearby
            end = solve_ivp(
                slope, (late[0], late[0] + period), begun, method="DOP853", rtol=1e-10,
                atol=1e-12, max_step=period / 60,
            )  # fmt: skip
            ends.append(end.y[:, -1])
        columns.append((ends[0] - ends[1]) / 2e-5)
    expected = np.sort(np.abs(np.linalg.eigvals(np.array(columns).T)))[::-1]
    multipliers = np.sort(np.abs(found.multipliers[0]))[::-1][: expected.size]
    np.testing.assert_allclose(multipliers, expected, atol=5e-5)


def test_in_time_the_reason_is_reported():
    """With a table of points both are refused in time: the message names the alternative."""
    kernel = vv.TabulatedKernel(times=[0, 1, 2], values=[0.3, 0.1, 0.05])
    system = vv.Structure(
        mass=[1], stiffness=[[1]], damping=[[0.1]],
        elements=[
            vv.Jenkins(on="x1", stiffness=2, limit=0.3),
            vv.Spring(on="x1", stiffness=0.5, kernel=kernel),
        ],
    )  # fmt: skip
    with pytest.raises(vv.InputError, match=r"use kernel\.sum_of_exponentials"):
        vv.simulate(system, 10, load=[1.0], nu=0.9)
