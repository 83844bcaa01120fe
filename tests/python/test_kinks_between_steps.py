"""Kinks of laws inside steps, with memory: true errors are below the stated errors."""

import numpy as np
import pytest
import viscovib as vv
from viscovib.analyses.runs import NotMetError

#: Laws, and whether they are behind the kernel.
LAWS = [
    ("2*max(d - 0.1, 0)", False),
    ("0.5*max(d - 0.05, 0)^1.5", False),
    ("4*abs(d - 0.1)*d", False),
    ("2*abs(d)*v", True),
]


def simulated(law, load, **given):
    """A mass on rubber; the law is behind the kernel or in parallel."""
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.5])
    springs = [law, vv.Spring(on="x1", law="0.5*d + 0.2*d^3", kernel=kernel)]
    system = vv.Structure(mass=[1.0], stiffness=[1.4], damping=[0.1], elements=springs)
    given = {"load": {"x1": load}, "nu": 1.25, "initial": [0.4, 0.25], "keep": "last", **given}
    return vv.simulate(system, 5.0, **given)


@pytest.mark.parametrize(("law", "behind"), LAWS)
def test_errors_hold(law, behind):
    """Against runs with steps that end at kinks; a comparison of two runs fails in some cases."""
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.5]) if behind else None
    spring = vv.Spring(on="x1", law=law, kernel=kernel)
    beyond = []
    for load in 0.3 + 0.05 * np.arange(10):
        true = simulated(spring, load, tolerance=1e-9)
        try:
            run = simulated(spring, load, tolerance=1e-6, memory="direct")
        except NotMetError:
            continue
        assert run.error <= 1e-6
        beyond.append(np.abs(run.state - true.state).max() / run.error)
    assert len(beyond) >= 6
    assert max(beyond) <= 1


def test_a_kink_near_the_end_of_all_steps():
    """It is missed equally with steps h, h/2 and h/4: a run with other step ends detects it."""
    spring = vv.Spring(on="x1", law="4*abs(d - 0.1)*d")
    run = simulated(spring, 0.396, tolerance=1e-6, memory="direct")
    true = simulated(spring, 0.396, tolerance=1e-9)
    assert np.abs(run.state - true.state).max() <= run.error


@pytest.mark.parametrize("step", [0.1, 0.05])
@pytest.mark.parametrize("law", [law for law, _ in LAWS[1:3]])
def test_errors_at_given_steps(law, step):
    """Steps divided by three are compared too, and the remaining error of finer runs is added."""
    spring = vv.Spring(on="x1", law=law)
    beyond = []
    for load in 0.3 + 0.04 * np.arange(10):
        true = simulated(spring, load, tolerance=1e-9)
        run = simulated(spring, load, dt=step, estimate_error=True, memory="direct")
        beyond.append(np.abs(run.state - true.state).max() / run.error)
    assert "and a third of the step" in str(run.plan)
    assert max(beyond) <= 1


def test_smooth_laws_take_no_third_run():
    """A kink outside the motion requires one more run; a law without kinks none."""
    steps = [
        simulated(vv.Spring(on="x1", law=law), 0.4, tolerance=1e-3, memory="direct").stats["steps"]
        for law in ("0.3*sin(d)", "0.3*sin(d) + max(d - 9, 0)")
    ]
    assert steps[1] == 2 * steps[0]
