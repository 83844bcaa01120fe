"""Extreme parameters: corrected findings of benchmarks/stress, and its quick form."""

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from test_pendulum import P1R, START

STRESS = Path(__file__).parents[2] / "benchmarks" / "stress" / "run.py"


@pytest.mark.parametrize("method", ["gauss2", "gauss3", "gauss8"])
@pytest.mark.parametrize("h", [0.02, 0.12])
def test_small_steps_do_not_drift(method, h):
    """Collocation keeps the energy of an oscillator; steps are solved beyond 5e-14."""
    run = vv.simulate(
        vv.PolynomialSystem(mass=1, stiffness=1), 6400 * h, dt=h, initial=[1, 0], method=method
    )
    energy = (run.state**2).sum(axis=1)
    assert abs(energy[-1] - 1) < 1e-12


def test_small_steps_keep_the_order():
    body = vv.Pendulum(**P1R)
    exact = vv.simulate(body, 64, dt=0.1, initial=START, method="gauss16", keep="last").state
    errors = [
        np.abs(vv.simulate(body, 64, dt=dt, initial=START, method="gauss3").state[-1] - exact).max()
        for dt in (0.1, 0.05, 0.025)
    ]
    assert errors[0] / errors[1] == pytest.approx(64, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(64, rel=0.2)


@pytest.mark.parametrize(
    "kernel",
    [
        vv.RzhanitsynKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.RabotnovKernel(amplitude=0, alpha=0.3, beta=0.05),
        vv.AbelKernel(amplitude=0, alpha=0.3),
    ],
    ids=lambda kernel: type(kernel).__name__,
)
def test_a_kernel_of_amplitude_0_is_none(kernel):
    """Regression: a sum with 100001 exponentials, and a motion that stopped immediately."""
    few = kernel.sum_of_exponentials(t_min=0.01, t_max=100)
    assert few.weights.tolist() == [0]

    def run(kernel):
        body = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=kernel
        )
        return vv.simulate(body, 20, dt=0.25, load=0.5, nu=1.5).state

    assert run(kernel) == pytest.approx(run(None), abs=1e-14)


def test_quick_form(tmp_path):
    """The quick sweeps run without a finding, and write both tables."""
    done = subprocess.run(
        [sys.executable, STRESS, "--quick", "--only", "steps", "edges", "--out", tmp_path],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    lines = (tmp_path / "stress.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines[1:]))
    assert lines[0].startswith("# ")
    assert {row["topic"] for row in rows} >= {"time step", "stiffness", "load", "folds"}
    assert all(row["outcome"] in ("ok", "ok, warning", "ok, warning, clear error",
                                  "ok, clear error") for row in rows)  # fmt: skip
    assert (tmp_path / "stress.md").read_text().count("| ok") >= len(rows)


@pytest.fixture
def scenes(monkeypatch):
    monkeypatch.syspath_prepend(STRESS.parent)
    import driven_scenes

    return driven_scenes


def test_numbers_of_a_scene(scenes):
    text = (
        "&scene title = 'load 2.5, 3 masses' /\n"
        "&kernel acts_on = 'x', weights = 0.1 2e-1, beta = 0 / ! rate 7.0\n"
        "&force law = '0.5*x1^3' /\n&response nu_count = 20, nu = 1 /\n"
    )
    found = [(name, text[start:end]) for name, start, end in scenes.numbers_of(text)]
    assert found == [
        ("kernel.weights", "0.1"), ("kernel.weights", "2e-1"), ("force.law", "0.5"),
        ("response.nu", "1"),
    ]  # fmt: skip
    (_, start, end), *_ = scenes.numbers_of(text)
    assert "weights = 0.25 2e-1" in scenes.changed(text, start, end, 0.25)


def test_movement_sees_what_changes(scenes):
    was = np.array([1.0, -4.0, np.nan])
    assert scenes.movement(was, was) == 0
    assert scenes.movement(was + [0, 1e-9, 0], was) == pytest.approx(2.5e-10, rel=1e-6)
    assert scenes.movement(np.array([1.0, -4.0, 0.0]), was) == np.inf
    assert scenes.movement(was[:2], was) == np.inf
    assert scenes.movement(np.array(["diverged"]), np.array(["overflow"])) == np.inf
    assert scenes.moved({"x": was}, {"x": was, "y": was})[0] == np.inf
