"""Backbone curves against closed forms and direct integration of the motion."""

import warnings

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.linalg import eig
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk, ellipkm1
from tables import lines_without_plan

matplotlib.use("Agg")

BODY = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
STIFFNESS = np.array([[10.0, -5.0], [-5.0, 4.5]])


def test_no_unit_decides_which_coordinate_counts():
    curves = []
    for length in (1e-9, 1.0, 1e9):
        body = vv.Mount(
            mass=1, inertia=0.1 * length**2, offset=0.5 * length, stiffness_x=10,
            stiffness_phi=2 * length**2,
        )  # fmt: skip
        curves.append(vv.backbone(body, 0, (1e-3 * length, 0.4 * length), dof="x").nu)
        # A small rotation with large lengths must not be refused.
        vv.backbone(body, 0, (1e-3, 0.4), dof="phi")
        by_default = vv.backbone(body, 0, (1e-3 * length, 0.4 * length)).nu
        np.testing.assert_array_equal(by_default, curves[-1])
    for curve in curves:
        np.testing.assert_allclose(curve, curves[1], rtol=1e-12)


def test_duffing_in_elliptic_functions():
    """Motion from rest at A: x'' + x + c x^3 = 0 has omega = pi sqrt(1 + c A^2)/(2 K(m))."""
    for c, largest in ((1.0, 5.0), (-1.0, 0.8)):
        system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.3, forces=f"{c}*x^3")
        b = vv.backbone(system, 0, (1e-3, largest), harmonics=61, tolerance=1e-13)
        assert b.outcome == "completed"
        assert b.amplitude("x")[-1] == pytest.approx(largest, rel=1e-11)
        size = np.abs(b.start[:, 0])
        parameter = c * size**2 / (2 * (1 + c * size**2))
        exact = np.pi * np.sqrt(1 + c * size**2) / (2 * ellipk(parameter))
        assert b.nu == pytest.approx(exact, rel=4e-15)


def forces(name):
    """Accelerations written explicitly."""
    if name == "cubic":
        extra = lambda u: np.array(  # noqa: E731
            [5 / 6 * u[1] ** 3, 2.5 * u[1] ** 2 * u[0] - 5 / 3 * u[1] ** 3]
        )
        return lambda u: -(STIFFNESS @ u + extra(u)) / [1, 0.1]
    if name == "exact":

        def exact(u):
            spring = 10 * (u[0] - 0.5 * np.sin(u[1]))
            return -np.array([spring, (2 * u[1] - 0.5 * np.cos(u[1]) * spring) / 0.1])

        return exact
    if name == "asymmetric":
        return lambda u: -(u + 0.4 * u**2 + 0.5 * u**3)

    def chain(u):
        stretch = np.diff(np.concatenate([[0], u, [0]]))
        return np.diff(stretch + 0.3 * stretch**2 + 0.5 * stretch**3)

    return chain


def systems(name):
    if name in ("cubic", "exact"):
        return vv.Mount(**BODY, geometry=name, damping=0.1 * STIFFNESS)
    if name == "asymmetric":
        return vv.PolynomialSystem(mass=1, stiffness=1, forces="0.4*x^2 + 0.5*x^3")
    names = ["0", *(f"x{i}" for i in range(1, 6)), "0"]
    law = "({0}) + 0.3*({0})^2 + 0.5*({0})^3"
    texts = {
        names[i]: law.format(f"{names[i]} - {names[i - 1]}")
        + " - (" + law.format(f"{names[i + 1]} - {names[i]}") + ")"
        for i in range(1, 6)
    }  # fmt: skip
    return vv.PolynomialSystem(mass=np.ones(5), forces=texts)


@pytest.mark.parametrize("mode", [0, 1])
@pytest.mark.parametrize("kind", ["mount", "system", "structure"])
def test_the_frequency_of_a_linear_system_is_constant(kind, mode):
    matrices = {"mass": [1.0, 2.0], "stiffness": np.array([[3.0, -1.0], [-1.0, 2.0]])}
    linear = {
        "mount": vv.Mount(**BODY, cubic_scale=0),
        "system": vv.PolynomialSystem(**matrices, damping=[0.1, 0.1]),
        "structure": vv.Structure(**matrices, modal_damping=0.02),
    }[kind]
    curve = vv.backbone(linear, mode, (0.1, 5.0))
    assert curve.complete
    assert not curve.folds.size
    assert curve.nu == pytest.approx(linear.natural_frequencies()[mode], rel=1e-12)
    assert curve.truncation.max() < 1e-15
    shape = curve.coefficients[:, :, list(curve.harmonics).index(1)].imag
    expected = linear.mode_shapes()[:, mode] if kind != "structure" else shape[0]
    assert shape / shape[:, :1] == pytest.approx(np.tile(expected / expected[0], (len(shape), 1)))


