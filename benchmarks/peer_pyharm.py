"""pyHarm on the branch of the reference mount, and on chains of masses with a cubic spring.

Harmonic balance in Python with compiled elements.

Its elements are springs between nodes and cannot express the coupling of x and phi by the cubic
geometry. This coupling is added as pyHarm documents: a user-defined element with residual and exact
Jacobian by alternating frequency/time transforms, compiled by numba like the built-in elements.
pyHarm does not locate folds or compute multipliers: the folds are found from its points by a
polynomial in the arc length (Branch.turns).
"""

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from curve import MASS, STIFFNESS, Branch


def element() -> type:
    """Class of the element N = (5/6 phi^3, 5/2 phi^2 x - 5/3 phi^3), with a quartic potential."""
    import numba
    from pyHarm.Elements.SubstructureMatrixElements.MatrixElement import MatrixElement

    @numba.njit
    def force(q: Any, to_time: Any, to_orders: Any) -> Any:
        u = np.ascontiguousarray(q.reshape(-1, 2).T) @ to_time
        x, phi = u[0], u[1]
        pull = np.empty_like(u)
        pull[0] = 5 / 6 * phi**3
        pull[1] = 2.5 * phi**2 * x - 5 / 3 * phi**3
        return np.ascontiguousarray((pull @ to_orders).T).ravel()

    @numba.njit
    def slope(q: Any, to_time: Any, to_orders: Any) -> Any:
        u = np.ascontiguousarray(q.reshape(-1, 2).T) @ to_time
        x, phi = u[0], u[1]
        out = np.zeros((q.size, q.size))
        cross = ((to_time * (2.5 * phi**2)) @ to_orders).T
        out[0::2, 1::2] = cross
        out[1::2, 0::2] = cross
        out[1::2, 1::2] = ((to_time * (5 * phi * x - 5 * phi**2)) @ to_orders).T
        return out

    class Geometry(MatrixElement):
        """Cubic geometry of the mount."""

        factory_keyword = "MountGeometry"

        def _generateMatrices(self, data: dict[str, Any]) -> None:  # noqa: N802
            self.flag_elemtype = -1

        def __flag_update__(self) -> None:
            self.flag_nonlinear = self.flag_AFT = True

        def adim(self, lc: float, wc: float) -> None:
            raise NotImplementedError

        def evalResidual(self, xg: np.ndarray, om: float) -> np.ndarray:  # noqa: N802
            self.R = force(xg[self.indices], self.D["ft"], self.D["tf"])
            return self.R

        def evalJacobian(  # noqa: N802
            self, xg: np.ndarray, om: float
        ) -> tuple[np.ndarray, np.ndarray]:
            self.J = slope(xg[self.indices], self.D["ft"], self.D["tf"])
            self.dJdom = np.zeros(len(self.indices))
            return self.J, self.dJdom

    return Geometry


def missing() -> str:
    """Return what is missing; empty if nothing is missing."""
    try:
        import pyHarm.Maestro
    except ImportError:
        return "pyHarm is not installed (pyharm-os): left out"
    from pyHarm.BaseUtilFuncs import pyHarm_plugin

    logging.disable(logging.WARNING)
    if not hasattr(pyHarm.Maestro, "known_mount"):
        pyHarm.Maestro.known_mount = True
        pyHarm_plugin(element())
    return ""


def branch(highest: int, step: float) -> Callable[[], Branch]:
    """Return a job that follows the branch from nu = 0.5 to 10, steps of at most ``step``.

    Call `missing` first. A period has 4 (highest + 1) samples, enough for cubic terms.
    """
    from pyHarm.Maestro import Maestro

    orders = list(range(1, highest + 1, 2))
    data = {
        "system": {"type": "Base", "nh": orders, "nti": 4 * (highest + 1)},
        "substructures": {
            "mount": {
                "ndofs": 2,
                "matrix": {"M": np.diag(MASS), "C": 0.02 * STIFFNESS, "K": STIFFNESS},
            }
        },
        "connectors": {
            "geometry": {"type": "MountGeometry", "connect": "mount"},
            "load": {
                "type": "SinusForcing", "connect": {"mount": [0]}, "dirs": [0], "amp": 0.5,
            },
        },
        "analysis": {
            "FRF": {
                "study": "frf", "puls_inf": 0.5, "puls_sup": 10.0, "ds0": 0.01, "ds_max": step,
                "ds_min": 1e-8, "solver": "NewtonRaphson", "predictor": "tangent",
                "corrector": "pseudo_arc_length", "verbose": False,
                "predictor_options": {"verbose": False},
            }
        },
    }  # fmt: skip

    def job() -> Branch:
        maestro = Maestro(data)
        maestro.operate()
        found = [s.x for s in maestro.nls["FRF"].SolList if s.flag_accepted]
        points = np.array(found)
        cos, sin = points[:, 0:2], points[:, 2:4]
        # Im(X exp(i nu t)) = a cos + b sin: X = b + i a.
        return Branch(nu=points[:, -1], first=sin + 1j * cos, folds=None)

    return job


def chain(
    stiffness: np.ndarray, first: float, highest: int, *, reduced: bool
) -> Callable[[], Branch]:
    """Return a job that computes the branch of the last mass of the chain of `structures`.

    ``stiffness`` of unit masses, damping 0.02 K, a cubic spring 0.5 at the last mass, a load of
    0.02 on the first; odd harmonics, 0.5 to 1.5 times the ``first`` frequency. ``reduced``: the
    unknowns are the coordinates with a nonlinear force ("NLdofs"). Call `missing` first.
    """
    from pyHarm.Maestro import Maestro

    n = len(stiffness)
    orders = list(range(1, highest + 1, 2))
    frf = {
        "study": "frf", "puls_inf": 0.5 * first, "puls_sup": 1.5 * first, "ds0": 0.01,
        "ds_max": 0.1, "ds_min": 1e-8, "solver": "NewtonRaphson", "predictor": "tangent",
        "corrector": "pseudo_arc_length", "verbose": False, "predictor_options": {"verbose": False},
    }  # fmt: skip
    if reduced:
        frf["reductors"] = [{"type": "NLdofs"}]
    data = {
        "system": {"type": "Base", "nh": orders, "nti": 4 * (highest + 1)},
        "substructures": {
            "chain": {"ndofs": 1,
                      "matrix": {"M": np.eye(n), "C": 0.02 * stiffness, "K": stiffness}}
        },
        "connectors": {
            "spring": {"type": "CubicSpring", "connect": {"chain": [n - 1]}, "dirs": [0], "k": 0.5},
            "load": {
                "type": "SinusForcing", "connect": {"chain": [0]}, "dirs": [0], "amp": 0.02,
            },
        },
        "analysis": {"FRF": frf},
    }  # fmt: skip

    def job() -> Branch:
        maestro = Maestro(data)
        maestro.operate()
        found = np.array([s.x for s in maestro.nls["FRF"].SolList if s.flag_accepted])
        # For each harmonic the cosines of all masses, then the sines.
        return Branch(
            nu=found[:, -1], first=(found[:, 2 * n - 1] + 1j * found[:, n - 1])[:, None], folds=None
        )

    return job
