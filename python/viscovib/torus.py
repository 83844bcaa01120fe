"""Base frequencies and lattices of orders of a pendulum under several loads."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.pendulum import Pendulum

FREQUENCIES = ("p1", "p2", "p3")
AMPLITUDES = ("f0", "m01", "m02")
#: Unknowns at most: their matrix takes 130 MB, its factors some seconds.
MAX_UNKNOWNS = 4000
#: Two frequencies count as commensurate if a ratio of small numbers meets theirs so closely.
_RATIO = 1e-12

IntArray = npt.NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Torus:
    """The angles of a motion, and how those of the loads follow from them.

    ``names`` of the axes and their frequencies ``base``, shape (n_axes,); ``drive_orders``, shape
    (3, n_axes): load j turns by drive_orders[j] times the angles.
    """

    names: tuple[str, ...]
    base: FloatArray
    drive_orders: IntArray

    @property
    def n_axes(self) -> int:
        """Number of base frequencies."""
        return len(self.names)

    def lattice(self, bound: int) -> IntArray:
        """Half of the orders with |k1| + |k2| + ... <= bound, 0 first, shape (n, n_axes)."""
        sides = [range(bound + 1)] + [range(-bound, bound + 1)] * (self.n_axes - 1)
        orders = [
            k
            for k in itertools.product(*sides)
            if sum(map(abs, k)) <= bound and next((i for i in k if i), 1) > 0
        ]
        orders.sort(key=lambda k: (sum(map(abs, k)), [-i for i in k]))
        return np.array(orders, dtype=np.intc)

    def count(self, bound: int) -> int:
        """Unknowns with orders up to ``bound``: three times the points of the lattice."""
        points: int = sum(
            2**i * math.comb(self.n_axes, i) * math.comb(bound, i) for i in range(self.n_axes + 1)
        )
        return 3 * points

    def largest(self, share: float = 1.0) -> int:
        """Largest bound that keeps a share of the unknowns within `MAX_UNKNOWNS`."""
        bound = 1
        while share * self.count(bound + 1) <= MAX_UNKNOWNS and bound < 199:
            bound += 1
        return bound


def check_pendulum(pend: object) -> None:
    """Refuse what is no pendulum."""
    if not isinstance(pend, Pendulum):
        raise InputError(f"pend = {_native.shown(pend)}: must be a Pendulum")


def moved(pend: Pendulum, name: str, value: float) -> Pendulum:
    """The same pendulum with another frequency of a load."""
    changes: dict[str, Any] = {name: value}
    return replace(pend, **changes)


def chosen(given: Mapping[str, object]) -> tuple[str | None, object]:
    """Return the one keyword that varies and its value; (None, None) if none does."""
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise InputError(f"{named[0]}, {named[1]}: only one of them may vary")
    return (named[0], given[named[0]]) if named else (None, None)


def make_torus(pend: Pendulum, varies: str | None, subharmonic: int, max_denominator: int) -> Torus:
    """Sort the loads that act by frequency: commensurate ones share an axis.

    A frequency that varies keeps an axis of its own; "nu" moves all of them together.
    """
    acting = []
    for j, (name, size) in enumerate(zip(FREQUENCIES, AMPLITUDES, strict=True)):
        moves = varies == name
        if moves and getattr(pend, size) == 0:
            raise InputError(f"{name}: varies, but no load acts at it: {size} = 0")
        if (getattr(pend, size) != 0 or varies == size) and (moves or getattr(pend, name) > 0):
            acting.append(j)
    if not acting:
        raise InputError("f0, m01, m02: at least one load of a frequency > 0 must act")
    groups: list[list[tuple[int, Fraction]]] = []
    for j in acting:
        value = getattr(pend, FREQUENCIES[j])
        for group in groups:
            first = getattr(pend, FREQUENCIES[group[0][0]])
            if varies in (FREQUENCIES[j], FREQUENCIES[group[0][0]]):
                continue
            ratio = Fraction(value / first).limit_denominator(max_denominator)
            if ratio.numerator <= max_denominator and abs(float(ratio) * first - value) <= (
                _RATIO * value
            ):
                group.append((j, ratio))
                break
        else:
            groups.append([(j, Fraction(1))])
    if len(groups) > 1 and (subharmonic > 1 or varies == "nu"):
        values = ", ".join(f"{getattr(pend, FREQUENCIES[g[0][0]]):g}" for g in groups)
        what = f"subharmonic = {subharmonic}" if subharmonic > 1 else "nu"
        raise InputError(f"{what}: needs a single base frequency, but those of the loads are "
                         f"incommensurate ({values})")  # fmt: skip
    names, base = [], []
    drive_orders = np.zeros((3, len(groups)), dtype=np.intc)
    for axis, group in enumerate(groups):
        multiple = subharmonic * math.lcm(*(ratio.denominator for _, ratio in group))
        first = FREQUENCIES[group[0][0]]
        common = math.gcd(*(int(ratio * multiple) for _, ratio in group))
        common = math.gcd(common, multiple) if subharmonic == 1 else 1
        for j, ratio in group:
            drive_orders[j, axis] = int(ratio * multiple) // common
        multiple //= common
        names.append(first if multiple == 1 and len(group) == 1 else "nu")
        base.append(getattr(pend, first) / multiple)
    return Torus(tuple(names), np.array(base), drive_orders)


def core_job(
    pend: Pendulum, torus: Torus, orders: IntArray, varies: str | None
) -> tuple[tuple[object, ...], float]:
    """Arguments of the core up to what varies, and units of the latter in the parameter."""
    flat = pend._flat.copy()
    amplitude = flat[7:10].copy()
    flat[7:10] = 1
    kind, which, unit = 1, 1, 1.0
    if varies in FREQUENCIES:
        j = FREQUENCIES.index(varies)
        which = int(np.flatnonzero(torus.drive_orders[j])[0]) + 1
        unit = float(torus.drive_orders[j, which - 1])
    elif varies in AMPLITUDES:
        kind, which = 2, AMPLITUDES.index(varies) + 1
    return (
        flat,
        np.asfortranarray(orders.T),
        np.asfortranarray(torus.drive_orders.T),
        torus.base,
        amplitude,
        kind,
        which,
    ), unit


def kept_by_symmetry(
    pend: Pendulum, torus: Torus, orders: IntArray, varies: str | None
) -> IntArray:
    """1 where an order of a coordinate is an unknown, shape (n_orders, 3).

    Mirrored motions, (z, -phi, -psi), belong to mirrored moments m01, m02. If a shift of the
    angles by half turns mirrors these and leaves f0 alone, the motion raised from rest is its own
    mirror image, shifted: an order turned by an even number of half turns lacks in phi and psi,
    any other one in z.
    """
    acts = [getattr(pend, name) != 0 or varies == name for name in AMPLITUDES]
    for shift in itertools.product((0, 1), repeat=torus.n_axes):
        turned = torus.drive_orders @ shift % 2
        if all(t == (j > 0) for j, t in enumerate(turned) if acts[j]):
            odd = (orders @ shift) % 2
            return np.stack([1 - odd, odd, odd], axis=1).astype(np.intc)
    return np.ones((len(orders), 3), dtype=np.intc)


def bound_of(torus: Torus, harmonics: object, share: float = 1.0) -> int:
    """Check the highest order."""
    return _native.integer("harmonics", harmonics, 1, torus.largest(share))


def complex_coefficients(x: FloatArray) -> ComplexArray:
    """X_k from unknowns, shape (n_unknowns, n) to (n, 3, n_orders); the mean as 1j mean."""
    parts = x.T.reshape(x.shape[1], 3, x.shape[0] // 3)
    result = np.empty((*parts.shape[:2], (parts.shape[2] + 1) // 2), dtype=complex)
    result[:, :, 0] = 1j * parts[:, :, 0]
    result[:, :, 1:] = parts[:, :, 1::2] + 1j * parts[:, :, 2::2]
    return result


def unknowns(coefficients: ComplexArray) -> FloatArray:
    """Invert `complex_coefficients` for one point, shape (3, n_orders)."""
    parts = np.empty((3, 2 * coefficients.shape[1] - 1))
    parts[:, 0] = coefficients[:, 0].imag
    parts[:, 1::2] = coefficients[:, 1:].real
    parts[:, 2::2] = coefficients[:, 1:].imag
    return parts.ravel()


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
    """Name of an order in column heads: "3" or "1,-2"."""
    return ",".join(str(int(k)) for k in order)


def tail(coefficients: ComplexArray, orders: IntArray) -> FloatArray:
    """Largest of the two outermost shells of orders against the largest of all, shape (n,)."""
    shell = np.abs(orders).sum(axis=1)
    sizes = np.abs(coefficients)
    largest = np.maximum(sizes.max(axis=(1, 2)), 1e-300)
    return np.asarray(sizes[:, :, shell >= shell.max() - 1].max(axis=(1, 2)) / largest)
