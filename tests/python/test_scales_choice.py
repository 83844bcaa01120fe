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


def test_modes_at_rest_grow_where_floquet_says():
    """Parametric excitation of one mode and of two modes, inside and near the tongues."""
    rng = np.random.default_rng(0)
    wrong, judged, off = 0, 0, []
    for i in range(40):
        h, damping = 10 ** rng.uniform(-1.5, -0.8), 10 ** rng.uniform(-3, -2)
        probe = coupled(np.random.default_rng(i), h, 1.0, damping)[2]
        centre = [2 * probe[0], 2 * probe[1], probe.sum()][i % 3]
        p = centre * (1 + rng.uniform(-0.8, 0.8) * h)
        system, matrix_at, _ = coupled(np.random.default_rng(i), h, p, damping)
        found = vv.MultipleScales(system).response("p1", [p])
        rest = found.eigenvalues[0].real.max()
        true = growth(matrix_at, 2 * np.pi / p, 4)
        judged += 1
        # The motion of the stiff coordinate is undamped.
        if abs(true) > 0.05 * h**2:
            wrong += (rest > 1e-6) != (true > 0)
        if true > 0:
            off.append(abs(rest / true - 1))
    assert judged == 40
    assert wrong == 0
    assert len(off) > 8
    assert np.median(off) < 0.03


def test_the_growth_of_modes_at_rest_has_an_error():
    """The motion itself is exact and has no error; the growth is compared with Floquet theory."""
    rng = np.random.default_rng(8)
    ratios, decided = [], 0
    for i in range(30):
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
    assert len(ratios) > 20
    assert decided > 15
    assert np.mean(np.array(ratios) < 1.5) > 0.9


def test_the_seed_pendulum_under_its_parametric_load():
    """p1 = 2 w2: z excites phi. The Floquet growth rate of the motion in z is .0246."""
    pend = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.005, c2=0.005, c3=0.005, f0=0.05, p1=0.8
    )
    steady = vv.MultipleScales(pend).response("p1", [0.8])
    in_z = np.flatnonzero(abs(steady.amplitudes[:, 1]) == 0)
    assert not steady.stable[in_z].any()
    np.testing.assert_allclose(steady.eigenvalues[in_z[0]].real.max(), 0.0246, rtol=0.02)


def test_results_do_not_depend_on_the_other_values():
    """One value, or the same value among others near and far from the mode."""
    rng = np.random.default_rng(4)
    for _ in range(12):
        c, load = 10 ** rng.uniform(-2.3, -1.3), 10 ** rng.uniform(-2.5, -1.2)
        system = vv.CubicSystem(
            mass=[[1]], stiffness=[[1]], damping=[[c]], cubic=[[[[rng.uniform(-1, 1)]]]],
            load=[[load]], drives=[1.0],
        )  # fmt: skip
        ms = vv.MultipleScales(system)
        p = rng.uniform(0.8, 1.2)
        alone = ms.response("p1", [p])
        among = ms.response("p1", [0.5, 1.0, p, 1.4])
        np.testing.assert_allclose(
            among.harmonics[among.index == 2], alone.harmonics, rtol=1e-10, atol=1e-14
        )


def test_all_three_motions_of_a_duffing_away_from_resonance():
    """At 1.08 three motions exist; a search for periodic motions by SciPy finds the same."""
    c, load, p = 0.02, 0.02, 1.08
    system = vv.CubicSystem(
        mass=[[1]], stiffness=[[1]], damping=[[c]], cubic=[[[[1.0]]]], load=[[load]], drives=[p]
    )
    steady = vv.MultipleScales(system).response("p1", [p])
    assert steady.index.size == 3
    assert list(steady.stable) == [True, False, True]

    def run(y, times=None):
        return solve_ivp(
            lambda t, y: [y[1], load * np.cos(p * t) - c * y[1] - y[0] - y[0] ** 3],
            (0, 2 * np.pi / p), y, t_eval=times, rtol=1e-11, atol=1e-13,
        ).y  # fmt: skip

    for i in range(3):
        x = steady.harmonics[i, 0]
        start = scipy.optimize.fsolve(lambda y: run(y)[:, -1] - y, [x.real, -p * x.imag])
        t = np.arange(64) / 64 * 2 * np.pi / p
        exact = 2 * np.mean(run(start, t)[0] * np.exp(-1j * p * t))
        error = abs(x - exact)
        assert error < 0.01 * abs(exact)
        assert 0.5 < steady.error_estimate[i] / error < 2


