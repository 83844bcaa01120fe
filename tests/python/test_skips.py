"""Skips of a plan change no result, and every result has its plan."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv

ROOT = Path(__file__).parents[2]
PENDULUM = vv.Pendulum(e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.05, c2=0.05, c3=0.05)
SWINGING = replace(PENDULUM, m01=0.003, p2=0.37)
KERNEL = vv.RzhanitsynKernel(amplitude=0.05, alpha=0.3, beta=0.2)


@pytest.fixture
def skips(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import skips

    return skips


def test_skips_change_no_result(skips):
    pairs = skips.skips()
    assert {pair.skip for pair in pairs} == {
        "linear scene", "no memory", "odd symmetry", "uncoupled mode", "no spectrum wanted",
        "one coordinate wanted", "no trajectory kept", "zero coefficients",
    }  # fmt: skip
    found = {f"{pair.skip}, {pair.job}": skips.difference(pair) for pair in pairs}
    assert max(found.values()) < 1e-13, found


def pair(coupling=0.0, force="b^2", kernel=None):
    """Two oscillators: a Duffing oscillator, and one that only the coupling can move."""
    return vv.PolynomialSystem(
        mass=[1.0, 2.0], damping=[0.1, 0.2], stiffness=[[3.0, coupling], [coupling, 8.0]],
        forces={"a": "a^3", "b": force}, names=["a", "b"], kernel=kernel,
        base_direction=[1.0, 1.0],
    )  # fmt: skip


IDLE = "1 coordinate at rest"


@pytest.mark.parametrize("method", ["linear", "successive", "newton"])
def test_a_coordinate_is_idle_only_if_nothing_moves_it(method):
    nu = np.array([0.7, 1.3])

    def of(system, **load):
        return vv.forced_response(system, nu, method=method, **load)

    alone = of(pair(), load=0.02)
    assert IDLE in alone.plan.skips
    assert not alone.coefficients[:, 1].any()
    assert alone.amplitude("a").min() > 1e-3
    assert alone.coefficients.shape[1:] == (2, alone.harmonics.size)
    for moved in (
        of(pair(), load=[0.02, 0.01]),
        of(pair(), load={1: 0.02, 3: [0, 1e-3]}),
        of(pair(), base=0.02),
        of(pair(-0.5), load=0.02),
    ):
        assert IDLE not in moved.plan.skips
        assert np.abs(moved.coefficients[:, 1]).max() > 1e-6
    # A product in a force couples too: neither may be omitted, although b stays at rest.
    assert IDLE not in of(pair(force="a*b"), load=0.02).plan.skips
    # With a force on the other oscillator only.
    other = of(pair(), load=[0, 0.02])
    assert not other.coefficients[:, 0].any()
    assert other.amplitude("b").min() > 1e-4


@pytest.mark.parametrize("kernel", [None, KERNEL])
def test_idle_coordinates_in_time(kernel):
    load = {"load": 0.05, "nu": 1.3, "dt": 0.1}
    alone = vv.simulate(pair(kernel=kernel), 10, **load)
    assert IDLE in alone.plan.skips
    assert not alone.state[:, 2:].any()
    pushed = vv.simulate(pair(kernel=kernel), 10, initial=[0, 0, 0, 0.1], **load)
    assert IDLE not in pushed.plan.skips
    assert np.abs(pushed.state[:, 2]).max() > 1e-3
    assert np.abs(pushed.state[:, :2] - alone.state[:, :2]).max() < 1e-13
    # Resumed bitwise equal, with any stored times.
    whole = vv.simulate(pair(kernel=kernel), 20, **load)
    again = vv.simulate(pair(kernel=kernel), 20, resume=alone)
    assert (again.state == whole.state[-again.t.size :]).all()
    at_times = vv.simulate(pair(kernel=kernel), 10, times=[1.0, 5.03], **load)
    assert np.abs(at_times.state[0] - alone.state[10]).max() < 1e-14
    assert at_times.state[1, 0] != 0
    assert not at_times.state[:, 2:].any()
    if kernel is not None:
        held = vv.simulate(pair(kernel=kernel), 10, held=[0, 0.1], initial=[0, 0, 0.1, 0], **load)
        assert np.abs(held.state[-1, 2:]).max() > 1e-3
        table = vv.LoadTable(times=[0.0, 10.0], values=[[0.0, 0.1], [0.0, 0.1]])
        forced = vv.simulate(pair(kernel=kernel), 10, force=table, **load)
        assert np.abs(forced.state[-1, 2:]).max() > 1e-3


@pytest.mark.parametrize("method", ["gauss8", "rk4", "verner9"])
@pytest.mark.parametrize("equations", ["exact", "cubic", "printed"])
def test_a_pendulum_that_does_not_swing(method, equations):
    still = replace(PENDULUM, f0=0.05, p1=0.9, equations=equations)
    start = [0.1, 0.02, 0, 0, 0, 0]
    short = vv.simulate(still, 30, dt=0.25, initial=start, method=method)
    assert "2 coordinates at rest" in short.plan.skips
    # Zero moments make it a pendulum with three coordinates.
    full = vv.simulate(replace(still, m02=1e-300), 30, dt=0.25, initial=start, method=method)
    assert "2 coordinates at rest" not in full.plan.skips
    assert np.abs(short.state - full.state).max() < 1e-14
    again = vv.simulate(still, 60, resume=short)
    assert (again.state[-1] == vv.simulate(still, 60, dt=0.25, initial=start, method=method)
            .state[-1]).all()  # fmt: skip
    fallen = vv.simulate(still, 30, dt=0.05, initial=[0.1, -3, 0, 0, 0, 0], method=method)
    assert fallen.outcome == "unphysical"


def test_coordinates_wanted_and_the_last_state(tmp_path):
    scene = tmp_path / "scene.nml"
    text = (ROOT / "data" / "scenes" / "pendulum_paper.nml").read_text()
    scene.write_text(text.replace("t_end = 2000", "t_end = 100\n coordinates = 'psi' 'z'")
                     .replace("discard = 1000", "discard = 0\n coordinates = 'phi'"))  # fmt: skip
    result = vv.run(scene)
    assert result.spectrum.names == ("phi",)
    assert result.plan["skips"]["Fourier transforms of z, psi"] == "not requested"
    result.to_csv(tmp_path / "motion.csv")
    lines = (tmp_path / "motion.csv").read_text().splitlines()
    assert next(line for line in lines if line[0] != "#") == "t,z,z_dot,psi,psi_dot"
    assert f"# {str(result.plan).splitlines()[0]}" in lines
    with pytest.raises(vv.InputError, match="must be one of 'z', 'phi', 'psi'"):
        result.trajectory.to_csv(tmp_path / "motion.csv", coordinates=["x"])
    with pytest.raises(vv.InputError, match="must be a list or tuple of names"):
        result.trajectory.to_csv(tmp_path / "motion.csv", coordinates="z")
    bad = tmp_path / "bad.nml"
    for old, new, message in (
        ("dt = 0.25", "coordinates = 'x'", "'x' is none of them, must be among 'z', 'phi', 'psi'"),
        ("dt = 0.25", "coordinates = 'z' 'Z'", "'Z' is there twice"),
        ("dt = 0.25", "keep = 'last'", "&spectrum: needs the states all along"),
        ("dt = 0.25", "keep = 'last', save_every = 2", "save_every = 2: must be 1 with keep"),
    ):
        bad.write_text(text.replace(old, new))
        with pytest.raises(vv.InputError, match=message):
            vv.Scene.read(bad)


def test_every_result_carries_its_plan():
    mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
    damped = replace(mount, damping=0.02 * np.array([[10, -5], [-5, 4.5]]))
    run = vv.simulate(SWINGING, 20, initial=np.zeros(6), dt=0.25)
    scales = vv.MultipleScales(SWINGING)
    results = {
        "response": vv.forced_response(damped, [1.0], load=0.01),
        "branch": vv.trace_response(damped, (0.7, 0.9), load=0.01),
        "branch in the load": vv.trace_response(damped, nu=1.0, load=0.01, load_range=(0, 1)),
        "steady motions": vv.forced_response(SWINGING),
        "branch of the pendulum": vv.trace_response(SWINGING, p2=(0.3, 0.35), symmetric=True),
        "motion": run,
        "motion with memory": vv.simulate(
            replace(damped, kernel=KERNEL), 5, load=0.1, nu=1.0, tolerance=1e-6
        ),
        "motion of a polynomial": vv.simulate(pair(), 5, load=0.1, nu=1.0, keep="tail", tail=1),
        "spectrum": vv.spectrum(run.state[:, ::2], run.dt, names=run.dof_names),
        "backbone": vv.backbone(mount, 0, (1e-3, 1e-2)),
        "ensemble": vv.simulate_ensemble(SWINGING, initial=np.zeros(6), t_end=20, dt=0.25),
        "scales": scales.response("p2", [0.3, 0.31]),
        "modulation": scales.modulation([0.0, 1.0], np.array([0, 0, 0.01, 0, 0, 0])),
        "scales motion": scales.motion([0.0, 1.0], np.array([0, 0, 0.01, 0, 0, 0])),
    }
    for name, result in results.items():
        plan = result.plan
        assert isinstance(plan, vv.Plan), name
        assert plan.computes, name
        assert all(plan.skips.values()), name
        assert dict(plan) == {"computes": plan.computes, "skips": plan.skips}, name
        lines = str(plan).splitlines()
        assert len(lines) == len(plan.computes) + len(plan.skips), name
        if hasattr(result, "to_dataset"):
            assert result.to_dataset().attrs["plan"] == str(plan), name
    assert results["response"].plan.skips["kernel transforms"] == "no memory"
    assert "even harmonics and half of each period" in results["branch"].plan.skips
    assert results["branch in the load"].plan.computes[0].startswith("the branch from load factor")
    assert "loads f0, m02" in results["steady motions"].plan.skips
    assert "estimate of the error" not in results["motion with memory"].plan.skips
    assert "estimate of the error" in results["motion"].plan.skips
    assert "storing states before the last 1" in results["motion of a polynomial"].plan.skips
    checked = vv.simulate(SWINGING, 20, initial=np.zeros(6), dt=0.25, estimate_error=True)
    assert "estimate of the error" not in checked.plan.skips
    with pytest.raises(KeyError):
        run.plan["why"]
