"""Shared scenes and tools of the driver tests."""

import io
import subprocess
import sys
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv
from viscovib.__main__ import main

SCENES = Path(__file__).parents[2] / "data" / "scenes"


GOOD = """&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /
&kernel kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05 /
&load amplitude=0.1 /
&response nu_from=0.5, nu_to=4, nu_count=8 /
"""


MOTION = """&pendulum e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, f0=0.005, p1=0.93 /
&transient initial=0.05 0 0.3 0 -0.2 0, t_end=20, dt=0.25 /
"""


KERNEL = "kind='rzhanitsyn', amplitude=0.048, alpha=0.1, beta=0.05"


BRANCH = GOOD[: GOOD.index("&response")] + "&branch nu_from=1, nu_to=4 /\n"


GRID = "nu_from=0.5, nu_to=4, nu_count=8"


@contextmanager
def silence():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def read_csv(path):
    return np.genfromtxt(
        [line for line in path.read_text().splitlines() if not line.startswith("#")],
        delimiter=",",
        names=True,
        dtype=None,
        encoding="utf-8",
    )


def check_failure(done, status, text, folder):
    assert done.returncode == status, done
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert text in lines[0]
    assert not list(folder.iterdir())


def changed(text, changes):
    """Replace texts that must occur."""
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    return text


def check_refused(solve, folder, text, message, line=None, *, same=True):
    """The driver refuses a scene with one line, with its place, and Python in the same words.

    ``same=False``: Python names the call, not the place in the scene.
    """
    scene, out = folder / "bad.nml", folder / "out"
    scene.write_bytes(text if isinstance(text, bytes) else text.encode())
    out.mkdir(exist_ok=True)
    done = solve(scene, "--out", out)
    check_failure(done, 2, message, out)
    assert f"bad.nml:{line}: " in done.stderr or line is None
    with silence(), pytest.raises(vv.ViscovibError) as error:
        vv.run(scene)
    said = str(error.value)
    assert done.stderr == f"viscovib-solve: {said}\n" if same else message in said


def command(*arguments):
    """Run the package command in this process, which is faster."""
    out, err = io.StringIO(), io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(out), redirect_stderr(err):
        warnings.simplefilter("default")
        status = main([*map(str, arguments)])
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def separate_command(*arguments):
    """Run the package command in a new process, which a bound on time may end at once."""
    return subprocess.run(
        [sys.executable, "-m", "viscovib", *map(str, arguments)], capture_output=True, text=True
    )
