"""Ensembles of separate runs: kinks, stops, hysteresis, memory, surfaces."""

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp

GAP = vv.PolynomialSystem(
    mass=1, stiffness=1, damping=0.05, forces="k*max(x - 0.5, 0)", parameters={"k": 30.0}
)
KERNEL = vv.PronyKernel(weights=[0.3], rates=[1.0])


def one_mass(*elements, c=0.05):
    """A mass of 1 on a spring of 1."""
    return vv.Structure(mass=[1.0], stiffness=[1.0], damping=[c], elements=list(elements))


def test_statistics_sections_and_lines_of_a_structure_with_friction():
    """The statistics, sections and spectra equal those of the single run."""
    nu = 1.1
    slip = one_mass(vv.Jenkins(on={"x1": 1}, stiffness=2.0, limit=0.3))
    many = vv.simulate_ensemble(
        slip, initial=[0, 0], load=0.8, nu=nu, n_periods=20, discard=5, sections=1, dt=0.05,
        statistics=True, amplitudes_at=[nu], sample_every=2,
        parameters={"elements[0].limit": [0.3, 0.6]},
    )  # fmt: skip
    for i, limit in enumerate([0.3, 0.6]):
        own = one_mass(vv.Jenkins(on={"x1": 1}, stiffness=2.0, limit=limit))
        end = 20 * 2 * np.pi / nu
        run = vv.simulate(own, end, dt=many.step[i], initial=[0, 0], load=0.8, nu=nu)
        n = run.stats["steps"] // 20
        late = run.state[5 * n + 2 :: 2]
        states = run(np.linspace(5 * n * run.step, run.t_reached, 40_001))
        np.testing.assert_allclose(many.peak[i], np.abs(states).max(0), rtol=2e-6)
        mean, square = (
            (x[0] / 2 + x[1:-1].sum(0) + x[-1] / 2) / 40_000 for x in (states, states**2)
        )
        np.testing.assert_allclose(many.mean[i], mean, atol=1e-6)
        np.testing.assert_allclose(many.rms[i], np.sqrt(square), atol=1e-6)
        np.testing.assert_allclose(many.sections[i], run.state[6 * n :: n], atol=1e-12)
        window = np.hanning(late.shape[0] + 2)[1:-1]
        wave = window * np.exp(-1j * nu * run.t[5 * n + 2 :: 2])
        moved = late[:, 0] - window @ late[:, 0] / window.sum()
        assert many.amplitudes[i, 0, 0] == pytest.approx(2 * wave @ moved / window.sum(), rel=1e-10)


def test_sections_by_a_surface():
    """Sections equal the events of the single run; also for a pendulum."""
    many = vv.simulate_ensemble(
        GAP, initial=[[0, 0], [0.4, 0]], load=0.8, nu=0.7, t_end=60, discard=20, dt=0.05,
        sections=vv.Event("x_dot", direction="down"),
    )  # fmt: skip
    run = vv.simulate(GAP, 60, load=0.8, nu=0.7, initial=[0.4, 0], dt=0.05, events="x_dot")
    t, state = run.events[0]
    late = (t >= 20) & (state[:, 0] > run.state[:, 0].mean())
    own = ~np.isnan(many.section_times[1])
    assert set(np.round(many.section_times[1][own], 9)) <= set(np.round(t[t >= 20], 9))
    assert own.sum() >= late.sum() // 2
    assert np.abs(many.sections[..., 1][~np.isnan(many.section_times)]).max() < 1e-12
    never = vv.simulate_ensemble(GAP, initial=[0, 0], t_end=5, dt=0.1, sections="x - 9")
    assert never.sections.shape == (1, 0, 2)
    pendulum = vv.Pendulum(
        e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.02, p1=0.93
    )
    swing = vv.simulate_ensemble(
        pendulum, initial=[0, 0, 0.1, 0, 0.1, 0], t_end=60.0, sections="phi_dot", dt=0.1
    )
    assert np.abs(swing.sections[0, :, 3]).max() < 1e-10
    assert swing.sections.shape[1] > 3


