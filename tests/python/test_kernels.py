"""Relaxation kernels against 50-digit references, quadrature and limits."""

import itertools
import math
import re
import warnings

import matplotlib
import matplotlib.pyplot
import mpmath
import numpy as np
import pytest
import viscovib as vv
from scipy.integrate import quad
from tables import read_table

matplotlib.use("Agg")

KINDS = {"rzhanitsyn": vv.RzhanitsynKernel, "rabotnov": vv.RabotnovKernel}


@pytest.mark.parametrize("kind", KINDS)
def test_transforms_to_the_last_digits(kind):
    worst = 0.0
    rows = [row for row in read_table("kernel_transforms.csv") if row["kernel"] == kind]
    assert len(rows) == 540
    for row in rows:
        kernel = KINDS[kind](amplitude=1.0, alpha=float(row["alpha"]), beta=float(row["beta"]))
        mu = float(row["mu"])
        for got, text in ((kernel.cosine(mu), row["cosine"]), (kernel.sine(mu), row["sine"])):
            expected = float(text)
            if expected:
                worst = max(worst, abs(got - expected) / abs(expected))
            else:
                assert got == 0
    assert worst <= (8e-16 if kind == "rzhanitsyn" else 1.2e-15)


def test_rabotnov_in_time():
    for row in read_table("kernel_values.csv"):
        kernel = vv.RabotnovKernel(
            amplitude=1.0, alpha=float(row["alpha"]), beta=float(row["beta"])
        )
        assert kernel(float(row["t"])) == pytest.approx(float(row["value"]), rel=1e-11)


def test_abel_is_rzhanitsyn_without_decay():
    abel = vv.AbelKernel(amplitude=0.3, alpha=0.4)
    same = vv.RzhanitsynKernel(amplitude=0.3, alpha=0.4, beta=0.0)
    mu = np.logspace(-8, 8, 33)
    assert (abel.transform(mu) == same.transform(mu)).all()
    assert abel.integral == math.inf


def test_rabotnov_limits():
    mu, t = np.logspace(-6, 6, 25), np.logspace(-4, 1, 11)
    abel = vv.AbelKernel(amplitude=2.0 / math.gamma(0.3), alpha=0.3)
    power = vv.RabotnovKernel(amplitude=2.0, alpha=0.3, beta=0.0)
    assert power.transform(mu) == pytest.approx(abel.transform(mu), rel=2e-15)
    assert power(t) == pytest.approx(abel(t), rel=1e-14)
    maxwell = vv.PronyKernel(weights=[2.0], rates=[0.7])
    exponential = vv.RabotnovKernel(amplitude=2.0, alpha=1.0, beta=0.7)
    assert exponential.transform(mu) == pytest.approx(maxwell.transform(mu), rel=2e-15)
    assert exponential(t) == pytest.approx(maxwell(t), rel=1e-15)


KERNELS = [
    vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05),
    vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=1.5),
    vv.PronyKernel(weights=[0.1, 0.4], rates=[0.3, 8.0]),
    vv.TabulatedKernel(times=[0.0, 0.5, 1.5, 4.0], values=[1.0, 0.6, 0.2, 0.05]),
    vv.TabulatedKernel(
        times=[0.2, 0.5, 1.5, 4.0], values=[1.0, 0.6, 0.2, 0.05], interpolation="exponential"
    ),
]


@pytest.mark.parametrize("kernel", KERNELS, ids=lambda kernel: type(kernel).__name__)
class TestLaws:
    """Properties of every kernel."""

    def test_laplace_on_the_imaginary_axis_is_the_transform(self, kernel):
        mu = np.logspace(-3, 4, 29)
        assert kernel.laplace(1j * mu) == pytest.approx(kernel.transform(mu), rel=1e-13)

    def test_integral_is_the_transform_at_zero(self, kernel):
        assert kernel.cosine(0.0) == pytest.approx(kernel.integral, rel=1e-14)
        assert kernel.sine(0.0) == 0

    def test_sine_is_odd(self, kernel):
        assert kernel.transform(-2.0) == np.conj(kernel.transform(2.0))

    def test_transform_of_the_values(self, kernel):
        """Laplace transform at real s against quadrature of R(t)."""
        for s in (0.5, 3.0):
            breaks = [0.2, 0.5, 1.5, 4.0]
            inner = quad(
                lambda y, s=s: kernel(np.exp(y)) * np.exp(y - s * np.exp(y)),
                -400.0,
                math.log(0.2),
                epsabs=1e-13,
                epsrel=1e-12,
                limit=400,
            )[0]
            outer = quad(
                lambda t, s=s: kernel(t) * np.exp(-s * t), 0.2, 80.0, points=breaks[1:], limit=400
            )[0]
            assert kernel.laplace(s).real == pytest.approx(inner + outer, rel=1e-8)
            assert abs(kernel.laplace(s).imag) < 1e-15

    def test_shapes_follow_the_argument(self, kernel):
        assert kernel.transform(1.0).shape == ()
        assert kernel.transform([[1.0, 2.0]]).shape == (1, 2)
        assert kernel([1.0, 2.0, 3.0]).shape == (3,)
        assert kernel.cosine([]).shape == (0,)