def test_constant_loads_of_any_size():
    """A static load shifts the frequency: the error covers the difference to integration."""
    rng = np.random.default_rng(7)
    for _ in range(8):
        static, c = rng.uniform(-0.6, 0.6), rng.uniform(0.03, 0.08)
        quadratic, cubic = rng.uniform(-0.3, 0.3), rng.uniform(0.3, 1.0)
        p, load = rng.uniform(0.9, 1.5), 0.01
        system = vv.CubicSystem(
            mass=[[1]], stiffness=[[1]], damping=[[c]], quadratic=[[[quadratic]]],
            cubic=[[[[cubic]]]], load=[[static, load]], drives=[0.0, p],
        )  # fmt: skip
        steady = vv.MultipleScales(system).response("p2", [p])

        def run(
            y, times=None, static=static, c=c, quadratic=quadratic, cubic=cubic, p=p, load=load
        ):  # fmt: skip
            return solve_ivp(
                lambda t, y: [
                    y[1],
                    static + load * np.cos(p * t) - c * y[1] - y[0] - quadratic * y[0] ** 2
                    - cubic * y[0] ** 3,
                ],
                (0, 2 * np.pi / p), y, t_eval=times, rtol=1e-10, atol=1e-12,
            ).y  # fmt: skip

        rest = scipy.optimize.brentq(
            lambda x, s=static, q=quadratic, k=cubic: x + q * x**2 + k * x**3 - s, -2, 2
        )
        stable = np.flatnonzero(steady.stable & steady.in_range)
        assert stable.size
        x = steady.harmonics[stable[0], 0]
        start = scipy.optimize.fsolve(
            lambda y, run=run: run(y)[:, -1] - y, [rest + x.real, -p * x.imag]
        )
        times = np.arange(64) / 64 * 2 * np.pi / p
        exact = 2 * np.mean(run(start, times)[0] * np.exp(-1j * p * times))
        error = abs(x - exact)
        assert error < 0.1 * abs(exact)
        assert error < 2 * steady.error_estimate[stable[0]] + 1e-8


def test_three_loads_near_three_modes_need_no_settings():
    """Sixty random pendulums: none is refused, most are in range, some checked by integration."""
    rng = np.random.default_rng(1)
    inside, compared = 0, 0
    for i in range(60):
        damping = 0.05 if i < 3 else 0.01
        body = {
            "e": rng.uniform(0.05, 0.1), "w2": rng.uniform(0.35, 0.6), "w3": rng.uniform(0.7, 1.0),
            "alpha": rng.uniform(0, 0.5), "c1": damping, "c2": damping, "c3": damping,
        }  # fmt: skip
        w = vv.MultipleScales(vv.Pendulum(**body)).frequencies
        drives = {f"p{j + 1}": w[j] * (1 + rng.uniform(-0.03, 0.03)) for j in range(3)}
        pend = vv.Pendulum(**body, **drives, f0=10 ** rng.uniform(-4, -3), m01=1e-4, m02=2e-4)
        ms = vv.MultipleScales(pend)
        steady = ms.response("p1", [drives["p1"]])
        assert steady.index.size
        inside += steady.in_range.any()
        good = np.flatnonzero(steady.in_range & steady.stable)
        if i >= 3 or not good.size:
            continue
        start = ms.motion([0.0], amplitudes=steady.amplitudes[good[0]]).state[0]
        times = np.linspace(500, 2000, 6001)
        run = vv.simulate(pend, 2000, times=times, initial=start, tolerance=1e-9)
        lines = vv.amplitudes_at(run, frequencies=list(drives.values()), coordinate="z")
        found = abs(steady.harmonics[good[0], 0])
        assert (
            abs(found - lines.amplitude[0]) < 4 * steady.harmonic_errors[good[0], 0] + 1e-4 * found
        )
        compared += 1
    assert inside >= 50
    assert compared >= 2


