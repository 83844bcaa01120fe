"""Steps that end at switches with a moving base and with a past: SciPy from kink to kink."""

import itertools

import numpy as np
import pytest
import viscovib as vv
from referee.element_motions import Driven
from referee.integration import solve_ivp
from referee.switched import Fading, Sliders

WEIGHTS, RATES = np.array([0.2, 9.0]), np.array([0.7, 30.0])
KERNEL = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
MASS, STIFFNESS, DAMPING = np.array([1.0, 2.0]), np.array([1.0, 3.0]), np.array([0.1, 0.2])
DIRECTION, BETWEEN = np.array([1.0, 0.6]), np.array([1.0, -1.0])
END, NU, GAP = 5.0, 1.7, 0.05
TIMES = np.linspace(0, END, 6)
RECORD = np.array([[0.0, 0.0], [0.4, 0.3], [0.9, -0.2], [1.3, 0.1], [2.6, 0.25]])
PUSHED = np.array([[0.3, 0.0], [1.1, 1.5], [1.7, -0.4]])


def system(kernel=KERNEL):
    """Kinks behind a kernel and without a kernel."""
    return vv.Structure(
        mass=MASS, stiffness=STIFFNESS, damping=DAMPING, base_direction=DIRECTION,
        elements=[
            vv.Spring(on=("x1", "x2"), law=f"8*max(d - {GAP}, 0)", kernel=kernel),
            vv.Spring(on="x1", law="5*abs(d)"),
        ],
    )  # fmt: skip


def behind(d):
    return 8 * np.maximum(d - GAP, 0)


def forgotten(times, moved):
    """Memory states at t = 0 after a piecewise linear past, by Gauss quadrature between kinks."""
    along = moved @ BETWEEN
    z = WEIGHTS / RATES * behind(along[0])
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for (begin, end), (first, last) in zip(
        itertools.pairwise(times), itertools.pairwise(along), strict=True
    ):
        place = begin + (GAP - first) / (last - first) * (end - begin)
        for a, b in itertools.pairwise([begin, *([place] if begin < place < end else []), end]):
            t = (a + b) / 2 + (b - a) / 2 * nodes
            g = behind(first + (last - first) * (t - begin) / (end - begin))
            z = z * np.exp(-RATES * (b - a))
            z = z + WEIGHTS * (np.exp(-np.outer(RATES, b - t)) @ ((b - a) / 2 * weights * g))
    return z


def true_states(start, z, base, force, corners):
    """Absolute coordinates; the deflections of elements are relative to the base."""

    def rates(t, y, piece):
        place, speed = base(t, piece)
        d, rate = y[:2] - DIRECTION * place, y[2:4] - DIRECTION * speed
        pull = behind(BETWEEN @ d)
        push = force(t, piece) - STIFFNESS * d - DAMPING * rate
        push = push - BETWEEN * (pull - y[4:].sum()) - np.array([5 * abs(d[0]), 0.0])
        return np.r_[y[2:4], push / MASS, WEIGHTS * pull - RATES * y[4:]]

    def kinks(piece):
        for e, c in ((BETWEEN, GAP), (np.array([1.0, 0.0]), 0.0)):

            def g(t, y, _, e=e, c=c):
                return e @ (y[:2] - DIRECTION * base(t, piece)[0]) - c

            g.terminal = True
            yield g

    y, out = np.r_[start[::2], start[1::2], z], [start]
    for piece in itertools.pairwise(np.union1d(TIMES, corners)):
        t, longest = piece[0], 1e-6
        while t < piece[1]:
            # Start slightly away from a kink at which the previous part ended.
            until = min(piece[1], t + longest)
            run = solve_ivp(
                rates, (t, until), y, "DOP853", rtol=1e-12, atol=1e-14, args=(piece,),
                max_step=0.1, events=list(kinks(piece)) if longest > 1e-3 else None,
            )  # fmt: skip
            t, y = run.t[-1], run.y[:, -1]
            longest = 1e-6 if run.status == 1 else END
        if np.isclose(piece[1], TIMES).any():
            out.append(np.stack([y[:2], y[2:4]], axis=1).ravel())
    return np.array(out)


def along(table):
    """A piecewise linear record, constant after its last time."""

    def at(t, piece):
        i = np.searchsorted(table[:, 0], 0.5 * sum(piece)) - 1
        if i < 0 or i == len(table) - 1:
            return table[max(i, 0), 1], 0.0
        slope = (table[i + 1, 1] - table[i, 1]) / (table[i + 1, 0] - table[i, 0])
        return table[i, 1] + slope * (t - table[i, 0]), slope

    return at


def wave(t, piece):
    return 0.3 * np.sin(NU * t), 0.3 * NU * np.cos(NU * t)


def push(t, piece):
    """Forces by a table, 0 outside its times."""
    i = np.searchsorted(PUSHED[:, 0], 0.5 * sum(piece)) - 1
    if i < 0 or i == len(PUSHED) - 1:
        return np.zeros(2)
    return np.array([np.interp(t, *PUSHED.T), 0.0])