def test_exponents_of_a_gap_are_its_divergence():
    """A continuous force changes areas by damping only: the sum of exponents is -c."""
    many = vv.simulate_ensemble(
        GAP, initial=[0, 0], load=0.8, nu=0.7, n_periods=30, sections=1, lyapunov="all",
        parameters={"load_scale": [0.5, 1.0, 1.5]}, tolerance=1e-6,
    )  # fmt: skip
    np.testing.assert_allclose(many.spectrum.sum(axis=1), -0.05, atol=1e-6)


def test_exponents_where_laws_jump():
    """Saltation: an impact scales areas by e^2; sign(v) by the ratio a_+/a_- of accelerations."""
    e, end = 0.8, 80.0
    hard = one_mass(vv.Gap(on={"x1": 1}, gap=0.3, restitution=e))
    call = {"load": 0.8, "nu": 0.7, "initial": [0, 0], "dt": 0.1}
    many = vv.simulate_ensemble(hard, t_end=end, lyapunov="all", **call)
    run = vv.simulate(hard, end, events=[vv.Event("x1 - 0.3 + 1e-9", direction="up")], **call)
    hits = run.events[0].t.size
    assert hits > 5
    assert many.spectrum.sum() == pytest.approx(-0.05 + hits * 2 * np.log(e) / end, abs=1e-6)

    rub = one_mass(vv.Spring(on={"x1": 1}, stiffness=0.0, law="0.2*sign(v)"))
    call = {"load": 1.5, "nu": 1.3, "initial": [0.5, 1.0], "dt": 0.1}
    many = vv.simulate_ensemble(rub, t_end=end, lyapunov="all", **call)
    run = vv.simulate(rub, end, events=["x1_dot"], **call)
    t, state = run.events[0]
    rest = 1.5 * np.sin(1.3 * t) - state[:, 0]
    # Without sticking, v passes 0 with the same sign of acceleration on both sides.
    assert t.size > 20
    assert (np.abs(rest) > 0.2).all()
    taken = np.log((np.abs(rest) - 0.2) / (np.abs(rest) + 0.2)).sum()
    assert many.spectrum.sum() == pytest.approx(-0.05 + taken / end, abs=1e-5)


def test_exponents_of_what_sticks():
    """A perturbation of the velocity vanishes, one of the displacement remains."""
    stuck = one_mass(vv.Spring(on={"x1": 1}, stiffness=0.0, law="0.3*sign(v)"))
    many = vv.simulate_ensemble(
        stuck, initial=[0.1, 0], load=0.1, nu=1.1, t_end=40, discard=10, dt=0.1, lyapunov="all",
    )  # fmt: skip
    assert many.spectrum[0, 0] == pytest.approx(0, abs=1e-7)
    assert many.spectrum[0, 1] == -np.inf


