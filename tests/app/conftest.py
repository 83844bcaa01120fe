"""Fixtures for running the standalone driver."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def solve():
    """Run the driver with these arguments."""
    program = os.environ.get(
        "VISCOVIB_SOLVE", str(ROOT / "build" / "release" / "fortran" / "viscovib-solve")
    )

    def run(*arguments, cwd=None):
        return subprocess.run(
            [program, *map(str, arguments)], capture_output=True, text=True, timeout=60, cwd=cwd
        )

    return run
