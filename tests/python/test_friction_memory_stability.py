"""Stability of motions with a slider and memory, against perturbed motions in time."""

import numpy as np
import pytest
import viscovib as vv

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")


def disturbed(case, nu, orders, x, periods, steps):
    """Distance of perturbed motions after each period, shape (periods, n); nu (n,), x (n, m).

    Runge-Kutta's method for x'' + c x' + (1 + kappa) x + beta x^3 + z - kappa m = P sin(nu t), with
    m' = weight x - rate m and a slider z' = k x' within |z| <= limit. The motions start at the
    harmonics and at a distance of a thousandth.
    """
    c, kappa, weight, rate, beta, stiffness, limit, force = case
    waves = np.exp(2j * np.pi * np.outer(orders, np.arange(4001) / 2000))
    along = (x @ waves).imag
    z = np.zeros(nu.size)
    for before, after in zip(along.T[:-1], along.T[1:], strict=True):
        z = np.clip(z + stiffness * (after - before), -limit, limit)
    memory = (x * weight / (rate + 1j * np.outer(nu, orders))).sum(axis=1).imag
    begun = np.array([x.sum(axis=1).imag, (1j * np.outer(nu, orders) * x).sum(axis=1).imag])
    state = np.array([*(begun + 1e-3 * np.abs(x).max(axis=1)), memory])
    dt = 2 * np.pi / nu / steps

    def slope(t, s, held):
        u, v, m = s
        pulled = (1 + kappa) * u + beta * u**3 + held - kappa * m
        return np.array([v, force * np.sin(nu * t) - c * v - pulled, weight * u - rate * m])

    def slid(held, before, after):
        return np.clip(held + stiffness * (after[0] - before[0]), -limit, limit)

    found = []
    for step in range(periods * steps):
        t = step * dt
        a = slope(t, state, z)
        middle = state + dt / 2 * a
        b = slope(t + dt / 2, middle, slid(z, state, middle))
        middle = state + dt / 2 * b
        d = slope(t + dt / 2, middle, slid(z, state, middle))
        end = state + dt * d
        e = slope(t + dt, end, slid(z, state, end))
        after = state + dt / 6 * (a + 2 * b + 2 * d + e)
        z, state = slid(z, state, after), after
        if (step + 1) % steps == 0:
            found.append(np.abs(state[:2] - begun).max(axis=0) / np.abs(x).max(axis=1))
    return np.array(found)


@pytest.mark.parametrize("seed", range(3))
def test_verdicts_with_memory_are_right(seed):
    rng = np.random.default_rng(seed)
    c, kappa, rate = rng.uniform(0.01, 0.03), rng.uniform(0.05, 0.2), 10 ** rng.uniform(-0.5, 0.5)
    case = [c, kappa, rng.uniform(0.02, 0.1) * rate, rate, rng.uniform(0.4, 0.8)]
    case += [rng.uniform(0.2, 0.5), rng.uniform(0.02, 0.05), rng.uniform(0.2, 0.28)]
    elements = [
        vv.Spring(on="x1", stiffness=kappa, kernel=vv.PronyKernel(weights=[case[2]], rates=[rate])),
        vv.Spring(on="x1", law=f"{case[4]}*d^3"),
        vv.Jenkins(on="x1", stiffness=case[5], limit=case[6]),
    ]
    system = vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[c]], elements=elements)
    branch = vv.trace_response(system, (0.9, 5), load=case[7], harmonics=21, tolerance=0.02)
    verdicts = list(branch.stable)
    # Motions in which the slider slips.
    slips = np.abs(branch.coefficients[:, 0, 0]) > 1.5 * case[6] / case[5]
    known = np.flatnonzero([v is not None and s for v, s in zip(verdicts, slips, strict=True)])
    assert known.size > 0.95 * slips.sum() > 10
    stable = np.array([bool(verdicts[i]) for i in known])
    size = np.abs(branch.multipliers[known]).max(axis=1)
    chosen = np.flatnonzero(np.abs(size - 1) > 0.05)
    chosen = np.unique(chosen[np.linspace(0, chosen.size - 1, 30).astype(int)])
    chosen = np.union1d(chosen, np.flatnonzero(~stable & (size > 1.05))[::3])
    places, stable = known[chosen], stable[chosen]
    distance = disturbed(
        case, branch.nu[places], branch.harmonics, branch.coefficients[places, 0], 40, 200
    )
    grown = distance[-10:].max(axis=0) > distance[:10].max(axis=0)
    assert (stable == ~grown).all(), (branch.nu[places], stable, distance[-1], size[chosen])
    assert (~stable).sum() > 10
