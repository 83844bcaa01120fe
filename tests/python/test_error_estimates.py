"""Further results with stated errors, which cover the true errors."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp


def _duffing(seed):
    rng = np.random.default_rng(seed)
    c, b = round(rng.uniform(0.05, 0.2), 3), round(rng.uniform(0.2, 1), 3)
    return vv.PolynomialSystem(mass=1, stiffness=1, damping=c, forces=f"{b}*x^3"), c, b


def _runs(c, b, f, nu, starts, t_end):
    """Motions by SciPy, each with its dense output."""
    return [
        solve_ivp(
            lambda t, y: [y[1], f * np.sin(nu * t) - c * y[1] - y[0] - b * y[0] ** 3],
            (0, t_end), start, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True,
        ).sol
        for start in starts
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_sections_of_ensembles(seed, tolerance):
    system, c, b = _duffing(seed)
    starts = np.random.default_rng(seed + 100).uniform(-1, 1, (4, 2))
    nu, f = 0.8 + 0.1 * seed, 0.4
    many = vv.simulate_ensemble(
        system, initial=starts, n_periods=6, nu=nu, load=f, sections=1, tolerance=tolerance,
    )  # fmt: skip
    assert many.section_error > 0
    period = 2 * np.pi / nu
    exact = _runs(c, b, f, nu, starts, 6.01 * period)
    for run, sol in zip(many.sections, exact, strict=True):
        times = period * (np.arange(len(run)) + 6 - len(run) + 1)
        off = np.abs(run - sol(times).T).max()
        assert off <= 1.5 * many.section_error + 1e-11
    assert many.to_dataset().attrs["section_error"] == many.section_error


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_passages_of_ensembles_and_lines(tolerance):
    """Event times by SciPy; the spectrum of a settled linear motion is known."""
    system, c, b = _duffing(3)
    starts = np.array([[1.0, 0.2], [-0.6, 0.5]])
    many = vv.simulate_ensemble(
        system, initial=starts, t_end=12.0, nu=1.1, load=0.4, sections="x", tolerance=tolerance
    )
    exact = _runs(c, b, 0.4, 1.1, starts, 12.0)
    for times, points, sol in zip(many.section_times, many.sections, exact, strict=True):
        known = times[~np.isnan(times)]
        assert known.size > 2
        at = sol(known)
        # Error of the time: the remaining x divided by its rate.
        assert np.abs(at[0] / at[1]).max() <= 1.5 * many.section_error + 1e-11
        assert np.abs(points[: known.size] - at.T).max() <= 3 * many.section_error + 1e-11
    linear = vv.PolynomialSystem(mass=1, stiffness=1, damping=1.0, forces="0*x^3 + 0*x")
    lines = vv.simulate_ensemble(
        linear, initial=[[0.0, 0.0]], n_periods=60, discard=40, nu=1.3, load=1.0, sections=1,
        amplitudes_at=[1.3], tolerance=tolerance,
    )  # fmt: skip
    true = 1 / abs(1 - 1.3**2 + 1.3j)
    assert lines.amplitude_error > 0
    assert abs(abs(lines.amplitudes[0, 0, 0]) - true) <= lines.amplitude_error + 1e-4


@pytest.mark.parametrize("seed", range(2))
def test_steady_motions_of_the_pendulum_tell_what_rounding_leaves(seed):
    """Two tolerances with the same harmonics differ by at most the stated error."""
    rng = np.random.default_rng(seed)
    damping = dict.fromkeys(("c1", "c2", "c3"), rng.uniform(0.005, 0.03))
    body = vv.Pendulum(
        e=0.1, w2=0.5, w3=0.8, alpha=0.5, **damping, f0=rng.uniform(0.002, 0.01), p1=1
    )
    rows = [0.8, 0.97, 1.1]
    rough, fine = (
        vv.forced_response(body, p1=rows, harmonics=7, tolerance=t, stability=False)
        for t in (1e-6, 1e-12)
    )
    size = np.abs(fine.coefficients).max(axis=(1, 2))
    off = np.abs(rough.coefficients - fine.coefficients).max(axis=(1, 2)) / size
    assert (off <= 1.5 * (rough.error + fine.error)).all()
    assert (fine.error > 0).all()
    assert (fine.error < 1e-11).all()
    assert fine.to_dataset().error.to_numpy().tolist() == fine.error.tolist()


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("accuracy", [1e-4, 1e-7])
def test_amplitudes_in_time_tell_what_their_integration_leaves(seed, accuracy):
    rng = np.random.default_rng(seed)
    body = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=rng.uniform(0.001, 0.004),
        p1=1.02,
    )  # fmt: skip
    scales = vv.MultipleScales(body)
    t, start = np.linspace(0, 200, 60), [0.05, 0, rng.uniform(0.05, 0.2), 0, 0, 0]
    rough = scales.modulation(t, start, accuracy=accuracy)
    fine = scales.modulation(t, start, accuracy=1e-13)
    off = np.abs(rough.complex_amplitudes - fine.complex_amplitudes).max(axis=1)
    assert (off <= 1.2 * (rough.error + fine.error)).all()
    assert rough.error.max() <= 3 * off.max() + 1e-13
    assert rough.to_dataset().error.to_numpy().tolist() == rough.error.tolist()
