"""Properties of all options of curves, read from their table."""

import inspect
import warnings

import numpy as np
import pytest
import viscovib as vv
from viscovib.common import progress
from viscovib.common.curve_options import OPTIONS, WHOLE
from viscovib.common.parameters import TOLERANCE

DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
SYSTEM = """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='x^3' /
&load amplitude=0.3 /
"""
CURVES = {
    "branch": "&branch nu_from=0.4 nu_to=2.5 max_step=0.3 {} /\n",
    "backbone": "&backbone from=0.1 to=2 {} /\n",
}


def trace(**options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        return vv.trace_response(DUFFING, (0.4, 2.5), load=0.3, **options)


USUAL = trace()


def test_the_bounds_of_tolerance_are_those_of_all_methods():
    one = OPTIONS["tolerance"]
    assert (one.lowest, one.highest) == (TOLERANCE.lowest, TOLERANCE.highest)


@pytest.mark.parametrize("name", OPTIONS)
def test_its_default_is_what_is_taken_and_another_value_changes_the_curve(name):
    np.testing.assert_array_equal(
        trace(**{name: OPTIONS[name].default}).coefficients, USUAL.coefficients
    )
    other = trace(**{name: OPTIONS[name].other})
    assert not np.array_equal(other.nu, USUAL.nu)


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("function", [vv.trace_response, vv.backbone])
def test_it_is_an_argument_that_help_explains(name, function):
    one = inspect.signature(function).parameters[name]
    assert one.default == OPTIONS[name].default
    assert isinstance(one.default, int) == (name in WHOLE)
    kind = "int" if name in WHOLE else "float"
    assert f"{name} : {kind}\n" in function.__doc__ or not OPTIONS[name].text
    assert "**curve" not in function.__doc__


@pytest.mark.parametrize("name", OPTIONS)
def test_what_is_not_allowed_is_refused_by_every_face(tmp_path, name):
    one = OPTIONS[name]
    scene = tmp_path / "scene.nml"
    for wrong in (-1 if name in WHOLE or not one.lowest else 0.9 * one.lowest, 1.1 * one.highest):
        value = int(wrong) if name in WHOLE else wrong
        refused = f"{name} = .*: must be"
        with pytest.raises(vv.InputError, match=refused):
            trace(**{name: value})
        with pytest.raises(vv.InputError, match=refused):
            vv.backbone(DUFFING, 0, (0.1, 2), **{name: value})
        with pytest.raises(vv.InputError, match=refused):
            vv.trace_response(vv.Pendulum(e=0.1, w2=0.4, w3=0.8), p1=(1, 2), **{name: value})
        for group in CURVES.values():
            if name == "max_step":
                group = group.replace("max_step=0.3", "")
            scene.write_text(SYSTEM + group.format(f"{name}={value}"))
            with pytest.raises(vv.InputError, match=refused):
                vv.run(scene)


CORNERS = ["0.2*abs(x1)*x1", "max(x1 - 0.1, 0)", "0.1*tanh(x1_dot) + 0.3*where(x1 > 0.2, x1, 0.2)"]


def by_structure(law):
    spring = vv.Spring(on="x1", law=law.replace("x1_dot", "v").replace("x1", "d"))
    return vv.Structure(mass=[1.0], stiffness=[1.0], damping=[0.1], elements=[spring])


@pytest.mark.parametrize("law", [*CORNERS, "0.2*tanh(x1_dot)", "x1^3", "0.3*exp(x1)*x1"])
def test_laws_with_corners_have_a_larger_tolerance(law, tmp_path):
    usual = 1e-6 if law in CORNERS else 1e-10
    reported = "a relative error of 1e-6 (a law has corners)"
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law, names=["x1"])
    for one in (system, by_structure(law)):
        response = vv.forced_response(one, [0.5], load={"x1": 0.1})
        branch = vv.trace_response(one, (0.5, 0.55), load={"x1": 0.1}, stability=False)
        for result in (response, branch):
            assert result._tolerance == usual
            assert (reported in str(result.plan)) == (law in CORNERS)
        assert vv.forced_response(one, [0.5], load={"x1": 0.1}, rtol=1e-7)._tolerance == 1e-7
    scene = tmp_path / "scene.nml"
    for group in ("response nu=0.5", "branch nu_from=0.5 nu_to=0.55 stability='no'"):
        scene.write_text(
            "&system coordinates='x1' mass=1 stiffness=1 damping=0.1 /\n"
            f"&force on='x1' law='{law}' /\n&load amplitude=0.1 /\n&{group} /\n"
        )
        result = vv.run(scene).value
        assert getattr(result, "branch", result)._tolerance == usual


@pytest.mark.parametrize("shown", [False, True])
def test_a_bar_counts_points_where_it_is_wanted(monkeypatch, capsys, shown):
    monkeypatch.setattr(progress, "_PATIENCE", 0.001)
    monkeypatch.setattr(progress, "_LOOK", 0.001)
    branch = vv.trace_response(DUFFING, (0.3, 3), load=0.3, max_step=0.005, progress=shown)
    curve = vv.backbone(DUFFING, 0, (0.01, 1), max_step=0.005, progress=shown)
    assert branch.outcome == curve.outcome == "completed"
    bars = capsys.readouterr().err
    assert bars.count(" points") >= 2 if shown else not bars


def test_a_bar_is_wanted_or_not():
    with pytest.raises(vv.InputError, match="progress"):
        vv.trace_response(DUFFING, (0.3, 3), load=0.3, progress=2)
    with pytest.raises(TypeError, match="progres"):
        vv.trace_response(DUFFING, (0.3, 3), load=0.3, progres=True)
