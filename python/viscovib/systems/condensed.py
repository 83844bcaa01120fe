"""A structure condensed to the deflections of its elements, and back to all its coordinates."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray, Handle, oscillator_object, run
from viscovib.common.counts import things
from viscovib.errors import InputError
from viscovib.systems.element_laws import Laws
from viscovib.systems.frequency_formulas import joined, law_of, values_of
from viscovib.systems.load import FORMULA_CODE, Job, VaryingForce
from viscovib.systems.penalty_supports import supports_text
from viscovib.systems.structure_rest import Rest

#: Kernel kind in x that marks a vector of numbers as a condensed structure for the core.
STRUCTURE_IN_VECTOR = -3
#: Largest relative deflection of a rigid-body motion that counts as rounding error.
_UNSEEN = 1e-10
#: Size of the array of one part of an expansion to all coordinates.
_AT_ONCE = 2_000_000


class Condensation:
    """H(s) = Q^T D(s)^-1 Q of the linear subsystem at the coordinates of the laws."""

    #: Names of coordinates that are supports (`systems.penalty_supports`).
    supports: tuple[str, ...] = ()

    def __init__(self, rest: Rest, laws: Laws, reduced: Any = None) -> None:
        # ``reduced``: reduction of the linear subsystem (`systems.reduced.ReducedRest`), or None.
        # The core treats the first modes one by one, so modes are sorted by frequency.
        order = np.argsort(np.abs(rest.squares), kind="stable")
        if (np.diff(order) < 0).any():
            rest = rest._replace(
                squares=rest.squares[order], rates=rest.rates[order], losses=rest.losses[order],
                shapes=rest.shapes[:, order],
            )  # fmt: skip
        self.rest, self.laws, self.reduced = rest, laws, reduced
        q = laws.directions
        rigid, still = rest.squares == 0, rest.poles == 0
        self.seen, self.left, self.right = rest.shapes.T @ q, rest.left.T @ q, rest.right.T @ q
        for seen, shapes, bodies in (
            (self.seen, rest.shapes, rigid), (self.left, rest.left, still),
            (self.right, rest.right, still),
        ):  # fmt: skip
            lost = _UNSEEN * (np.abs(shapes[:, bodies]).T @ np.abs(q))
            seen[bodies] = np.where(np.abs(seen[bodies]) <= lost, 0.0, seen[bodies])
        self.flexible, self.flexible_rate = np.zeros_like(q), np.zeros_like(q)
        if rest.flexibility is not None:
            self.flexible, self.flexible_rate = rest.flexibility(q)

    @property
    def q(self) -> int:
        """Number of coordinates after condensation."""
        return int(self.laws.directions.shape[1])

    @cached_property
    def weights(self) -> FloatArray:
        """Inertia of each coordinate alone: H tends to 1/(weight s^2) for large s."""
        inverse = (self.seen**2).sum(axis=0)
        # The sum of left right^T pole is Q^T M^-1 Q, the limit of s^2 H for large s.
        inverse = inverse + np.einsum("lq,lq,l->q", self.left, self.right, self.rest.poles).real
        return np.asarray(1 / np.where(inverse > 0, inverse, 1.0))

    @cached_property
    def rest_vector(self) -> list[Any]:
        """The linear subsystem as numbers in the order of `viscovib_binding_tools`."""
        rest = self.rest
        return [
            rest.squares, rest.rates, rest.losses * rest.squares, self.seen.ravel(order="F"),
            self.seen.ravel(order="F"), _pairs(rest.poles), _pairs(self.left), _pairs(self.right),
            (self.laws.directions.T @ self.flexible).ravel(order="F"),
            (self.laws.directions.T @ self.flexible_rate).ravel(order="F"),
        ]  # fmt: skip

    def law_vector(self, direction: FloatArray) -> FloatArray:
        """The laws as numbers of a polynomial system in the condensed coordinates.

        ``direction``: motion of these coordinates per unit motion of the base, shape (q,).
        """
        if any(place.law.text == "restitution" for place in self.laws.programs):
            raise InputError(
                "elements: a stop with restitution is for motions in time (simulate), must have "
                "a stiffness instead here"
            )
        return self.laws.vector(np.diag(self.weights), np.zeros((self.q, self.q)), direction)


def _pairs(values: ComplexArray) -> FloatArray:
    """Alternating real and imaginary parts, column by column."""
    return np.ascontiguousarray(values.ravel(order="F")).view(float)


class LoadedStructure:
    """A condensation under a load, in the form of the core, and its motions in all coordinates.

    Parameters
    ----------
    condensation : Condensation
    orders : ndarray of int, shape (m,)
        Harmonics of the load.
    forces : complex ndarray, shape (n, m)
        Forces on all coordinates.
    base : complex ndarray, shape (m,)
        Displacement of the base.
    inertia : ndarray, shape (n,)
        M b, where b is the direction of the base motion.
    direction : ndarray, shape (n,), or None
        b.
    varying : sequence of VaryingForce
        Forces on the coordinates that depend on the frequency, of these harmonics.
    """

    def __init__(
        self,
        condensation: Condensation,
        orders: Any,
        forces: ComplexArray,
        base: ComplexArray,
        inertia: FloatArray,
        direction: FloatArray | None,
        varying: Sequence[VaryingForce] = (),
    ) -> None:
        self.condensation, self.orders = condensation, orders
        self.base, self.direction = base, direction
        self.pushes = [_push(condensation, forces[:, j]) for j in range(orders.size)]
        self.forces, self._inertia, self.varying = forces, inertia, tuple(varying)
        push = _push(condensation, inertia.astype(complex))
        self.inertial_pushes = [push.times(factor) for factor in base]
        self.varying_pushes = [_push(condensation, one.force) for one in self.varying]
        #: Motions of supports that move each on its own, by order, shape (n_held,).
        self.apart: dict[int, ComplexArray] = {}
        #: Whether motions are those of the linear part.
        self.linear = False

    def linear_part(self) -> "LoadedStructure":
        """Return the structure for motions without nonlinear forces."""
        same = copy(self)
        same.linear = True
        return same

    @classmethod
    def of(
        cls,
        condensation: Condensation,
        orders: Any,
        series: ComplexArray,
        inertia: FloatArray,
        direction: FloatArray | None,
        varying: Sequence[VaryingForce],
    ) -> "LoadedStructure":
        """From forces and the motion of the base, shape (n + 1, m); harmonics of 0 are dropped."""
        own = list(dict.fromkeys(one.order for one in varying))
        new = np.array([k for k in own if k not in orders], dtype=orders.dtype)
        orders = np.concatenate([orders, new])
        series = np.hstack([series, np.zeros((series.shape[0], new.size))])
        kept = series.any(axis=0) | np.isin(orders, own)
        given = orders[kept], series[:-1, kept], series[-1, kept], inertia, direction
        return cls(condensation, *given, varying)

    @property
    def touched(self) -> Any:
        """True for each coordinate with a load, shape (n,)."""
        touched = self.forces.any(axis=1)
        for one in self.varying:
            touched |= one.force != 0
        return touched

    def inertial_force(self, j: int) -> ComplexArray:
        """Force per (k nu)^2 of load j by the motion of the base, shape (n,)."""
        return np.asarray(self._inertia * self.base[j])

    def varying_at(self, order: int, nu: FloatArray) -> list[tuple[FloatArray, int]]:
        """Values of the formulas of a harmonic, shape (n,), with the indices of their forces."""
        own = [i for i, one in enumerate(self.varying) if one.order == order]
        if not own:
            return []
        # Motions that were not located, such as a crossing, have the frequency NaN.
        known = np.isfinite(nu)
        values = np.full((nu.size, len(own)), np.nan)
        values[known] = values_of([self.varying[i].formula for i in own], nu[known])
        return list(zip(values.T, own, strict=True))

    @property
    def note(self) -> str:
        """Line of a plan about the condensation."""
        c = self.condensation
        n = c.laws.directions.shape[0]
        kinds = [things(c.rest.squares.size, "real mode")] if c.rest.squares.size else []
        poles = c.rest.poles
        # Real poles of layers are single, not halves of pairs.
        still = int((poles.imag == 0).sum()) if c.rest.remembered else 0
        pairs = (poles.size - still) // 2
        kinds += [things(pairs, "pair of complex modes", "pairs of complex modes")] if pairs else []
        kinds += (
            [things(still, "mode that does not swing", "modes that do not swing")] if still else []
        )
        rigid, below = int((c.rest.squares == 0).sum()), int((c.rest.squares < 0).sum())
        more = f", {rigid} of rigid bodies" if rigid else ""
        more += f", {below} unstable without the elements" if below else ""
        if c.reduced is not None:
            more += c.reduced.note
        if c.supports:
            more += f"\n{supports_text(c.supports)}"
        return (
            f"{things(n, 'coordinate')} condensed to {things(c.q, 'deflection')} by "
            f"{' and '.join(kinds)}{more}"
        )

    @cached_property
    def job(self) -> tuple[Any, ...]:
        """System and load as arguments of the flat routines."""
        c = self.condensation
        parts: list[Any] = [
            [c.q, c.rest.squares.size, c.rest.poles.size, self.orders.size],
            *c.rest_vector,
        ]
        for j, order in enumerate(self.orders):
            parts += [[order], *self.pushes[j].numbers, *self.inertial_pushes[j].numbers]
            own = [i for i, one in enumerate(self.varying) if one.order == order]
            parts.append([len(own)])
            for i in own:
                law = law_of(self.varying[i].formula)
                parts += [*self.varying_pushes[i].numbers, [len(law.code)], law.code, law.number]
        parts.append(c.law_vector(self._base_deflections))
        flat = np.concatenate([np.asarray(part, dtype=float) for part in parts])
        # The core reads the loads from the vector. These arrays contain only the harmonic orders
        # and the motion of the base.
        orders = self.orders if self.orders.size else np.ones(1, dtype=np.int32)
        series = np.zeros((c.q + 1, orders.size), dtype=complex, order="F")
        series[:-1, : self.orders.size] = np.where(self.orders == 0, 1j, 1)
        series[-1, : self.orders.size] = self.base
        nothing = np.zeros(1)
        # Frequencies of formulas are checked with them.
        formulas = list(dict.fromkeys(one.formula for one in self.varying))
        codes = [
            FORMULA_CODE * (formulas.index(one.formula) + 1) - one.order for one in self.varying
        ]
        orders = np.concatenate([orders, codes]).astype(np.int32)
        series = np.asfortranarray(np.hstack([series, np.zeros((c.q + 1, len(codes)))]))
        return flat, STRUCTURE_IN_VECTOR, nothing, 0, nothing, orders, series, joined(formulas)

    @cached_property
    def _handle(self) -> Handle:
        """The condensed structure and its load in the core."""
        return oscillator_object(self.job[0], self.job[1:5])

    @cached_property
    def steady(self) -> Job:
        """Arguments of tasks on steady motions."""
        given = dict(zip(("orders", "series", "formulas"), self.job[5:], strict=True))
        return Job(self._handle, given)

    @property
    def _base_deflections(self) -> FloatArray:
        """Motion of the condensed coordinates per unit motion of the base, shape (q,)."""
        if self.direction is None:
            return np.zeros(self.condensation.q)
        return np.asarray(self.condensation.laws.directions.T @ self.direction)

    def base_motion(self, orders: Any) -> ComplexArray:
        """Harmonics of the condensed coordinates due to the motion of the base, shape (q, m)."""
        moved = np.zeros((self.condensation.q, orders.size), dtype=complex)
        for order, base in zip(self.orders, self.base, strict=True):
            if base != 0:
                moved[:, orders == order] += (self._base_deflections * base)[:, np.newaxis]
        return moved

    def watching(self, place: int) -> tuple["LoadedStructure", int]:
        """Add a coordinate of the structure to the condensed ones; also return its index."""
        c = self.condensation
        one = np.zeros(c.laws.directions.shape[0])
        one[place] = 1.0
        for row, direction in enumerate(c.laws.directions.T):
            if (direction == one).all():
                return self, row
        laws, row = c.laws.watching(one)
        more = Condensation(c.rest, laws, c.reduced)
        more.supports = c.supports
        return LoadedStructure(
            more, self.orders, self.forces, self.base, self._inertia, self.direction, self.varying
        ), row

    def expand(
        self,
        nu: FloatArray,
        orders: Any,
        y: ComplexArray,
        places: Any,
        factors: FloatArray | None = None,
    ) -> ComplexArray:
        """Harmonics of coordinates, shape (n, len(places), m): U_k = D_k^-1 (P_k - Q G_k).

        ``y``: harmonics (n, q, m) of the condensed coordinates, relative to the base; ``factors``:
        load factors of the motions.
        """
        factors = np.ones(nu.size) if factors is None else factors
        if not nu.size * orders.size:
            # No motions or no harmonics, for example for a linear structure without load.
            return np.empty((nu.size, len(places), orders.size), dtype=complex)
        c, rest = self.condensation, self.condensation.rest
        u = np.empty((nu.size, len(places), orders.size), dtype=complex)
        shapes, left = rest.shapes[places].T, rest.left[places].T
        size = max(1, _AT_ONCE // (max(rest.squares.size + rest.poles.size, 1) * orders.size))
        for first in range(0, nu.size, size):
            part = slice(first, first + size)
            found = self._in_modes(nu[part], orders, y[part], factors[part])
            for k, order in enumerate(orders):
                modes, poles, g = (one[:, k].T for one in found)
                u[part, :, k] = modes @ shapes + poles @ left
                j = np.flatnonzero(self.orders == order)
                if rest.flexibility is not None:
                    s = 1j * order * nu[part] if order else np.zeros(g.shape[0], dtype=complex)
                    u[part, :, k] += g @ c.flexible[places].T
                    u[part, :, k] += (s[:, np.newaxis] * g) @ c.flexible_rate[places].T
                    u[part, :, k] += self._flexible_load(s, j, places, factors[part])
                if j.size and self.direction is not None:
                    base = self.direction[places] * self.base[j[0]]
                    u[part, :, k] += np.outer(factors[part], base)
        return u

    def reaction(
        self, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray
    ) -> ComplexArray:
        """Forces of elements on the linear subsystem, shape (n, q, m); arguments of `expand`."""
        return np.asarray(self._in_modes(nu, orders, y, factors)[2].T.transpose(0, 2, 1))

    def _in_modes(
        self, nu: FloatArray, orders: Any, y: ComplexArray, factors: FloatArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Amplitudes of real and complex modes, and forces of elements, shapes (n_modes, m, n)."""
        found = run(
            "response modes", self._handle, nu=np.asarray(nu, dtype=float),
            factor=np.asarray(factors, dtype=float), kept=np.asarray(orders, dtype=np.int32),
            motions=np.asfortranarray(y.T), linear=self.linear,
        )  # fmt: skip
        return found["modes"], found["poles"], found["forces"]

    def _flexible_load(
        self, s: ComplexArray, j: Any, places: Any, factors: FloatArray
    ) -> ComplexArray:
        """Displacements of the omitted modes under the load itself."""
        if not j.size or self.condensation.rest.flexibility is None:
            return np.zeros((s.size, len(places)), dtype=complex)
        at = s[:, np.newaxis]
        order = self.orders[j[0]]
        varying = self.varying_at(order, s.imag / max(order, 1))
        loads = np.stack(
            [
                self.forces[:, j[0]], self.inertial_force(j[0]),
                *(self.varying[i].force for _, i in varying),
            ],
            axis=1,
        )  # fmt: skip
        real, real_rate = self.condensation.rest.flexibility(np.ascontiguousarray(loads.real))
        imag, imag_rate = self.condensation.rest.flexibility(np.ascontiguousarray(loads.imag))
        bend, rate = (real + 1j * imag)[places], (real_rate + 1j * imag_rate)[places]
        force, base = bend[:, 0] + at * rate[:, 0], bend[:, 1] + at * rate[:, 1]
        for column, (values, _) in enumerate(varying, start=2):
            force = force + values[:, np.newaxis] * (bend[:, column] + at * rate[:, column])
        return np.asarray((force - at**2 * base) * factors[:, np.newaxis])


class _Push(NamedTuple):
    """One harmonic of forces, on real modes (m,), complex modes (p,) and the flexibility."""

    modes: ComplexArray
    poles: ComplexArray
    flexible: ComplexArray
    flexible_rate: ComplexArray

    def times(self, factor: complex) -> "_Push":
        return _Push(*(factor * part for part in self))

    @property
    def numbers(self) -> list[FloatArray]:
        return [_pairs(part) for part in self]


def _push(c: Condensation, force: ComplexArray) -> _Push:
    acted = np.flatnonzero(force)
    parts = force[acted].view(float).reshape(-1, 2)

    def onto(columns: FloatArray) -> ComplexArray:
        # Real and imaginary parts as two columns avoid a complex copy of the modes.
        return np.ascontiguousarray(columns[acted].T @ parts).view(complex)[:, 0]

    # The flexibility is symmetric.
    return _Push(
        onto(c.rest.shapes), c.rest.right[acted].T @ force[acted], onto(c.flexible),
        onto(c.flexible_rate),
    )  # fmt: skip
