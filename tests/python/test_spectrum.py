"""Spectra against closed forms, the transform of NumPy and the windows of SciPy."""

import math
import time
import warnings

import matplotlib
import numpy as np
import pytest
import viscovib as vv
from scipy.signal import get_window, lfilter

matplotlib.use("Agg")

SCIPY_NAMES = {
    "rectangular": "boxcar", "hann": "hann", "blackman_harris": "blackmanharris",
    "flat_top": "flattop",
}  # fmt: skip


def random_signal(n, columns=None):
    shape = n if columns is None else (n, columns)
    return np.random.default_rng(5).normal(size=shape)


@pytest.mark.parametrize("window", SCIPY_NAMES)
@pytest.mark.parametrize("n", [16, 101])
def test_against_numpy(window, n):
    u = random_signal(n)
    w = get_window(SCIPY_NAMES[window], n)
    mean = (w * u).sum() / w.sum()
    expected = np.fft.rfft(w * (u - mean)) * 2 / w.sum()
    expected[0] = mean
    if n % 2 == 0:
        expected[-1] /= 2
    s = vv.spectrum(u, 0.1, window=window)
    assert s.coefficients == pytest.approx(expected, abs=1e-14)
    assert s.omega == pytest.approx(2 * np.pi * np.fft.rfftfreq(n, 0.1), rel=1e-15)
    assert s.noise_bandwidth == pytest.approx(n * (w**2).sum() / w.sum() ** 2, rel=1e-12)


def test_flat_top_reads_amplitudes_between_bins():
    n = 400
    for position in np.linspace(50, 51, 11):
        u = np.cos(2 * np.pi * position * np.arange(n) / n)
        largest = vv.spectrum(u, 1.0, window="flat_top").amplitude.max()
        assert largest == pytest.approx(1, abs=2e-3)


def test_columns_are_transformed_one_by_one():
    u = random_signal(64, 3)
    whole = vv.spectrum(u, 0.1, names=("a", "b", "c"))
    for j in range(3):
        assert (whole.coefficients[:, j] == vv.spectrum(u[:, j], 0.1).coefficients).all()
    assert whole.to_dataset().amplitude.shape == (33, 3)


