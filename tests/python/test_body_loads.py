"""Bodies under practical loads: random floors, terminal sawtooth; checks of units."""

import math
import warnings

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

PLACES = {"a": (0.3, 0.2, -0.1), "b": (-0.3, 0.25, -0.1), "c": (0.05, -0.3, -0.12)}
STIFFNESS, DAMPING = np.array([2e4, 3e4, 6e4]), np.array([150.0, 200.0, 300.0])
MASS, INERTIA = 12.0, np.diag([0.5, 0.4, 0.6])


def body(**options):
    mounts = [
        vv.MountPoint(name=name, position=place, stiffness=STIFFNESS, damping=DAMPING)
        for name, place in PLACES.items()
    ]
    return vv.Body(**{"mass": MASS, "inertia": INERTIA, "mounts": mounts} | options)


def test_random_floor_is_the_mean_over_random_motions_in_time():
    """Floors with random phases in time: the mean square is the integral of |H|^2 S.

    With lines df apart the mean over a period 1/df is this sum for any phases. The acceleration
    of the last period is computed from its Fourier coefficients.
    """
    df, level, n = 1.0, 0.3, 2000
    lines = np.arange(4.0, 31.0, df)
    hz = np.r_[lines[0] - df, lines, lines[-1] + df]
    density = np.r_[0.0, np.full(lines.size, level), 0.0]
    shaken = body(base_direction="z")
    _, expected = shaken.random_floor(hz, density, "z")
    rng = np.random.default_rng(11)
    t = np.arange(0, 4 * n + 1) / (n * df)
    found = []
    for _ in range(3):
        omega = 2 * math.pi * lines
        phase = rng.uniform(0, 2 * math.pi, lines.size)
        waves = np.sqrt(2 * level * df) / omega**2 * np.sin(np.outer(t, omega) + phase)
        floor = waves.sum(axis=1) * np.clip(t * df, 0, 1) ** 3
        table = vv.LoadTable(times=t, values=floor, interpolation="cubic")
        run = vv.simulate(shaken, t[-1], base=table, dt=4 / (n * df))
        last = run.state[-n // 4 :, :6:2]
        order = np.fft.rfftfreq(len(last), 4 / (n * df)) * 2 * math.pi
        lines_of = np.fft.rfft(last, axis=0) / len(last)
        found.append(2 * (order[:, np.newaxis] ** 4 * np.abs(lines_of) ** 2)[:40].sum(axis=0))
    np.testing.assert_allclose(np.sqrt(found), np.tile(expected, (3, 1)), rtol=1e-4)


def test_random_floor_has_no_mean_at_a_resonance_without_damping():
    feet = [
        vv.MountPoint(name=name, position=place, stiffness=STIFFNESS)
        for name, place in PLACES.items()
    ]
    free = body(mounts=feet)
    first = free.modes().hz[0]
    with pytest.raises(vv.InputError, match="a resonance without damping at"):
        free.random_floor([first / 2, first * 1.1], [1, 1], "x")
    _, below = free.random_floor([first / 4, first / 2], [1, 1], "x")
    assert (below > 0.1).any()


def test_terminal_sawtooth():
    """A force that rises in 11 ms and ends, against SciPy with independent equations."""
    end, peak, at = 0.011, 900.0, np.array([0.1, 0.0, 0.05])
    shocked = body()
    push = np.r_[0, 0, peak, np.cross(at, [0, 0, peak])]
    np.testing.assert_allclose(shocked.load(force=(0, 0, peak), at=at), push, atol=1e-12)
    table = vv.LoadTable(times=[0, end, end * (1 + 1e-9)], values=[np.zeros(6), push, np.zeros(6)])
    stiff, damp, mass = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
    for place in PLACES.values():
        for j, axis in enumerate(np.eye(3)):
            row = np.r_[axis, np.cross(place, axis)]
            stiff += STIFFNESS[j] * np.outer(row, row)
            damp += DAMPING[j] * np.outer(row, row)
    mass[:3, :3], mass[3:, 3:] = MASS * np.eye(3), INERTIA

    def rate(t, y, size):
        load = push * size * t / end
        return np.r_[y[6:], np.linalg.solve(mass, load - stiff @ y[:6] - damp @ y[6:])]

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14}
    first = solve_ivp(rate, (0, end), np.zeros(12), args=(1.0,), **options).y[:, -1]
    t = np.linspace(0, 0.3, 31)
    later = solve_ivp(rate, (end, 0.3), first, args=(0.0,), t_eval=t[2:], **options).y.T
    run = vv.simulate(shocked, 0.3, force=table, dt=0.01, tolerance=1e-9)
    scale = np.abs(later[:, :6]).max()
    np.testing.assert_allclose(run.state[2:, ::2], later[:, :6], atol=1e-7 * scale)


@pytest.mark.parametrize(
    ("place", "angle", "moment", "reported"),
    [
        ((66.0, 463.0, 156.0), 0.0, 1.0, "multiply values in mm by units.mm$"),
        ((0.1, 0.4, 0.1), 90.0, 1.0, "multiply degrees by units.degree$"),
        ((0.1, 0.4, 0.1), 0.0, 1e6, r"multiply values in kg mm\^2 by units.mm\*\*2$"),
        ((0.1, 0.4, 0.1), 2 * math.pi, 1.0, None),
        ((0.0, 0.0, 0.0), 0.0, 1e6, None),
    ],
)
def test_numbers_that_look_like_other_units_are_reported(place, angle, moment, reported):
    def made():
        foot = vv.MountPoint(
            name="foot", position=place, stiffness=(1e5,) * 3, angles=(0, 0, angle)
        )
        return vv.Body(mass=10, inertia=(moment,) * 3, mounts=[foot])

    if reported is None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            made()
        return
    with pytest.warns(vv.StabilityWarning, match=reported) as seen:
        made()
    assert len(seen) == 1


def test_angles_and_axes_are_not_given_both():
    with pytest.raises(vv.InputError, match="foot: angles, axes: define the orientation twice"):
        vv.MountPoint(
            name="foot", position=(0, 0, 0), stiffness=(1, 1, 1), angles=(0.1, 0, 0), axes=np.eye(3)
        )


def some_machine(rng, unit):
    """Return a random machine of 1 kg to 5 t on four mounts with bounce modes at 2.5 to 25 Hz."""
    mass = math.exp(rng.uniform(0, math.log(5000)))
    size = 0.5 * (mass / 500) ** (1 / 3) * rng.uniform(0.6, 1.6)
    bounce = 2 * math.pi * math.exp(rng.uniform(math.log(2.5), math.log(25)))
    feet = [
        vv.MountPoint(
            name=f"foot{i}", position=size * np.array([x, y, -0.3]),
            stiffness=unit * mass * bounce**2 / 4 * np.array([0.3, 0.3, 1]) * rng.uniform(0.7, 1.4),
        )
        for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    ]  # fmt: skip
    return vv.Body(mass=mass, inertia=mass * size**2 * rng.uniform(0.1, 0.2, 3), mounts=feet)


def test_stiffnesses_in_newtons_a_millimetre_are_doubted():
    """No reasonable machine gives a warning; nearly all machines with the wrong unit do."""
    rng = np.random.default_rng(3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in range(200):
            some_machine(rng, 1.0)
    doubted = 0
    for _ in range(200):
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            some_machine(rng, 1e-3)
        doubted += any("units.newton_per_mm" in str(one.message) for one in seen)
    assert doubted > 170
