"""Energy lost in a period by elements: what the loads feed is what all of them take."""

import warnings

import numpy as np
import pytest
import viscovib as vv

STIFFNESS = np.array([[2.0, -1], [-1, 2]])
DAMPING = np.array([[0.06, -0.01], [-0.01, 0.05]])
ELEMENTS = {
    "dashpot": vv.Spring(on=("x1", "x2"), damping=0.1, stiffness=0.5),
    "quadratic": vv.Spring(on="x2", law="0.2*v*abs(v) + 0.3*d^3"),
    "friction": vv.Spring(on="x1", law="0.05*sign(v)"),
    "smooth": vv.Spring(on=("x1", "x2"), law="0.1*tanh(v/0.3) + sin(d)"),
    "memory": vv.Spring(
        on="x1", stiffness=1, law="0.2*d^3",
        kernel=vv.PronyKernel(weights=[0.3], rates=[0.8]),
    ),
    "jenkins": vv.Jenkins(on="x1", stiffness=3, limit=0.2),
    "iwan": vv.Iwan(on="x2", stiffness=[2, 1], limit=[0.1, 0.2]),
    "bouc-wen": vv.BoucWen(on="x1", stiffness=1, beta=4, gamma=2, ratio=0.1),
    "gap": vv.Gap(on="x1", stiffness=20, gap=0.2),
    "coupling": vv.Coupling(
        on={"a": "x1", "b": "x2"}, law={"a": "0.3*a_dot*b^2", "b": "0.3*a^2*b_dot"}
    ),
}  # fmt: skip

#: All that move together without sticking.
TOGETHER = [name for name in ELEMENTS if name != "friction"]


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("names", [*([name] for name in ELEMENTS), TOGETHER])
@pytest.mark.parametrize("loaded", [{"load": [0.7, 0.2]}, {"base": 0.15, "load": [0, 0.4]}])
def test_what_is_fed_is_lost(names, loaded):
    """Work of load and supports, less that of the structure's own damping."""
    structure = vv.Structure(
        mass=np.eye(2), stiffness=STIFFNESS, damping=DAMPING, base_direction=[1, 1],
        elements=[ELEMENTS[name] for name in names],
    )  # fmt: skip
    r = vv.forced_response(structure, [0.7, 1.1], method="newton", harmonics=25, **loaded)
    lost = r.dissipation()
    assert lost.shape == (2, len(names))
    k, x = r.harmonics, r.coefficients
    load = np.array(loaded["load"], dtype=complex)
    base = np.outer(np.ones(2), k == 1) * loaded.get("base", 0.0)
    relative = x - base
    for i, nu in enumerate(r.nu):
        # In the frame of the base its acceleration is a load, -M a.
        push = np.outer(load, k == 1) + (k * nu) ** 2 * base
        fed = np.pi * (k * (push * relative[i].conj()).imag.sum(axis=0)).sum()
        own = np.pi * nu * (k**2 * np.einsum("ak,ab,bk->k", relative[i].conj(), DAMPING,
                                             relative[i]).real).sum()  # fmt: skip
        assert lost[i].sum() == pytest.approx(fed - own, abs=2e-6 * max(abs(fed), own))


def test_a_slider_loses_what_its_formula_says():
    """4 F_s (a - F_s/k), and along a branch too."""
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
    """Its elements are others at each point."""
    spring = vv.Spring(on="x1", law="k3*d^3", parameters={"k3": 1.0})
    structure = vv.Structure(mass=[[1.0]], stiffness=[[1.0]], damping=[[0.1]], elements=[spring])
    branch = vv.trace_response(
        structure, nu=1.0, load=[0.1], vary="elements[0].k3", vary_range=(1, 2), stability=False
    )
    with pytest.raises(vv.InputError, match="dissipation: elements change along a branch"):
        branch.dissipation()