def test_exponents_with_memory():
    """For a linear oscillator the real parts of its roots; for a chaotic one those of the ODE."""
    linear = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, kernel=KERNEL)
    many = vv.simulate_ensemble(
        linear, initial=[1, 0], t_end=60.0, discard=30.0, dt=0.1, lyapunov="all"
    )
    real = linear.characteristic_roots().oscillatory.real
    assert many.spectrum.sum() == pytest.approx(2 * real[0], abs=1e-6)

    # A Prony kernel is an additional equation, z' = -z + 0.3 k x: its perturbations by SciPy.
    wells = vv.PolynomialSystem(
        mass=1, stiffness=-1, damping=0.2, forces="x^3",
        springs=[vv.Springs(stiffness=0.5, kernel=KERNEL)],
    )  # fmt: skip
    end = 60.0
    many = vv.simulate_ensemble(
        wells, initial=[1, 0.2], load=0.4, nu=1.2, t_end=end, dt=0.05, lyapunov="all"
    )

    def rates(t, y):
        x, v, z = y[:3]
        d = y[3:].reshape(3, -1)
        a = 0.4 * np.sin(1.2 * t) - 0.2 * v + x - x**3 - 0.5 * x + 0.5 * z
        jacobian = np.array([[0, 1, 0], [1 - 3 * x**2 - 0.5, -0.2, 0.5], [0.3, 0, -1]])
        return np.concatenate([[v, a, 0.3 * x - z], (jacobian @ d).ravel()])

    start = np.zeros(9)
    start[:2] = 1, 0.2
    # The same perturbations: of the present state, not of the past.
    start[3:7] = np.eye(2).ravel()
    run = solve_ivp(rates, (0, end), start, "DOP853", rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(many.state[0], run.y[:2, -1], atol=1e-7)
    # The area of both perturbations grows by the sum of both exponents.
    area = np.linalg.det(run.y[3:, -1].reshape(3, 2)[:2])
    assert many.spectrum.sum() == pytest.approx(np.log(abs(area)) / end, abs=1e-5)


def test_more_coordinates_and_single_or_side_by_side():
    """Exponents of 8 coordinates add up to the damping; both methods give the same motions."""
    n = 8
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    chain = vv.Structure(
        mass=np.ones(n), stiffness=matrix, damping=0.05 * np.ones(n),
        elements=[vv.Spring(on={"x1": 1}, stiffness=0.0, law="0.3*d^3")],
    )  # fmt: skip
    many = vv.simulate_ensemble(
        chain, initial=np.zeros(2 * n), load={"x3": 0.2}, nu=0.5, t_end=60, dt=0.1, lyapunov="all"
    )
    assert many.spectrum.sum() == pytest.approx(-0.05 * n, abs=1e-6)
    duffing = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    call = {"initial": [0.1, 0.2], "load": 0.3, "nu": 1.2, "t_end": 50.0, "dt": 0.05}
    fast = vv.simulate_ensemble(duffing, lyapunov="all", **call)
    slow = vv.simulate_ensemble(duffing, lyapunov="all", sections="x", method="verner9", **call)
    np.testing.assert_allclose(fast.state, slow.state, atol=1e-12)
    assert fast.spectrum.sum() == pytest.approx(slow.spectrum.sum(), abs=1e-6)


def test_basins_with_a_rigid_stop_and_with_memory():
    """Wells where a stop or memory decides; the grid against single runs."""
    wells = vv.PolynomialSystem(
        mass=1, stiffness=-1, damping=0.3, forces="x^3",
        springs=[vv.Springs(stiffness=0.3, kernel=KERNEL)],
    )  # fmt: skip
    grid = np.linspace(-1.4, 1.6, 5)
    found = vv.basins(wells, {"x": grid, "x_dot": grid}, t_end=120.0, dt=0.1)
    assert len(found.attractors) == 2
    for j in (0, 3):
        for i in range(5):
            end = vv.simulate(wells, 120.0, dt=0.1, initial=[grid[i], grid[j]]).state[-1]
            label = found.labels[j, i]
            assert label >= 0
            np.testing.assert_allclose(found.attractors[label][0], end, atol=1e-3)
    beam = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3 + 50*max(x - 0.8, 0)")
    found = vv.basins(beam, {"x": grid, "x_dot": grid}, t_end=120.0, dt=0.1)
    ends = sorted(float(a[0, 0]) for a in found.attractors)
    # Equilibrium in contact with the stop: -x + x^3 + 50 (x - 0.8) = 0.
    right = [r.real for r in np.roots([1, 0, 49, -40]) if abs(r.imag) < 1e-9]
    np.testing.assert_allclose(ends, [-1.0, right[0]], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"parameters": {"kk": [1.0]}}, "kk"),
        ({"sections": "y_dot"}, "y_dot"),
        ({"sections": 2}, "sections"),
        ({"sections": vv.Event("x", terminal=True)}, "terminal"),
        ({"method": "verner"}, "method"),
        ({"nu": None}, "nu"),
        ({"lyapunov": "some"}, "lyapunov"),
        ({"initial": [0, 0, 0]}, "initial"),
    ],
)
def test_bad_calls(changes, text):
    """One line that names the argument."""
    call = {"initial": [0, 0], "load": 0.8, "nu": 0.7, "t_end": 5.0} | changes
    with pytest.raises(vv.InputError, match=text):
        vv.simulate_ensemble(GAP, **call)


