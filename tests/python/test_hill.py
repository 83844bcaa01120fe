"""Stability with memory, against ordinary equations, time integration and linear theory."""

import warnings

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from referee import balance
from referee.integration import solve_ivp
from referee.models import chain, some_prony
from scipy.optimize import brentq
from scipy.special import gamma
from tables import lines_without_plan

#: Fixed numbers of harmonics; the truncation is tested elsewhere.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*do not reach the tolerance:viscovib.ConvergenceWarning"
)

matplotlib.use("Agg")

M0 = {"mass": 1, "inertia": 0.1, "offset": 0.5, "stiffness_x": 10, "stiffness_phi": 2}
PRONY = vv.PronyKernel(weights=[0.02, 0.3], rates=[0.15, 3.0])


def body(**changes):
    return vv.Mount(**(M0 | {"kernel": PRONY} | changes))


def multipliers(nu, k, x, geometry):
    """Multipliers of the mount on Prony springs, with two memory states per spring force."""
    period = 2 * np.pi / nu
    amplitudes, rates = np.asarray(PRONY.weights), np.asarray(PRONY.rates)

    def orbit(t):
        return (x * np.exp(1j * k * nu * t)).sum(axis=1).imag

    # Memory of each exponential for the spring deflection along the orbit.
    times = 2 * np.pi / nu * np.arange(512) / 512
    along = np.array([orbit(t) for t in times])
    stretched = np.fft.rfft(along[:, 0] - 0.5 * np.sin(along[:, 1])) / 512
    at = 1j * nu * np.arange(stretched.size)
    kept = stretched * (1 - sum(a / (b + at) for a, b in zip(amplitudes, rates, strict=True)))

    def force(t):
        turn = np.exp(at[:60] * t)
        return 10 * (2 * (kept[:60] * turn).sum() - kept[0]).real

    def slope(t, y):
        y = y.reshape(-1, 4 + 6)
        x, phi = orbit(t)
        u, v, z = y[:, :2], y[:, 2:4], y[:, 4:].reshape(-1, 3, 2)
        if geometry == "exact":
            w = np.stack(
                [10 * (u[:, 0] - 0.5 * np.cos(phi) * u[:, 1]), 0 * u[:, 0], 2 * u[:, 1]], 1
            )
        else:
            w = np.stack(
                [
                    10 * u[:, 0] - 5 * u[:, 1] + 2.5 * phi**2 * u[:, 1],
                    -5 * u[:, 0] + 2.5 * u[:, 1] + 2.5 * phi**2 * u[:, 0]
                    + (5 * phi * x - 5 * phi**2) * u[:, 1],
                    2 * u[:, 1],
                ],
                1,
            )  # fmt: skip
        h = w - (amplitudes * z).sum(axis=2)
        moment = h[:, 1] + h[:, 2]
        if geometry == "exact":
            moment = h[:, 2] - 0.5 * np.cos(phi) * h[:, 0] + 0.5 * np.sin(phi) * force(t) * u[:, 1]
        a = np.stack([-h[:, 0], -moment / 0.1], 1)
        dz = w[:, :, np.newaxis] - rates * z
        return np.concatenate([v, a, dz.reshape(-1, 6)], 1).ravel()

    end = solve_ivp(slope, (0, period), np.eye(10).ravel(), "DOP853", rtol=1e-11, atol=1e-12)
    return np.linalg.eigvals(end.y[:, -1].reshape(10, 10))


def known(values):
    return values[~np.isnan(values)]


@pytest.mark.parametrize("geometry", ["cubic", "exact"])
@pytest.mark.parametrize("amplitude", [0.048, 0.078])
def test_at_rest_they_are_the_characteristic_roots(amplitude, geometry):
    kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.1, beta=0.05)
    if amplitude == 0.078:
        with pytest.warns(vv.StabilityWarning, match="relaxed stiffness"):
            mount = body(kernel=kernel, geometry=geometry)
    else:
        mount = body(kernel=kernel, geometry=geometry)
    roots = mount.characteristic_roots()
    expected = np.concatenate([roots.oscillatory, roots.oscillatory.conj(), roots.real])
    branch = vv.trace_response(mount, (0.9, 3.1), load=0.0)
    assert (branch.stable == (roots.n_unstable == 0)).all()
    # Two slow roots 5e-8 apart: if they are not distinguished, the result is unknown.
    reported = ~np.isnan(branch.exponents[:, 0])
    assert reported.all() if amplitude == 0.048 else reported.any()
    for nu, exponents in zip(branch.nu[reported], branch.exponents[reported], strict=True):
        found = known(exponents)
        assert found.size >= 4
        assert (found.real > 0).sum() == roots.n_unstable
        # Odd harmonics only: modulo 2 i nu, with lambda = s + i nu.
        turns = (found[:, None] - expected) / nu
        turns = turns.imag - 1
        error = np.abs(found.real[:, None] - expected.real) + np.abs(
            turns - 2 * np.round(turns / 2)
        )
        assert error.min(axis=1).max() < 1e-7


