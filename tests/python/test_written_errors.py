"""Tables contain the errors of the results."""

import re
import warnings

import numpy as np
import pytest
import viscovib as vv

#: Its branch has folds, and a motion leaves the domain of its law.
SYSTEM = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="0.5*x^3")


def written(path, result):
    """Notes and columns of the table of a result."""
    result.to_csv(path)
    lines = path.read_text().splitlines()
    notes = [line for line in lines if line[0] == "#"]
    return "\n".join(notes), np.genfromtxt(lines[len(notes) :], delimiter=",", names=True)


@pytest.mark.parametrize("event", [None, "x - 0.1"])
def test_motions(tmp_path, event):
    asked = None if event is None else [vv.Event(event, terminal=True)]
    run = vv.simulate(SYSTEM, 9, initial=[0.5, 0], events=asked)
    notes, _ = written(tmp_path / "t.csv", run)
    assert float(re.search(f"{run.outcome}, estimated error (.*)", notes)[1]) == run.error > 0
    given = vv.simulate(SYSTEM, 9, dt=0.1, initial=[0.5, 0], events=asked)
    assert "estimated error" not in written(tmp_path / "t.csv", given)[0]


@pytest.mark.parametrize("method", ["linear", "successive", "newton"])
def test_responses(tmp_path, method):
    r = vv.forced_response(SYSTEM, [0.5, 0.9, 1.5], load=0.02, method=method)
    _, table = written(tmp_path / "t.csv", r)
    assert (table["error"] == r.error).all()
    assert (r.error > 0).all()


def test_linear_responses_with_a_kernel_without_integral():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mount = vv.Mount(
            mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2,
            kernel=vv.AbelKernel(amplitude=0.03, alpha=0.2),
        )  # fmt: skip
    r = vv.forced_response(mount, [0.5, 2.0], load=0.1, method="linear")
    assert (r.error > 0).all()
    assert (r.error < 1e-13).all()


def test_folds(tmp_path):
    branch = vv.trace_response(SYSTEM, (0.5, 2), load=0.2)
    notes, _ = written(tmp_path / "t.csv", branch)
    reported = re.search("estimated errors of these folds:(.*)", notes)[1]
    assert list(map(float, reported.split())) == list(branch.fold_errors)
    assert branch.fold_errors.size == 2


def test_spectra_of_states_too_far_apart(tmp_path):
    fast = vv.PolynomialSystem(mass=1, stiffness=100)
    run = vv.simulate(fast, 40, dt=0.01, save_every=50, initial=[1, 0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = vv.spectrum(run)
    assert "too far apart for x" in written(tmp_path / "t.csv", found)[0]
    slow = vv.spectrum(vv.simulate(SYSTEM, 40, dt=0.1, initial=[0.1, 0]))
    assert "too far apart" not in written(tmp_path / "t.csv", slow)[0]


def test_many_motions(tmp_path):
    scene = tmp_path / "many.nml"
    group = "&ensemble vary='stiffness_scale' from=1 to=2 count=3 t_end=9 initial=0.5 0 {} /\n"
    system = "&system coordinates='x' mass=1 stiffness=1 damping=0.05 /\n"
    notes = []
    for step in ("dt=0.1", "tolerance=1e-8"):
        scene.write_text(system + group.format(step))
        vv.run(scene).to_csv(tmp_path / "t.csv")
        notes.append((tmp_path / "t.csv").read_text())
    table = np.genfromtxt(
        [line for line in notes[1].splitlines() if line[0] != "#"], delimiter=",", names=True
    )
    w = np.sqrt(table["stiffness_scale"] - 0.025**2)
    exact = 0.5 * np.exp(-0.025 * 9) * (np.cos(9 * w) + 0.025 / w * np.sin(9 * w))
    reported = float(re.search("estimated error (.*)", notes[1])[1])
    assert np.abs(table["x"] - exact).max() <= reported <= 1e-8
    assert "estimated error" not in notes[0]
