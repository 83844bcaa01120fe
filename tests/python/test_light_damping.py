"""Stability with memory near the imaginary axis: random chains on Prony springs."""

import numpy as np
import pytest
import viscovib as vv

#: Fixed numbers of harmonics; the truncation is tested elsewhere.
pytestmark = pytest.mark.filterwarnings(
    "ignore:.*do not reach the tolerance:viscovib.ConvergenceWarning"
)


def monodromy(matrices, period, steps):
    """Monodromy matrix of y' = A(t) y, Magnus expansion of order 6 (Blanes, Casas, Ros, BIT 40)."""
    h = period / steps
    at = h * (np.arange(steps) + 0.5)
    offset = np.sqrt(15) / 10 * h
    before, middle, after = matrices(at - offset), matrices(at), matrices(at + offset)
    first, second = h * middle, h * np.sqrt(15) / 3 * (after - before)
    third = 10 * h / 3 * (after - 2 * middle + before)

    def bracket(a, b):
        return a @ b - b @ a

    inner = bracket(first, second)
    outer = -bracket(first, 2 * third + inner) / 60
    omega = first + third / 12 + bracket(-20 * first - third + inner, second + outer) / 240
    power = step = np.eye(omega.shape[1]) + 0 * omega
    for k in range(1, 14):
        power = power @ omega / k
        step = step + power
    total = np.eye(omega.shape[1])
    for one in step:
        total = one @ total
    return total


class Chain:
    """Masses between walls, all springs with memory, a cubic force on one mass."""

    def __init__(self, rng, n, damping, cubic):
        self.n, self.mass = n, rng.uniform(1, 2, n)
        springs = rng.uniform(0.5, 1.6, n + 1)
        self.k = np.diag(springs[:-1] + springs[1:])
        self.k -= np.diag(springs[1:-1], 1) + np.diag(springs[1:-1], -1)
        self.damping = 10 ** rng.uniform(*damping) * self.k
        terms = rng.integers(1, 3)
        self.weights, self.rates = 10 ** rng.uniform(-5, -2, terms), 10 ** rng.uniform(-1, 1, terms)
        self.cubic = cubic * (np.arange(n) == rng.integers(n))
        self.load = 1.0 * (np.arange(n) == rng.integers(n))
        self.remember(self.weights, self.rates)

    def remember(self, weights, rates):
        self.weights, self.rates, n = weights, rates, self.n
        self.system = vv.PolynomialSystem(
            mass=self.mass,
            stiffness=self.k,
            damping=self.damping,
            forces=[
                vv.Monomial(coefficient=c, powers=3 * np.eye(n, dtype=int)[i], on=i)
                for i, c in enumerate(self.cubic)
                if c
            ],
            kernel=vv.PronyKernel(weights=self.weights, rates=self.rates),
        )

    def frequencies(self):
        return np.sqrt(np.linalg.eigvals(self.k / self.mass[:, None]).real)

    def multipliers(self, nu, orders, x):
        n, terms = self.n, self.rates.size

        def matrices(t):
            u = (np.exp(1j * nu * np.outer(t, orders)) @ np.reshape(x, (n, -1)).T).imag
            a = np.zeros((t.size, (2 + terms) * n, (2 + terms) * n))
            spring = self.k + 3 * (self.cubic * u**2)[:, :, None] * np.eye(n)
            a[:, :n, n : 2 * n] = np.eye(n)
            a[:, n : 2 * n, :n] = -spring / self.mass[:, None]
            a[:, n : 2 * n, n : 2 * n] = -self.damping / self.mass[:, None]
            for j in range(terms):
                own = slice((2 + j) * n, (3 + j) * n)
                a[:, n : 2 * n, own] = np.diag(self.weights[j] / self.mass)
                a[:, own, :n] = spring
                a[:, own, own] = -self.rates[j] * np.eye(n)
            return a

        steps = int(60 + 60 / nu + 4 * self.rates.max() / nu)
        return np.linalg.eigvals(monodromy(matrices, 2 * np.pi / nu, steps))


def reported(multipliers):
    known = multipliers[~np.isnan(multipliers)]
    return np.abs(known).max(), (np.abs(known) > 1).sum()