@pytest.mark.parametrize("beta", [0.05, 0.0])
def test_creep_makes_every_motion_unstable(beta):
    with pytest.warns(vv.StabilityWarning, match="relaxed stiffness"):
        mount = body(kernel=vv.RzhanitsynKernel(amplitude=0.078, alpha=0.1, beta=beta))
    branch = vv.trace_response(mount, (0.8, 5), load=0.3)
    assert not branch.stable.any()
    assert (known(branch.exponents.ravel()).real > 0).any()


def creeping(rng):
    """A system of two coordinates that creeps, and the rates at rest without mass."""
    amplitude, alpha = 10 ** rng.uniform(-2.5, -0.5), rng.uniform(0.1, 0.7)
    beta = rng.choice([0.0, 10 ** rng.uniform(-9, -5)])
    kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=alpha, beta=beta)
    soft, damping = np.diag([rng.uniform(0.1, 0.5), 0]), rng.uniform(0.01, 0.1)
    held = np.array([[2.0, -1.0], [-1.0, rng.uniform(0.8, 3)]])
    system = vv.PolynomialSystem(
        mass=[1, 2], damping=[damping, damping], stiffness=soft, forces={"x1": "0.5*x1^3"},
        springs=[vv.Springs(stiffness=held, kernel=kernel)],
    )  # fmt: skip

    def determinant(t):
        s = np.exp(t)
        # Abel kernel: amplitude Gamma(alpha)/s^alpha; with beta, s + beta instead of s.
        kept = 1 - amplitude * gamma(alpha) / (s + beta) ** alpha
        return np.linalg.det(s**2 * np.diag([1, 2]) + s * damping * np.eye(2) + soft + kept * held)

    t = np.linspace(np.log(1e-12), np.log(10), 2000)
    signs = np.sign([determinant(at) for at in t])
    places = np.flatnonzero(signs[1:] != signs[:-1])
    return system, np.exp([brentq(determinant, t[i], t[i + 1], xtol=1e-14) for i in places])


def test_slow_creep_has_its_rate():
    """Small motions creep at the rates of rest, and large motions have rates too."""
    rng = np.random.default_rng(5)
    slow = 0
    for _ in range(30):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            system, rates = creeping(rng)
            small, large = (
                vv.forced_response(
                    system, [0.7, 30.0], load=[load, 0], method="newton", harmonics=5,
                    stability=True,
                )
                for load in (1e-5, 0.6)
            )  # fmt: skip
        for i, nu in enumerate([0.7, 30.0]):
            grows = np.sort(rates[rates > 1e-11 * nu])
            found = small.exponents[i][small.exponents[i].real > 0]
            assert small.stable[i] == (not grows.size)
            assert np.sort(found.real) == pytest.approx(grows, rel=1e-7)
            assert (found.imag == nu).all()
            slow += (grows < 1e-3 * nu).sum()
        for response in (small, large):
            known_to_grow = (response.stable == False) & response.converged  # noqa: E712
            assert np.isfinite(response.multipliers[known_to_grow, 0]).all()
    assert slow > 30


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_close_rates_of_random_systems_are_all_found():
    """Four rates that grow, close together: those that decay leave places for them."""
    for seed in range(15):
        rng = np.random.default_rng(seed)
        kernel = (
            vv.RzhanitsynKernel(
                amplitude=rng.uniform(0.25, 0.5), alpha=rng.uniform(0.4, 0.8), beta=0.03
            ),
            vv.RabotnovKernel(
                amplitude=rng.uniform(0.3, 0.6), alpha=rng.uniform(0.3, 0.8), beta=0.05
            ),
            vv.PronyKernel(weights=[rng.uniform(0.5, 1.5)], rates=[rng.uniform(0.1, 0.4)]),
        )[seed % 3]
        spread = rng.normal(size=(4, 4))
        stiffness = spread @ spread.T / 4 + 0.5 * np.eye(4)
        forces = [
            vv.Monomial(coefficient=c, powers=tuple(powers), on=on)
            for on, (c, powers) in enumerate(
                zip(rng.uniform(0.1, 0.5, 4), 3 * np.eye(4, dtype=int), strict=True)
            )
        ]
        system = vv.PolynomialSystem(
            mass=np.ones(4), damping=0.02 * stiffness, stiffness=stiffness, forces=forces,
            kernel=kernel,
        )  # fmt: skip
        rates = np.sort(system.characteristic_roots().real)[:-5:-1]
        response = vv.forced_response(
            system, np.sort(rng.uniform(0.5, 2.5, 3)), load={1: [1e-3, 0, 0, 0]},
            method="newton", harmonics=5, stability=True,
        )  # fmt: skip
        assert (rates > 0).all()
        for exponents in response.exponents:
            found = np.sort(exponents.real[exponents.real > 0])[::-1]
            assert found == pytest.approx(rates, rel=1e-4), seed