@pytest.mark.parametrize("n", [1, 2, 3, 9, 10, 9973])
def test_odd_lengths(n):
    s = vv.spectrum(np.arange(n, dtype=np.int64), 0.5)
    assert s.omega.shape == (n // 2 + 1,)
    assert np.isfinite(s.coefficients).all()


@pytest.mark.parametrize("n", [64, 257, 1000, 5000])
def test_frequency_and_amplitude_of_any_tone(n):
    """Much finer than the bin width, for any frequency and phase."""
    rng = np.random.default_rng(n)
    for _ in range(40):
        omega = rng.uniform(8 * np.pi / n, np.pi - 8 * np.pi / n) / 0.1
        phase, a = rng.uniform(-np.pi, np.pi), 10 ** rng.uniform(-4, 4)
        u = a * (0.3 + np.cos(omega * 0.1 * np.arange(n) + phase))
        found = vv.dominant_frequencies(u, 0.1, count=1)
        assert abs(found.omega[0] - omega) * 0.1 / (2 * np.pi) < 1e-13
        assert found.amplitude[0] == pytest.approx(a, rel=1e-12)
        assert math.remainder(found.phase[0] - phase, 2 * np.pi) == pytest.approx(0, abs=1e-10)
        assert found.mean == pytest.approx(0.3 * a, rel=1e-11)


def test_two_close_lines_are_distinguished_and_flagged():
    n = 4000
    bin_width = 2 * np.pi / n
    u = np.cos(0.5 * np.arange(n)) + 0.5 * np.cos((0.5 + 1.7 * bin_width) * np.arange(n) + 1)
    found = vv.dominant_frequencies(u, 1.0, count=2)
    assert found.omega == pytest.approx([0.5, 0.5 + 1.7 * bin_width], abs=1e-9)
    assert not found.resolved.any()


@pytest.mark.parametrize(("n", "colour"), [(64, 0.0), (1000, 0.0), (8192, 0.5)])
def test_noise_gives_lines_as_rarely_as_promised(n, colour):
    """White noise, and first-order coloured noise: three times larger at low frequencies."""
    alarm, runs, alarms = 0.05, 100, 0
    rng = np.random.default_rng(n)
    for _ in range(runs):
        noise = lfilter([1], [1, -colour], rng.normal(size=n + 100))
        found = vv.dominant_frequencies(7 + noise[100:], 0.1, count=1, false_alarm=alarm)
        alarms += found.omega.size > 0
    # Five standard deviations above the stated rate.
    slack = 5 * np.sqrt(alarm * (1 - alarm) * runs)
    if not colour:
        assert alarms <= alarm * runs + slack
        assert n < 1000 or alarms > 0
    else:
        assert alarms <= 2 * alarm * runs + slack
    everything = vv.dominant_frequencies(rng.normal(size=n), 0.1, count=3, false_alarm=1)
    assert everything.omega.size == 3


def test_lines_are_found_in_noise_and_no_others():
    """Two lines, with 30 times the bin power of the noise of a Hann window and much more."""
    n, sigma, runs, rng = 2048, 1.0, 40, np.random.default_rng(3)
    k = np.arange(n)
    # Power of a line in its bin over the mean noise power there: a^2 n/(6 sigma^2).
    small = np.sqrt(30 * 6 / n) * sigma
    seen = []
    for _ in range(runs):
        u = np.cos(0.7 * k + 1) + small * np.cos(1.9 * k) + rng.normal(scale=sigma, size=n)
        seen.append(vv.dominant_frequencies(u, 1.0, count=10).omega)
    assert all(abs(omega[0] - 0.7) < 1e-3 for omega in seen)
    found = [omega.size > 1 and abs(omega[1] - 1.9) < 2e-3 for omega in seen]
    assert np.mean(found) > 0.9
    assert sum(omega.size > 2 for omega in seen) <= 1


def test_errors_in_noise_are_those_of_the_window():
    """Standard errors relative to the Cramer-Rao bound: 1.53 and 1.22 with a Hann window."""
    n, a, sigma, runs, rng = 1000, 1.0, 0.3, 200, np.random.default_rng(4)
    k = np.arange(n)
    errors = []
    for _ in range(runs):
        phase = rng.uniform(0, 2 * np.pi)
        u = a * np.cos(0.9 * k + phase) + rng.normal(scale=sigma, size=n)
        found = vv.dominant_frequencies(u, 1.0, count=1)
        errors.append([found.omega[0] - 0.9, found.amplitude[0] - a])
    spread = np.std(errors, axis=0) / [
        np.sqrt(24 / n**3) * sigma / a,
        np.sqrt(2 / n) * sigma,
    ]
    # Four standard deviations of a standard deviation from 200 samples.
    assert spread == pytest.approx([1.531, 1.225], rel=4 / np.sqrt(2 * runs))


def test_weak_lines_with_strong_ones_are_no_noise():
    n = 5000
    k = np.arange(n)
    sizes, omega = 10.0 ** -np.arange(0, 10, 2), [0.3, 0.31, 1.0, 1.02, 2.2]
    u = sum(a * np.cos(w * k + 1) for a, w in zip(sizes, omega, strict=True))
    found = vv.dominant_frequencies(u, 1.0, count=9)
    assert found.omega == pytest.approx(omega, abs=1e-10)
    assert found.amplitude == pytest.approx(sizes, rel=1e-5)
    assert found.omega[0] == pytest.approx(0.3, abs=1e-15)


def test_known_frequencies_need_no_whole_periods():
    t = 3.0 + 0.13 * np.arange(200)
    u = 0.5 + 2 * np.cos(1.1 * t + 0.3) + 1e-3 * np.cos(np.sqrt(2) * t - 1)
    found = vv.amplitudes_at(u, 0.13, [np.sqrt(2), 1.1], start=3.0)
    assert found.omega == pytest.approx([np.sqrt(2), 1.1])
    assert found.amplitude == pytest.approx([1e-3, 2], abs=1e-13)
    assert found.phase == pytest.approx([-1, 0.3], abs=1e-10)
    assert found.mean == pytest.approx(0.5, abs=1e-13)
    assert found.residual < 1e-13


def test_spectra_of_a_trajectory_know_the_spacing_of_its_states():
    """``dt`` of a run is the time between stored states, ``step`` is the integration step."""
    body = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, f0=0.01, p1=0.93, c1=0.01, c2=0.01, c3=0.01)
    run = vv.simulate(body, 400, dt=0.1, initial=[0, 0, 0.1, 0, 0.05, 0], save_every=5)
    assert (run.step, run.dt) == pytest.approx((0.1, 0.5), rel=1e-12)
    own = vv.simulate(body, 50, dt="auto", initial=[0, 0, 0.1, 0, 0.05, 0])
    assert own.dt == pytest.approx(own.t[1] - own.t[0], rel=1e-12)
    uneven = vv.simulate(body, 50, dt=0.1, initial=[0, 0, 0.1, 0, 0.05, 0], times=[1, 2, 7])
    assert np.isnan(uneven.dt)
    with pytest.raises(vv.InputError, match="dt = nan"):
        vv.spectrum(uneven.coordinate("phi"), uneven.dt)
    whole = vv.spectrum(run)
    assert whole.names == run.dof_names
    assert whole.dt == pytest.approx(0.5, rel=1e-12)
    phi = vv.spectrum(run, coordinates="phi")
    by_hand = vv.spectrum(run.coordinate("phi"), 0.5)
    assert phi.omega == pytest.approx(by_hand.omega, rel=1e-12)
    assert (phi.coefficients == by_hand.coefficients).all()
    assert (whole.coefficients[:, 1] == phi.coefficients).all()
    rates = vv.spectrum(run, coordinates=("phi_dot", "z"))
    assert rates.names == ("phi_dot", "z")
    lines = vv.dominant_frequencies(run, coordinate="phi", count=2)
    same = vv.dominant_frequencies(run.coordinate("phi"), 0.5, count=2)
    assert lines.omega == pytest.approx(same.omega, rel=1e-12)


