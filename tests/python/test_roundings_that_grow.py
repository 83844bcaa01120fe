"""Beside chaos `error` holds what roundings become: they grow in all runs of a motion alike."""

import numpy as np
import pytest
import viscovib as vv

#: Terms of power series, steps of them, and the end of a motion.
ORDER, STEPS, END = 30, 640, 80.0
#: Doubles of more digits, where there are any.
LONG = np.longdouble


def by_series(start, drag, linear, cubic, sine, force, nu):
    """Ends of x'' = force sin(nu t) - drag x' - linear x - cubic x^3 - sine sin(x), of systems.

    By power series of x, x^2, sin(x) and cos(x) in each step, by recurrence, in 19 digits or more.
    """
    numbers = (np.asarray(one, LONG) for one in (drag, linear, cubic, sine, force, nu))
    drag, linear, cubic, sine, force, nu = numbers
    x, v = np.asarray(start, LONG).T
    h = LONG(END) / STEPS
    c, square, sin, cos, turned = (np.zeros((ORDER + 1, x.size), LONG) for _ in range(5))
    for step in range(STEPS):
        c[0], c[1], sin[0], cos[0] = x, v, np.sin(x), np.cos(x)
        wave = force * np.array([np.sin(nu * step * h), nu * np.cos(nu * step * h)])
        for k in range(ORDER - 1):
            square[k] = (c[: k + 1] * c[k::-1]).sum(axis=0)
            turned[k] = (k + 1) * c[k + 1]
            push = wave[k % 2] * (1, 1, -1, -1)[k % 4]
            a = push - drag * turned[k] - linear * c[k] - sine * sin[k]
            c[k + 2] = (a - cubic * (square[: k + 1] * c[k::-1]).sum(axis=0)) / ((k + 1) * (k + 2))
            sin[k + 1] = (turned[: k + 1] * cos[k::-1]).sum(axis=0) / (k + 1)
            cos[k + 1] = -(turned[: k + 1] * sin[k::-1]).sum(axis=0) / (k + 1)
            wave[k % 2] *= nu**2 / ((k + 1) * (k + 2))
        x, v = c[-1], 0 * c[-1]
        for k in range(ORDER - 1, -1, -1):
            x, v = x * h + c[k], v * h + (k + 1) * c[k + 1]
    return np.array([x, v]).T


def beside_chaos(rng):
    """Numbers of a Duffing oscillator in two wells and of a driven pendulum, and their laws."""
    drag, cubic, force = rng.uniform((0.1, 0.8, 0.25), (0.3, 1.2, 0.5)).tolist()
    linear, nu = rng.uniform((-1.2, 0.9), (-0.8, 1.4)).tolist()
    yield (drag, linear, cubic, 0.0, force, nu), f"{cubic!r}*x^3"
    drag, sine, force, nu = rng.uniform((0.1, 0.8, 0.9, 0.5), (0.5, 1.2, 1.5, 0.75)).tolist()
    yield (drag, 0.0, 0.0, sine, force, nu), f"{sine!r}*sin(x)"


@pytest.mark.skipif(np.finfo(LONG).eps > 1e-18, reason="no doubles of more digits")
def test_errors_hold_what_roundings_grow_to():
    """A run more than two in other steps tells it, of which numbers are other by 1e-12.

    Numbers of a system are rounded alike in all runs, so that their differences do not tell it.
    """
    rng = np.random.default_rng(1)
    drawn = [one for _ in range(10) for one in beside_chaos(rng)]
    starts = rng.uniform(-1, 1, (len(drawn), 2))
    right = by_series(starts, *np.transpose([numbers for numbers, _ in drawn]))
    grown, told = 0, []
    for start, (numbers, law), end in zip(starts, drawn, right, strict=True):
        drag, linear, _, _, force, nu = numbers
        system = vv.PolynomialSystem(mass=1, damping=drag, stiffness=linear, forces=law)
        for how in ({"dt": 0.05, "estimate_error": True}, {"tolerance": 1e-6}):
            try:
                run = vv.simulate(system, END, initial=start, load=force, nu=nu, **how)
            except vv.InputError as refused:
                told.append(str(refused))
                continue
            off = float(np.abs(run.state[-1] - end).max())
            assert off <= run.error
            grown += off > 1e-13
    assert grown >= 6
    assert all("the motion is chaotic or unstable" in one for one in told)