def test_unknown_is_said(tmp_path):
    """A coordinate without losses and coupling has its exponents on the imaginary axis."""
    kernel = vv.PronyKernel(weights=[0.1], rates=[0.5])
    spring = vv.Springs(stiffness=[[0, 0], [0, 2]])
    system = vv.PolynomialSystem(
        mass=[1, 1], stiffness=[[1, 0], [0, 0]], forces={"x1": "0.5*x1^3"}, kernel=kernel,
        springs=[spring],
    )  # fmt: skip
    with pytest.warns(vv.StabilityWarning, match="on the imaginary axis"):
        branch = vv.trace_response(system, (0.5, 1.0), load=0.1)
    assert set(branch.stable.tolist()) <= {True, False, None}
    assert None in branch.stable.tolist()
    assert np.isnan(branch.exponents[[s is None for s in branch.stable]]).all()
    branch.to_csv(tmp_path / "branch.csv")
    rows = lines_without_plan(tmp_path / "branch.csv")[4:]
    assert "-1" in {row.split(",")[2] for row in rows}
    assert (branch.to_dataset().stable == -1).any()
    labels = {line.get_label() for line in vv.plot_branch(branch)[0].lines}
    assert "stability unknown" in labels
    matplotlib.pyplot.close("all")


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_slow_strong_motions_keep_enough_orders():
    """Few harmonics of the motion, many of its perturbations; reported exponents are true ones."""
    rng = np.random.default_rng(11)
    worst, judged, decided = 0.0, 0, 0
    for index in range(60):
        # Single coordinates and pairs: three have close exponents of the memory.
        model = chain(
            rng, 1 + index % 2, 0.03, memory=some_prony(rng, 0.3), quadratic=index % 3 == 0
        ).model()
        slow = index % 4 > 0
        nu = model.frequencies[0] * (rng.uniform(0.12, 0.6) if slow else rng.uniform(0.6, 1.5))
        r = vv.forced_response(
            eval(model.source), [nu], load=rng.uniform(0.3, 3) if slow else 0.1, method="newton",
            harmonics=(5, 9)[index % 2], stability=True,
        )  # fmt: skip
        found = known(r.multipliers[0])
        if not found.size:
            continue
        x = np.zeros((model.n, r.harmonics.max() + 1), complex)
        x[:, r.harmonics] = r.coefficients[0]
        true, off = balance.multipliers(model, x, nu)
        if off[0] > 1e-10 * abs(true[0]):
            continue
        judged += 1
        distance = np.abs(found[:, None] - true).min(1) / np.maximum(1, np.abs(found))
        assert distance.max() < 2e-8, (index, distance.max())
        worst = max(worst, distance.max())
        if r.stable[0] is not None:  # Omitted harmonics may decide it.
            decided += 1
            assert r.stable[0] == (np.abs(true) < 1).all()
    assert judged > 45
    assert decided > 30
    assert worst > 1e-15


def test_no_exponent_is_found_near_the_divisors():
    """Odd harmonics: divisors of the determinant have poles at i d/2, where a step may end."""
    kernel = vv.PronyKernel(weights=[0.354, 0.0844], rates=[2.44, 1.42])
    system = vv.PolynomialSystem(
        mass=[1.81, 1.99], damping=[[0.016422, -0.004802], [-0.004802, 0.017192]],
        stiffness=[[2.346, -0.686], [-0.686, 2.456]], forces={"x1": "0.439*x1^3"}, kernel=kernel,
    )  # fmt: skip
    r = vv.forced_response(
        system, [0.6751], load=0.094, method="newton", harmonics=5, stability=True
    )
    found = np.sort(np.abs(known(r.multipliers[0])))[::-1]
    # By integration of the ordinary equations.
    assert found[:4] == pytest.approx([0.675050, 0.675050, 0.529377, 0.529377], abs=2e-6)
    assert (found[4:] < 1e-5).all()


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_a_multiplier_that_was_counted_but_not_found_is_not_the_slowest():
    """A fast growing exponent of a softening spring with memory: counted but not located."""
    spring = vv.PolynomialSystem(
        mass=1.69, damping=0.017369, stiffness=1.579, forces="-1.072*x^3 + 0.129*x^2",
        kernel=vv.RzhanitsynKernel(amplitude=0.0258, alpha=0.651, beta=0.927),
    )  # fmt: skip
    branch = vv.trace_response(spring, (0.58, 1.74), load=0.75, max_points=40)
    reported = np.isfinite(np.abs(branch.multipliers)).any(axis=1)
    assert (branch.growing > 0).any()
    assert not (branch.slowest & ~reported).any()