def test_lines_near_what_they_do_not_explain_are_not_resolved():
    """One line for two tones; a chirp."""
    k = np.arange(2000)
    pair = np.cos(0.5 * k) + 0.7 * np.cos(0.507 * k + 1)
    assert not vv.dominant_frequencies(pair, 1.0, count=1).resolved.any()
    apart = np.cos(0.5 * k) + 0.7 * np.cos(0.9 * k + 1)
    assert vv.dominant_frequencies(apart, 1.0, count=1).resolved.all()
    chirp = np.cos(0.5 * k + 2e-5 * k**2)
    assert not vv.dominant_frequencies(chirp, 1.0, count=3).resolved.any()


def test_decay_is_reported_from_noise():
    """Steady tones in noise stay steady; decays above noise are found within their errors."""
    rng, n = np.random.default_rng(8), 1000
    k, steady, rates = np.arange(n), 0, []
    for _ in range(30):
        noise = rng.normal(scale=0.2, size=n)
        tone = np.cos(0.7 * k + rng.uniform(-3, 3))
        steady += vv.dominant_frequencies(tone + noise, 1.0, count=1).decay[0] == 0
        found = vv.dominant_frequencies(np.exp(-2 * k / n) * tone + noise, 1.0, count=3)
        assert found.omega.size == 1
        rates.append(found.decay[0] * n)
    assert steady == 30
    # Mean and spread: a bias would be larger than three standard errors of the mean.
    assert np.mean(rates) == pytest.approx(2, abs=3 * np.std(rates) / np.sqrt(len(rates)))
    # A few times the minimum spread of a rate, which is that of an envelope exp(-2 k/n).
    least = 0.2 * np.sqrt(24 / (n * np.mean(np.exp(-4 * k / n))))
    assert np.std(rates) < 3 * least


