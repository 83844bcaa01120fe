"""Error measures of the benchmarks: against data, closed forms and synthetic rows."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def parts(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import combined
    import curve
    import peer_auto

    return combined, curve, peer_auto


def test_amplitudes_of_the_reference(parts):
    _, curve, _ = parts
    found = json.loads((ROOT / "data" / "mount_periodic_reference.json").read_text())
    for point in found["first_harmonics"]:
        size = np.array([point["x1"], point["phi1"]])
        # Start near the motion from its magnitude only; the phase is that of the linear response
        # below or above resonance.
        starts = [size * np.exp(1j * turn) for turn in np.linspace(-np.pi, np.pi, 9)]
        errors = [np.abs(np.abs(curve.periodic(point["nu"], s)) / size - 1).max() for s in starts]
        assert np.nanmin(errors) < 2e-9


def test_amplitude_error_sees_a_change(parts):
    _, curve, _ = parts
    exact = curve.periodic(1.0, np.array([0.149, 0.169]) * np.exp(-0.02j))
    branch = curve.Branch(nu=np.array([1.0]), first=exact[None] * (1 + 1e-6), folds=np.zeros(0))
    assert curve.amplitude_error(branch) == pytest.approx(1e-6, rel=1e-3)
    assert np.isnan(curve.fold_error(branch))


def test_turns_of_a_curve_that_is_known(parts):
    _, curve, _ = parts
    s = np.linspace(-2, 2, 201)
    branch = curve.Branch(nu=s**3 / 3 - s, first=np.column_stack([s, 0 * s]).astype(complex),
                          folds=None)  # fmt: skip
    np.testing.assert_allclose(branch.turns(), [2 / 3, -2 / 3], atol=1e-7)


def test_first_harmonic_of_piecewise_polynomials(parts):
    _, _, peer_auto = parts
    t = np.concatenate([np.linspace(0, 0.3, 41)[:-1], np.linspace(0.3, 1, 41)])
    u = np.column_stack([1 + 0.7 * np.sin(2 * np.pi * t + 0.4), np.sin(6 * np.pi * t)])
    found = peer_auto.first_harmonic(t, u, intervals=20, degree=4)
    np.testing.assert_allclose(found, [0.7 * np.exp(0.4j), 0], atol=1e-6)


def test_quickest_that_is_good_enough(parts):
    combined, _, _ = parts
    rows = [
        {"method": "viscovib", "setting": "a", "seconds": 1.0, "error": 1e-3},
        {"method": "viscovib", "setting": "b", "seconds": 2.0, "error": 1e-9},
        {"method": "peer", "setting": "c", "seconds": 8.0, "error": 1e-6},
    ]
    assert combined.quickest(rows, 1e-2) == 1.0
    assert combined.quickest(rows, 1e-8) == 2.0
    assert np.isnan(combined.quickest(rows, 1e-10))
    assert "| peer | 8 s (8x) | 8 s (4x) | 8 s (4x) |" in "\n".join(combined.table({"p": rows}))


def test_a_part_is_ended_at_its_limit(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import results

    program = tmp_path / "program.py"
    program.write_text(
        "import pathlib, pickle, subprocess, sys, time\n"
        "name, out = sys.argv[2], pathlib.Path(sys.argv[4])\n"
        "if name == 'slow':\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        "    (out / 'child').write_text(str(child.pid))\n"
        "    time.sleep(600)\n"
        "if name == 'broken':\n"
        "    sys.exit(3)\n"
        "(out / f'.{name}.pickle').write_bytes(pickle.dumps(([name], {})))\n"
    )
    limits = {"slow": 5.0, "broken": 60.0, "good": 60.0}
    found, lost = results.run_parts(program, tmp_path, limits)
    assert found == {"good": (["good"], {})}
    assert lost == ["slow: ended after 5 s, left out", "broken: exit status 3, left out"]
    child = Path(f"/proc/{(tmp_path / 'child').read_text()}/stat")
    assert not child.exists() or child.read_text().split()[2] == "Z"


def test_every_routine_has_a_phase(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import phases

    core = "_viscovib.cpython-311-x86_64-linux-gnu.so"
    assert phases.phase_of(core, "[.] __viscovib_dense_MOD_factorize") == "equations solved"
    assert phases.phase_of(core, "[.] __viscovib_node_kernels_MOD_predict") == "prediction"
    assert phases.phase_of("libm.so.6", "[.] __sincos_fma").startswith("sines")
    assert phases.phase_of("libpython3.11.so.1.0", "[.] _PyEval") == "Python and NumPy"


def test_a_comparison_with_an_unknown_commit_ends_with_one_line():
    call = [sys.executable, ROOT / "benchmarks" / "against.py", "--against", "no-such-commit"]
    done = subprocess.run(call, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        "bench: --against no-such-commit: no commit of this repository: see git log\n"
    )
