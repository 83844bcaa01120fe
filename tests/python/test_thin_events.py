"""Events of functions that are thinner than a step: found, or reported as unresolved."""

import math
import warnings

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

FREE = vv.PolynomialSystem(mass=1, stiffness=1)
DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
WORDS = {
    "exp": np.exp, "tanh": np.tanh, "sin": np.sin, "abs": np.abs, "atan": np.arctan,
    "min": np.minimum, "max": np.maximum, "sqrt": np.sqrt, "log": np.log,
}  # fmt: skip


def passes(level, end):
    """Times at which sin(t) crosses a level."""
    first = math.asin(level)
    both = [[first + 2 * math.pi * k, math.pi - first + 2 * math.pi * k] for k in range(-1, 9)]
    return np.array([t for pair in both for t in pair if 0 < t < end])


@pytest.mark.parametrize("width", [1e-1, 1e-3, 1e-6])
@pytest.mark.parametrize("step", [{}, {"dt": 0.5}], ids=["default", "0.5"])
def test_layers_on_an_exact_motion(width, step):
    """Along sin(t): every entry into a layer and every exit, with much longer steps."""
    half = width * math.sqrt(math.log(2))
    layers = {
        f"exp(-((x - 0.3)/{width})^2) - 0.5": (0.3 - half, 0.3 + half),
        f"1/(1 + ((x - 0.3)/{width})^2) - 0.5": (0.3 - width, 0.3 + width),
        f"abs(x - 0.3) - {width}": (0.3 - width, 0.3 + width),
        f"(x - 0.3)^2 - {width}^2": (0.3 - width, 0.3 + width),
        f"tanh((x - 0.3)/{width}) - 0.5": (0.3 + width * math.atanh(0.5),),
        f"max(x - 0.3, {-width}) + {width / 2}": (0.3 - width / 2,),
        f"where(x > 0.3, 1, -1)*tanh((x - 0.3 - {width})/{width})": (0.3, 0.3 + width),
    }
    run = vv.simulate(FREE, 20.0, initial=[0, 1], events=list(layers), **step)
    for (text, levels), found in zip(layers.items(), run.events, strict=True):
        expected = np.sort(np.concatenate([passes(level, 20.0) for level in levels]))
        assert found.t.size == expected.size, text
        np.testing.assert_allclose(found.t, expected, atol=1e-11, err_msg=text)
        np.testing.assert_allclose(found.state[:, 0], np.sin(expected), atol=1e-11, err_msg=text)


def with_memory():
    kernel = vv.RzhanitsynKernel(amplitude=0.1, alpha=0.3, beta=0.2)
    return vv.PolynomialSystem(mass=1, stiffness=1, forces="0.4*x^3", kernel=kernel)


def chain(kernel=None):
    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    spring = vv.Spring(on="x1", stiffness=0.4, law="0.5*d^3", kernel=kernel)
    return vv.Structure(
        mass=[1.0, 2, 1], stiffness=stiffness, damping=0.03 * stiffness, elements=[spring]
    )