PAST = vv.Past(times=[-3, -0.6, 0], displacements=[[0.4, -0.1], [-0.3, 0.2], [0.3, 0.1]])
ROAD = vv.LoadTable(times=RECORD[:, 0], values=RECORD[:, 1])
SHAKES = vv.LoadTable(
    times=PUSHED[:, 0], values=np.stack([PUSHED[:, 1], 0 * PUSHED[:, 1]], axis=1)
)  # fmt: skip
CASES = {
    "wave": {"base": 0.3, "nu": NU},
    "record": {"base": ROAD},
    "held": {"held": [0.4, 0.1]},
    "past": {"held": PAST},
    "all": {
        "base": ROAD, "held": PAST, "initial": [0.1, 0.3, -0.2, 0], "force": SHAKES,
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_against_scipy(case):
    """The tolerance is reached, and with given steps the order is kept: 1e-11 for 0.05."""
    given = CASES[case]
    base, force, corners = (lambda t, piece: (0.0, 0.0)), (lambda t, piece: np.zeros(2)), [0.0]
    if case == "wave":
        base = wave
    if case in ("record", "all"):
        base, corners = along(RECORD), [*RECORD[1:, 0]]
    if case == "all":
        force, corners = push, [*corners, *PUSHED[:, 0]]
    start, z = np.zeros(4), np.zeros(2)
    if case == "held":
        start[::2] = given["held"]
        z = WEIGHTS / RATES * behind(BETWEEN @ start[::2])
    if case in ("past", "all"):
        moved = np.array(PAST.displacements)
        start[::2] = moved[-1]
        z = forgotten(np.array(PAST.times), moved)
    start = np.array(given.get("initial", start), dtype=float)
    true = true_states(start, z, base, force, corners)
    for how in ({"tolerance": 1e-10}, {"dt": 0.05}):
        run = vv.simulate(system(), END, times=TIMES, **given, **how)
        assert run.outcome == "completed"
        assert not run._resume.over_kinks
        np.testing.assert_allclose(run.state, true, atol=3e-11)


@pytest.mark.parametrize("held", [0.0, 0.3])
def test_sliders_turn_at_corners_of_the_base(held):
    """A record with corners at which a slider may reverse, with and without an initial past."""

    def force(d, over):
        return 8 * (d - GAP) * over

    slider, fading = Sliders(BETWEEN, [4.0], [0.1]), Fading(BETWEEN, force, WEIGHTS, RATES, GAP)
    judge = Driven(
        [], MASS, np.diag(STIFFNESS), np.diag(DAMPING), lambda t: np.zeros(2), [slider, fading],
        [None] * 2, [None] * 2,
    )  # fmt: skip
    slopes = np.append(np.diff(RECORD[:, 1]) / np.diff(RECORD[:, 0]), 0.0)
    y = judge.start(np.zeros(2), -DIRECTION * slopes[0])
    y[fading.at] += force(held, held > GAP) / RATES
    ends, true = np.append(RECORD[1:, 0], END), []
    for k, until in enumerate(ends):
        if k:
            y[2:4] -= DIRECTION * (slopes[k] - slopes[k - 1])
        y = judge.stretch(y, RECORD[k, 0], until)
        moved = DIRECTION * np.interp(until, *RECORD.T)
        true.append(np.stack([y[:2] + moved, y[2:4] + DIRECTION * slopes[k]], axis=1).ravel())
    shaken = vv.Structure(
        mass=MASS, stiffness=STIFFNESS, damping=DAMPING, base_direction=DIRECTION,
        elements=[
            vv.Jenkins(on=("x1", "x2"), stiffness=4, limit=0.1),
            vv.Spring(on=("x1", "x2"), law=f"8*max(d - {GAP}, 0)", kernel=KERNEL),
        ],
    )  # fmt: skip
    run = vv.simulate(
        shaken, END, base=ROAD, held=[held, 0.0], initial=np.zeros(4), times=ends
    )  # fmt: skip
    np.testing.assert_allclose(run.state, true, atol=3e-10)
    assert run.error < 1e-10
    # Deflections are relative to the base.
    np.testing.assert_allclose(
        run.deflections[:, 0], [s[0] - s[2] - np.interp(t, *RECORD.T) * 0.4
                                for t, s in zip(ends, true, strict=True)], atol=3e-10,
    )  # fmt: skip


def test_a_mass_that_sticks_goes_on_under_a_base_that_starts():
    """The base begins to move when the run is resumed: the mass slides immediately."""
    law = "0.5*sign(x_dot) + 3*max(x - 1, 0)"
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, base_direction=[1], forces=law)
    ramp = {"times": [0, 4, 4.5, 5], "values": [0, 0, 0.5, 0.5]}
    at_once = vv.simulate(body, 6, dt=0.1, initial=[0.1, 0], base=vv.LoadTable(**ramp))
    begun = vv.simulate(body, 4, dt=0.1, initial=[0.1, 0], load=0.1, nu=1)
    later = vv.LoadTable(times=ramp["times"][1:], values=ramp["values"][1:])
    found = vv.simulate(body, 6, resume=begun, base=later)
    np.testing.assert_allclose(found.state[-1], at_once.state[-1], atol=1e-12)
