"""Free motions of the pendulum against quadrature, multiple scales and direct integration."""

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.integrate import quad
from scipy.optimize import brentq
from tables import lines_without_plan

matplotlib.use("Agg")

SET = {"e": 0.1, "w2": 0.4, "w3": 0.8, "alpha": 0.5}
#: Near 2:1 of z and the first swinging mode.
NEAR = {"e": 0.1, "w2": 0.53, "w3": 0.9, "alpha": 0.5}


def stiffness(pend):
    """1 + 3 alpha z_r^2 and 3 alpha z_r, with an independent z_r."""
    z_r = brentq(lambda z: pend.alpha * z**3 + z - pend.w2**2, 0, 1, xtol=1e-15, rtol=1e-14)
    return 1 + 3 * pend.alpha * z_r**2, 3 * pend.alpha * z_r


def test_motion_in_z_alone_by_quadrature():
    """2 pi/nu = 2 integral dz/sqrt(2 (E - V)) between the turning points."""
    pend = vv.Pendulum(**SET)
    b = vv.backbone(pend, 0, (1e-3, 0.8), harmonics=25, tolerance=1e-13, symmetric=True)
    k, square = stiffness(pend)

    def potential(z):
        return k * z**2 / 2 + square * z**3 / 3 + pend.alpha * z**4 / 4

    assert b.outcome == "completed"
    for i in (0, b.nu.size // 2, b.nu.size - 1):
        top = b.start[i, 0]
        energy = potential(top)
        assert b.energy[i] == pytest.approx(energy, rel=1e-13)
        bottom = brentq(lambda z, e=energy: potential(z) - e, -1.2 * top, 0, xtol=1e-15)
        middle, half = (top + bottom) / 2, (top - bottom) / 2
        # E - V is (top - z)(z - bottom) times a quadratic, found by comparison of coefficients.
        c2 = pend.alpha / 4
        c1 = square / 3 + c2 * (top + bottom)
        c0 = k / 2 + c1 * (top + bottom) - c2 * top * bottom

        def slowness(angle, c=(c0, c1, c2), middle=middle, half=half):
            z = middle + half * np.sin(angle)
            return 1 / np.sqrt(2 * (c[0] + c[1] * z + c[2] * z**2))

        period = 2 * quad(slowness, -np.pi / 2, np.pi / 2, epsabs=1e-13, epsrel=1e-13)[0]
        assert b.nu[i] == pytest.approx(2 * np.pi / period, rel=1e-12)


def swing(pend, top):
    """Period and monodromy matrix of small swinging about the motion in z from rest at `top`."""
    k, square = stiffness(pend)
    r = (pend.w3 / pend.w2) ** 2

    def slope(_, y):
        z, v = y[:2]
        a = -z * (k + z * (square + pend.alpha * z))
        length = 1 + z
        mass = np.array([[length**2, pend.e * length], [r * length, 1]])
        spring = np.array([[pend.w2**2 * length, 0], [r * a, pend.w3**2 - r * a]])
        rate = np.array([[2 * length * v, 0], [2 * r * v, 0]])
        q, dq = y[2:10].reshape(2, 4), y[10:].reshape(2, 4)
        bend = -np.linalg.solve(mass, rate @ dq + spring @ q)
        return np.concatenate([[v, a], dq.ravel(), bend.ravel()])

    def turns(_, y):
        return y[1]

    turns.direction = -1
    start = np.concatenate([[top, 0], np.eye(4).ravel()])
    run = solve_ivp(slope, (0, 20), start, method="DOP853", rtol=1e-13, atol=1e-15, events=turns)
    at = next(t for t in run.t_events[0] if t > 1)
    run = solve_ivp(slope, (0, at), start, method="DOP853", rtol=1e-13, atol=1e-15)
    return at, run.y[2:, -1].reshape(4, 4)


@pytest.mark.parametrize("multiple", [1, 2])
def test_swings_branch_off_where_their_multiplier_says(multiple):
    """Branch points lie where a multiplier of the swinging is 1, or -1 for half the frequency."""
    pend = vv.Pendulum(**(SET if multiple == 1 else NEAR))
    b = vv.backbone(pend, 0, (0.01, 0.4), harmonics=15, subharmonic=multiple, tolerance=1e-13)
    assert len(b.branch_points) >= 1
    for point in b.branch_points:
        top = point.coefficients[0].imag.sum()
        slow = np.abs(point.across[1:, 1::2]).max() > np.abs(point.across[1:, ::2]).max()
        root = -1 if multiple == 2 and slow else 1

        def gap(z, root=root):
            return np.linalg.det(swing(pend, z)[1] - root * np.eye(4))

        exact = brentq(gap, top - 0.003, top + 0.003, xtol=1e-13)
        assert top == pytest.approx(exact, rel=1e-8)
        roots = b.multipliers[point.before : point.before + 2]
        # Four of the six belong to the swinging; for half the frequency they are squares.
        wanted = np.linalg.matrix_power(swing(pend, b.start[point.before, 0])[1], multiple)
        assert np.sort_complex(np.linalg.eigvals(wanted)) == pytest.approx(
            np.sort_complex(roots[0][np.abs(roots[0] - 1) > 1e-5]), abs=1e-6
        )


def test_the_family_of_swings():
    """Both directions give mirror images, and every motion agrees with direct integration."""
    pend = vv.Pendulum(**NEAR)
    b = vv.backbone(pend, 0, (0.01, 0.4), harmonics=17, subharmonic=2, tolerance=1e-13)
    # Near a resonance of z with a third family rounding errors are amplified.
    with pytest.warns(vv.ConvergenceWarning, match="the rounding error exceeds"):
        families = [
            vv.backbone(
                pend, 0, (0.01, 0.4), harmonics=17, subharmonic=2, tolerance=1e-13, max_points=30,
                leave=b.branch_points[0], opposite=opposite,
            )
            for opposite in (False, True)
        ]  # fmt: skip
    one, other = families
    assert one.amplitude("phi")[-1] > 0.05
    assert one.coefficients[:, 1:, 1] == pytest.approx(-other.coefficients[:, 1:, 1], abs=1e-8)
    assert one.coefficients[:, 0] == pytest.approx(other.coefficients[:, 0], abs=1e-8)
    for i in (5, 29):
        start = np.zeros(6)
        start[::2] = one.start[i]
        run = solve_ivp(
            pend.rhs, (0, 2 * np.pi / one.nu[i]), start, method="DOP853", rtol=1e-13, atol=1e-15
        )
        assert run.y[:, -1] == pytest.approx(start, abs=1e-9)


def test_resonance_of_modes_turns_the_curve_back():
    """At 3:1 of the swinging modes the amplitude of psi has a fold; the energy continues."""
    pend = vv.Pendulum(**SET, equations="cubic")
    # The final motion has three times the frequency: its harmonics are multiples of 3.
    with pytest.warns(vv.ConvergenceWarning, match="harmonics up to 63 do not reach"):
        b = vv.backbone(pend, 1, (1e-3, 0.8), symmetric=True)
    assert b.outcome == "returned"
    assert not b.complete
    assert 1e-10 < b.truncation.max() < 1e-7
    assert b.folds == pytest.approx([0.36947238], rel=1e-7)
    upper = int(b.amplitude("psi").argmax())
    assert b.amplitude("psi", 3)[-1] > 100 * b.amplitude("psi")[-1]
    e = vv.backbone(pend, 1, energy_range=(1e-6, float(b.energy[upper + 5])), symmetric=True)
    assert e.outcome == "completed"
    assert e.varies == "energy"
    assert e.nu[-1] == pytest.approx(b.nu[upper + 5], rel=1e-8)
    assert e.energy[-1] == pytest.approx(b.energy[upper + 5], rel=1e-12)


def test_too_few_orders_are_reported():
    with pytest.warns(vv.ConvergenceWarning, match="harmonics up to 5 do not reach"):
        vv.backbone(vv.Pendulum(**SET), 1, (1e-3, 0.5), harmonics=5)


def test_ends_at_the_pivot():
    b = vv.backbone(vv.Pendulum(**SET), 0, (0.01, 2.0), symmetric=True)
    assert b.outcome == "unphysical"
    lowest = (b.coefficients[-1, 0].imag * (-1.0) ** b.harmonics).sum()
    assert -1 < lowest < -0.9999
    printed = vv.backbone(vv.Pendulum(**SET, equations="printed"), 0, (0.01, 0.5))
    exact = vv.backbone(vv.Pendulum(**SET), 0, (0.01, 0.5), symmetric=True)
    assert printed.nu == pytest.approx(exact.nu, rel=1e-14)


def test_tables_and_picture(tmp_path):
    b = vv.backbone(vv.Pendulum(**SET), 2, (1e-3, 0.3))
    b.to_csv(tmp_path / "b.csv")
    lines = lines_without_plan(tmp_path / "b.csv")[1:]
    assert lines[2].startswith("nu,energy,stable,growing,multiplier,truncation,error,z_0,z_1")
    assert len(lines) == 3 + b.nu.size
    assert b.to_dataset().energy.shape == b.nu.shape
    assert len(vv.plot_backbone(b)) == 3
    bare = vv.backbone(vv.Pendulum(**SET), 2, (1e-3, 0.3), stability=False)
    assert bare.stable is None
    assert np.array_equal(bare.coefficients, b.coefficients)
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"mode": 3}, "mode = 3: must be 0 to 2"),
        (
            {"system": vv.Pendulum(**SET, equations="printed")},
            "the printed equations keep no energy",
        ),
        ({"amplitude_range": (0, 1)}, "amplitude_range: must be two numbers, 0 < from < to"),
        ({"energy_range": (1, 2)}, "amplitude_range or energy_range: give exactly one"),
        ({"amplitude_range": None}, "amplitude_range or energy_range: give exactly one"),
        ({"amplitude_range": None, "energy_range": (2, 1)}, "energy_range: must be two numbers"),
        ({"dof": "z"}, "dof = 'z': does not move in mode 1"),
        ({"dof": "x"}, "dof = 'x': must be one of"),
        ({"harmonics": 0}, "harmonics = 0: must be 1 to"),
        ({"max_step": 2}, "max_step = 2: must be in [1e-4, 1]"),
        ({"tolerance": 0}, "tolerance = 0: must be in"),
        ({"leave": 3}, "leave = 3: must be one of a backbone's branch_points"),
    ],
)
def test_bad_input_is_named(changes, text):
    given = {"system": vv.Pendulum(**SET), "mode": 1, "amplitude_range": (1e-3, 0.1)} | changes
    with pytest.raises(vv.InputError) as error:
        vv.backbone(**given)
    assert text in str(error.value)
