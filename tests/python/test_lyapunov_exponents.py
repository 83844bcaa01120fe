"""Lyapunov exponents: sums of neighbouring motions are mean traces, and stated errors hold."""

import mpmath
import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

#: Laws with corners: text, force, and its derivative with respect to the velocity.
LAWS = (
    ("0.5*abs(x)", lambda x, v: 0.5 * abs(x), lambda x, v: 0.0),
    ("4*max(x - 0.3, 0)", lambda x, v: 4 * max(x - 0.3, 0), lambda x, v: 0.0),
    ("3*min(abs(x), 0.5)*sign(x)", lambda x, v: 3 * np.clip(x, -0.5, 0.5), lambda x, v: 0.0),
    ("0.1*v*abs(v)", lambda x, v: 0.1 * v * abs(v), lambda x, v: 0.2 * abs(v)),
    ("20*v*abs(v)", lambda x, v: 20 * v * abs(v), lambda x, v: 40 * abs(v)),
    ("0.5*max(v, 0)", lambda x, v: 0.5 * max(v, 0), lambda x, v: 0.5 * (v > 0)),
    ("50*max(v, 0)", lambda x, v: 50 * max(v, 0), lambda x, v: 50.0 * (v > 0)),
)


def system_of(law, k, c, structure):
    """One coordinate, as a polynomial system or as a structure."""
    if not structure:
        return vv.PolynomialSystem(mass=1, stiffness=k, damping=c, forces=law.replace("v", "x_dot"))
    text = law.replace("(x", "(d")
    spring = vv.Spring(on={"x1": 1}, stiffness=0.0, law=text)
    return vv.Structure(mass=[1.0], stiffness=[k], damping=[c], elements=[spring])


def mean_trace(force, slope, k, c, load, nu, start, begin, end):
    """Mean of the trace of the Jacobian between two times."""

    def rates(t, y):
        x, v = y[:2]
        return [v, load * np.sin(nu * t) - c * v - k * x - force(x, v), -c - slope(x, v)]

    run = solve_ivp(
        rates, (0, end), [*start, 0.0], "DOP853", rtol=1e-10, atol=1e-13,
        t_eval=[begin, end], max_step=0.05 / np.sqrt(k),
    )  # fmt: skip
    return (run.y[2, 1] - run.y[2, 0]) / (end - begin)


@pytest.mark.parametrize("which", range(len(LAWS)))
def test_sums_of_random_kinked_systems(which):
    """Damping from very small to far above critical; also motions that decay by many decades."""
    law, force, slope = LAWS[which]
    rng = np.random.default_rng(100 + which)
    # Half of the four kinds for each law.
    for i in (0, 3) if which % 2 else (1, 2):
        k, c = 10 ** rng.uniform(-0.5, 1.5), 10 ** rng.uniform(-2, (0, 1.9)[i % 2])
        load, nu = (0.0, 0.5, 2.0)[(i + which) % 3], rng.uniform(0.3, 2) * np.sqrt(k)
        # The trace is evaluated along the motion, if it does not rest on a corner.
        start = rng.uniform(0.1, 1, 2) * rng.choice([-1, 1], 2)
        period = 2 * np.pi / np.sqrt(k)
        n, before = int(rng.integers(100, 300)), int(rng.choice([0, 50]))
        end, begin = 0.05 * period * n, 0.05 * period * before
        call = {"initial": start, "t_end": end, "discard": begin, "dt": 0.05 * period}
        if load:
            call |= {"load": load, "nu": nu}
        many = vv.simulate_ensemble(
            system_of(law, k, c, structure=i % 4 < 2), lyapunov="all", **call
        )
        assert many.outcome[0] == "completed"
        true = mean_trace(force, slope, k, c, load, nu, start, begin, end)
        assert many.spectrum.sum() * (end - begin) == pytest.approx(
            true * (end - begin), rel=2e-5, abs=2e-4
        ), (law, k, c, load, nu, start)


