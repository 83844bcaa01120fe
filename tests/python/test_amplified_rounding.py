"""Near chaos `error` includes amplified rounding errors, which are equal in all runs."""

import numpy as np
import pytest
import viscovib as vv

#: Terms of power series, their number of steps, and the end time.
ORDER, STEPS, END = 30, 640, 80.0
#: Extended precision, if available.
LONG = np.longdouble
#: Rounding errors that have not grown.
UNGROWN = 1e-13

#: Weights and rates of the kernel.
MEMORY = np.array([0.1, 0.2]), np.array([0.8, 5.0])


def by_series(start, drag, linear, cubic, sine, force, nu, weights=0.0 * MEMORY[0]):
    """Final states of x'' = force sin(nu t) - drag x' - linear w - cubic x^3 - sine sin(x).

    w = x - sum_i weight_i z_i, z_i' = x - rate_i z_i, z_i(0) = 0. By power series of x, x^2,
    sin(x), cos(x) and z in each step, by recurrence, with 19 digits or more.
    """
    weights, rates = weights.astype(LONG), MEMORY[1].astype(LONG)
    numbers = (np.asarray(one, LONG) for one in (drag, linear, cubic, sine, force, nu))
    drag, linear, cubic, sine, force, nu = numbers
    x, v = np.asarray(start, LONG).T
    h = LONG(END) / STEPS
    c, square, sin, cos, turned = (np.zeros((ORDER + 1, x.size), LONG) for _ in range(5))
    past, z = np.zeros((ORDER + 1, rates.size, x.size), LONG), np.zeros((rates.size, x.size), LONG)
    for step in range(STEPS):
        c[0], c[1], sin[0], cos[0], past[0] = x, v, np.sin(x), np.cos(x), z
        wave = force * np.array([np.sin(nu * step * h), nu * np.cos(nu * step * h)])
        for k in range(ORDER - 1):
            square[k] = (c[: k + 1] * c[k::-1]).sum(axis=0)
            turned[k] = (k + 1) * c[k + 1]
            push = wave[k % 2] * (1, 1, -1, -1)[k % 4]
            a = push - drag * turned[k] - linear * (c[k] - weights @ past[k]) - sine * sin[k]
            c[k + 2] = (a - cubic * (square[: k + 1] * c[k::-1]).sum(axis=0)) / ((k + 1) * (k + 2))
            sin[k + 1] = (turned[: k + 1] * cos[k::-1]).sum(axis=0) / (k + 1)
            cos[k + 1] = -(turned[: k + 1] * sin[k::-1]).sum(axis=0) / (k + 1)
            past[k + 1] = (c[k] - rates[:, np.newaxis] * past[k]) / (k + 1)
            wave[k % 2] *= nu**2 / ((k + 1) * (k + 2))
        x, v, z = c[-1], 0 * c[-1], past[-2]
        for k in range(ORDER - 1, -1, -1):
            x, v = x * h + c[k], v * h + (k + 1) * c[k + 1]
            z = z * h + past[k] if k < ORDER - 1 else z
    return np.array([x, v]).T


_REFERENCES: dict[tuple[int, float], np.ndarray] = {}


def reference(seed, remembers, starts, numbers):
    """Return final states of the systems of a seed, computed once for all ways to build them."""
    if (seed, remembers) not in _REFERENCES:
        ends = by_series(starts, *numbers, remembers * MEMORY[0])
        _REFERENCES[seed, remembers] = ends
    return _REFERENCES[seed, remembers]


def near_chaos(rng):
    """Parameters of a Duffing oscillator in two wells and of a driven pendulum, and their laws."""
    drag, cubic, force = rng.uniform((0.1, 0.8, 0.25), (0.3, 1.2, 0.5)).tolist()
    linear, nu = rng.uniform((-1.2, 0.9), (-0.8, 1.4)).tolist()
    yield (drag, linear, cubic, 0.0, force, nu), f"{cubic!r}*x^3"
    drag, sine, force, nu = rng.uniform((0.1, 0.8, 0.9, 0.5), (0.5, 1.2, 1.5, 0.75)).tolist()
    yield (drag, 0.0, 0.0, sine, force, nu), f"{sine!r}*sin(x)"


def as_system(linear, law, drag):
    return vv.PolynomialSystem(mass=1, damping=drag, stiffness=linear, forces=law)


def as_structure(linear, law, drag):
    spring = vv.Spring(on="x1", law=f"{linear - 1!r}*d + {law.replace('x', 'd')}")
    return vv.Structure(mass=[1.0], damping=[drag], stiffness=[1.0], elements=[spring])


def with_memory(linear, law, drag):
    weights, rates = MEMORY
    return vv.PolynomialSystem(
        mass=1, damping=drag, stiffness=linear, springs=[vv.Springs(forces=law)],
        kernel=vv.PronyKernel(weights=weights, rates=rates),
    )  # fmt: skip


@pytest.mark.skipif(np.finfo(LONG).eps > 1e-18, reason="no doubles of more digits")
@pytest.mark.parametrize(
    ("made", "remembers", "seed"),
    [(as_system, 0.0, 1), (as_structure, 0.0, 1), (with_memory, 1.0, 7)],
)
def test_errors_hold_what_roundings_grow_to(made, remembers, seed):
    """An additional run with parameters changed by 1e-12 detects it.

    Parameters are rounded equally in all runs, so differences of runs do not show it.
    """
    rng = np.random.default_rng(seed)
    drawn = [one for _ in range(10) for one in near_chaos(rng)]
    starts = rng.uniform(-1, 1, (len(drawn), 2))
    numbers = np.transpose([numbers for numbers, _ in drawn])
    right = reference(seed, remembers, starts, numbers)
    grown, reported = 0, []
    for start, (numbers, law), end in zip(starts, drawn, right, strict=True):
        drag, linear, _, _, force, nu = numbers
        system = made(linear, law, drag)
        for how in ({"dt": 0.05, "estimate_error": True}, {"tolerance": 1e-6}):
            try:
                run = vv.simulate(system, END, initial=start, load=[force], nu=nu, **how)
            except vv.InputError as refused:
                reported.append(str(refused))
                continue
            off = float(np.abs(run.state[-1] - end).max())
            # Rounding errors that did not grow differ between processors.
            assert off <= max(run.error, UNGROWN)
            grown += off > UNGROWN
    assert grown >= 6
    assert all("the motion is chaotic or unstable" in one for one in reported)