def test_errors_along_an_amplitude_are_those_at_the_amplitude():
    """The residual of the full system is computed for the varied load, not for the given load."""
    body = {"e": 0.1, "w2": 0.48, "w3": 0.8, "alpha": 0.5, "c1": 0.01, "c2": 0.01, "c3": 0.01}
    varied = vv.MultipleScales(vv.Pendulum(**body, f0=1.0, p1=1.05)).response("f0", [0.002])
    fixed = vv.MultipleScales(vv.Pendulum(**body, f0=0.002, p1=1.05)).response("f0", [0.002])
    np.testing.assert_allclose(varied.error_estimate, fixed.error_estimate, rtol=1e-6)
    assert varied.error_estimate[0] < 1e-4


def test_backbones_with_internal_resonance_against_shooting():
    """w2 ~ 2 w1: two free motions with the same amplitude, as SciPy finds them."""
    rng, b = np.random.default_rng(3), 0.04
    for _ in range(4):
        w2, k = 2 * (1 + rng.uniform(-0.004, 0.004)), rng.uniform(0.2, 0.5)
        quadratic = np.zeros((2, 2, 2))
        quadratic[0, 0, 1] = 2 * k
        quadratic[1, 0, 0] = k
        system = vv.CubicSystem(mass=np.eye(2), stiffness=np.diag([1, w2**2]), quadratic=quadratic)
        found = vv.MultipleScales(system).backbone(0, [b])[0]
        assert found.size == 2
        assert found[1] - found[0] > 0.002

        def miss(y, whole=False, w2=w2, k=k):
            run = solve_ivp(
                lambda t, q: [
                    q[1], -q[0] - 2 * k * q[0] * q[2], q[3], -(w2**2) * q[2] - k * q[0] ** 2
                ],
                (0, 2 * np.pi / y[2]), [y[0], 0, y[1], 0], "DOP853", rtol=1e-10, atol=1e-13,
                t_eval=np.arange(65) / 64 * 2 * np.pi / y[2],
            )  # fmt: skip
            first = 2 * np.mean(run.y[0, :64] * np.cos(np.arange(64) * 2 * np.pi / 64))
            return [run.y[1, 32], run.y[3, 32], first - b]

        for sign, frequency in zip((1, -1), (found[1], found[0]), strict=True):
            start = [b, sign * b / np.sqrt(8), frequency]
            exact = scipy.optimize.fsolve(miss, start, xtol=1e-11)[2]
            assert abs(frequency - exact) < 0.1 * abs(exact - 1)
        alone = vv.MultipleScales(system).backbone(1, [b])
        assert alone.shape == (1,)


def test_backbones_out_of_range_are_reported():
    system = vv.CubicSystem(mass=[[1]], stiffness=[[1]], cubic=[[[[1.0]]]])
    ms = vv.MultipleScales(system)
    with pytest.warns(vv.RangeWarning, match="amplitude 5 of mode 0"):
        ms.backbone(0, 5.0)
    with pytest.raises(vv.InputError, match="amplitudes: must not be empty"):
        ms.backbone(0, [])