def test_coordinates_that_rest_are_disturbed():
    """The second coordinate is at rest: its perturbations are those of a damped oscillator."""
    c1, c2 = 0.1, 60.0
    two = vv.Structure(
        mass=[1.0, 1.0], stiffness=[1.0, 3.0], damping=[c1, c2],
        elements=[vv.Spring(on={"x1": 1}, stiffness=0.0, law="0.5*abs(d)")],
    )  # fmt: skip
    many = vv.simulate_ensemble(
        two, initial=[0.3, 0.1, 0, 0], load={"x1": 0.5}, nu=1.1, t_end=60, discard=20, dt=0.05,
        lyapunov="all",
    )  # fmt: skip
    root = np.sqrt(c2**2 / 4 - 3)
    assert many.spectrum[0, 3] == pytest.approx(-c2 / 2 - root, abs=1e-4)
    assert many.spectrum.sum() == pytest.approx(-c1 - c2, abs=2e-6)


@pytest.mark.parametrize(("c", "k"), [(0.1, 1.0), (3.0, 1.0), (20.0, 1.0)])
def test_sums_with_memory_and_strong_damping(c, k):
    """Area of perturbations of the present state, by the full exponential with 120 digits."""
    kernel, end = vv.PronyKernel(weights=[0.3], rates=[1.0]), 60
    system = vv.PolynomialSystem(
        mass=1, stiffness=0, damping=c, springs=[vv.Springs(stiffness=k, kernel=kernel)]
    )
    many = vv.simulate_ensemble(system, initial=[1, 0], t_end=end, dt=0.1, lyapunov="all")
    with mpmath.workdps(120):
        whole = mpmath.expm(
            end * mpmath.matrix([[0, 1, 0], [-k, -c, k], [mpmath.mpf(3) / 10, 0, -1]])
        )
        area = float(mpmath.log(abs(whole[0, 0] * whole[1, 1] - whole[0, 1] * whole[1, 0])))
    assert many.spectrum.sum() * end == pytest.approx(area, abs=1e-5)


def area_rate(rates, tangent, hidden, before, end):
    """Mean growth of areas of coordinates and velocities from a time on, starting at rest.

    By the variational equation. Hidden states are perturbed according to their derivatives with
    respect to the first state.
    """
    n = 2 + hidden.size
    state, grown = np.zeros(n), 0.0
    nearby = np.vstack([np.eye(2), np.outer(hidden, [1, 0])])
    for begin in np.arange(0, end, 0.5):

        def both(t, y):
            return np.concatenate([rates(t, y[:n]), (tangent(y[:n]) @ y[n:].reshape(n, 2)).ravel()])

        run = solve_ivp(
            both, (begin, begin + 0.5), [*state, *nearby.ravel()], "DOP853", rtol=1e-10,
            atol=1e-12, max_step=0.02,
        )  # fmt: skip
        state, nearby = run.y[:n, -1], run.y[n:, -1].reshape(n, 2)
        grown += np.log(abs(np.linalg.det(nearby[:2]))) * (begin >= before)
        nearby = nearby @ np.linalg.inv(nearby[:2])
    return grown / (end - before)


