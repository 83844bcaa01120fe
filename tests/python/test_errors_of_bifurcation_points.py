"""Stated errors of bifurcation points and branch points."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def _single(rng, memory):
    kernel = vv.PronyKernel(weights=[0.05], rates=[0.6]) if memory else None
    return vv.PolynomialSystem(
        mass=1, stiffness=1, damping=rng.uniform(0.02, 0.06), kernel=kernel,
        forces=f"{rng.uniform(0.2, 0.8):.3f}*x^2 + {rng.uniform(0.3, 1):.3f}*x^3",
    )  # fmt: skip


def _odd(rng, memory):
    kernel = vv.PronyKernel(weights=[0.05], rates=[0.6]) if memory else None
    return vv.PolynomialSystem(
        mass=1, stiffness=1, damping=rng.uniform(0.02, 0.06), kernel=kernel,
        forces=f"{rng.uniform(0.3, 1):.3f}*x^3",
    )  # fmt: skip


def _pair(rng):
    k = rng.uniform(0.5, 1.8, 3)
    stiffness = np.array([[k[0] + k[1], -k[1]], [-k[1], k[1] + k[2]]])
    terms = zip(rng.uniform(0.1, 0.6, 3), ((3, 0), (0, 3), (2, 0)), (0, 1, 0), strict=True)
    return vv.PolynomialSystem(
        mass=rng.uniform(0.6, 2, 2), stiffness=stiffness,
        damping=rng.uniform(0.005, 0.03) * stiffness,
        forces=[vv.Monomial(coefficient=c, powers=p, on=d) for c, p, d in terms],
    )  # fmt: skip


def _draw(seed):
    """A system and the arguments of its branch."""
    rng = np.random.default_rng(seed)
    kind, memory = seed % 4, seed % 8 >= 6
    if kind == 0:
        same = dict(load={2: [rng.uniform(0.1, 0.6)]}, symmetric=False)
        return _single(rng, memory), (0.5, 1.7), same
    if kind == 3:
        same = dict(load={1: [rng.uniform(0.1, 0.5), 0]}, symmetric=False)
        return _pair(rng), (0.4, 2.0), same
    same = dict(load={1: [rng.uniform(0.5, 2)]}, symmetric=kind == 1)
    return _odd(rng, memory), (0.6, 1.7), same


def _apart(one, other):
    """Distance of two points, including their motions."""
    x, y = one.coefficients, other.coefficients
    n = min(x.shape[1], y.shape[1])
    return abs(one.parameter - other.parameter) + np.abs(x[:, :n] - y[:, :n]).max()


@pytest.mark.parametrize("first", range(0, 24, 8))
def test_places_of_few_orders_are_as_far_off_as_reported(first):
    """Against a balance with three times as many harmonics."""
    ratios = {}
    for seed in range(first, first + 8):
        system, ends, same = _draw(seed)
        n = 7 + 2 * (seed % 3)
        few, many = (
            vv.trace_response(system, ends, **same, harmonics=m, max_points=600) for m in (n, 3 * n)
        )
        for found, true in (
            (few.crossings, many.crossings),
            (few.branch_points, many.branch_points),
        ):
            for one in found:
                kind = getattr(one, "kind", "leaves")
                assert one.error > 0
                alike = [c for c in true if getattr(c, "kind", "leaves") == kind]
                if not alike or not np.isfinite(one.error) or one.error > 1e-3:
                    continue
                nearest = min(alike, key=lambda c, one=one: _apart(one, c))
                off = abs(one.parameter - nearest.parameter)
                ratios.setdefault(kind, []).append(off / (one.error + nearest.error))
    whole = np.concatenate(list(ratios.values()))
    assert whole.size >= 8
    assert whole.max() < 1.3, {kind: max(r) for kind, r in ratios.items()}


def _disturbances(system, nu, load, start):
    """Perturbations of a periodic motion after a period, by integration in time."""
    damping, force = float(system.damping[0, 0]), system.forces
    a, b = force

    def right(t, y):
        x, v = y[:2]
        slope = 1 + 2 * a * x + 3 * b * x * x
        rate = load * np.sin(2 * nu * t) - damping * v - x - a * x * x - b * x**3
        by = y[2:].reshape(2, 2)
        return [v, rate, *(np.array([[0, 1], [-slope, -damping]]) @ by).ravel()]

    state = np.array(start)
    for _ in range(20):
        last = solve_ivp(
            right, (0, 2 * np.pi / nu), [*state, 1, 0, 0, 1], "DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]
        by = last[2:].reshape(2, 2)
        step = np.linalg.solve(by - np.eye(2), state - last[:2])
        state = state + step
        if np.abs(step).max() < 1e-11:
            break
    return by


class _Drawn:
    """x'' + c x' + x + a x^2 + b x^3 under a load of harmonic 2."""

    def __init__(self, c, a, b):
        self.damping, self.forces = np.array([[c]]), (a, b)
        self.system = vv.PolynomialSystem(
            mass=1, stiffness=1, damping=c, forces=f"{a}*x^2 + {b}*x^3"
        )


@pytest.mark.parametrize("seed", range(4))
def test_branch_points_are_those_of_motions_in_time(seed):
    """A multiplier is 1 at the branch point: SciPy locates it to 1e-9."""
    rng = np.random.default_rng(seed)
    drawn = _Drawn(0.03, round(rng.uniform(0.5, 0.9), 3), round(rng.uniform(0.5, 0.9), 3))
    load = round(rng.uniform(0.15, 0.25), 3)
    branch = vv.trace_response(
        drawn.system, (0.6, 1.4), load={2: load}, symmetric=False, harmonics=9 + 2 * seed
    )
    crossings = [c for c in branch.crossings if c.kind == "branch point"]
    assert crossings
    for one in crossings[:2]:
        waves = one.coefficients[0]
        start = [waves.imag.sum(), (branch.harmonics * one.parameter * waves.real).sum()]

        def passed(nu, start=start):
            by = _disturbances(drawn, nu, load, start)
            return float(np.linalg.det(by - np.eye(2)))

        reach = max(1e-6, 3 * one.error)
        # The motion continues through the point, a simple zero of the determinant.
        lower, upper = passed(one.parameter - reach), passed(one.parameter + reach)
        assert lower * upper < 0
        true = one.parameter + reach * (lower + upper) / (lower - upper)
        assert abs(true - one.parameter) <= 1.3 * one.error + 2e-9
