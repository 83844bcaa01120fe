"""Terms that multiple scales count as resonant, against Floquet multipliers by SciPy."""

import warnings

import numpy as np
import pytest
import scipy.optimize
import viscovib as vv
from referee.integration import solve_ivp

pytestmark = pytest.mark.filterwarnings("ignore::viscovib.RangeWarning")


def growth(matrix_at, period, n):
    """Largest growth rate of y' = A(t) y, by SciPy."""

    def rhs(t, y):
        return (matrix_at(t) @ y.reshape(n, n)).ravel()

    run = solve_ivp(rhs, (0, period), np.eye(n).ravel(), rtol=1e-9, atol=1e-11, method="DOP853")
    multipliers = np.linalg.eigvals(run.y[:, -1].reshape(n, n))
    return np.log(abs(multipliers)).max() / period


def coupled(rng, h, p, damping, stiff=0.0):
    """Two modes at rest, whose stiffness is modulated by a stiff third coordinate as h cos(p t)."""
    w = np.array([1.0, rng.uniform(1.3, 2.2)])
    fast, slow = 40.0, rng.normal(size=(2, 2))
    coupling = slow + slow.T
    quadratic = np.zeros((3, 3, 3))
    quadratic[:2, :2, 2] = coupling
    load = np.array([[0.0], [0.0], [h * (fast**2 - p**2)]])
    system = vv.CubicSystem(
        mass=np.eye(3), stiffness=np.diag([*w**2, fast**2]), quadratic=quadratic, load=load,
        damping=np.diag([damping, damping, stiff]), drives=[p],
    )  # fmt: skip

    def matrix_at(t):
        stiffness = np.diag(w**2) + h * np.cos(p * t) * coupling
        return np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping * np.eye(2)]])

    return system, matrix_at, w


def test_the_growth_of_modes_at_rest_has_an_error():
    """The motion itself is exact and has no error; the growth is compared with Floquet theory."""
    rng = np.random.default_rng(8)
    ratios, decided = [], 0
    for i in range(15):
        h, damping = 10 ** rng.uniform(-1.5, -0.5), 10 ** rng.uniform(-4, -1.7)
        w = coupled(np.random.default_rng(i), h, 1.0, damping)[2]
        centre = [2 * w[0], 2 * w[1], w.sum(), w[0], 2 * w[0] / 3][i % 5]
        p = centre * (1 + rng.uniform(-0.8, 0.8) * h)
        system, matrix_at, _ = coupled(np.random.default_rng(i), h, p, damping, 1.0)
        found = vv.MultipleScales(system).response("p1", [p])
        if not found.in_range[0]:
            continue
        reported = max(found.eigenvalues[0].real.max(), found.resting_growth[0])
        true = growth(matrix_at, 2 * np.pi / p, 4)
        assert found.growth_error[0] > 0
        ratios.append(abs(reported - true) / (found.growth_error[0] + 1e-8))
        if found.decided[0]:
            decided += 1
            assert (reported > 0) == (true > 0)
    assert len(ratios) > 9
    assert decided > 6
    assert np.mean(np.array(ratios) < 1.5) > 0.9


def test_errors_along_an_amplitude_are_those_at_the_amplitude():
    """The residual of the full system is computed for the varied load, not for the given load."""
    body = {"e": 0.1, "w2": 0.48, "w3": 0.8, "alpha": 0.5, "c1": 0.01, "c2": 0.01, "c3": 0.01}
    varied = vv.MultipleScales(vv.Pendulum(**body, f0=1.0, p1=1.05)).response("f0", [0.002])
    fixed = vv.MultipleScales(vv.Pendulum(**body, f0=0.002, p1=1.05)).response("f0", [0.002])
    np.testing.assert_allclose(varied.error_estimate, fixed.error_estimate, rtol=1e-6)
    assert varied.error_estimate[0] < 1e-4


def test_backbones_out_of_range_are_reported():
    system = vv.CubicSystem(mass=[[1]], stiffness=[[1]], cubic=[[[[1.0]]]])
    ms = vv.MultipleScales(system)
    with pytest.warns(vv.RangeWarning, match="amplitude 5 of mode 0"):
        ms.backbone(0, 5.0)
    with pytest.raises(vv.InputError, match="amplitudes: must not be empty"):
        ms.backbone(0, [])