def subharmonics(ratio, damping, quadratic, cubic, load, p):
    """Initial states of the stable motions of period 2 pi ratio/p of oscillators, by shooting.

    All oscillators and starts in parallel: Runge-Kutta steps and Newton's method. Motions with the
    period of the load are excluded.
    """
    n = damping.size
    steps = 180
    grid = [(a, f) for a in (0.2, 0.35, 0.5) for f in np.arange(0, 2 * np.pi, np.pi / 4)]
    at = np.repeat(np.arange(n), len(grid))
    y = np.tile([[a * np.cos(f) for a, f in grid], [a * np.sin(f) for a, f in grid]], n)

    def mapped(y, turns):
        h = 2 * np.pi / p[at] * ratio / steps

        def rhs(t, y):
            force = load[at] * np.cos(p[at] * t)
            x, v = y
            return np.array([v, force - damping[at] * v - x - quadratic[at] * x**2
                             - cubic[at] * x**3])  # fmt: skip

        for k in range(steps * turns // ratio):
            t = k * h
            k1 = rhs(t, y)
            k2 = rhs(t + h / 2, y + h / 2 * k1)
            k3 = rhs(t + h / 2, y + h / 2 * k2)
            k4 = rhs(t + h, y + h * k3)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return y

    with np.errstate(all="ignore"):
        for _ in range(8):
            end = mapped(y, ratio)
            slope = np.array([(mapped(y + 1e-6 * e, ratio) - end) / 1e-6
                              for e in np.eye(2)[:, :, None]])  # fmt: skip
            a, b, c, d = slope[0, 0] - 1, slope[1, 0], slope[0, 1], slope[1, 1] - 1
            r = end - y
            y = y - np.array([d * r[0] - b * r[1], a * r[1] - c * r[0]]) / (a * d - b * c)
        converged = (abs(mapped(y, ratio) - y) < 1e-7).all(axis=0) & (abs(y) < 1).all(axis=0)
        converged &= abs(mapped(y, 1) - y).max(axis=0) > 0.05
    trace = slope[0, 0] + slope[1, 1]
    determinant = slope[0, 0] * slope[1, 1] - slope[0, 1] * slope[1, 0]
    stable = converged & (abs(trace) < 1 + determinant)
    return [np.unique(y[:, stable & (at == i)].T.round(4), axis=0) for i in range(n)]


@pytest.mark.parametrize("ratio", [2, 3])
def test_subharmonic_motions_away_from_linear_resonance(ratio):
    """A load excites a mode shifted by its amplitude: the response has every stable motion."""
    rng = np.random.default_rng(ratio)
    n = 16
    damping, load = 10 ** rng.uniform(-3.3, -2.3, n), rng.uniform(0.3, 1.2, n)
    quadratic = 10 ** rng.uniform(-2, -1, n) * (ratio == 2)
    cubic = 10 ** rng.uniform(-1.3, -0.3, n)
    p = ratio * (1 + rng.uniform(0.01, 0.06, n))
    true = subharmonics(ratio, damping, quadratic, cubic, load, p)
    counted, lost, off = 0, [], []
    for i in range(n):
        system = vv.CubicSystem(
            mass=[[1.0]], stiffness=[[1.0]], damping=[[damping[i]]], load=[[load[i]]],
            drives=[p[i]], quadratic=[[[quadratic[i]]]], cubic=[[[[cubic[i]]]]],
        )  # fmt: skip
        scales = vv.MultipleScales(system)
        response = scales.response("p1", [p[i]])
        moving = response.stable & (abs(response.amplitudes[:, 0]) > 1e-3)
        counted += len(true[i])
        if moving.sum() < len(true[i]):
            lost.append(i)
            continue
        found = [scales.motion([0.0], amplitudes=a).state[0] for a in response.amplitudes[moving]]
        off += [
            min(np.linalg.norm(f - state) for f in found) / np.linalg.norm(state)
            for state in true[i]
        ]
    assert counted > 15
    assert not lost
    assert np.median(off) < 0.05


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


def test_tongues_that_reach_far():
    """A large motion destabilizes a mode at rest, with p far from twice its frequency."""
    rng = np.random.default_rng(4)
    growing = judged = 0
    while judged < 24:
        e, w2, w3 = rng.uniform([0.1, 0.35, 0.55], [0.16, 0.5, 0.7])
        body = {"e": e, "w2": w2, "w3": w3, "alpha": 0.1}
        p, f0 = rng.uniform(1.1, 1.25), rng.uniform(0.03, 0.06)

        def pend(p, body=body, f0=f0):
            return vv.Pendulum(**body, c1=0.004, c2=0.004, c3=0.004, f0=f0, p1=p)

        ms = vv.MultipleScales(pend(p))
        psi = ms.frequencies[2]
        found = ms.response("p1", [p])
        if abs(p - 2 * psi) < 0.5 * psi or psi > 0.95 or not found.in_range[0]:
            continue
        around = [
            vv.forced_response(pend(p * x), stability=True).growth[0].max()
            for x in (0.985, 1, 1.015)
        ]
        # At the edges of a tongue no expansion of finite order is certain.
        if min(around) < 0 < max(around):
            continue
        judged += 1
        growing += around[1] > 0
        assert (found.resting_growth[0] > 0) == (around[1] > 0)
        if around[1] > 0:
            assert not found.stable[0]
            # Motions of a fifth of the length: neglected terms are of that size.
            np.testing.assert_allclose(found.resting_growth[0], around[1], rtol=0.25)
    assert growing >= 3


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


@pytest.mark.parametrize("seed", [1, 23, 33, 36, 41, 43, 50, 51])
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