@pytest.mark.parametrize("drop", [1e-2, 1e-4, 1e-6, 1e-9])
def test_the_integral_of_a_table_that_hardly_falls_at_its_end_keeps_its_digits(drop):
    t, r = [0.564, 1.1021, 1.7301], [0.75672, 0.61535, 0.61535 * (1 - drop)]
    total = vv.TabulatedKernel(times=t, values=r, interpolation="exponential").integral
    with mpmath.workdps(30):
        a, b = (
            mpmath.log(mpmath.mpf(r[i]) / mpmath.mpf(r[i + 1]))
            / (mpmath.mpf(t[i + 1]) - mpmath.mpf(t[i]))
            for i in (0, 1)
        )
        before = mpmath.mpf(r[0]) * mpmath.expm1(a * mpmath.mpf(t[0])) / a
        between = sum((mpmath.mpf(r[i]) - mpmath.mpf(r[i + 1])) / q for i, q in enumerate((a, b)))
        exact = float(before + between + mpmath.mpf(r[2]) / b)
    assert total == pytest.approx(exact, rel=1e-15)


def test_tabulated_exponential_is_exact_for_an_exponential():
    t = np.array([0.3, 0.31, 2.0, 7.0])
    table = vv.TabulatedKernel(times=t, values=0.4 * np.exp(-0.9 * t), interpolation="exponential")
    maxwell = vv.PronyKernel(weights=[0.4], rates=[0.9])
    mu = np.logspace(-8, 8, 65)
    assert table.cosine(mu) == pytest.approx(maxwell.cosine(mu), rel=1e-12)
    assert table.sine(mu) == pytest.approx(maxwell.sine(mu), rel=1e-12)
    assert table.integral == pytest.approx(0.4 / 0.9, rel=1e-14)