def test_motions_without_a_place_in_the_frame_are_not_complete():
    """Two loads sustain subharmonics of one mode at two frequencies: one frame contains one."""
    rng = np.random.default_rng(8)
    pairs = 0
    for i in range(12):
        p = np.array([3.0, 3.0 - i % 2]) * (1 + rng.uniform(0.01, 0.05, 2))
        loads = np.array([1.0, 0.3 if i % 2 else 1.0]) * rng.uniform(0.9, 1.3, 2)
        quadratic, cubic = rng.uniform(0.1, 0.3, 2)

        def response(kept, p=p, loads=loads, quadratic=quadratic, cubic=cubic):
            system = vv.CubicSystem(
                mass=[[1.0]], stiffness=[[1.0]], damping=[[0.004]], load=[loads[kept]],
                drives=p[kept], quadratic=[[[quadratic]]], cubic=[[[[cubic]]]],
            )  # fmt: skip
            found = vv.MultipleScales(system).response("p1", p[kept][:1])
            moving = found.stable & (abs(found.amplitudes[:, 0]) > 1e-3)
            return found, np.unique(found.frequencies[moving, 0].round(9))

        with warnings.catch_warnings(record=True) as messages:
            warnings.simplefilter("always")
            both, frequencies = response(np.array([0, 1]))
        alone = [response(np.array([k])) for k in (0, 1)]
        assert all(one.complete for one, _ in alone)
        expected = np.unique(np.concatenate([one for _, one in alone]))
        pairs += expected.size == 2
        missing = not np.isin(expected, frequencies).all()
        assert both.complete == (not missing)
        assert both.may_lack.tolist() == [missing]
        assert missing == any(
            "motions of one load may be missing" in str(m.message) for m in messages
        )
    assert pairs > 6


def test_tongues_of_the_order_that_follows():
    """3 p ~ 2 w is no term of the modulation equations; Floquet growth at its middle is found."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        w, h, damping = rng.uniform(0.7, 1.5), rng.uniform(0.25, 0.45), 10 ** rng.uniform(-5, -4)
        fast = 40.0

        def system(p, w=w, h=h, damping=damping, fast=fast):
            quadratic = np.zeros((2, 2, 2))
            quadratic[0, 0, 1] = w**2
            return vv.CubicSystem(
                mass=np.eye(2), stiffness=np.diag([w**2, fast**2]),
                damping=np.diag([damping, 0]), quadratic=quadratic,
                load=[[0.0], [h * (fast**2 - p**2)]], drives=[p],
            )  # fmt: skip

        def true(p, w=w, h=h, damping=damping):
            def matrix_at(t):
                return np.array([[0, 1], [-(w**2) * (1 + h * np.cos(p * t)), -damping]])

            return growth(matrix_at, 2 * np.pi / p, 2)

        places = 2 / 3 * w * (1 + np.linspace(-0.5, 0.5, 41) * h**2)
        middle, wide = places[np.argmax([true(p) for p in places])], places[1] - places[0]
        top = scipy.optimize.minimize_scalar(
            lambda p, true=true: -true(p), bounds=(middle - wide, middle + wide), method="bounded",
            options={"xatol": 1e-5},
        )  # fmt: skip
        assert -top.fun > 5 * damping
        ms = vv.MultipleScales(system(top.x))
        here = ms.response("p1", [top.x])
        assert here.eigenvalues.real.max() < 1e-9
        assert not here.stable[0]
        around = ms.response("p1", top.x + wide * np.linspace(-1, 1, 61))
        np.testing.assert_allclose(around.resting_growth.max(), -top.fun, rtol=0.1)
        nearby = ms.response("p1", top.x + np.array([-4, 4]) * wide)
        assert nearby.stable.all()


def in_units(units, time, force, mass, stiffness, forces, load):
    """Return harmonics, errors and decided verdicts of one system in these units."""
    n, both = units.size, np.outer(units, units) * force
    monomials = [
        vv.Monomial(
            coefficient=c * force * units[i] ** (p + 1), powers=tuple(p * np.eye(n, dtype=int)[i]),
            on=i,
        )
        for (i, p), c in forces.items()
    ]  # fmt: skip
    system = vv.PolynomialSystem(
        mass=both * mass / time**2, damping=both * 0.02 * stiffness / time,
        stiffness=both * stiffness, forces=monomials,
    )  # fmt: skip
    scales = vv.MultipleScales(system, load=load * units * force, nu=time)
    found = scales.response("nu", np.linspace(0.3, 3, 8) * time)
    return abs(found.harmonics) * units, found.growth_error / time, found.decided, found.stable


@pytest.mark.parametrize("seed", [1, 33, 50])
def test_the_choice_does_not_depend_on_units(seed):
    """Length, time and force in random units: the same terms, the same result."""
    rng = np.random.default_rng([77, seed])
    n = 2 + seed % 2
    a, b = rng.normal(size=(2, n, n))
    mass, stiffness = np.eye(n) + 0.2 * a @ a.T / n, np.diag(rng.uniform(0.5, 3, n)) + 0.3 * b @ b.T
    cubic, quadratic = rng.uniform(-0.5, 0.5, (2, n))
    forces = {(i, 3): cubic[i] for i in range(n)} | {(i, 2): quadratic[i] for i in range(n)}
    given = mass, stiffness, forces, rng.normal(size=n) * 0.05
    plain = in_units(np.ones(n), 1.0, 1.0, *given)
    other = in_units(np.exp(rng.uniform(-5, 5, n)), *np.exp(rng.uniform(-5, 5, 2)), *given)
    np.testing.assert_allclose(other[0], plain[0], rtol=0, atol=1e-7 * plain[0].max())
    np.testing.assert_allclose(other[1], plain[1], rtol=1e-4, atol=1e-12)
    np.testing.assert_array_equal(other[2], plain[2])
    np.testing.assert_array_equal(other[3], plain[3])
