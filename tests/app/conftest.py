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
            [program, *map(str, arguments)], capture_output=True, text=True, timeout=120, cwd=cwd
        )

    return run


def pytest_collection_modifyitems(config, items):
    """Skip tests of the package command in runs of the debug driver.

    They do not use the driver.
    """
    if "debug" not in os.environ.get("VISCOVIB_SOLVE", ""):
        return
    here = Path(__file__).parent
    idle = [
        item
        for item in items
        if item.path.is_relative_to(here)
        and item.path.stem != "test_library"
        and "solve" not in item.fixturenames
    ]
    config.hook.pytest_deselected(items=idle)
    items[:] = [item for item in items if item not in idle]
