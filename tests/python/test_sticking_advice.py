"""If harmonic balance fails because a body sticks, the message gives advice; else it does not."""

import warnings

import pytest
import viscovib as vv

ADVICE = "a body may stick, which harmonics do not represent: use simulate"


def one(force):
    return vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces=force)


def on_spring(law):
    return vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]], elements=[vv.Spring(on="x1", law=law)]
    )


@pytest.mark.parametrize(
    ("system", "load"),
    [
        (one("0.3*sign(x_dot)"), 0.2),
        (one("0.3*(x_dot > 0) - 0.15"), 0.1),
        (on_spring("0.3*sign(v)"), [0.2]),
    ],
)
def test_what_sticks_is_reported(system, load):
    with pytest.raises(vv.InputError) as error:
        vv.trace_response(system, (0.5, 1.6), load=load, harmonics=15)
    assert "no solution was found at the start 0.5" in str(error.value)
    assert ADVICE in str(error.value)
    with pytest.warns(vv.ConvergenceWarning, match=ADVICE):
        found = vv.forced_response(system, [0.5], load=load, harmonics=15)
    assert not found.converged.any()


def test_branch_that_ends_tells_why():
    with warnings.catch_warnings(record=True) as reported:
        warnings.simplefilter("always")
        branch = vv.trace_response(
            one("0.3*sign(x_dot)"), (1.0, 0.3), load=0.5, harmonics=31, stability=False
        )
    assert branch.outcome == "stuck"
    assert any("the branch ends at nu = 0.6" in str(x.message) and ADVICE in str(x.message)
               for x in reported)  # fmt: skip


@pytest.mark.parametrize(
    "force",
    ["-0.3*sign(x_dot)", "0.3*x_dot*abs(x_dot)", "0.3*tanh(x_dot/1e-6)", "0.3*sign(x)"],
)
def test_what_cannot_stick_is_not_reported(force):
    from viscovib.systems.sticking import advice_on_sticking

    assert advice_on_sticking(one(force)) == ""
    assert ADVICE in advice_on_sticking(one(f"({force}) + 0.1*sign(x_dot)")) or "-0.3" in force
