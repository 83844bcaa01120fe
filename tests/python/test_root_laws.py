"""Roots and fractional powers at a contact surface, such as Hertz's max(d, 0)^1.5, in time.

Reference: SciPy with runs that end and restart at the surface.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def motion(
    force: Callable[[float, float], float],
    surface: Callable[[float, float], float],
    drive: tuple[float, float, float],
    start: np.ndarray,
    t_end: float,
    *others: Callable[[float, float], float],
) -> np.ndarray:
    """State at ``t_end`` of x'' + c x' + x + f = F sin(w t), from contact to contact.

    ``others``: further surfaces at which runs end and restart.
    """
    damping, amplitude, nu = drive

    def rates(t: float, y: np.ndarray) -> list[float]:
        return [y[1], amplitude * np.sin(nu * t) - damping * y[1] - y[0] - force(y[0], y[1])]

    def ends(one: Callable[[float, float], float]) -> Callable[[float, np.ndarray], float]:
        def passage(_: float, y: np.ndarray) -> float:
            return one(y[0], y[1])

        passage.terminal = True  # type: ignore[attr-defined]
        return passage

    passages = [ends(one) for one in (surface, *others)]
    accuracy = {"method": "DOP853", "rtol": 3e-14, "atol": 1e-16}
    t, y = 0.0, start
    while t < t_end:
        run = solve_ivp(rates, (t, t_end), y, events=passages, max_step=0.05, **accuracy)
        t, y = run.t[-1], run.y[:, -1]
        if t < t_end:
            # Slightly off the surface, so that the first state is not an event.
            run = solve_ivp(rates, (t, min(t_end, t + 1e-9)), y, **accuracy)
            t, y = run.t[-1], run.y[:, -1]
    return y


@pytest.mark.parametrize("other", ["max(x - h, 0)", "max(h - x, 0)^2", "0.1*sign(x - h)"])
@pytest.mark.parametrize("first", ["sign(x - g)*abs(x - g)^1.5", "max(x - g, 0)^1.3"])
def test_another_surface_nearby(first: str, other: str) -> None:
    """A step that ends at one surface may be close to a second, singular surface.

    Regression: such steps were not shortened, so runs with any step size had equal errors.
    """
    rng = np.random.default_rng(len(first) + len(other))
    for _ in range(3):
        k, g = rng.uniform(0.5, 2), rng.uniform(0.1, 0.4)
        h = g + rng.choice([-1, 1]) * 10 ** rng.uniform(-4, -1.5)

        def force(x: float, _: float, k: float = k, g: float = g, h: float = h) -> float:
            rough = np.sign(x - g) * abs(x - g) ** 1.5 if "^1.5" in first else max(x - g, 0) ** 1.3
            kink = {"m": max(x - h, 0), "0": 0.1 * np.sign(x - h)}[other[0]]
            return float(k * rough + (max(h - x, 0) ** 2 if "^2" in other else kink))

        system = vv.PolynomialSystem(
            mass=1,
            stiffness=1,
            damping=0.1,
            forces=f"k*{first} + {other}",
            parameters={"k": k, "g": g, "h": h},
        )
        start = np.array([0.0, rng.uniform(0.6, 0.9)])
        true = motion(
            force, lambda x, v, g=g: x - g, (0.1, 0.3, 1.1), start, 4.0, lambda x, v, h=h: x - h
        )
        for dt in (0.5, 0.3):
            run = vv.simulate(system, 4.0, dt=dt, initial=start, load=0.3, nu=1.1, keep="last")
            assert np.allclose(run.state[-1], true, rtol=0, atol=2e-11), dt


@pytest.mark.parametrize("method", ["gauss2", "gauss8", "dop8", "verner9"])
def test_order(method: str) -> None:
    """With given steps, the parts outside contact keep the order of the method."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces="8*max(x - 0.1, 0)^1.5")
    fine = vv.simulate(system, 8.0, initial=[0.5, 0.1]).state[-1]
    errors = [
        np.abs(vv.simulate(system, 8.0, dt=dt, initial=[0.5, 0.1], method=method).state[-1] - fine)
        for dt in (0.1, 0.05)
    ]
    assert errors[1].max() < max(errors[0].max() / 10, 1e-11)


@pytest.mark.parametrize(
    ("text", "force", "gap"),
    [
        ("0.3*abs(x)^(1.5 + x^2)", lambda x, _: 0.3 * abs(x) ** (1.5 + x * x), 0.0),
        ("3*max(x - 0.2, 0)^(1.3 + x^2)", lambda x, _: 3 * max(x - 0.2, 0) ** (1.3 + x * x), 0.2),
        ("(x - 0.5)*log(abs(x - 0.5))", lambda x, _: (d := x - 0.5) * np.log(abs(d) + 1e-300), 0.5),
        ("0.2*log(abs(x - 0.5))", lambda x, _: 0.2 * np.log(abs(x - 0.5) + 1e-300), 0.5),
    ],
)
def test_logs_and_powers_whose_exponent_varies(
    text: str, force: Callable[[float, float], float], gap: float
) -> None:
    """With a fixed branch they are continued beyond the surface, where they are undefined."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=text, names=["x"])
    start = np.array([1.0, 0.0])
    run = vv.simulate(system, initial=start, t_end=8, dt="auto")
    exact = motion(force, lambda x, v: x - gap, (0.1, 0.0, 1.0), start, run.t[-1])
    np.testing.assert_allclose(run.state[-1], exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize("start", [[0.0, 0.8], [0.1, -0.5], [1e-9, -0.3], [-1e-9, 0.3]])
def test_starts_on_the_surface(start: list[float]) -> None:
    """A motion may start on the surface, or so near that the first step would miss it."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces="8*x*sqrt(abs(x))")
    run = vv.simulate(system, 5.0, dt=0.1, initial=start, estimate_error=True)
    true = motion(
        lambda x, v: 8 * x * abs(x) ** 0.5, lambda x, v: x, (0, 0, 1), np.array(start), 5.0
    )
    assert run.error < 1e-11
    assert np.allclose(run.state[-1], true, rtol=0, atol=1e-10)


def test_structures() -> None:
    """Elements of small structures are treated equally; a ball on a Hertzian floor keeps energy."""
    structure = vv.Structure(
        mass=[[1.0]],
        stiffness=[[1.0]],
        names=["z"],
        elements=[vv.Spring(on="z", law="-50*max(-d, 0)^1.5")],
    )
    run = vv.simulate(structure, 30.0, initial=[0.4, 0.0])
    z, v = run.state[:, 0], run.state[:, 1]
    energy = v**2 / 2 + z**2 / 2 + 20 * np.maximum(-z, 0) ** 2.5
    assert run.outcome == "completed"
    assert np.ptp(energy) < 1e-11