def test_first_rates_of_tables_are_continued_to_0_or_refused():
    rng = np.random.default_rng(7)
    refused = 0
    for _ in range(200):
        t = 10.0 ** rng.uniform(-2, 2) + np.cumsum(10.0 ** rng.uniform(-4, 1, 4))
        r = 10.0 ** rng.uniform(-3, 0, 4)
        r[3] = 0.5 * r[2]  # the kernel decays
        with mpmath.workdps(40):
            times, values = [mpmath.mpf(x) for x in t], [mpmath.mpf(x) for x in r]
            falls = [mpmath.log(a / b) for a, b in itertools.pairwise(values)]
            rates = [
                fall / (v - u)
                for fall, (u, v) in zip(falls, itertools.pairwise(times), strict=True)
            ]
            start = values[0] * mpmath.exp(rates[0] * times[0])
            ends = itertools.pairwise([start, *values])
            whole = sum(
                (a - b) / rate for (a, b), rate in zip(ends, [rates[0], *rates], strict=True)
            )
            whole += values[-1] / rates[-1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", vv.StabilityWarning)
            if not 1e-307 < start < 1e307:
                refused += 1
                with pytest.raises(vv.InputError, match="continued to 0"):
                    vv.TabulatedKernel(times=t, values=r, interpolation="exponential")
                continue
            kernel = vv.TabulatedKernel(times=t, values=r, interpolation="exponential")
        assert kernel.integral == pytest.approx(float(whole), rel=2e-12)
        assert np.isfinite(kernel.transform([1e-3, 1.0, 1e3])).all()
    assert 20 < refused < 100
    steep = vv.TabulatedKernel(times=[0, 1], values=[1e200, 1e-200], interpolation="exponential")
    assert steep.integral == pytest.approx(1e200 / (400 * math.log(10)), rel=1e-14)


def test_tabulated_linear_triangle():
    """R = 1 - t on [0, 1]: R_c = (1 - cos mu)/mu^2, R_s = (mu - sin mu)/mu^2."""
    kernel = vv.TabulatedKernel(times=[0.0, 0.3, 1.0], values=[1.0, 0.7, 0.0])
    mu = np.array([1e-8, 1e-3, 0.5, 1.9, 2.1, 30.0, 1e5])
    cosine = 2 * (np.sin(mu / 2) / mu) ** 2
    series = mu / 6 - mu**3 / 120 + mu**5 / 5040
    sine = np.where(mu < 0.01, series, (mu - np.sin(mu)) / mu**2)
    assert kernel.cosine(mu) == pytest.approx(cosine, rel=2e-13)
    assert kernel.sine(mu) == pytest.approx(sine, rel=2e-13)


def test_tabulated_approaches_its_kernel_with_the_square_of_the_step():
    smooth = vv.PronyKernel(weights=[1.0], rates=[1.0])
    errors = []
    for n in (101, 201, 401):
        t = np.linspace(0.0, 40.0, n)
        table = vv.TabulatedKernel(times=t, values=smooth(np.maximum(t, 1e-300)))
        errors.append(abs(table.transform(0.7) - smooth.transform(0.7)))
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_a_frequency_does_not_depend_on_its_place():
    kernel = vv.RzhanitsynKernel(amplitude=1.0, alpha=0.37, beta=0.01)
    mu = np.logspace(-8, 8, 1003)
    together = kernel.transform(mu)
    assert all(kernel.transform(mu[i]) == together[i] for i in range(0, 1003, 17))


def test_extreme_frequencies_fall_back_without_loss():
    kernel = vv.RzhanitsynKernel(amplitude=1.0, alpha=0.5, beta=0.0)
    for mu in (1e-300, 1e-160, 1e160, 1e300):
        expected = math.sqrt(math.pi / 2) / math.sqrt(mu)
        assert kernel.cosine(mu) == pytest.approx(expected, rel=1e-15)
        assert kernel.sine(mu) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: vv.RzhanitsynKernel(amplitude=1, alpha=0, beta=1), "alpha = 0: must be in (0, 1]"),
        (lambda: vv.RzhanitsynKernel(amplitude=1, alpha=1.1, beta=1), "alpha = 1.1"),
        (lambda: vv.RzhanitsynKernel(amplitude=1, alpha=0.5, beta=-0.1), "beta = -0.1"),
        (lambda: vv.RzhanitsynKernel(amplitude=-1, alpha=0.5, beta=0.1), "amplitude = -1"),
        (lambda: vv.RzhanitsynKernel(amplitude=1, alpha=math.nan, beta=1), "alpha = nan"),
        (lambda: vv.RzhanitsynKernel(amplitude="1", alpha=0.5, beta=1), "amplitude = '1'"),
        (lambda: vv.AbelKernel(amplitude=1, alpha=2), "alpha = 2: must be in (0, 1]"),
        (lambda: vv.RabotnovKernel(amplitude=1, alpha=0.5, beta=-1), "beta = -1"),
        (lambda: vv.PronyKernel(weights=[1, 2], rates=[1]), "weights and rates have 2 and 1"),
        (lambda: vv.PronyKernel(weights=[1, -2], rates=[1, 1]), "weights (value 2) = -2"),
        (lambda: vv.PronyKernel(weights=[], rates=[]), "weights: must not be empty"),
        (
            lambda: vv.TabulatedKernel(times=[0, 1, 1], values=[1, 1, 1]),
            "times (value 3) = 1 after 1",
        ),
        (lambda: vv.TabulatedKernel(times=[-1, 1], values=[1, 1]), "times (value 1) = -1"),
        (lambda: vv.TabulatedKernel(times=[1], values=[1]), "must match and be 2 or more"),
        (lambda: vv.TabulatedKernel(times=[0, 1], values=[1, math.inf]), "values[1] = inf"),
        (
            lambda: vv.TabulatedKernel(times=[0, 1], values=[1, 0], interpolation="exponential"),
            "values (value 2) = 0: must be greater than 0",
        ),
        (
            lambda: vv.TabulatedKernel(times=[0, 1], values=[1, 0], interpolation="cubic"),
            "interpolation = 'cubic': must be one of",
        ),
        (lambda: KERNELS[0](0.0), "t = 0.0: must be greater than 0"),
        (lambda: KERNELS[0](np.nan), "t = nan: must be a finite number"),
        (lambda: vv.AbelKernel(amplitude=1, alpha=0.5).cosine([1.0, 0.0]), "mu must not be 0"),
        (lambda: KERNELS[0].cosine(1j), "mu: must be real"),
    ],
)
def test_bad_input_is_named(make, text):
    with pytest.raises(vv.InputError) as error:
        make()
    assert text in str(error.value)


