"""Friction and contact elements of pyHarm on the oscillator of the benchmark of laws.

Harmonic balance with equidistant samples of a period; the slider is run for three periods.
"""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np

#: Samples per period that give an error of 1e-4 of the motion with harmonics up to 15.
SAMPLES = 256
ELEMENTS: dict[str, dict[str, Any]] = {
    "Jenkins element": {"type": "Jenkins", "mu": 1.0, "N0": 0.3, "k": 1.0},
    "gap, penalty": {"type": "PenaltyUnilateralGap", "g": 0.5, "k": 3.0},
}


def missing() -> str:
    """Return what is missing; empty if nothing is missing."""
    try:
        import pyHarm.Maestro  # noqa: F401
    except ImportError:
        return "pyHarm is not installed (pyharm-os): left out"
    logging.disable(logging.WARNING)
    return ""


def branch(law: str, step: float) -> Callable[[], np.ndarray]:
    """Return a job that gives points (unknowns, nu) of the branch, steps of at most ``step``."""
    from pyHarm.Maestro import Maestro

    # A gap causes even harmonics and a mean.
    orders = list(range(1, 16, 2)) if law == "Jenkins element" else list(range(16))
    data = {
        "system": {"type": "Base", "nh": orders, "nti": SAMPLES},
        "substructures": {
            "mass": {
                "ndofs": 1,
                "matrix": {"M": np.eye(1), "C": 0.05 * np.eye(1), "K": np.eye(1)},
            }
        },
        "connectors": {
            "law": {"connect": {"mass": [0]}, "dirs": [0], **ELEMENTS[law]},
            "load": {"type": "SinusForcing", "connect": {"mass": [0]}, "dirs": [0], "amp": 0.5},
        },
        "analysis": {
            "FRF": {
                "study": "frf", "puls_inf": 0.5, "puls_sup": 1.6, "ds0": 0.01, "ds_max": step,
                "ds_min": 1e-8, "solver": "NewtonRaphson", "predictor": "tangent",
                "corrector": "pseudo_arc_length", "verbose": False,
                "predictor_options": {"verbose": False},
            }
        },
    }  # fmt: skip

    def job() -> np.ndarray:
        maestro = Maestro(data)
        maestro.operate()
        return np.array([s.x for s in maestro.nls["FRF"].SolList if s.flag_accepted])

    return job
