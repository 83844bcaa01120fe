"""Thin layers of smooth force laws in time, which long steps could miss.

Reference: SciPy with short steps inside the layer.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

#: Text of a law with the strength F, the location g and the width e; its force for the operand z,
#: and whether the operand is a rate.
LAWS: dict[str, tuple[Callable[[float], float], bool]] = {
    "F*tanh((x - g)/e)": (math.tanh, False),
    "F*exp(-((x - g)/e)^2)": (lambda z: math.exp(-min(z * z, 700.0)), False),
    "F/(1 + ((x - g)/e)^2)": (lambda z: 1 / (1 + z * z), False),
    "F*atan((x - g)/e)": (math.atan, False),
    "F*(tanh((x - g)/e) - tanh((x - g)/e - 5))": (
        lambda z: math.tanh(z) - math.tanh(z - 5), False
    ),
    "F*sqrt(((x - g)/e)^2 + 1)*e": (lambda z: math.sqrt(z * z + 1), False),
    "F*e*log(1 + exp((x - g)/e))": (lambda z: float(np.logaddexp(0.0, z)), False),
    "F*tanh((x_dot - g)/e)": (math.tanh, True),
    "F*(x_dot - g)/e*exp(-((x_dot - g)/e)^2)": (
        lambda z: z * math.exp(-min(z * z, 700.0)), True
    ),
}  # fmt: skip
#: Number of widths around it, and minimum length, where the steps of SciPy are short; elsewhere
#: steps are limited so that none crosses this range.
REACH, LENGTH, LONGEST = 30.0, 0.04, 0.02


def state(
    force: Callable[[float], float],
    of_rate: bool,
    layer: tuple[float, float, float],
    drive: tuple[float, float, float],
    start: np.ndarray,
    t_end: float,
) -> np.ndarray:
    """State at ``t_end`` of x'' + c x' + x + f = P sin(w t)."""
    strength, place, width = layer
    damping, amplitude, nu = drive

    def operand(y: np.ndarray) -> float:
        return float((y[1] if of_rate else y[0]) - place) / width

    def rates(t: float, y: np.ndarray) -> list[float]:
        pushed = amplitude * math.sin(nu * t) - strength * force(operand(y))
        return [y[1], pushed - damping * y[1] - y[0]]

    def edge(side: float) -> Callable[[float, np.ndarray], float]:
        def passage(_: float, y: np.ndarray) -> float:
            return operand(y) - side

        passage.terminal = True  # type: ignore[attr-defined]
        return passage

    reach = max(REACH, LENGTH / width)
    edges = [edge(-reach), edge(reach)]
    t, y = 0.0, start
    while t < t_end:
        speed = abs(rates(t, y)[1] if of_rate else y[1]) + abs(strength) + 0.1
        inside = abs(operand(y)) <= reach * (1 + 1e-6)
        run = solve_ivp(
            rates, (t, t_end), y, method="DOP853", rtol=1e-11, atol=1e-13, events=edges,
            max_step=width / speed if inside else LONGEST,
        )  # fmt: skip
        t, y = run.t[-1], run.y[:, -1]
        if t < t_end:
            # Slightly off the edge, so that the first state is not an event.
            off = min(t_end, t + 1e-4 * width)
            run = solve_ivp(rates, (t, off), y, method="DOP853", rtol=1e-12, atol=1e-14)
            t, y = run.t[-1], run.y[:, -1]
    return y


def system(rng: np.random.Generator, law: str) -> tuple[vv.PolynomialSystem, dict[str, float]]:
    """A random oscillator with a layer within its motion, and the layer."""
    width = 10 ** rng.uniform(-3.5, -2)
    if LAWS[law][1]:
        width = 10 ** rng.uniform(-2.5, -1.5)
    if "log" in law:
        width = 10 ** rng.uniform(-2, -1)
    strength = rng.uniform(0.1, 0.4) * (1 if LAWS[law][1] else rng.choice([-1, 1]))
    if "exp(-" in law or "/(1 +" in law or "- 5)" in law:
        # For a bump the impulse is given.
        strength *= 0.1 / max(width, 1e-3)
    if law.startswith("F*(x_dot"):
        # Else the rate would stay in it.
        strength *= -0.3
    values = {"F": float(strength), "g": rng.uniform(-0.5, 0.7), "e": float(width)}
    damping = rng.uniform(0.01, 0.1)
    one = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=law, parameters=values)
    return one, values | {"c": damping}


@pytest.mark.parametrize("law", LAWS)
def test_runs_see_them(law: str) -> None:
    """The error of the default run is valid for any location and width of the layer."""
    rng = np.random.default_rng([list(LAWS).index(law), 0])
    one, values = system(rng, law)
    start, load, nu, t_end = rng.uniform(-1, 1, 2), rng.uniform(0.1, 1), rng.uniform(0.3, 2), 6.0
    run = vv.simulate(one, t_end, initial=start, load=load, nu=nu)
    assert run.outcome == "completed"
    force, of_rate = LAWS[law]
    factor = values["e"] if "sqrt" in law or "log" in law else 1.0
    true = state(
        force, of_rate, (values["F"] * factor, values["g"], values["e"]),
        (values["c"], load, nu), start, t_end,
    )  # fmt: skip
    assert run.error < 1e-8
    assert np.abs(run.state[-1] - true).max() < max(3 * run.error, 1e-9)