def test_follower_forces():
    """Unsymmetric stiffness, by another eigenvalue solver and by integration."""
    stiffness = np.array([[3.0, -1.0, 0.2], [-0.4, 2.0, -0.5], [0.1, -0.3, 1.0]])
    mass = np.array([[2.0, 0.1, 0.0], [0.1, 1.0, 0.2], [0.0, 0.2, 1.5]])
    system = vv.PolynomialSystem(mass=mass, stiffness=stiffness, forces={"x2": "x2^3"})
    squares, shapes = eig(stiffness, mass)
    order = np.argsort(squares.real)
    for mode in range(3):
        shape = shapes[:, order[mode]].real
        b = vv.backbone(system, mode, (1e-6, 0.3), dof="x2", harmonics=25, tolerance=1e-13)
        assert b.nu[0] == pytest.approx(np.sqrt(squares.real[order[mode]]), rel=1e-11)
        first = b.coefficients[0, :, 0].imag
        assert first / first[1] == pytest.approx(shape / shape[1], rel=1e-10)
        start = np.concatenate([b.start[-1], np.zeros(3)])
        inverse = np.linalg.inv(mass)
        end = solve_ivp(
            lambda t, y, m=inverse: np.concatenate(
                [y[3:], -m @ (stiffness @ y[:3] + [0, y[1] ** 3, 0])]
            ),
            (0, 2 * np.pi / b.nu[-1]), start, "DOP853", rtol=1e-13, atol=1e-15,
        ).y[:, -1]  # fmt: skip
        assert np.abs(end - start).max() < 1e-10


def test_alike_masses_move_by_the_first():
    """If two coordinates move equally, rounding does not select the amplitude coordinate."""
    pair = {"x1": "x1^3", "x2": "x2^3"}
    both = {
        stiffness: vv.PolynomialSystem(
            mass=[1, 1], stiffness=stiffness * np.array([[3, -1], [-1, 3]]), forces=pair
        )
        for stiffness in (0.7, 1.0, 3.3)
    }
    for system in both.values():
        b = vv.backbone(system, 0, (1e-3, 0.5))
        assert b.amplitude("x1")[[0, -1]] == pytest.approx([1e-3, 0.5], rel=1e-15)


def test_tables_and_picture(tmp_path):
    b = vv.backbone(vv.Mount(**BODY), 0, (1e-3, 0.3))
    b.to_csv(tmp_path / "b.csv")
    lines = lines_without_plan(tmp_path / "b.csv")[1:]
    assert lines[2].startswith("nu,truncation,error,x_1,x_3")
    assert len(lines) == 3 + b.nu.size
    assert b.to_dataset().coefficients.shape == b.coefficients.shape
    axes = vv.plot_backbone([b, vv.backbone(vv.Mount(**BODY), 1, (1e-3, 0.3))])
    assert len(axes) == 2
    assert axes[0].lines[0].get_xdata() == pytest.approx(b.nu)
    axes[0].figure.savefig(tmp_path / "b.png")
    assert b.truncation.max() < 1e-3
    few = vv.backbone(vv.Mount(**BODY), 0, (1e-3, 0.3), max_points=5)
    assert (few.outcome, few.nu.size) == ("step limit", 5)
    matplotlib.pyplot.close("all")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"system": 1}, "must be a Mount or a PolynomialSystem"),
        ({"mode": 2}, "mode = 2: must be 0 to 1"),
        ({"amplitude_range": (0, 1)}, "amplitude_range: must be two numbers, 0 < from < to"),
        ({"amplitude_range": (2, 1)}, "amplitude_range: must be two numbers"),
        ({"amplitude_range": 1}, "amplitude_range = 1: must be two numbers"),
        ({"dof": "y"}, "dof = 'y': must be one of"),
        ({"max_points": 1}, "max_points = 1: must be 2 to"),
        ({"max_step": 2}, "max_step = 2: must be in [1e-4, 1]"),
        ({"harmonics": 0}, "harmonics = 0: must be 1"),
        (
            {"system": vv.PolynomialSystem(mass=[1, 1], forces={"x1": "x1^3", "x2": "x2"})},
            "mode = 0: moves as a rigid body",
        ),
        (
            {
                "system": vv.PolynomialSystem(mass=[1, 1], stiffness=[1, 2], forces={"x1": "x1^3"}),
                "dof": "x2",
            },
            "dof = 'x2': does not move in mode 0",
        ),
        (
            {"system": vv.PolynomialSystem(mass=1, stiffness=-1, forces="x^3")},
            "stiffness: has an eigenvalue -1 < 0, rest is unstable",
        ),
        (
            {
                "system": vv.PolynomialSystem(
                    mass=[1, 1], stiffness=[[1, 1], [-1, 1]], forces={"x1": "x1^3"}
                )
            },
            "stiffness: has complex eigenvalues, rest flutters",
        ),
    ],
)
def test_bad_input_is_named(changes, text):
    given = {"system": vv.Mount(**BODY), "mode": 0, "amplitude_range": (1e-3, 0.1)} | changes
    with pytest.raises(vv.InputError) as error:
        vv.backbone(**given)
    assert text in str(error.value)


