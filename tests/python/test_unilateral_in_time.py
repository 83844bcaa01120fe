"""Example 03 of NLvib (Krack and Gross): bifurcations by an event-accurate period map."""

import numpy as np
import pytest
import viscovib as vv

SPRINGS = np.array([[1.0, -1.0], [-1.0, 2.0]])
MASSES = vv.PolynomialSystem(
    mass=[1, 1], stiffness=SPRINGS, damping=0.03 * SPRINGS, forces={"x1": "100*max(x1 - 1, 0)"}
)


def after(state, nu, steps):
    """The state after a period."""
    period = 2 * np.pi / nu
    run = vv.simulate(
        MASSES, period, dt=period / steps, initial=state, load=[0, 0.1], nu=nu, keep="last"
    )
    assert run.outcome == "completed"
    return run.state[-1]


def monodromy(state, nu, steps, h=1e-5):
    columns = [
        (after(state + h * e, nu, steps) - after(state - h * e, nu, steps)) / (2 * h)
        for e in np.eye(4)
    ]
    return np.array(columns).T


def periodic(state, nu, steps):
    """The periodic motion near a given state, and its monodromy matrix."""
    matrix = monodromy(state, nu, steps)
    for _ in range(8):
        step = np.linalg.solve(matrix - np.eye(4), after(state, nu, steps) - state)
        state = state - step
        if np.abs(step).max() < 1e-12:
            break
    return state, monodromy(state, nu, steps)


def flips(matrix):
    """0 if a multiplier is -1."""
    return np.linalg.det(matrix + np.eye(4))


def turns(matrix):
    """0 if the largest pair is on the unit circle."""
    return np.abs(np.linalg.eigvals(matrix)).max() - 1


@pytest.mark.parametrize(
    ("found", "test", "between", "start"),
    [
        (0.75559, flips, (0.755605, 0.755565), [-1.7437, -0.5182, -0.6096, 0.2772]),
        (0.61861, turns, (0.6200, 0.6177), [-0.23824, 0.55031, -0.19346, 0.42285]),
    ],
)
def test_bifurcations(found, test, between, start):
    """Period doubling and Neimark-Sacker point: the published digits, also with other steps."""
    places = []
    for steps in (90, 110):
        nu = [between[1], between[1] + 0.25 * (between[0] - between[1])]
        state, matrix = periodic(np.array(start), nu[0], steps)
        values = [test(matrix)]
        for _ in range(7):
            state, matrix = periodic(state, nu[-1], steps)
            values.append(test(matrix))
            slope = (values[-1] - values[-2]) / (nu[-1] - nu[-2])
            nu.append(nu[-1] - values[-1] / slope)
            if abs(nu[-1] - nu[-2]) < 1e-8:
                break
        places.append(nu[-1])
    assert places[0] == pytest.approx(places[1], abs=1e-7)
    assert places[0] == pytest.approx(found, abs=6e-6)
