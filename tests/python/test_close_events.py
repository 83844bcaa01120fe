"""Linear functions of the state with two or three zeros close together inside a step."""

import numpy as np
import pytest
import viscovib as vv
from scipy.optimize import brentq

END = 12.0


def motion(rng):
    """Two free masses: their sum and its derivatives, frequencies, and the initial state."""
    w, size, phase = (
        np.sort(rng.uniform(0.5, 4, 2)),
        rng.uniform(0.2, 1, 2),
        rng.uniform(0, 6.28, 2),
    )

    def at(t, k=0):
        angles = np.multiply.outer(t, w) + phase + k * np.pi / 2
        return (size * w**k * np.sin(angles)).sum(axis=-1)

    start = np.stack([size * np.sin(phase), size * w * np.cos(phase)], axis=1).ravel()
    return at, w, start


def line(at, rng, zeros):
    """A linear function with several zeros within about 1e-5 or 1e-3 of a point."""
    place, apart = rng.uniform(1, 11), 10 ** rng.uniform(-5.3, -2)
    if zeros == 3:
        grid = np.linspace(1, 11, 400)
        bends = at(grid, 2)
        i = rng.choice(np.flatnonzero(bends[:-1] * bends[1:] < 0))
        place = brentq(lambda t: at(t, 2), grid[i], grid[i + 1], xtol=1e-15)
        apart = 10 ** rng.uniform(-3.7, -1.5)
    slope = (at(place + apart) - at(place - apart)) / (2 * apart)
    near = place + apart * np.linspace(-6, 6, 2401)
    return float(at(place - apart) - slope * (place - apart)), float(slope), near


@pytest.mark.parametrize("kind", ["small", "by sections"])
def test_close_zeros_are_all_found(kind):
    rng = np.random.default_rng(5)
    for i in range(40):
        at, w, start = motion(rng)
        begin, slope, near = line(at, rng, 2 + i % 2)
        times = np.unique(np.r_[np.linspace(0, END, 20001), near])
        values = at(times) - begin - slope * times
        values = values[np.abs(values) > 2e-15]
        wanted = int((values[1:] * values[:-1] < 0).sum())
        if kind == "small":
            system = vv.PolynomialSystem(mass=[1, 1], stiffness=w**2)
        else:
            system = vv.Structure(mass=[1.0, 1.0], stiffness=w**2)
        event = f"x1 + x2 - ({begin!r}) - ({slope!r})*t"
        run = vv.simulate(system, END, initial=start, events=[event], rtol=1e-12)
        assert run.events[0].t.size == wanted