def test_tables_that_no_material_has_are_reported():
    with pytest.warns(vv.StabilityWarning, match=r"R\(2\) = -0.1 < 0: the spring would stiffen"):
        vv.TabulatedKernel(times=[0, 1, 2], values=[0.3, 0.1, -0.1])
    with pytest.warns(vv.StabilityWarning, match="R increases between t = 1 and 2"):
        vv.TabulatedKernel(times=[0, 1, 2], values=[0.3, 0.1, 0.2])


def test_a_table_of_a_singular_kernel_says_what_it_lacks():
    """Integral before the first time, A Gamma(alpha, 0 ... t_1), against mpmath."""
    rng = np.random.default_rng(6)
    for _ in range(20):
        alpha, beta, first = rng.uniform(0.05, 0.7), rng.uniform(0.02, 2), 10 ** rng.uniform(-6, -2)
        kernel = vv.RzhanitsynKernel(amplitude=0.1, alpha=alpha, beta=beta)
        times = np.geomspace(first, 50, 80)
        lost = 0.1 * float(mpmath.gammainc(alpha, 0, beta * first)) / beta**alpha
        lost -= float(kernel(first)) * first
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            table = vv.TabulatedKernel(times=times, values=kernel(times))
        if lost > 0.02 * table.integral:
            assert len(caught) == 1
            reported = re.search(r"an integral of about (\S+) lies before", str(caught[0].message))
            assert float(reported[1]) == pytest.approx(lost, rel=0.1)
        elif lost < 0.005 * table.integral:
            assert not caught


@pytest.mark.parametrize("singular", [True, False])
def test_tables_with_noise_say_what_they_lack(singular):
    """With 2 % scatter a singular kernel causes a warning, a smooth kernel does not."""
    rng = np.random.default_rng(9)
    reported, judged = 0, 0
    for _ in range(100):
        alpha, beta, n = rng.uniform(0.1, 0.7), rng.uniform(0.02, 2), int(rng.integers(20, 80))
        first = 10 ** rng.uniform(-4, -1.5) / beta
        times = np.geomspace(first, 20 / beta, n)
        values = times ** (alpha - 1) if singular else 1 + 0.5 * np.exp(-3 * beta * times)
        values = values * np.exp(-beta * times) * (1 + 0.02 * rng.normal(size=n))
        values = np.minimum.accumulate(values)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            table = vv.TabulatedKernel(times=times, values=values, interpolation="exponential")
        z = np.log(values[0] / values[1]) * first / (times[1] - first)
        held = values[0] * first * (np.expm1(z) / z if z else 1.0)
        lost = float(mpmath.gammainc(alpha, 0, beta * first)) / beta**alpha - held
        if singular and lost < 0.05 * table.integral:
            continue
        judged += 1
        reported += len(caught)
    assert judged > 30
    assert reported > 0.95 * judged if singular else reported < 0.05 * judged


@pytest.mark.parametrize("interpolation", ["linear", "exponential"])
def test_a_table_of_a_smooth_kernel_lacks_nothing(interpolation):
    times = np.geomspace(0.01, 20, 60)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vv.TabulatedKernel(
            times=times, values=0.2 * np.exp(-times) + 0.1 * np.exp(-0.1 * times),
            interpolation=interpolation,
        )  # fmt: skip


