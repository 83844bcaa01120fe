"""Steady motions outside the domain of a force law: the law and the location are named."""

import warnings

import numpy as np
import pytest
import viscovib as vv

#: Laws by the location of their end.
LAWS = [("log({e} + x) - log({e})", -1), ("sqrt({e} - x) - sqrt({e})", 1), ("-asin(x/{e})", 1)]


def reported_by(call):
    """Texts of warnings and refusals."""
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        try:
            call()
        except vv.InputError as error:
            return str(error)
    return "\n".join(str(one.message) for one in given)


@pytest.mark.parametrize("seed", range(3))
def test_the_law_and_its_end_are_named(seed):
    rng = np.random.default_rng(seed)
    form, side = LAWS[seed % 3]
    edge, load = float(rng.uniform(0.5, 2)), float(rng.uniform(4, 8))
    law = form.format(e=repr(edge))
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law)
    shown = law.replace("x", "d").replace("-adin", "-asin")
    element = vv.Spring(on="x", law=shown)
    structure = vv.Structure(
        mass=[1], stiffness=[[1]], damping=[[0.1]], names=["x"], elements=[element]
    )
    for body, text, name in ((system, law, "x"), (structure, shown, "d")):
        expected = f"the law {text!r} has no value beyond {name} = {side * edge:.6g}"
        for method in ("newton", "successive"):
            found = reported_by(
                lambda body=body, method=method: vv.forced_response(
                    body, [0.7, 0.9], load=edge * load, method=method, max_iterations=60
                )
            )
            assert expected in found
        try:
            ended = vv.simulate(body, 30, load=edge * load, nu=0.9).reason
        except vv.InputError as error:
            ended = str(error)
        assert ended is not None
        assert expected in ended
    assert f"the law {law!r} has no value beyond" in reported_by(
        lambda: vv.trace_response(system, (0.7, 0.9), load=edge * load, harmonics=9)
    )


def test_what_has_no_end_is_not_reported():
    """A law that is defined everywhere is not named as a reason."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="-0.5*tanh(x)*x^2")
    found = reported_by(lambda: vv.forced_response(system, [0.9], load=50, method="newton"))
    assert "has no value" not in found
