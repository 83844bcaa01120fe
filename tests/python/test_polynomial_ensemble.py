"""Ensembles of polynomial systems with laws: against single runs, SciPy, exact exponents."""

import numpy as np
import pytest
import viscovib as vv

DUFFING = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
TWO = vv.PolynomialSystem(
    mass=[1, 2],
    stiffness=[[3, -1], [-1, 2]],
    damping=[0.1, 0.2],
    forces={"x1": "x1^3 + 2*x1*x2^2", "x2": "tanh(3*x2) + 0.3*sin(x1 - x2_dot)"},
)


def test_forces_scale_and_statistics():
    """Statistics, spectra and sections equal those of the single runs."""
    call = {"load": 0.2, "nu": 1.2}
    many = vv.simulate_ensemble(
        DUFFING, initial=[0.1, 0.2], n_periods=20, discard=5, sections=1, dt=0.05,
        parameters={"forces_scale": [1.0, 2.0, 0.5]}, statistics=True, amplitudes_at=[1.2], **call,
    )  # fmt: skip
    for i, scale in enumerate((1.0, 2.0, 0.5)):
        alone = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces=f"{scale}*x^3")
        period = 2 * np.pi / 1.2
        run = vv.simulate(
            alone, 20 * period, dt=many.step[i], initial=[0.1, 0.2], method="verner9", **call
        )
        late = run.t > 5 * period + 1e-9
        times = np.linspace(5, 20, 15_001) * period
        states = run(np.minimum(times, run.t_reached))
        np.testing.assert_allclose(many.peak[i], np.abs(states).max(0), rtol=6e-6)
        mean = (states[0] / 2 + states[1:-1].sum(0) + states[-1] / 2) / 15_000
        np.testing.assert_allclose(many.mean[i], mean, atol=1e-7)
        at = run(np.minimum(period * np.arange(6, 21), run.t_reached))
        np.testing.assert_allclose(many.sections[i], at, atol=1e-8)
        window = np.hanning(late.sum() + 2)[1:-1]
        wave = window * np.exp(-1.2j * run.t[late])
        moved = run.state[late, 0] - (window @ run.state[late, 0]) / window.sum()
        line = 2 * (wave @ moved) / window.sum()
        assert many.amplitudes[i, 0, 0] == pytest.approx(line, abs=1e-3 * abs(line))


def test_refused_by_name():
    """Arguments that an ensemble does not support."""
    for system, given, words in (
        (DUFFING, {"parameters": {"mass": [1.0]}}, "'mass' does not vary"),
        (TWO, {"parameters": {"forces_scale": [1.0]}}, "must not scale laws"),
        (DUFFING, {"nu": 1.0}, "without load"),
        (DUFFING, {"sections": 2, "load": 1, "nu": 1.0}, "sections"),
        (DUFFING, {"lyapunov": "some"}, "lyapunov"),
    ):
        n = len(system.dof_names)
        with pytest.raises(vv.InputError, match=words):
            vv.simulate_ensemble(system, initial=np.zeros(2 * n), t_end=5.0, dt=0.1, **given)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_peaks_and_means_by_default_are_those_of_the_motions(tolerance):
    """Regression: with four states per period peaks were up to a third too low."""
    rng = np.random.default_rng(8)
    for _ in range(3):
        stiffness, cubic, nu = rng.uniform(0.5, 2), rng.uniform(0, 0.5), rng.uniform(0.4, 2)
        body = vv.PolynomialSystem(
            mass=1, stiffness=stiffness, damping=0.02, forces=f"{cubic}*x^3"
        )  # fmt: skip
        starts = rng.uniform(-0.5, 0.5, (3, 2))
        job = {"t_end": 40, "load": 0.2, "nu": nu}
        many = vv.simulate_ensemble(
            body, initial=starts, statistics=True, amplitudes_at=[nu], tolerance=tolerance, **job
        )
        assert many.error <= tolerance
        t = np.linspace(0, 40, 20001)
        for start, peak, rms in zip(starts, many.peak, many.rms, strict=True):
            states = vv.simulate(body, initial=start, tolerance=1e-9, **job)(t)
            square = (states[0] ** 2 + states[-1] ** 2) / 2 + (states[1:-1] ** 2).sum(axis=0)
            assert peak == pytest.approx(np.abs(states).max(axis=0), abs=many.error + 4e-6)
            assert rms == pytest.approx(np.sqrt(square / 20000), abs=many.error + 4e-6)


@pytest.mark.parametrize("law", ["0.3*sin(1e6*x)", "0.2*cos(3e5*x)*x_dot"])
def test_large_angles_with_small_ones(law):
    """Large and small angles in parallel: no motion depends on its neighbours, bitwise."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces=law)
    starts = np.array([[x, 0.0] for x in (1e-6, 0.05, 0.2, 0.9, 1.1, 3.0, 40.0, 1e-3)])
    call = {"t_end": 0.1, "dt": 0.05, "method": "verner9", "n_threads": 1}
    together = vv.simulate_ensemble(system, initial=starts, **call).state
    alone = [vv.simulate_ensemble(system, initial=[start], **call).state[0] for start in starts]
    np.testing.assert_array_equal(together, alone)
    at = starts[:, 0]
    force = {"0.3": 0.3 * np.sin(1e6 * at)}.get(law[:3], 0 * at)
    brief = vv.simulate_ensemble(system, initial=starts, **{**call, "t_end": 1e-9, "dt": 1e-9})
    np.testing.assert_allclose(brief.state[:, 1], -(at + force) * 1e-9, rtol=1e-2)


@pytest.mark.parametrize("forces", ["x^3", "x^3 + max(x - 0.1, 0)"])
def test_a_factor_of_nothing_is_refused_at_once(forces):
    """In parallel and in separate runs, before any motion."""
    system = vv.PolynomialSystem(mass=1, stiffness=2, forces=forces)
    with pytest.raises(vv.InputError, match=r"^parameters: 'damping_scale': all of it is 0$"):
        vv.simulate_ensemble(
            system, initial=[0.1, 0], t_end=1, parameters={"damping_scale": [1.0, 2.0]}
        )
