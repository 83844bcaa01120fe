"""Energy loss of elements per period: the work of the loads equals the sum of the losses."""

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

#: Elements that are combined in one structure without sticking.
TOGETHER = [name for name in ELEMENTS if name != "friction"]


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("names", [*([name] for name in ELEMENTS), TOGETHER])
def test_what_is_fed_is_lost(names):
    """Work of load and supports, minus the loss of the structural damping."""
    loaded = {"load": [0.7, 0.2]} if len(names[0]) % 2 else {"base": 0.15, "load": [0, 0.4]}
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
        # In the frame of the base the base acceleration is a load, -M a.
        push = np.outer(load, k == 1) + (k * nu) ** 2 * base
        fed = np.pi * (k * (push * relative[i].conj()).imag.sum(axis=0)).sum()
        own = np.pi * nu * (k**2 * np.einsum("ak,ab,bk->k", relative[i].conj(), DAMPING,
                                             relative[i]).real).sum()  # fmt: skip
        assert lost[i].sum() == pytest.approx(fed - own, abs=2e-6 * max(abs(fed), own))


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


#: Forces of a system of two coordinates, with dampers of each kind.
SPRINGS = {
    "dashpots": {"damping": DAMPING, "forces": {"x1": "0.3*x1^3"}},
    "quadratic": {"forces": {"x2": "0.2*x2_dot*abs(x2_dot) + 0.3*x2^3"}},
    "friction": {"forces": {"x1": "0.05*tanh((x1_dot - x2_dot)/0.05)",
                            "x2": "-0.05*tanh((x1_dot - x2_dot)/0.05)"}},
    "gap": {"forces": {"x1": "5*max(x1 - 0.2, 0)*(1 + 0.3*x1_dot)"}, "damping": 0.5 * DAMPING},
    "memory": {"forces": {"x1": "0.2*x1^3 + 0.1*sin(x1)"},
               "kernel": vv.PronyKernel(weights=[0.3], rates=[0.8]), "damping": DAMPING},
    "follower": {"springs": [vv.Springs(stiffness=[[0.5, 0.3], [-0.3, 0.5]])],
                 "damping": DAMPING, "forces": {"x1": "0.3*x1^3"}},
    "several": {
        "damping": DAMPING, "forces": {"x1": "0.1*sin(x1 - x2) + 0.2*x1_dot^3"},
        "springs": [
            vv.Springs(stiffness=[[1, -1], [-1, 1]],
                       kernel=vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.2)),
            vv.Springs(forces={"x2": "0.3*x2*abs(x2) + 0.1*tanh(x2_dot)"}),
        ],
    },
}  # fmt: skip


def _integrated(system, nu, k, y):
    """Work of dampers and text forces per period: a sum over 2^17 samples, no memory."""
    theta = 2 * np.pi * np.arange(2**17) / 2**17
    waves = np.exp(1j * np.outer(theta, k))
    u, v = (waves @ y.T).imag, (waves @ (1j * k * nu * y).T).imag
    named = {"x1": u[:, 0], "x2": u[:, 1], "x1_dot": v[:, 0], "x2_dot": v[:, 1]}
    named |= {name: getattr(np, name) for name in ("sin", "tanh", "abs")}
    named["max"] = np.maximum
    work = [((v @ np.asarray(system.damping)) * v).sum(axis=1)]
    for part in (system, *system.springs):
        stiffness = np.zeros((2, 2)) if part.stiffness is None else np.asarray(part.stiffness)
        power = ((u @ stiffness.T) * v).sum(axis=1)
        for name, law in (part.forces or {}).items():
            power = power + eval(law.replace("^", "**"), {}, named) * named[f"{name}_dot"]
        work.append(power)
    return np.array(work).mean(axis=1) * 2 * np.pi / nu


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("name", SPRINGS)
def test_a_system_loses_what_it_is_fed(name):
    """Each part against its integral by NumPy; their sum against the work of load and base."""
    place = list(SPRINGS).index(name)
    base, branch = (None, 0.15)[place % 2], place % 3 == 0
    system = vv.PolynomialSystem(
        mass=[1, 2], stiffness=STIFFNESS, base_direction=[1, 1], **SPRINGS[name]
    )
    load = [0.7, 0.2j]
    if branch:
        r = vv.trace_response(
            system, load_range=(0.5, 1), nu=0.8, load=load, base=base, harmonics=25, max_points=9,
            stability=False,
        )  # fmt: skip
    else:
        r = vv.forced_response(
            system, [0.7, 1.1], load=load, base=base, method="newton", harmonics=25
        )
    lost, k = r.dissipation(), r.harmonics
    assert lost.shape == (r.nu.size, 2 + len(system.springs))
    factors = r.load_factor if branch else np.ones(r.nu.size)
    for i in range(0, r.nu.size, 4):
        nu, factor = r.nu[i], factors[i]
        moved = np.outer([1, 1], k == 1) * (base or 0) * factor
        y = r.coefficients[i] - moved
        push = np.outer(load, k == 1) * factor + (k * nu) ** 2 * (np.diag([1, 2]) @ moved)
        fed = np.pi * (k * (push * y.conj()).imag.sum(axis=0)).sum()
        assert lost[i].sum() == pytest.approx(fed, rel=1e-5, abs=1e-9)
        expected = _integrated(system, nu, k, y)
        for j, group in enumerate(system.groups, start=1):
            if group.kernel is not None:
                expected[j] = lost[i, j]
        assert lost[i] == pytest.approx(expected, rel=1e-6, abs=1e-7 * abs(fed))


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