@pytest.mark.parametrize(
    ("system", "name", "method"),
    [
        (DUFFING, "x", "gauss8"),
        (DUFFING, "x", "gauss16"),
        (DUFFING, "x", "verner9"),
        (DUFFING, "x", "gauss3"),
        (vv.PolynomialSystem(mass=1, stiffness=1, forces="2*max(x - 0.2, 0)"), "x", "gauss8"),
        (with_memory(), "x", "gauss8"),
        (chain(), "x1", "gauss8"),
        (chain(vv.PronyKernel(weights=[0.3], rates=[1.5])), "x2", "gauss8"),
    ],
)
def test_layers_as_the_levels_where_they_begin(system, name, method):
    """The zeros of a layer are at two levels of the coordinate, found by plain events."""
    n = 6 if isinstance(system, vv.Structure) else 2
    start = [0.3, 0.8] * (n // 2)
    step = {"dt": 0.01} if method == "gauss3" else {}
    for width in (1e-2, 1e-4, 1e-6):
        half = width * math.sqrt(math.log(2))
        events = [f"exp(-(({name} - 0.1)/{width})^2) - 0.5"]
        events += [f"{name} - {0.1 + sign * half!r}" for sign in (-1, 1)]
        layer, low, high = vv.simulate(
            system, 12.0, initial=start, method=method, events=events, **step
        ).events
        expected = np.sort(np.concatenate([low.t, high.t]))
        assert layer.t.size == expected.size > 2
        np.testing.assert_allclose(layer.t, expected, atol=1e-10)


def test_random_functions_against_fine_samples():
    """Products, sums, minima and maxima of layers along a motion by SciPy."""
    rng = np.random.default_rng(12)

    def simple():
        what = ("x", "x_dot", "(x + 0.3*x_dot)")[int(rng.integers(3))]
        place = rng.uniform(-0.4, 0.4)
        width = 10 ** rng.uniform(-4, -1)
        z = f"({what} - ({place:.3f}))/{width:.2e}"
        return (
            f"(exp(-({z})^2) - 0.4)", f"(1/(1 + ({z})^2) - 0.3)", f"(tanh({z}) - 0.2)",
            f"(sin(40*{what}) - 0.3)", f"(abs({what} - ({place:.3f})) - {width:.2e})",
            f"(x*x_dot - ({place:.3f})*0.3)",
        )[int(rng.integers(6))]  # fmt: skip

    forms = ("{}*{}", "{} + {}", "min({}, {})", "max({}, {})")
    events = [forms[i % 4].format(simple(), simple()) for i in range(24)]
    run = vv.simulate(DUFFING, 6.0, initial=[0.3, 0.8], dt=0.2, events=events)
    reference = solve_ivp(
        lambda t, y: [y[1], -0.1 * y[1] - y[0] - y[0] ** 3], (0, 6), [0.3, 0.8], "DOP853",
        rtol=1e-12, atol=1e-13, dense_output=True, max_step=0.05,
    ).sol  # fmt: skip
    times = np.linspace(0, 6, 400_001)
    states = reference(times)
    for text, found in zip(events, run.events, strict=True):
        values = eval(text.replace("^", "**"), WORDS, {"x": states[0], "x_dot": states[1]})
        changes = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
        assert found.t.size == changes.size, text
        np.testing.assert_allclose(found.t, times[changes], atol=2e-5, err_msg=text)


def test_a_thin_terminal_event_ends_the_run_at_the_first():
    run = vv.simulate(
        FREE, 20.0, initial=[0, 1], dt=0.5, keep="last",
        events=[vv.Event("exp(-((x - 0.3)/1e-5)^2) - 0.5", direction="down", terminal=True)],
    )  # fmt: skip
    assert run.outcome == "event"
    level = 0.3 + 1e-5 * math.sqrt(math.log(2))
    assert run.t_reached == pytest.approx(math.asin(level), abs=1e-12)
    np.testing.assert_allclose(run.state[-1], [level, math.sqrt(1 - level**2)], atol=1e-11)


def test_many_passages_in_one_step():
    """2000 sin(t) crosses every multiple of pi: more than 300 per step."""
    run = vv.simulate(FREE, 1.5, initial=[0, 1], dt=0.3, events="sin(2000*x + 1)")
    expected = np.arcsin((np.arange(1, 636) * math.pi - 1) / 2000)
    expected = expected[expected < 1.5]
    np.testing.assert_allclose(run.events[0].t, expected, atol=1e-11)


def test_touching_is_no_passage():
    """Functions that touch 0, or are 0 for a while, have no event."""
    events = ["(x - 0.3)^2", "abs(x - 0.3)", "max(x - 0.3, 0)", "x - abs(x)", "1 - cos(50*x)"]
    run = vv.simulate(FREE, 20.0, initial=[0, 1], events=events)
    assert [e.t.size for e in run.events] == [0] * len(events)


def test_what_cannot_be_resolved_is_reported():
    """Below the rounding error of the motion: a warning with the event and the count."""
    with pytest.warns(vv.RangeWarning, match=r"events\[1\].* changes too fast in [34] steps"):
        run = vv.simulate(
            FREE, 7.0, initial=[0, 1], events=["x - 0.3", "exp(-((x - 0.3)/1e-18)^2) - 0.5"]
        )
    assert run.events[0].t.size == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vv.simulate(FREE, 7.0, initial=[0, 1], events="exp(-((x - 0.3)/1e-10)^2) - 0.5")


def test_sections_on_a_thin_surface():
    """Ensembles find them like single runs."""
    text = "tanh((x - 0.3)/1e-5) - 0.5"
    many = vv.simulate_ensemble(
        FREE, initial=[[0, 1], [0, 0.8]], t_end=12.0, dt=0.4, sections=vv.Event(text)
    )
    for i, speed in enumerate((1.0, 0.8)):
        one = vv.simulate(FREE, 12.0, dt=0.4, initial=[0, speed], events=text).events[0]
        found = many.sections[i]
        np.testing.assert_allclose(found[~np.isnan(found[:, 0])], one.state, atol=1e-12)
