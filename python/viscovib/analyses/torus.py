"""Base frequencies and lattices of orders of a pendulum under several loads."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, Handle
from viscovib.errors import InputError
from viscovib.systems.pendulum import Pendulum

FREQUENCIES = ("p1", "p2", "p3")
AMPLITUDES = ("f0", "m01", "m02")
#: Parameters that may vary, in the order of the core, from 1.
_VARIES = (*FREQUENCIES, *AMPLITUDES, "nu")

IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Torus:
    """The angles of a motion, and the phases of the loads as their combinations.

    ``names`` of the axes and their frequencies ``base``, shape (n_axes,); ``drive_orders``, shape
    (3, n_axes): the phase of load j is drive_orders[j] times the angles. ``varying``: axis (from 1)
    of a varied frequency, and the factor between both.
    """

    names: tuple[str, ...]
    base: FloatArray
    drive_orders: IntArray
    varying: tuple[int, int]

    @property
    def n_axes(self) -> int:
        """Number of base frequencies."""
        return len(self.names)

    def lattice(self, bound: int) -> IntArray:
        """Half of the orders with |k1| + |k2| + ... <= bound, 0 first, shape (n, n_axes)."""
        orders = _native.run("lattice orders", n_axes=self.n_axes, bound=bound)["orders"]
        return np.ascontiguousarray(orders.T, dtype=np.int32)

    def count(self, bound: int) -> int:
        """Number of orders of this lattice."""
        found = _native.run("lattice orders", n_axes=self.n_axes, bound=bound, count_only=True)
        return int(found["n"])

    def largest(self, share: float = 1.0, *, matrix: bool = True) -> int:
        """Largest bound for which a fraction of the unknowns (or their matrix) fits into memory."""
        found = _native.run("lattice bound", n_axes=self.n_axes, share=float(share), matrix=matrix)
        return int(found["bound"])

    @property
    def lowest(self) -> int:
        """Smallest bound of a lattice that contains all loads."""
        return int(self._bounds()[0])

    @property
    def usual(self) -> int:
        """Default bound of the lattice of a branch."""
        return int(self._bounds()[1])

    def _bounds(self) -> tuple[int, int]:
        found = _native.run("lattice usual_bounds", drive_orders=self.drive_orders.T)
        return found["lowest"], found["usual"]

    @property
    def shells(self) -> int:
        """Number of shells for the error estimate; loads may excite only multiples of an order."""
        return 2 * math.gcd(*self.drive_orders.ravel().tolist()) if self.n_axes == 1 else 2


def moved(pend: Pendulum, name: str, value: float) -> Pendulum:
    """The pendulum with a new value of a parameter."""
    changes: dict[str, Any] = {name: value}
    return replace(pend, **changes)


def chosen(given: Mapping[str, object]) -> tuple[str | None, object]:
    """Return the one keyword that varies and its value; (None, None) if none does."""
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise InputError(f"{named[0]}, {named[1]}: only one of them may vary")
    return (named[0], given[named[0]]) if named else (None, None)


def make_torus(pend: Pendulum, varies: str | None, subharmonic: int, max_denominator: int) -> Torus:
    """Sort the loads by frequency: loads with rational frequency ratios share an axis.

    A varied frequency has a separate axis; "nu" varies all frequencies together.
    """
    found = _native.run(
        "lattice sort", frequency=_numbers(pend, FREQUENCIES), amplitude=_numbers(pend, AMPLITUDES),
        varies=code_of(varies), subharmonic=subharmonic, max_denominator=max_denominator,
    )  # fmt: skip
    return Torus(
        names=tuple("nu" if j == 0 else FREQUENCIES[j - 1] for j in found["named"].tolist()),
        base=found["base"],
        drive_orders=np.ascontiguousarray(found["drive_orders"].T, dtype=np.int32),
        varying=(found["axis"], found["multiple"]),
    )


def _numbers(pend: Pendulum, names: tuple[str, ...]) -> FloatArray:
    return np.array([getattr(pend, name) for name in names])


def code_of(varies: str | None) -> int:
    """Number of the varied parameter in the core."""
    return 0 if varies is None else _VARIES.index(varies) + 1


@dataclass(frozen=True)
class TorusJob:
    """A pendulum with loads and orders, as arguments of tasks of the core.

    ``unit``: unit of the varied parameter.
    """

    system: Handle
    given: Mapping[str, Any]
    unit: float

    @classmethod
    def of(
        cls, pend: Pendulum, torus: Torus, orders: IntArray, varies: str | None, kept: IntArray
    ) -> "TorusJob":
        """Create the job; ``kept``: 1 where an order of a coordinate is an unknown."""
        flat = pend._flat.copy()
        amplitude = flat[7:10].copy()
        flat[7:10] = 1
        kind, which, unit = 1, 1, 1.0
        if varies in FREQUENCIES:
            which, unit = torus.varying[0], float(torus.varying[1])
        elif varies in AMPLITUDES:
            kind, which = 2, AMPLITUDES.index(varies) + 1
        given = {
            "orders": orders.T, "kept": kept, "drive_orders": torus.drive_orders.T,
            "omega": torus.base, "amplitude": amplitude, "vary": kind, "which": which,
        }  # fmt: skip
        return cls(Handle("system pendulum", flat=flat), given, unit)

    def base(self, torus: Torus, values: FloatArray) -> FloatArray:
        """Base frequencies at values of the parameter, shape (n, n_axes)."""
        base = np.tile(torus.base, (values.size, 1))
        if self.given["vary"] == 1:
            base[:, self.given["which"] - 1] = values
        return base

    def run_apart(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a long task in a thread, so that Ctrl-C works."""
        return _native.apart(lambda: _native.run(task, self.system, **self.given, **values))