def test_states_too_far_apart_are_reported():
    """Random free vibrations with one to eight stored states per half-period, or too few."""
    rng = np.random.default_rng(0)
    for case in range(40):
        omega = 10 ** rng.uniform(-3, 3)
        system = vv.PolynomialSystem(
            mass=1, stiffness=omega**2, damping=0.02 * omega * rng.uniform(0, 1)
        )
        too_few = case % 2 == 0
        apart = math.pi / omega * (rng.uniform(1.05, 8) if too_few else rng.uniform(0.12, 0.8))
        n = int(rng.integers(64, 200))
        run = vv.simulate(
            system, n * apart, initial=[1, omega * rng.normal()], times=apart * np.arange(n + 1)
        )
        for ask in (vv.spectrum, vv.dominant_frequencies, lambda run: vv.free_decay(run, count=1)):
            with warnings.catch_warnings(record=True) as reported:
                warnings.simplefilter("always")
                ask(run)
            assert any("are too far for x" in str(one.message) for one in reported) == too_few
            assert all(one.filename == __file__ for one in reported)


def test_lines_never_leave_more_than_fewer_of_them():
    """For any signal: tones, chirps, noise, steps."""
    rng = np.random.default_rng(9)
    for trial in range(12):
        n = int(rng.integers(64, 400))
        k = np.arange(n)
        signal = {
            0: np.cos(0.3 * k + rng.uniform(0, 2) * k**2 / n),
            1: np.cumsum(rng.normal(size=n)),
            2: np.exp(-rng.uniform(0, 60) * k / n) * np.sin(0.9 * k),
            3: np.sign(np.sin(0.21 * k)) + 0.01 * rng.normal(size=n),
        }[trial % 4]
        left = [vv.dominant_frequencies(signal, 1.0, count=c, false_alarm=1).residual
                for c in (1, 2, 4)]  # fmt: skip
        tiny = 1e-12 * np.abs(signal).max()
        assert left[1] <= left[0] * (1 + 1e-9) + tiny
        assert left[2] <= left[1] * (1 + 1e-9) + tiny


def test_a_long_record_takes_seconds_and_loses_no_digits():
    n = 1_000_000
    u = 1e6 + np.cos(2.0 * 0.7 * np.arange(n))
    # Processor time, independent of other processes.
    begin = time.process_time()
    found = vv.dominant_frequencies(u, 0.7, count=1)
    assert time.process_time() - begin < 20
    assert found.omega[0] == pytest.approx(2.0, abs=1e-13)
    assert found.amplitude[0] == pytest.approx(1, abs=1e-11)


def test_combinations_have_names():
    bases = {"p1": 0.93, "p2": 0.37, "p3": 0.71}
    wanted = {
        0.93: "p1", 1.86: "2 p1", 1.64: "p1 + p3", 0.56: "p1 - p2", -0.56: "p2 - p1", 0.0: "mean",
        0.123: "", 1.49: "p1 + p1 - p2",
    }  # fmt: skip
    names = vv.name_frequencies(list(wanted), bases)
    assert names[:-1] == list(wanted.values())[:-1]
    assert names[-1] == "2 p1 - p2"
    assert vv.name_frequencies([2.0], {"a": 1.0, "b": 2.0}) == ["b"]
    assert vv.name_frequencies([3.0], {"a": 1.0, "b": 2.0}) == ["a + b"]
    assert vv.name_frequencies([2.0], {"a": 1.0, "b": 1.0}, order=2)[0].count(" or ") == 2


