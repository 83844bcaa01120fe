"""Multiple scales on random systems of two to four modes against harmonic balance."""

import numpy as np
import pytest
import viscovib as vv
from balance_reference import random_system, steady_motion
from referee.balance import Balance, load_rows, multipliers
from referee.integration import solve_ivp
from referee.models import chain

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")

#: Natural frequencies and the resonances among them.
MODES = {
    "none": [1.0, 1.73, 2.93],
    "w2 ~ 2 w1": [1.0, 2.0, 2.7],
    "w2 ~ 3 w1": [1.0, 3.0, 1.75],
    "w2 ~ w1": [1.0, 1.0, 2.6],
    "w3 ~ w1 + w2": [1.0, 1.5, 2.5],
    "four": [1.0, 1.62, 2.37, 3.71],
}


def steady(system, loads, drives, tolerance, values):
    ms = vv.MultipleScales(vv.CubicSystem(**system, load=loads, drives=drives), tolerance=tolerance)
    return ms, ms.response("p1", values)


def errors_and_estimates(system, loads, drives, tolerance, values, highest):
    """Relative errors of the harmonic of p1 and ratios of estimate to error, in range."""
    ms, response = steady(system, loads, drives, tolerance, values)
    assert np.isfinite(response.harmonics).all()
    assert np.isfinite(response.eigenvalues).all()
    found = []
    for i in np.flatnonzero(response.in_range):
        exact = steady_motion(system, ms, response, i, loads, drives, highest)
        if exact is None:
            continue
        error = abs(response.harmonics[i] - exact).max()
        found.append((error / abs(exact).max(), response.error_estimate[i] / error))
    return np.array(found).reshape(-1, 2)


@pytest.mark.parametrize("derivatives", [False, True])
@pytest.mark.parametrize("near", [True, False])
@pytest.mark.parametrize("modes", MODES)
def test_estimate_tends_to_the_error(modes, near, derivatives):
    """Equal to leading order: one load, at the second mode or away from the modes."""
    w = np.array(MODES[modes])
    ratios, force = [], 0.2 if derivatives else 0.6
    for x in (0.06, 0.02):
        rng = np.random.default_rng(len(modes))
        system = random_system(rng, w, 0.02 * x, derivatives=derivatives)
        p = w[1] * (1 + 0.01 * x) if near else 0.71
        loads = rng.normal(size=(w.size, 1)) * (0.02 * x**2 if near else force * x)
        found = errors_and_estimates(system, loads, [p], 0.015, [p], 9)
        kept = found[(found[:, 0] > 1e-11) & (found[:, 0] < 0.1), 1]
        assert kept.size
        ratios.append(abs(kept - 1).max())
    assert ratios[0] < 0.25
    assert ratios[1] < 0.05


def test_random_systems():
    """One or two loads, near modes or not, with and without damping: never far off."""
    ratios, refused = [], 0
    for seed in range(24):
        rng = np.random.default_rng(seed)
        w = np.array(list(MODES.values())[seed % len(MODES)])
        x = 10 ** rng.uniform(-2, -0.8)
        w *= 1 + 0.02 * x * rng.normal(size=w.size)
        system = random_system(
            rng, w, rng.choice([0, 0.01, 0.05]) * x,
            quadratic=rng.uniform() < 0.7, derivatives=rng.uniform() < 0.3,
        )  # fmt: skip
        drives, sizes = [], []
        for k in range(rng.choice([1, 1, 2])):
            near = rng.uniform() < 0.6
            drives.append(w[k] * (1 + 0.03 * x) if near else rng.uniform(0.4, 5))
            sizes.append(0.03 * x**2 if near else 0.3 * x)
        loads = rng.normal(size=(w.size, len(drives))) * sizes
        try:
            found = errors_and_estimates(
                system, loads, drives, 0.012, drives[:1], [7, 4][len(drives) - 1]
            )
        except vv.InputError:
            # Too many resonant modes, or frequencies without a common frame.
            refused += 1
            continue
        ratios.extend(found[(found[:, 0] > 1e-9) & (found[:, 0] < 0.1), 1])
    ratios = np.array(ratios)
    assert ratios.size > 20
    assert refused < 5
    assert ((ratios > 0.4) & (ratios < 2.5)).all()
    assert np.mean((ratios > 0.9) & (ratios < 1.1)) > 0.8


def test_three_loads_at_once():
    """Each load near its mode, with motions of all modes and their products."""
    w = np.array(MODES["none"])
    ratios = []
    for x in (0.06, 0.02):
        rng = np.random.default_rng(8)
        system = random_system(rng, w, 0.3 * x**2)
        loads = np.linalg.inv(np.linalg.eigh(system["stiffness"])[1]).T * 0.3 * x**3
        drives = w * (1 + np.array([0.3, -0.2, 0.4]) * x**2)
        found = errors_and_estimates(system, loads, drives, 0.012, drives[:1], 3)
        ratios.append(abs(found[0, 1] - 1))
    assert ratios[0] < 0.2
    assert ratios[-1] < 0.03


