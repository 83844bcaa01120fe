"""Energy loss of elements per period: the work of the loads equals the sum of the losses."""

import warnings

import numpy as np
import pytest
import viscovib as vv

STIFFNESS = np.array([[2.0, -1], [-1, 2]])
DAMPING = np.array([[0.06, -0.01], [-0.01, 0.05]])


@pytest.mark.parametrize(
    "element",
    [
        vv.Spring(on="x1", law="0.3*v*abs(v) + 0.2*v", damping=0.1),
        vv.Spring(on="x1", law="0.3*d^3 + sin(d)", kernel=vv.PronyKernel(weights=[0.3], rates=[1])),
        vv.Coupling(on={"a": "x1", "b": "x2"}, law={"a": "a*b*a_dot", "b": "0.3*b^2*b_dot"}),
        vv.Jenkins(on="x2", stiffness=3, limit=0.02),
    ],
    ids=lambda element: type(element).__name__,
)
def test_a_linear_motion_loses_by_linear_forces(element):
    """In a linear motion only the linear part of a law dissipates."""
    structure = vv.Structure(
        mass=np.eye(2), stiffness=STIFFNESS, damping=DAMPING, elements=[element]
    )
    r = vv.forced_response(structure, [0.8], load=[1, 0], method="linear")
    x = r.coefficients[0, :, 0]
    own = np.pi * 0.8 * (x.conj() @ DAMPING @ x).real
    assert r.dissipation()[0, 0] == pytest.approx(-np.pi * x[0].imag - own, rel=1e-9, abs=1e-12)


def test_a_slider_loses_what_its_formula_says():
    """4 F_s (a - F_s/k), also along a branch."""
    slider = vv.Jenkins(on="x1", stiffness=20, limit=0.3)
    structure = vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[slider])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        branch = vv.trace_response(
            structure, (0.8, 1.2), load=[1.2], harmonics=31, stability=False, tolerance=1e-9
        )
    a = branch.peak_to_peak("x1") / 2
    assert branch.dissipation()[:, 0] == pytest.approx(4 * 0.3 * (a - 0.3 / 20), rel=1e-10)
    assert (a > 0.015).all()


def test_a_branch_over_a_parameter_is_refused():
    """Its elements differ at each point."""
    spring = vv.Spring(on="x1", law="k3*d^3", parameters={"k3": 1.0})
    structure = vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[spring])
    branch = vv.trace_response(
        structure, nu=1.0, load=[0.1], vary="elements[0].k3", vary_range=(1, 2), stability=False
    )
    with pytest.raises(vv.InputError, match="dissipation: the system changes along a branch"):
        branch.dissipation()


def test_a_large_system_loses_what_it_is_fed():
    """A condensed system, with two coordinates in the result; also linear motions."""
    n = 8
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    system = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=chain, damping=0.05 * chain,
        forces={"x1": "0.3*x1_dot^3 + 0.5*x1^3"},
    )  # fmt: skip
    load = np.zeros(n)
    load[3] = 0.5
    for method in ("newton", "linear"):
        r = vv.forced_response(system, [0.4, 1.0], load=load, method=method)
        lost = r.dissipation()
        fed = -np.pi * 0.5 * r.coefficient("x4", 1).imag
        assert lost.shape == (2, 2)
        assert lost.sum(axis=1) == pytest.approx(fed, rel=1e-9)
        assert (lost[:, 1] > 0).all() == (method == "newton")


def test_a_mount_has_no_such_parts():
    """Its springs are not groups: refused."""
    mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
    r = vv.forced_response(mount, [1.0], load=0.1)
    with pytest.raises(vv.InputError, match=r"is of a PolynomialSystem.*this is of Mount"):
        r.dissipation()


def test_a_body_on_a_base_that_tilts_loses_what_it_is_fed():
    """A base with an amplitude and a phase for each coordinate."""
    mounts = [
        vv.MountPoint(
            name=name, position=place, stiffness=[1e4, 1e4, 2e4], damping=[20, 20, 30],
            law=["0", "0", "1e8*d^3"], kernel=vv.PronyKernel(weights=[0.2], rates=[15.0]),
        )
        for name, place in (("a", [0.1, 0.2, 0]), ("b", [-0.1, 0.1, 0]), ("c", [0, -0.2, 0.1]))
    ]  # fmt: skip
    body = vv.Body(mass=10, inertia=[0.3, 0.2, 0.4], mounts=mounts)
    moved = np.array([0, 0, 1e-3, 2e-3j, 1e-3, 0])
    load = np.array([0, 0, 50, 0, 1, 0])
    r = vv.forced_response(body, [30.0], load=load, base=moved, method="newton", harmonics=9)
    k = r.harmonics
    base = np.outer(moved, k == 1)
    y = r.coefficients[0] - base
    push = np.outer(load, k == 1) + (k * 30.0) ** 2 * (np.asarray(body.mass) @ base)
    fed = np.pi * (k * (push * y.conj()).imag.sum(axis=0)).sum()
    assert r.dissipation().sum() == pytest.approx(fed, rel=1e-8)
    assert (r.sampling == 0).all()
