"""Motions that reach the end of the domain of a law: reported with law, location and time."""

import math
import re
import warnings

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from viscovib.systems.sticking import advice_on_sticking

#: Laws of x, the sign of the side of their end, and their kind.
LAWS = {
    "{k}*log(1 + x/{e})": (-1, lambda x, k, e: k * math.log(1 + x / e)),
    "-{k}*log(1 - x/{e})": (1, lambda x, k, e: -k * math.log(1 - x / e)),
    "{k}*sqrt(1 - x/{e}) - {k}": (1, lambda x, k, e: k * math.sqrt(1 - x / e) - k),
    "-{k}*acos(x/{e}) + {k}*pi/2": (1, lambda x, k, e: -k * math.acos(x / e) + k * math.pi / 2),
}


def other_stop(force, side, edge, start, end):
    """Return the time when a motion approaches the edge, by another program; None: never."""

    def right(t, y):
        x = side * min(side * y[0], edge * (1 - 1e-12))
        return [y[1], -y[0] - 0.02 * y[1] - force(x)]

    def there(t, y):
        return side * y[0] - edge * (1 - 1e-10)

    there.terminal = True
    run = solve_ivp(right, (0, end), start, "DOP853", events=there, rtol=1e-11, atol=1e-12)
    return float(run.t[-1]) if run.status == 1 else None


@pytest.mark.parametrize("text", LAWS)
def test_a_run_tells_which_law_ends_where_and_when(text):
    rng = np.random.default_rng(len(text))
    side, value = LAWS[text]
    seen = set()
    for _ in range(5):
        k, edge = float(rng.uniform(0.1, 0.5)), float(rng.uniform(0.5, 1.5))
        start = [side * 0.3 * edge, side * edge * float(rng.uniform(0, 2))]
        true = other_stop(lambda x, k=k, e=edge: value(x, k, e), side, edge, start, 8.0)
        law = text.format(k=k, e=edge)
        system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces=law)
        structure = vv.Structure(
            mass=[1], stiffness=[[1]], damping=[[0.02]], names=["x"],
            elements=[vv.Spring(on="x", law=law.replace("x", "d"))],
        )  # fmt: skip
        for body, name, job in (
            (system, "x", {"tolerance": 1e-7}),
            (system, "x", {"dt": 0.05, "method": "verner9"}),
            (system, "x", {"dt": 0.05, "keep": "last"}),
            (system, "x", {"dt": 0.05, "events": "x"}),
            (structure, "d", {"dt": 0.05}),
        ):
            run = vv.simulate(body, 8, initial=start, **job)
            assert np.isfinite(run.state).all()
            seen.add(run.outcome)
            if true is None:
                assert (run.outcome, run.reason) == ("completed", None)
                continue
            shown = law.replace("x", name)
            reported = f"the law '{shown}' has no value beyond {name} = {side * edge:.6g}, reached"
            if body is structure and run.outcome == "step too large":
                assert run.t_reached <= true <= run.t_reached + 2 * run.step
                assert run.reason.startswith(reported)
                continue
            assert run.outcome == "diverged"
            # A law may have an infinite slope at its edge.
            assert run.t_reached == pytest.approx(true, abs=2e-5)
            assert run.reason == f"{reported} at t = {run.t_reached:.6g}"
            assert run.reason in repr(run)
    assert "diverged" in seen


def test_of_two_laws_the_one_that_ends_is_named_with_all_that_it_reads():
    system = vv.PolynomialSystem(
        mass=np.eye(2), stiffness=np.eye(2), names=["a", "b"],
        forces={"a": "0.3*log(2 + a - b)", "b": "0.2*sqrt(3 - b) - 0.2*sqrt(3)"},
    )  # fmt: skip
    run = vv.simulate(system, 9, initial=[-0.9, 0, 0.9, 2.0], dt=0.02)
    assert "the law '0.3*log(2 + a - b)' has no value beyond a = " in run.reason
    last = vv.simulate(system, 9, initial=[-0.9, 0, 0.9, 2.0], dt=0.02, keep="last").state[0]
    assert last[0] - last[2] == pytest.approx(-2, abs=1e-9)
    assert f"a = {last[0]:.6g}, b = {last[2]:.6g}" in run.reason


def test_other_ends_are_reported_too():
    soft = vv.PolynomialSystem(mass=1, stiffness=1, forces="-x^3 + 0.01*tanh(x)")
    run = vv.simulate(soft, 20, initial=[1.2, 0.3])
    assert run.reason == f"the motion runs away at t = {run.t_reached:.6g}"
    off = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.3*log(1 + x)")
    run = vv.simulate(off, 20, initial=[-1.5, 0], dt=0.1)
    assert run.reason == "the law '0.3*log(1 + x)' has no value at the start, x = -1.5"
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8)
    run = vv.simulate(body, 20, dt=0.1, initial=(1.3, 0, 0, 0, 0, 0))
    assert run.reason == f"the spring reaches its pivot (z = -1) at t = {run.t_reached:.6g}"


def with_law(law, kernel=None):
    """Return an oscillator with a spring with this law."""
    return vv.Structure(
        mass=[1], stiffness=[[1]], damping=[[0.02]], names=["x"],
        elements=[vv.Spring(on="x", law=law, kernel=kernel)],
    )  # fmt: skip