def kept_by_symmetry(
    pend: Pendulum, torus: Torus, orders: IntArray, varies: str | None
) -> IntArray:
    """1 where an order of a coordinate is an unknown of the motion that starts from rest.

    Shape (n_orders, 3); half of the orders if system and loads are symmetric.
    """
    kept = _native.run(
        "lattice kept", drive_orders=torus.drive_orders.T, orders=orders.T,
        amplitude=_numbers(pend, AMPLITUDES), varies=code_of(varies),
    )["kept"]  # fmt: skip
    return np.asarray(kept, dtype=np.int32)


def bound_of(torus: Torus, harmonics: object, largest: int) -> int:
    """Check the highest order, which must include the loads."""
    if torus.lowest > largest:
        raise InputError(
            f"max_denominator: the loads are up to {torus.lowest} times their base frequencies, "
            f"must be at most {largest}"
        )
    return _native.integer("harmonics", harmonics, torus.lowest, largest)


def unknowns_of(coefficients: ComplexArray) -> FloatArray:
    """Unknowns of one motion from X_k, shape (3, n_orders)."""
    x = np.empty((3, 2 * coefficients.shape[1] - 1))
    x[:, 0] = coefficients[:, 0].imag
    x[:, 1::2] = coefficients[:, 1:].real
    x[:, 2::2] = coefficients[:, 1:].imag
    return x.ravel()


def place_of(orders: IntArray, harmonic: object) -> int:
    """Index of an order, or of its negative, which has the same amplitude."""
    wanted = np.atleast_1d(np.asarray(harmonic))
    if wanted.dtype.kind not in "iu" or wanted.shape != orders.shape[1:]:
        raise InputError(
            f"harmonic = {_native.shown(harmonic)}: "
            f"must be {'an integer' if orders.shape[1] == 1 else ''}"
            f"{f'{orders.shape[1]} integers' if orders.shape[1] > 1 else ''}"
        )
    for sign in (1, -1):
        where = np.flatnonzero((orders == sign * wanted).all(axis=1))
        if where.size:
            return int(where[0])
    highest = int(np.abs(orders).sum(axis=1).max())
    raise InputError(
        f"harmonic = {_native.shown(harmonic)}: must be one of those kept, up to {highest} in all"
    )


def order_name(order: npt.NDArray[np.int32]) -> str:
    """Name of an order in column names: "3" or "1,-2"."""
    return ",".join(str(int(k)) for k in order)


def tail(coefficients: ComplexArray, orders: IntArray) -> FloatArray:
    """Largest coefficient of the two outermost shells relative to the largest of all, (n,)."""
    shell = np.abs(orders).sum(axis=1)
    sizes = np.abs(coefficients)
    largest = np.maximum(sizes.max(axis=(1, 2)), 1e-300)
    return np.asarray(sizes[:, :, shell >= shell.max() - 1].max(axis=(1, 2)) / largest)
