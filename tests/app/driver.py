"""Shared scenes and tools of the driver tests."""

import io
import subprocess
import sys
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
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