def test_rabotnov_keeps_its_digits_for_any_exponent():
    """R(t) = A t^(a-1) E_{a,a}(-b t^a) by its series in many digits, small and large exponents."""
    rng = np.random.default_rng(7)
    for _ in range(60):
        alpha = rng.choice([rng.uniform(0.01, 0.1), rng.uniform(0.1, 0.9), rng.uniform(0.9, 0.999)])
        # The series in this z needs about z^(1/alpha) terms and as many digits.
        z = rng.uniform(0.1, 0.95) if alpha < 0.1 else rng.uniform(0.3, 25**alpha)
        t = 10 ** rng.uniform(-2, 2)
        kernel = vv.RabotnovKernel(amplitude=0.3, alpha=alpha, beta=z / t**alpha)
        with mpmath.workdps(60):
            a, beta, time = mpmath.mpf(alpha), mpmath.mpf(kernel.beta), mpmath.mpf(t)
            power = -beta * time**a
            terms = int(400 / alpha) if z < 1 else 800
            total, factor = mpmath.mpf(0), mpmath.mpf(1)
            for n in range(1, terms):
                total += factor * mpmath.rgamma(a * n)
                factor *= power
                if n > 50 and abs(factor * mpmath.rgamma(a * n)) < 1e-30 * abs(total):
                    break
            expected = mpmath.mpf("0.3") * time ** (a - 1) * total
            assert abs(kernel(t) / expected - 1) < 2e-14


@pytest.mark.parametrize("alpha", [0.02, 0.05, 0.3, 0.7])
def test_sums_for_rabotnov_meet_their_tolerance(alpha):
    """Their stated error is the error against the spectral integral, not a rounding of it."""
    kernel = vv.RabotnovKernel(amplitude=1.0, alpha=alpha, beta=1.0)
    close = kernel.sum_of_exponentials(tolerance=1e-13, t_min=1e-3, t_max=1e3)
    assert close.error < 1e-13
    t = np.geomspace(1e-3, 1e3, 5)
    with mpmath.workdps(30):
        a = mpmath.mpf(alpha)

        def density(x, time):
            rate = mpmath.exp(x)
            low = rate**a
            return (
                mpmath.exp(-rate * time)
                * rate
                * low
                / (low**2 + 2 * low * mpmath.cos(mpmath.pi * a) + 1)
            )

        for time in t:
            middle = -mpmath.log(time)
            cuts = [middle + step for step in (-80, -40, -20, -8, -3, 0, 2, 5)]
            whole = mpmath.quad(lambda x, time=time: density(x, time), cuts)
            expected = mpmath.sin(mpmath.pi * a) / mpmath.pi * whole
            assert abs(close(time) / expected - 1) < 1.5e-13


@pytest.mark.parametrize("beta", [0.0, 0.3])
def test_laplace_of_points_with_equal_real_parts(beta):
    """Right and left of -beta, above, on and below the real axis: mpmath and single calls."""
    alpha, amplitude = 0.35, 0.2
    if beta:
        kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=alpha, beta=beta)
    else:
        kernel = vv.AbelKernel(amplitude=amplitude, alpha=alpha)
    heights = np.array([-1e5, -2.0, -1e-9, 1e-12, 0.3, 7.0, 1e4])
    for real in (-2.0, -beta, 1e-3, 40.0):
        s = real + 1j * np.tile(heights, 12)
        found = kernel.laplace(s)
        np.testing.assert_array_equal(found, [kernel.laplace(point) for point in s])
        for value, point in zip(found, s, strict=True):
            exact = (
                amplitude
                * mpmath.gamma(alpha)
                * (mpmath.mpf(beta) + mpmath.mpc(point)) ** (-mpmath.mpf(alpha))
            )
            assert abs(mpmath.mpc(value) - exact) <= 1e-15 * abs(exact)


def test_a_kernel_is_drawn():
    kernel = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    for t in (None, [0.1, 1.0, 10.0]):
        first, second = kernel.plot(t=t)
        at, drawn = first.lines[0].get_data()
        assert drawn == pytest.approx(0.048 * np.exp(-0.05 * at) * at**-0.9, rel=1e-12)
        assert second.lines[0].get_ydata() == pytest.approx(kernel.relaxation(at))
        assert t is None or list(at) == t
    with pytest.raises(vv.InputError, match="t: must be times greater than 0"):
        kernel.plot(t=[0.0, 1.0])
    matplotlib.pyplot.close("all")