@pytest.mark.parametrize("kernel", [None, vv.PronyKernel(weights=[0.1], rates=[0.5])])
@pytest.mark.parametrize(
    ("law", "place"),
    [
        ("-0.2/(1 - d) + 0.2", 1.0),
        ("-0.1*tan(2*d)", math.pi / 4),
        ("-0.3/(0.7 - d)^2 + 0.3/0.49", 0.7),
    ],
)
def test_a_pole_is_named_with_its_place_and_time(law, place, kernel):
    """An attracting force: a search of steps stops or fails there; given steps stop or pass it."""
    system = with_law(law, kernel)
    # Attracted, it arrives earlier than with its initial speed.
    soonest, latest = 0.2, place / 2

    def reported(text):
        found = re.search(r"has a pole at d = ([\d.]+), which .* near t = ([\d.]+)", text)
        assert found, text
        assert float(found[1]) == pytest.approx(place, abs=1e-5)
        return float(found[2])

    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        run = vv.simulate(system, 0.6, initial=[0, 2], dt=0.02)
    text = run.reason if run.outcome != "completed" else str(heard[0].message)
    assert soonest < reported(text) < latest + 0.02
    if run.outcome == "completed":
        try:
            text = vv.simulate(system, 0.6, initial=[0, 2]).reason
        except vv.InputError as refusal:
            text = str(refusal)
        assert soonest < reported(text) < latest + 0.02


@pytest.mark.parametrize("law", ["1/(1 - d)^2 - 1", "d/(1 + d^2)", "tanh(d/0.01)", "d/0.1"])
def test_no_pole_is_reported_where_none_is_passed(law, recwarn):
    run = vv.simulate(with_law(law), 3, initial=[0, 2], dt=0.01)
    assert (run.outcome, run.reason) == ("completed", None)
    assert not recwarn.list


#: Laws with an attracting pole at g, smooth laws with a layer of width e there, and others.
POLES = (
    "-{f}/({g} - d)", "{f}*(d - {g})^(-3)", "-{f}/({g} - d)^6", "-{f}/(d^2 - 2*{g}*d + {g}^2)",
    "-{f}*tan(pi/2*d/{g})", "{f}/sin(d/{g} - 1)", "-{f}*exp(d)/(1 - d/{g})",
    "{f}/(tanh(d) - tanh({g}))", "-{f}/abs(d - {g})", "-{f}/((d - {g})^2 - 1e-8)",
)  # fmt: skip
LAYERS = (
    "{f}/(1 + ((d - {g})/{e})^2)", "{f}*exp(-((d - {g})/{e})^2)", "{f}*tanh((d - {g})/{e})",
    "{f}/cosh((d - {g})/{e})", "{f}*{e}^2/({e}^2 + (d - {g})^2)",
)  # fmt: skip
SMOOTH = (
    "{f}*sin(d - {g})/(d - {g})", "{f}/(1 + d^2)", "{f}*where(d < 9, 1, 1/(d - {g}))",
    "{f}*tan(d/9)", "{f}*tanh(d/0.3)",
)  # fmt: skip


@pytest.mark.parametrize("text", [*POLES, *LAYERS, *SMOOTH])
def test_true_poles_are_reported_and_thin_bumps_are_reported_as_layers(text):
    """Smooth bumps grow like poles outside their width; only poles grow without bound."""
    rng = np.random.default_rng(len(text))
    for _ in range(4):
        f, g = float(rng.uniform(0.01, 0.1)), float(rng.uniform(0.4, 0.8))
        e = float(10 ** rng.uniform(-6, -3.3))
        system = with_law(text.format(f=repr(f), g=repr(g), e=repr(e)))
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            run = vv.simulate(system, 3, initial=[0, 2], dt=0.02)
        reported = run.reason or "".join(str(one.message) for one in heard)
        assert ("has a pole" in reported) == (text in POLES), reported
        assert ("a layer thinner" in reported) == (text in LAYERS), reported
        if text not in SMOOTH:
            assert float(re.search(r"d = ([\d.]+)", reported)[1]) == pytest.approx(g, abs=2e-4)
        if text in LAYERS:
            width = float(re.search(r"within (\S+) about", reported)[1])
            assert e < width < 4 * e, reported


@pytest.mark.parametrize(
    ("law", "reported"),
    [
        ("sign(x)*sqrt(abs(x))", "the derivative of 'sign(x)*sqrt(abs(x))' at x = 0 grows"),
        ("abs(x_dot)^0.6*sign(x_dot)", "at x_dot = 0 grows"),
        ("0.5*x*sqrt(abs(x)) + tanh(x/1e-9)", ""),
    ],
)
def test_slopes_without_bound_are_reported(law, reported):
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law)
    said = advice_on_sticking(system)
    assert reported in said
    assert bool(reported) == bool(said)
    if "sqrt(abs(x))" in reported:
        with pytest.warns(vv.ConvergenceWarning, match=r"finds no motion .* grows without bound"):
            vv.forced_response(system, [1.0], load=0.5, method="newton")


@pytest.mark.parametrize("law", ["d*log(abs(d))", "v*abs(v)^-0.4", "d*abs(d)^-0.5"])
def test_laws_without_a_finite_derivative_at_rest_are_refused(law):
    """It would be a stiffness of 1e60, which prevents any motion."""
    reported = "must have a finite derivative at rest"
    with pytest.raises(vv.InputError, match=reported):
        vv.Spring(on="x1", law=law)
    named = law.replace("v", "x_dot").replace("d*", "x*").replace("(d)", "(x)")
    with pytest.raises(vv.InputError, match=reported):
        vv.PolynomialSystem(mass=1, stiffness=1, forces=named)
    with pytest.raises(vv.InputError, match=reported):
        vv.MountPoint(name="a", position=(0, 0, 0), stiffness=(1, 1, 1), law=(law, None, None))