@pytest.mark.parametrize(("way", "dt"), [("plain", "auto"), ("kink", 0.05), ("memory", "auto")])
def test_nothing_is_left_in_a_lane_that_escapes(way, dt):
    """Statistics of incomplete runs are NaN in all parts."""
    law = "-0.4*x^3" + {"kink": " + 0.1*max(x - 0.3, 0)"}.get(way, "")
    kernel = vv.PronyKernel(weights=[0.1], rates=[0.7]) if way == "memory" else None
    system = vv.PolynomialSystem(mass=1, damping=0.02, stiffness=1, forces=law, kernel=kernel)
    many = vv.simulate_ensemble(
        system, initial=[[2, 0], [0.1, 0], [1.7, 1]], load=[0.05], nu=1.3, n_periods=4, dt=dt,
        tolerance=1e-6, amplitudes_at=[1.3, 2.6], statistics=True, lyapunov=True, sections=1,
    )  # fmt: skip
    assert many.outcome.tolist() == ["diverged", "completed", "diverged"]
    lines = many.amplitudes
    for found in (lines.real, lines.imag, many.peak, many.mean, many.rms, many.lyapunov):
        assert np.isnan(found[[0, 2]]).all()
        assert np.isfinite(found[1]).all()
    assert np.isnan(many.sections[[0, 2]]).all()
    assert np.isfinite(many.sections[1]).all()
    assert np.isfinite(many.state).all()
    assert (many.t_reached[[0, 2]] < 2).all()


def test_a_wrong_surface_is_reported_by_the_name_given():
    system = vv.PolynomialSystem(mass=1, stiffness=1, forces="x^3")
    with pytest.raises(vv.InputError, match=r"^sections = 'xdot'.*did you mean x_dot"):
        vv.simulate_ensemble(system, initial=[0, 0], t_end=5, dt=0.1, sections="xdot")


@pytest.mark.parametrize(("every", "steps"), [(3, 50), (60, 50), (7, 127_001)])
def test_last_states_are_those_at_the_end(every, steps):
    """For any sampling: steps are not an integer multiple of the samples, or of those in memory."""
    system = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="3*max(x - 0.2, 0)")
    load = {"load": 0.7, "nu": 1.3, "dt": 5 / steps}
    many = vv.simulate_ensemble(
        system, initial=[[0.3, 0], [-0.2, 0.5]], t_end=5, discard=1, statistics=True,
        sample_every=every, amplitudes_at=[0.4], **load,
    )  # fmt: skip
    for i, start in enumerate([[0.3, 0], [-0.2, 0.5]]):
        run = vv.simulate(system, 5, initial=start, **load)
        assert many.state[i].tolist() == run.state[-1].tolist()
        t, x = run.t[-(-steps // 5) :][every::every], run.state[-(-steps // 5) :, 0][every::every]
        window = np.hanning(t.size + 2)[1:-1]
        wave = window * np.exp(-0.4j * t)
        line = 2 * wave @ (x - window @ x / window.sum()) / window.sum() if t.size else np.nan
        assert many.amplitudes[i, 0, 0] == pytest.approx(line, rel=1e-10, nan_ok=True)
        peak = many.peak[i]
        assert peak == pytest.approx(np.abs(run(np.linspace(1, 5, 4001))).max(axis=0), rel=1e-5)


def test_a_structure_is_built_once(monkeypatch):
    """Members with different starts and loads share its equations."""
    from viscovib.systems import whole

    built, make = [], whole._Whole
    monkeypatch.setattr(whole, "_Whole", lambda **given: built.append(1) or make(**given))
    slider = vv.Structure(
        mass=[1.0], stiffness=[1.0], damping=[0.1],
        elements=[vv.Jenkins(on="x1", stiffness=2.0, limit=0.3)],
    )  # fmt: skip
    starts = np.linspace(0, 1, 8)[:, np.newaxis] * [1.0, 0.5]
    given = {"load": [0.5], "nu": 1.1, "dt": 0.2}
    many = vv.simulate_ensemble(slider, initial=starts, t_end=6.0, **given)
    assert len(built) == 1
    for start, end in zip(starts, many.state, strict=True):
        alone = vv.simulate(slider, 6.0, initial=start, **given)
        assert alone.state[-1].tobytes() == end.tobytes()
