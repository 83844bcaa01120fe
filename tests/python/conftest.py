"""Shared fixtures: the reference scene of the mount."""

import csv
from pathlib import Path

import pytest
import viscovib as vv

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture
def mount():
    """Build the reference mount with any parameter changed."""

    def build(amplitude=0.048, **changes):
        kernel = vv.RzhanitsynKernel(amplitude=amplitude, alpha=0.1, beta=0.05)
        parameters = {
            "mass": 1.0,
            "inertia": 0.1,
            "offset": 0.5,
            "stiffness_x": 10.0,
            "stiffness_phi": 2.0,
            "kernel": kernel,
        }
        return vv.Mount(**(parameters | changes))

    return build


def read_table(name):
    """Rows of a reference table as dictionaries, comment lines left out."""
    with open(DATA / name, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))
