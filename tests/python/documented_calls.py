"""Calls of the documentation with the types of their results.

mypy reads this file with the package, and `test_signatures` runs it. `assert_type` concerns mypy
only. A call that mypy must reject is marked; mypy reports unnecessary marks.
"""

from typing import assert_type

import viscovib as vv

DUFFING = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
MOUNT = vv.Mount(
    mass=1, inertia=1, offset=0.1, stiffness_x=1, stiffness_phi=2, damping=[[0.2, 0], [0, 0.2]]
)
SWUNG = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.02, c2=0.02, c3=0.02, m01=0.005, p2=0.37)


def responses() -> None:
    """Results of `forced_response` for each kind of system."""
    assert_type(vv.forced_response(DUFFING, [0.5, 3.0], load=0.1), vv.Response)
    r = vv.forced_response(
        system=MOUNT, nu=3.0, load={1: 0.01}, method="newton", harmonics="auto", stability=True
    )
    assert_type(r, vv.Response)
    assert_type(vv.forced_response(MOUNT, 3.0, base=0.01, relaxation="auto"), vv.Response)
    assert_type(vv.forced_response(SWUNG, harmonics="auto"), vv.DrivenResponse)
    assert_type(vv.forced_response(SWUNG, 0.37, harmonics=9), vv.DrivenResponse)
    assert_type(vv.forced_response(SWUNG, p2=[0.36, 0.37], harmonics=9), vv.DrivenResponse)
    assert_type(vv.plan_response(DUFFING, 3.0, load=0.1, harmonics="auto"), vv.Plan)


def branches() -> None:
    """Results of `trace_response`."""
    branch = vv.trace_response(DUFFING, (0.3, 0.5), load=0.1, harmonics="auto", symmetric=True)
    assert_type(branch, vv.Branch)
    nonlinear = vv.trace_response(DUFFING, nu=0.5, load_range=(0.1, 0.2), load=1, at=[0.15])
    assert_type(nonlinear, vv.Branch)
    assert_type(vv.trace_response(SWUNG, p2=(0.36, 0.37), harmonics="auto"), vv.DrivenBranch)
    assert_type(vv.trace_response(SWUNG, nu=(0.36, 0.37), at=[0.365]), vv.DrivenBranch)


def backbones() -> None:
    """Results of `backbone`."""
    assert_type(vv.backbone(DUFFING, 0, (0.1, 0.2), harmonics="auto"), vv.Backbone)
    assert_type(vv.backbone(SWUNG, 1, energy_range=(1e-6, 2e-6), harmonics=9), vv.Backbone)


def motions() -> None:
    """Results of motions in time."""
    assert_type(vv.simulate(DUFFING, 1.0, dt="auto", initial=[0.1, 0]), vv.Trajectory)
    run = vv.simulate(SWUNG, 1.0, initial=[0, 0, 0.1, 0, 0, 0], method="gauss8")
    assert_type(run, vv.Trajectory)
    many = vv.simulate_ensemble(SWUNG, initial=[0, 0, 0.1, 0, 0, 0], t_end=1.0, statistics=True)
    assert_type(many, vv.Ensemble)


REFUSED = [
    lambda: vv.forced_response(SWUNG, load=0.1),  # type: ignore[call-overload]
    lambda: vv.forced_response(DUFFING, load=0.1),  # type: ignore[call-overload]
    lambda: vv.forced_response(DUFFING, 3.0, load=0.1, p2=0.3),  # type: ignore[call-overload]
    lambda: vv.trace_response(SWUNG, load_range=(1, 2)),  # type: ignore[call-overload]
    lambda: vv.trace_response(DUFFING, (1, 2), load=1, subharmonic=2),  # type: ignore[call-overload]
    lambda: vv.backbone(DUFFING, 0, energy_range=(0.1, 1)),  # type: ignore[call-overload]
    lambda: vv.backbone(DUFFING, 0, (0.1, 1), stability=True),  # type: ignore[call-overload]
]