def test_given_steps_are_made_in_parts_where_a_layer_is_thinner() -> None:
    """A bump between all nodes of all steps: a run with given steps detects it."""
    bump = {"forces": "F*exp(-((x - g)/e)^2)", "parameters": {"F": -40.0, "g": 0.43, "e": 2e-3}}
    with_bump = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, **bump)
    run = vv.simulate(with_bump, 6, initial=[0.0, 1.0], dt=0.05)
    true = state(
        LAWS["F*exp(-((x - g)/e)^2)"][0], False, (-40.0, 0.43, 2e-3), (0.02, 0.0, 1.0),
        np.array([0.0, 1.0]), 6.0,
    )  # fmt: skip
    assert np.abs(run.state[-1] - true).max() < 1e-9
    free = vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02), 6,
                       initial=[0.0, 1.0], dt=0.05)  # fmt: skip
    assert np.abs(run.state[-1] - free.state[-1]).max() > 1e-3


def test_a_wide_layer_costs_nothing() -> None:
    """Where a polynomial resolves the law, steps are not divided."""
    wide = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces="0.3*tanh(x/0.5)")
    run = vv.simulate(wide, 20, initial=[0.0, 1.0], dt=0.05)
    assert run.stats["evaluations"] < 2 * 402


@pytest.mark.parametrize("law", LAWS)
def test_ensembles_see_them(law: str) -> None:
    """In parallel runs none is missed either: such runs are computed separately."""
    rng = np.random.default_rng([list(LAWS).index(law), 100])
    one, _ = system(rng, law)
    starts, nu = rng.uniform(-1, 1, (9, 2)), np.linspace(0.4, 1.8, 9)
    many = vv.simulate_ensemble(one, initial=starts, t_end=6.0, load=0.5, parameters={"nu": nu})
    for i in range(9):
        run = vv.simulate(one, 6.0, initial=starts[i], load=0.5, nu=nu[i])
        assert np.abs(run.state[-1] - many.state[i]).max() < max(3 * many.error, 1e-9)


GRAZED: dict[str, Callable[[float], float]] = {
    "F*exp(-((d - g)/e)^2)": lambda z: math.exp(-min(z * z, 700.0)),
    "F*tanh((d - g)/e)": math.tanh,
    "F/(1 + ((d - g)/e)^2)": lambda z: 1 / (1 + z * z),
}


@pytest.mark.parametrize(
    ("law", "memory", "tip"),
    [(law, memory, memory == (k != 1)) for k, law in enumerate(GRAZED) for memory in (False, True)],
)
def test_structures_see_layers_that_they_only_graze(law: str, memory: bool, tip: bool) -> None:
    """A layer at the extreme of the motion lies between two close states."""
    rng = np.random.default_rng([list(GRAZED).index(law), memory, tip])
    n = int(rng.integers(1, 4))
    stiffness = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    weight, rate, force = 0.3, 0.7, GRAZED[law]
    layer = {"F": 0.0, "g": 0.0, "e": 1.0}

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v, z = y[:n], y[n : 2 * n], y[2 * n :]
        a = -stiffness @ q - 0.05 * stiffness @ v
        a[0] -= layer["F"] * force((q[0] - layer["g"]) / layer["e"])
        if memory:
            # A spring of stiffness 1 with memory.
            a[0] -= q[0] - z[0]
        return np.concatenate([v, a, weight * q[:1] - rate * z if memory else z])

    start = np.concatenate([np.zeros(n), rng.normal(size=n), np.zeros(int(memory))])
    free = solve_ivp(rates, (0, 4), start, "DOP853", max_step=0.02, rtol=1e-8).y[0]
    width = 10 ** rng.uniform(-3, -2)
    place = free.max() + rng.uniform(-2, 2) * width if tip else rng.uniform(0.2, 0.9) * free.max()
    layer |= {"F": rng.choice([-1, 1]) * rng.uniform(1, 4), "g": place, "e": width}
    elements = [vv.Spring(on="x1", law=law, parameters=layer)]
    if memory:
        kernel = vv.PronyKernel(weights=[weight], rates=[rate])
        elements.append(vv.Spring(on="x1", stiffness=1.0, kernel=kernel))
    chain = vv.Structure(
        mass=np.eye(n), stiffness=stiffness, damping=0.05 * stiffness, elements=elements
    )
    run = vv.simulate(chain, 4.0, initial=np.stack([start[:n], start[n : 2 * n]], 1).ravel())
    y = start
    for t in np.arange(400) / 100:
        near = abs(y[0] - place) < 20 * width + 0.02 * (abs(y[n]) + 1)
        y = solve_ivp(
            rates, (t, t + 0.01), y, "DOP853", rtol=1e-12, atol=1e-14,
            max_step=width / 4 if near else np.inf,
        ).y[:, -1]  # fmt: skip
    assert run.outcome == "completed"
    assert run.error < 1e-9
    assert np.abs(run.state[-1, ::2] - y[:n]).max() < max(3 * run.error, 1e-9)
    assert np.abs(run.state[-1, 1::2] - y[n : 2 * n]).max() < max(3 * run.error, 1e-9)


def test_wide_layers_stay_side_by_side() -> None:
    wide = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="0.3*tanh(x_dot/0.1)")
    many = vv.simulate_ensemble(wide, initial=np.ones((9, 2)), t_end=6.0, load=0.5, nu=1.0)
    assert "8 side by side" in str(many.plan)