def drawn(rng):
    """A random chain or mount: system, its accelerations, its masses."""
    if rng.integers(2):
        a, b = rng.uniform(0.5, 2, 2)
        body = {"mass": a, "inertia": 0.1 * b, "offset": 0.4, "stiffness_x": 10 * b}
        mount = vv.Mount(**body, stiffness_phi=2 * a, geometry="exact")

        def turned(u):
            spring = 10 * b * (u[0] - 0.4 * np.sin(u[1]))
            return -np.array([spring / a, (2 * a * u[1] - 0.4 * np.cos(u[1]) * spring) / (0.1 * b)])

        return mount, turned, np.array([a, 0.1 * b])
    masses, springs = rng.uniform(0.5, 2, 2), rng.uniform(0.5, 2, 3)
    square, cube = rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 1.0)
    stiffness = np.diag(springs[:2] + springs[1:]) - springs[1] * (1 - np.eye(2))
    chain = vv.PolynomialSystem(
        mass=masses, stiffness=stiffness, forces={"x1": f"{square}*x1^2 + {cube}*x1^3"}
    )

    def pulled(u):
        return -(stiffness @ u + [square * u[0] ** 2 + cube * u[0] ** 3, 0]) / masses

    return chain, pulled, masses


@pytest.mark.parametrize("seed", range(8))
def test_truncation_is_what_more_orders_change(seed):
    """Given harmonics against twice as many; automatic ones against integration of a period."""
    rng = np.random.default_rng(seed)
    system, acceleration, masses = drawn(rng)
    ends, mode = (1e-3, rng.uniform(0.2, 0.5)), int(rng.integers(2))
    coarse = {"harmonics": int(rng.integers(3, 8))}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        few = vv.backbone(system, mode, ends, **coarse)
        more = vv.backbone(system, mode, ends, harmonics=25)
    assert few.outcome == more.outcome == "completed"
    assert few.complete == (few.truncation.max() <= 1e-10)
    fine = more.coefficients[-1].imag
    own = np.zeros_like(fine)
    own[:, np.searchsorted(more.harmonics, few.harmonics)] = few.coefficients[-1].imag
    inertia = np.sqrt(masses)[:, np.newaxis]
    apart = np.linalg.norm((own - fine) * inertia) / np.linalg.norm(fine * inertia)
    apart = max(apart, abs(few.nu[-1] / more.nu[-1] - 1))
    assert few.truncation[-1] == pytest.approx(apart, rel=0.2, abs=1e-13)
    chosen = vv.backbone(system, mode, ends)
    assert chosen.complete
    assert chosen.truncation.max() <= 1e-10
    for i in (chosen.nu.size // 2, -1):
        start = np.concatenate([chosen.start[i], [0, 0]])
        end = solve_ivp(
            lambda t, y: np.concatenate([y[2:], acceleration(y[:2])]),
            (0, 2 * np.pi / chosen.nu[i]), start, "DOP853", rtol=1e-12, atol=1e-14,
        ).y[:, -1]  # fmt: skip
        assert np.abs(end - start).max() < 2e-8 * np.abs(start).max()


def near_homoclinic(nu, q, orders):
    """Cosines of x'' + x - q x^2 = 0 at a frequency: x = e3 - d dn^2, by its Fourier series."""

    def shape(log_rest):
        rest = np.exp(log_rest)  # 1 - m
        size, quarter = 1.5 / q / np.sqrt(1 - rest + rest**2), ellipkm1(rest)
        return rest, size, quarter, np.pi * np.sqrt(2 * q * size / 3) / (2 * quarter)

    rest, size, quarter, _ = shape(brentq(lambda x: shape(x)[-1] - nu, -690, -1e-12, xtol=1e-14))
    nome, k = np.exp(-np.pi * ellipk(rest) / quarter), np.maximum(orders, 1)
    waves = -size * 2 * (np.pi / quarter) ** 2 * k * (-nome) ** k / (1 - nome ** (2 * k))
    mean = (1.5 / q - size * (2 - rest)) / 3 + size * (1 - ellipe(1 - rest) / quarter)
    return np.where(orders == 0, mean, waves)


@pytest.mark.parametrize("harmonics", [9, "auto"])
@pytest.mark.parametrize("seed", range(3))
def test_near_a_homoclinic_orbit_the_curve_ends_where_harmonics_hold_the_motion(seed, harmonics):
    """Up to the end of the curve, motions agree with the closed form within the truncation."""
    q = np.random.default_rng(seed).uniform(0.3, 1.5)
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces=f"-{q}*x^2", names=["x"])
    with pytest.warns(vv.ConvergenceWarning, match="do not reach"):
        b = vv.backbone(system, 0, (0.01 / q, 5 / q), harmonics=harmonics)
    assert b.outcome == "unresolved"
    assert not b.complete
    assert (b.truncation < 1).all()
    assert 0 < b.nu[-1] == b.nu.min() < 0.2
    orders = np.arange(300)
    judged = np.flatnonzero((b.truncation > 1e-7) & (b.truncation < 0.3))
    assert judged.size >= 10
    for i in judged:
        own = np.zeros(orders.size)
        own[b.harmonics] = b.coefficients[i, 0].imag
        apart = np.linalg.norm(own - near_homoclinic(b.nu[i], q, orders)) / np.linalg.norm(own)
        assert apart < 1.5 * b.truncation[i]