@pytest.mark.parametrize("damping", [(-4.3, -3.3), (-5.0, -4.0)])
def test_zeros_next_to_the_axis_are_not_lost(damping):
    """One frequency per call: no neighbouring solution is available."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        chain = Chain(rng, 3, damping, 0.1)
        for nu in 0.9 * chain.frequencies():
            r = vv.forced_response(
                chain.system, nu, load={1: 1e-3 * chain.load}, method="newton", stability=True
            )
            expected = np.abs(chain.multipliers(nu, r.harmonics, r.coefficients[0])).max()
            assert expected < 1
            assert r.stable[0]
            # The least stable exponent is found and identified.
            assert r.slowest[0]
            assert reported(r.multipliers[0])[0] == pytest.approx(expected, abs=1e-8)


def test_nor_along_branches_through_folds():
    rng = np.random.default_rng(4)
    growing = 0
    for _ in range(6):
        chain = Chain(rng, int(rng.integers(1, 4)), (-5, -3), 0.5)
        at = rng.choice(chain.frequencies())
        load = 0.02 * chain.load
        load = {1: load} if chain.n > 1 else load[0]
        branch = vv.trace_response(
            chain.system, (0.9 * at, 1.15 * at), load=load, harmonics=9, max_points=150
        )
        for i in range(0, branch.nu.size, 6):
            all_of_them = chain.multipliers(branch.nu[i], branch.harmonics, branch.coefficients[i])
            expected = np.abs(all_of_them).max(), (np.abs(all_of_them) > 1).sum()
            largest, count = reported(branch.multipliers[i])
            assert branch.stable[i] == (expected[0] <= 1)
            assert count == expected[1]
            assert largest == pytest.approx(expected[0], rel=1e-6)
            growing += count > 0
    assert growing > 4


def test_the_slowest_exponent_is_found_or_may_lack():
    """Damping and memory of all sizes: structure or memory may be the slowest, or several equal."""
    rng = np.random.default_rng(8)
    certain = judged = 0
    for _ in range(60):
        chain = Chain(rng, int(rng.integers(1, 4)), (-5, -0.7), 0.3)
        rates = 10 ** rng.uniform(-2, 0.5, chain.rates.size)
        chain.remember(rates * rng.uniform(0.02, 0.4) / rates.size, rates)
        nu = rng.choice(chain.frequencies()) * rng.choice([0.3, 0.5, 0.9, 1.02, 1.1, 2.0])
        load = 10 ** rng.uniform(-3, -0.5) * chain.load
        r = vv.forced_response(
            chain.system, nu, load={1: load}, method="newton", harmonics=9, stability=True
        )
        if r.outcome[0] != "converged" or not r.stable[0]:
            continue
        judged += 1
        if r.slowest[0]:
            certain += 1
            expected = np.abs(chain.multipliers(nu, r.harmonics, r.coefficients[0])).max()
            assert reported(r.multipliers[0])[0] == pytest.approx(expected, rel=1e-5)
    assert judged > 40
    assert certain > 0.9 * judged


def test_what_memory_hides_is_counted():
    """A pair near the poles of slow memory, which nearly cancel it."""
    chain = Chain(np.random.default_rng(1), 2, (-5, -4), 0.1)
    chain.mass = np.array([1.794, 1.012])
    chain.k = np.array([[2.606, -1.211], [-1.211, 2.654]])
    chain.damping, chain.cubic = 2.2e-5 * chain.k, np.array([0, 0.1])
    chain.remember(np.array([0.00288, 0.015]), np.array([0.02846, 0.1484]))
    nu = 0.47978
    r = vv.forced_response(
        chain.system, nu, load={1: [0.3, 0.0]}, method="newton", harmonics=9, stability=True
    )
    expected = chain.multipliers(nu, r.harmonics, r.coefficients[0])
    assert r.slowest[0]
    assert reported(r.multipliers[0])[0] == pytest.approx(np.abs(expected).max(), rel=1e-8)


def test_memory_slower_than_any_exponential_is_reported():
    kernel = vv.RabotnovKernel(amplitude=0.01, alpha=0.5, beta=0.3)
    slow = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.02, forces="0.3*x^3", kernel=kernel)
    r = vv.forced_response(slow, [0.5, 2.0], load=0.1, method="newton", stability=True)
    assert r.stable.all()
    assert not r.slowest.any()


@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
@pytest.mark.parametrize("seed", range(6))
def test_the_error_of_a_response_counts_rounding(seed):
    """One harmonic of a Duffing or linear body, damping down to 1e-9, in higher precision."""
    rng = np.random.default_rng(seed)
    damping, linear = 10 ** rng.uniform(-9, -1), seed % 2 == 0
    cubic, load = 0.0 if linear else rng.uniform(0.1, 2), damping * rng.uniform(0.3, 3)
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=damping, forces=f"{cubic}*x^3")
    nu = np.sort(
        np.r_[rng.uniform(0.5, 2, 6), 1 + rng.uniform(-1, 1, 6) * 10 ** rng.uniform(-8, -2, 6)]
    )
    response = vv.forced_response(
        body, nu, load=load, method="linear" if linear else "newton", harmonics=1, stability=False
    )
    found = np.flatnonzero(response.converged)
    assert found.size > 6
    for i in found:
        begun = x = np.clongdouble(response.coefficient("x", 1)[i])
        w, three = np.longdouble(nu[i]), np.longdouble(3 * cubic) / 4
        z = 1 - w**2 + 1j * np.longdouble(damping) * w
        for _ in range(8):
            left = z * x + three * abs(x) ** 2 * x - np.longdouble(load)
            # By d(|x|^2 x) = 2 |x|^2 dx + x^2 conj(dx).
            a, b = z + 2 * three * abs(x) ** 2, three * x**2
            x = x - (a.conjugate() * left - b * left.conjugate()) / (abs(a) ** 2 - abs(b) ** 2)
        assert abs(x - begun) < 3 * response.error[i] * abs(x)