def test_picture_names_its_peaks():
    t = 0.2 * np.arange(4000)
    u = np.cos(0.93 * t) + 0.1 * np.cos(1.3 * t)
    axis = vv.plot_spectrum(vv.spectrum(u, 0.2), bases={"p1": 0.93, "p2": 0.37})
    assert {text.get_text() for text in axis.texts} >= {"p1", "p1 + p2"}


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: vv.spectrum([], 0.1), "signal: must have shape (n,) or (n, m) with n >= 1"),
        (lambda: vv.spectrum([1, np.nan], 0.1), "signal[1] = nan: must be a finite number"),
        (lambda: vv.spectrum(np.zeros((2, 2, 2)), 0.1), "got (2, 2, 2)"),
        (lambda: vv.spectrum([1, 2], 0), "dt = 0: must be greater than 0"),
        (lambda: vv.spectrum([1, 2], -1), "dt = -1: must be greater than 0"),
        (lambda: vv.spectrum([1, 2], np.nan), "dt = nan: must be a finite number"),
        (lambda: vv.spectrum([1, 2]), "dt: must be given with an array"),
        (lambda: vv.spectrum([1, 2], 1, coordinates="x"), "only a Trajectory has coordinates"),
        (lambda: vv.spectrum([1e200, 2], 1), "exceed the range of numbers"),
        (lambda: vv.spectrum([1, 2], 1, window="hamming"), "window = 'hamming': must be one of"),
        (lambda: vv.spectrum([1, 2], 1, names=("a", "b")), "names: 2 given, must be 1"),
        (lambda: vv.amplitudes_at(np.ones(9), 1, [3.2]), "frequencies[0] = 3.2: must be greater"),
        (lambda: vv.amplitudes_at(np.ones(9), 1, [0]), "frequencies[0] = 0: must be greater than"),
        (lambda: vv.amplitudes_at(np.ones(9), 1, []), "frequencies: 0 given, must be 1 to 50"),
        (lambda: vv.amplitudes_at(np.ones(4), 1, [1, 2]), "must be at least 5"),
        (lambda: vv.amplitudes_at(np.ones(99), 1, [1, 1 + 1e-9]), "too close together"),
        (lambda: vv.dominant_frequencies(np.ones(9), 1), "must be at least 16"),
        (lambda: vv.dominant_frequencies(np.ones(99), 1, count=0), "count = 0: must be 1 to 50"),
        (
            lambda: vv.dominant_frequencies(np.ones(99), 1, false_alarm=0),
            "false_alarm = 0: must be in (0, 1]",
        ),
        (lambda: vv.name_frequencies([1], {}), "bases: must not be empty"),
        (lambda: vv.name_frequencies([1], {"a": 1}, order=0), "order = 0: must be 1 to 20"),
        (lambda: vv.name_frequencies([1], dict.fromkeys("abcdefgh", 1), order=9), "too many"),
    ],
)
def test_bad_input_is_named(make, text):
    with pytest.raises(vv.InputError) as error:
        make()
    assert text in str(error.value)


@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_constant_has_no_lines(value):
    found = vv.dominant_frequencies(np.full(100, value), 0.1)
    assert found.omega.size == 0
    assert found.mean == value


def test_what_is_folded_is_reported_by_velocities():
    """Random tones, some above the Nyquist frequency: aliased fraction by NumPy transforms."""
    from viscovib.analyses.signals import aliased_part

    rng = np.random.default_rng(5)
    verdicts = []
    for _ in range(40):
        n, step = int(rng.integers(16, 400)), rng.uniform(0.01, 2)
        top = np.pi / step
        omega = np.r_[rng.uniform(0.05, 0.6) * top, rng.uniform(1.2, 3) * top]
        size = np.r_[1.0, rng.choice([0.0, 1e-3, 0.3])]
        phase = rng.uniform(0, 6, 2)
        t = step * np.arange(n)[:, np.newaxis]
        u = np.sin(omega * t + phase) @ size + rng.normal()
        v = np.cos(omega * t + phase) @ (omega * size)
        x = np.pi * (np.arange(n) + 0.5) / n
        window, slope = np.sin(x) ** 2, np.pi / (n * step) * np.sin(2 * x)
        swing = u - window @ u / window.sum()
        derived = 2j * np.pi * np.fft.rfftfreq(n, step) * np.fft.rfft(window * swing)
        if n % 2 == 0:
            derived[-1] = 0.0
        missed = np.fft.irfft(derived, n) - slope * swing - window * v
        expected = np.linalg.norm(missed) / (np.linalg.norm(window * swing) * 2 * np.pi / step)
        share, reported = aliased_part(u, v, step)
        assert share == pytest.approx(expected, rel=1e-9, abs=1e-14)
        if n > 60:
            verdicts.append((bool(reported), size[1] > 0.1))
    assert all(reported == folded for reported, folded in verdicts)
