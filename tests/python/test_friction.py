"""Jenkins elements: published motions, derivatives over the cycle, and the energy of a loop."""

import numpy as np
import pytest
import viscovib as vv

#: First harmonics at Omega = 0.9 of example 07 of NLvib (Krack and Gross: three masses, two
#: sliders, cubic springs and a gap), by time integration with two independent programs.
INTEGRATED = [0.051207, 0.101376, 0.085174]
CHAIN = np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])


def three_masses():
    elements = [
        vv.Jenkins(on="x1", stiffness=20, limit=1),
        vv.Jenkins(on=("x2", "x1"), stiffness=20, limit=1),
        vv.Spring(on="x2", law="d^3"),
        vv.Spring(on=("x3", "x2"), law="d^3"),
        vv.Spring(on="x3", law="max(d - gap, 0)", parameters={"gap": 0.25}),
    ]
    return vv.Structure(mass=np.eye(3), stiffness=CHAIN, damping=0.02 * CHAIN, elements=elements)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_three_masses_of_nlvib():
    """First harmonics of the steady motion, to the digits of the reference."""
    found = vv.forced_response(three_masses(), [0.9], load=[0, 1, 0], method="newton", harmonics=63)
    first = np.abs(found.coefficients[0][:, found.harmonics == 1]).ravel()
    np.testing.assert_allclose(first, INTEGRATED, atol=6e-7)


def slider(limit=0.3, **more):
    return vv.Structure(
        mass=[[1.0]], stiffness=[[1.0]], damping=[[0.05]],
        elements=[vv.Jenkins(on="x1", stiffness=5, limit=limit)], **more,
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_branch_and_its_losses():
    """The work of the load equals the loss of damper and slider; stability is unknown."""
    branch = vv.trace_response(slider(), (1.2, 3.0), load=[1.0], harmonics=31, stability=True)
    assert branch.outcome == "completed"
    theta = 2 * np.pi * np.arange(2000) / 2000
    element = vv.Jenkins(on="x1", stiffness=5, limit=0.3)
    slides = 0
    for nu, x in zip(branch.nu, branch.coefficients[:, 0], strict=True):
        u = (x @ np.exp(1j * np.outer(branch.harmonics, theta))).imag
        fed = -np.pi * x[branch.harmonics == 1][0].imag
        damped = np.pi * 0.05 * nu * (branch.harmonics**2 * np.abs(x) ** 2).sum()
        lost = float(element.energy(u))
        slides += lost > 0
        assert fed == pytest.approx(damped + lost, abs=3e-3 * fed)
    assert slides > 10


def test_what_never_slides_is_a_spring():
    """Below its limit it is linear and dissipates nothing."""
    found = vv.forced_response(slider(10.0), [1.2], load=[0.1], method="newton")
    expected = 0.1 / (6 - 1.2**2 + 0.05j * 1.2)
    first = found.coefficients[0, 0, found.harmonics == 1][0]
    assert first == pytest.approx(expected, rel=1e-12)
    assert vv.Jenkins(on="x1", stiffness=5, limit=10).energy([0, 1, 0, -1]) == 0


def test_energy_of_a_loop():
    """4 F_s (a - F_s/k), for several cycles at once."""
    element = vv.Jenkins(on="x1", stiffness=4, limit=2)
    a = np.array([0.4, 1.0, 3.0])
    d = a[:, np.newaxis] * np.sin(2 * np.pi * np.arange(400) / 400)
    np.testing.assert_allclose(element.energy(d), 8 * np.maximum(a - 0.5, 0), atol=1e-12)
    assert np.abs(element.loop(d)).max() == 2


@pytest.mark.parametrize(
    ("call", "reported"),
    [
        (lambda: vv.Jenkins(on="x1", stiffness=0, limit=1), "stiffness = 0: must be greater"),
        (lambda: vv.Jenkins(on="x1", stiffness=1, limit=-2), "limit = -2: must be greater"),
        (lambda: vv.Jenkins(on="x1", stiffness=1, limit=1).energy(3.0), "d: must have shape"),
        (
            lambda: vv.simulate(slider(), 10, load=[1.0], nu=1.0, memory="direct"),
            "restitution has memory .auto. or .exponentials., got memory = .direct.",
        ),
        (
            lambda: vv.forced_response(slider(), [1.0], load=[1.0], method="successive"),
            "does not take elements with hysteresis",
        ),
        (
            lambda: vv.backbone(
                vv.Structure(
                    mass=[[1.0]], stiffness=[[1.0]],
                    elements=[vv.Jenkins(on="x1", stiffness=5, limit=1)],
                ),
                mode=0, amplitude_range=(0.1, 1),
            ),
            "backbones are of systems without losses",
        ),
    ],
)  # fmt: skip
def test_what_is_refused(call, reported):
    """One line that names the argument."""
    with pytest.raises(vv.InputError, match=reported):
        call()