def test_internal_resonance_turns_the_curve_back():
    """At 5:1 the first harmonic returns to its initial amplitude; the end is a true motion."""
    body = {
        "mass": 1.15,
        "inertia": 0.0507,
        "offset": 0.5,
        "stiffness_x": 15,
        "stiffness_phi": 3.29,
    }
    b = vv.backbone(vv.Mount(**body), 0, (0.002, 0.2))
    assert (b.outcome, b.folds.size) == ("returned", 1)
    assert b.truncation.max() <= 1e-10
    assert b.amplitude("phi", 5)[-1] > 3 * b.amplitude("phi")[-1]
    c = 0.5 * 15

    def acceleration(u):
        x, phi = u
        linear = np.array([15 * x - c * phi, -c * x + (3.29 + 0.25 * 15) * phi])
        bent = np.array([c / 6 * phi**3, 0.5 * c * phi**2 * x - c / 3 * phi**3])
        return -(linear + bent) / [1.15, 0.0507]

    start = np.concatenate([b.start[-1], [0, 0]])
    end = solve_ivp(
        lambda t, y: np.concatenate([y[2:], acceleration(y[:2])]),
        (0, 2 * np.pi / b.nu[-1]), start, "DOP853", rtol=1e-13, atol=1e-15,
    ).y[:, -1]  # fmt: skip
    assert np.abs(end - start).max() < 1e-9 * np.abs(start).max()


@pytest.mark.parametrize(
    ("changes", "ends"),
    [
        ({}, (5e-324, 1e-323)), ({}, (1e-170, 1e-160)), ({}, (1e-3, 1e200)), ({}, (1e300, 1e308)),
        ({"stiffness": 1e300}, (1e-3, 1)), ({"mass": 1e-270}, (1e-3, 1)),
        ({"forces": "1e300*x^3"}, (1e-3, 1)), ({"forces": "-x^3"}, (1e-3, 3)),
    ],
)  # fmt: skip
def test_beyond_the_range_of_numbers(changes, ends):
    """Overflow gives an error or an outcome, never a complete curve with non-finite numbers."""
    system = vv.PolynomialSystem(**({"mass": 1, "stiffness": 1, "forces": "x^3"} | changes))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.ConvergenceWarning)
        try:
            b = vv.backbone(system, 0, ends)
        except vv.InputError:
            return
    assert not b.complete
    for values in (b.nu, b.coefficients, b.truncation):
        assert np.isfinite(values).all()


def test_a_beginning_far_from_the_linear_mode_is_reached_from_below():
    rng = np.random.default_rng(8)
    for _ in range(5):
        power = int(rng.choice([3, 5]))
        system = vv.PolynomialSystem(
            mass=1, stiffness=rng.uniform(0.05, 1), forces=f"{rng.uniform(0.3, 30):.3f}*x^{power}"
        )
        begin = rng.uniform(1, 4)
        curve = vv.backbone(system, 0, (begin, 1.5 * begin), max_points=10, tolerance=1e-8)
        whole = vv.backbone(system, 0, (0.001, begin), tolerance=1e-8, max_points=2000)
        assert curve.nu[0] == pytest.approx(whole.nu[-1], rel=1e-6)
    softening = vv.PolynomialSystem(mass=1, stiffness=1, forces="-x^3")
    with pytest.raises(vv.InputError, match="ends at a smaller amplitude"):
        vv.backbone(softening, 0, (3, 4))