@pytest.mark.parametrize(("c", "g", "b", "n"), [(8, 1, 2, 1.5), (20, 4, 5, 1)])
def test_sums_with_hysteresis(c, g, b, n):
    """With strong damping most of a perturbation is in the nonlinear state of the joint."""
    k, load, nu, before, end = 3.0, 6.0, 0.9, 10.0, 30.0
    joint = vv.BoucWen(on="x1", stiffness=k, ratio=0.2, beta=b, gamma=g, exponent=n)
    one = vv.Structure(mass=[1.0], stiffness=[1.0], damping=[c], elements=[joint])
    many = vv.simulate_ensemble(
        one, initial=[0, 0], load={"x1": load}, nu=nu, t_end=end, discard=before, dt=0.05,
        lyapunov="all",
    )  # fmt: skip

    def rates(t, y):
        x, v, z = y
        turned = 1 - (g + b * np.sign(z * v)) * abs(z) ** n
        force = load * np.sin(nu * t) - c * v - (1 + 0.2 * k) * x - 0.8 * k * z
        return [v, force, turned * v]

    def tangent(y):
        _, v, z = y
        s = g + b * np.sign(z * v)
        own = [1 - s * abs(z) ** n, -n * s * abs(z) ** (n - 1) * np.sign(z) * v]
        return np.array([[0, 1, 0], [-1 - 0.2 * k, -c, -0.8 * k], [0, *own]])

    true = area_rate(rates, tangent, np.ones(1), before, end)
    assert many.spectrum.sum() == pytest.approx(true, abs=5e-7)


def test_what_lives_on_in_the_past_alone_is_not_reported():
    """The second mass forgets fast, the first remembers: the fourth exponent is hidden."""
    kernel = vv.PronyKernel(weights=[0.3], rates=[1.0])
    two = vv.PolynomialSystem(
        mass=np.eye(2), stiffness=np.diag([0, 3.0]), damping=np.diag([0.1, 20.0]),
        springs=[vv.Springs(stiffness=np.diag([1.0, 0]), kernel=kernel)],
    )  # fmt: skip
    for start in ([1, 0, 0, 0], [1, 0, 0.5, 0]):
        many = vv.simulate_ensemble(two, initial=start, t_end=30, dt=0.1, lyapunov="all")
        assert np.isfinite(many.spectrum[0, :3]).all()
        assert many.lyapunov[0] == many.spectrum[0, 0]
        assert np.isnan(many.spectrum[0, 3])
        one = vv.simulate_ensemble(two, initial=start, t_end=30, dt=0.1, lyapunov=True)
        assert np.isfinite(one.lyapunov).all()


def test_exponents_of_linear_systems():
    """Real parts of eigenvalues, for run times from 10 to 300."""
    above, judged = 0, 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(1, 4))
        a, b = rng.normal(size=(2, n, n))
        stiffness = a @ a.T + 0.3 * np.eye(n)
        damping = 0.3 * rng.random() * (b @ b.T / n + 0.1 * np.eye(n))
        flow = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
        exact = np.sort(np.linalg.eigvals(flow).real)[::-1]
        t_end = 10 ** rng.uniform(1, 2.5)
        many = vv.simulate_ensemble(
            vv.PolynomialSystem(mass=np.eye(n), stiffness=stiffness, damping=damping),
            initial=1e-3 * rng.normal(size=(1, 2 * n)), t_end=t_end, lyapunov="all",
            discard=t_end / 4 if seed % 2 else 0.0,
        )  # fmt: skip
        off = np.abs(many.spectrum[0] - exact) / many.spectrum_error[0]
        assert off.max() < 2, seed
        assert many.lyapunov_error[0] == many.spectrum_error[0, 0]
        above += int((off > 1).sum())
        judged += off.size
    assert above <= 0.05 * judged


def test_exponents_of_chaos():
    """96 short runs against the mean of long runs; the errors are a few times the scatter."""
    duffing = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.25, forces="x^3")
    rng = np.random.default_rng(0)
    long, short = (
        vv.simulate_ensemble(
            duffing, initial=rng.normal(size=(n, 2)), t_end=t_end, load=0.3, nu=1.0, dt=0.1,
            lyapunov=True, discard=100.0,
        )
        for n, t_end in ((16, 4000.0), (96, 300.0))
    )  # fmt: skip
    off = short.lyapunov - long.lyapunov.mean()
    assert (np.abs(off) > short.lyapunov_error).sum() <= 7
    assert np.median(short.lyapunov_error) < 4 * off.std()
    assert long.lyapunov_error.mean() < 0.5 * short.lyapunov_error.mean()