@pytest.mark.parametrize(("modes", "step", "power"), [("none", 2, 1.9), ("w2 ~ 2 w1", 1, 0.9)])
def test_error_falls_as_it_should(modes, step, power):
    """Damping and detuning as amplitude^step, load as their product with the amplitude."""
    w, relative = np.array(MODES[modes]), []
    for k in range(4):
        x = 0.2 * 0.5**k
        rng = np.random.default_rng(3)
        system = random_system(rng, w, 0.1 * x**step)
        p = w[0] * (1 + 0.1 * x**step)
        loads = rng.normal(size=(w.size, 1)) * 0.05 * x ** (step + 1)
        found = errors_and_estimates(system, loads, [p], 0.06, [p], 9)
        relative.append(found[0, 0])
    powers = np.log2(np.array(relative[:-1]) / relative[1:])
    assert powers[-1] > power
    assert powers[-1] < power + 0.6


@pytest.mark.parametrize("damping", [-0.02, 0.0, 0.02])
@pytest.mark.parametrize("modes", ["none", "w2 ~ 2 w1", "w2 ~ w1", "four"])
def test_motions_against_integration(modes, damping):
    """Two loads, one of them near a mode; modes that grow, stay or decay."""
    rng = np.random.default_rng(len(modes))
    w, x = np.array(MODES[modes]), 0.1
    system = random_system(rng, w, damping * x)
    drives = np.array([w[0] * 1.003, 0.55])
    loads = rng.normal(size=(w.size, 2)) * [0.02 * x**2, 0.1 * x]
    initial = 0.3 * x * rng.normal(size=2 * w.size)
    t = np.linspace(0, 40, 121)

    def rhs(t, y):
        q, v = y[::2], y[1::2]
        force = loads @ np.cos(drives * t) - system["damping"] @ v - system["stiffness"] @ q
        force -= np.einsum("ijk,j,k->i", system["quadratic"], q, q)
        force -= np.einsum("ijkl,j,k,l->i", system["cubic"], q, q, q)
        return np.column_stack([v, force]).ravel()

    motion = vv.MultipleScales(
        vv.CubicSystem(**system, load=loads, drives=drives), tolerance=0.015
    ).motion(t, initial)
    run = solve_ivp(rhs, (0, 40), initial, t_eval=t, rtol=1e-10, atol=1e-13, method="DOP853")
    error = abs(motion.state.T - run.y)[::2].max()
    assert motion.in_range.all()
    assert error < 0.02 * abs(run.y[::2]).max()
    assert 0.4 < motion.error_estimate.max() / error < 2.5


def test_stability_that_is_reported_as_sure_is_that_of_floquet():
    """Any loads, large ones far from modes, little damping: some verdicts are undecided."""
    sure, unsure, wrong = 0, 0, []
    for seed in range(30):
        rng = np.random.default_rng([99, seed])
        n = 1 + seed % 2
        damping = float(np.exp(rng.uniform(np.log(2e-4), np.log(2e-2))))
        model = chain(rng, n, damping, cubic=(0.2, 1.0), quadratic=seed % 4 < 2).model()
        nu = float(rng.uniform(0.25, 3.2) * model.frequencies[0])
        size = float(np.exp(rng.uniform(np.log(0.02), np.log(0.5))))
        names = {"np": np, "vv": vv}
        exec(f"system = {model.source}", names)
        found = vv.MultipleScales(names["system"], load=size, nu=nu).response("nu", [nu])
        # A single motion must be that of the balance.
        if found.index.size > 1 or not found.in_range[0] or found.n_beats[0]:
            continue
        balance = Balance(model, 8)
        load = load_rows(balance, {1: np.array([1j * size] + [0.0] * (n - 1))})
        start = balance.real(1j * found.harmonics[0][:, None], np.array([1]))
        motion = balance.solve(start, nu, load)
        if motion is None:
            continue
        true = balance.complex(motion)
        if abs(true[:, 1] / 1j - found.harmonics[0]).max() > 4 * found.error_estimate[0]:
            continue
        multiplier, off = multipliers(model, true, nu, 64)
        growth = float(np.log(abs(multiplier[0])) * nu / (2 * np.pi))
        if abs(growth) < 1e-5 + off[0]:
            continue
        sure += bool(found.decided[0])
        unsure += not found.decided[0]
        if found.decided[0] and bool(found.stable[0]) != (growth < 0):
            wrong.append((seed, growth))
    assert not wrong
    assert sure >= 10
    assert sure > unsure
