"""A structure condensed to the deflections of its elements, and back to all its coordinates."""

from collections.abc import Sequence
from copy import copy
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from viscovib._native import ComplexArray, FloatArray, Handle, oscillator_object
from viscovib.common.counts import things
from viscovib.errors import InputError
from viscovib.systems.element_laws import Laws
from viscovib.systems.frequency_formulas import joined, law_of, values_of
from viscovib.systems.load import FORMULA_CODE, Job, VaryingForce
from viscovib.systems.penalty_supports import supports_text
from viscovib.systems.resonant_forces import compliance, refine, with_modes
from viscovib.systems.resting_forces import Motions, forces_of_laws, solved
from viscovib.systems.structure_rest import Rest, Static, static_form

#: Kernel kind in x that marks a vector of numbers as a condensed structure for the core.
STRUCTURE_IN_VECTOR = -3
#: Largest relative part of a mean load without support that counts as rounding error.
_UNHELD = 1e-9
#: Largest relative deflection of a rigid-body motion that counts as rounding error.
_UNSEEN = 1e-10
#: Size of the array of one part of an expansion to all coordinates.
_AT_ONCE = 2_000_000
#: Largest number of coordinates for which the core gets the matrices of the complex modes.
_FEW = 24
#: A mode is near a resonance if its dynamic stiffness is at most this part of its stiffness.
_NEAR = 1e-6


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
        self.seen = rest.shapes.T @ q
        self.left = rest.left.T @ q
        self.right = rest.right.T @ q
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
    def _elastic(self) -> FloatArray:
        """H(0) without rigid bodies."""
        rest, rigid = self.rest, self._rigid
        bend = np.where(rigid, 0.0, 1 / np.where(rigid, 1.0, rest.squares))
        total = (self.seen * bend[:, np.newaxis]).T @ self.seen
        moving = ~self._still
        total = (
            total
            - np.einsum(
                "lq,lp,l->qp", self.left[moving], self.right[moving], 1 / rest.poles[moving]
            ).real
        )
        return np.asarray(total + self.laws.directions.T @ self.flexible)

    @property
    def _rigid(self) -> Any:
        return self.rest.squares == 0

    def static(self, modes: ComplexArray, poles: ComplexArray, flexible: ComplexArray) -> Static:
        """Harmonic 0 under loads on real modes (m,), complex modes (p,), flexible deflections."""
        rest, rigid, still = self.rest, self._rigid, self._still
        deflection = flexible + (self.seen[~rigid].T / rest.squares[~rigid]) @ modes[~rigid]
        deflection = deflection - self.left[~still].T @ (poles[~still] / rest.poles[~still])
        # The shapes of a pole at 0 are real except for a common complex factor.
        q, bodies = self.laws.directions.T, rest.shapes[:, rigid]
        seen = np.hstack([_seen(q, bodies), _seen(q, (rest.left[:, still] / self._turn).real)])
        pushed = np.hstack([_seen(q, bodies), _seen(q, (rest.right[:, still] * self._turn).real)])
        pushes = np.concatenate([modes[rigid], poles[still] * self._turn])
        return static_form(self._elastic, deflection, seen, pushed, pushes)

    @property
    def _still(self) -> Any:
        """Complex modes that are rigid-body motions with dampers."""
        return self.rest.poles == 0

    @property
    def _turn(self) -> ComplexArray:
        """Factors that make the shapes of the poles at 0 real."""
        left = self.rest.left[:, self._still]
        largest = np.take_along_axis(left, np.abs(left).argmax(axis=0)[np.newaxis], axis=0)[0]
        return np.asarray(largest / np.abs(largest))

    @cached_property
    def rest_vector(self) -> list[Any]:
        """The linear subsystem as numbers in the order of `viscovib_binding_tools`."""
        rest, q = self.rest, self.q
        nothing = np.zeros(rest.squares.size, complex), np.zeros(rest.poles.size, complex)
        return [
            rest.squares, rest.rates, rest.losses * rest.squares, self.seen.ravel(order="F"),
            self.seen.ravel(order="F"), _pairs(rest.poles), _pairs(self.left), _pairs(self.right),
            (self.laws.directions.T @ self.flexible).ravel(order="F"),
            (self.laws.directions.T @ self.flexible_rate).ravel(order="F"),
            self.static(*nothing, np.zeros(q, complex)).stiffness.ravel(order="F"),
            *self._matrix_vector,
        ]  # fmt: skip

    @cached_property
    def _matrix_vector(self) -> list[Any]:
        """M^-1 C, M^-1 K, M^-1 Q and Q in units with masses 1, for few coordinates."""
        if self.rest.matrices is None or self.rest.matrices[0].shape[0] > _FEW:
            return [[0]]
        mass, damping, stiffness = self.rest.matrices
        unit = np.sqrt(np.diag(mass))
        left, right = np.diag(unit) @ np.linalg.inv(mass), np.diag(1 / unit)
        q = self.laws.directions
        parts = left @ damping @ right, left @ stiffness @ right, left @ q, right @ q
        return [[unit.size], *(part.ravel(order="F") for part in parts)]

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


def _seen(directions: FloatArray, bodies: FloatArray) -> FloatArray:
    """Rigid-body motions in the coordinates; entries below the rounding error are set to 0."""
    seen = directions @ bodies
    seen[np.abs(seen) <= _UNSEEN * (np.abs(directions) @ np.abs(bodies))] = 0.0
    return np.asarray(seen)


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
        #: Whether motions are those of the linear part, whose forces need no division by H.
        self.linear = False

    def linear_part(self) -> "LoadedStructure":
        """Return the structure without its nonlinear forces.

        Forces g of the elements on the linear subsystem then follow from the motions: g = S R(s) y
        with the stiffness S and transform R of each kernel, 0 without memory. From H g = y - free
        they would lose digits if H is small, and all digits at an antiresonance of an element.
        """
        laws = self.condensation.laws
        if any(sum(powers) < 2 for group in laws.forces for _, powers in group):
            return self
        alone = zip(laws.kernels, laws.stiffness, strict=True)
        if laws.programs or any(kernel is None and own.any() for kernel, own in alone):
            return self
        return self._linear_part

    @cached_property
    def _linear_part(self) -> "LoadedStructure":
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
            push = self.pushes[j]
            at_rest = np.zeros(c.q, complex)
            if order == 0:
                static = c.static(push.modes, push.poles, push.flexible)
                at_rest = static.load
                if static.unheld > _UNHELD:
                    raise InputError(
                        "load[0]: its mean acts on a rigid body without support: there is no "
                        "static equilibrium"
                    )
            moved = self.inertial_pushes[j]
            parts += [[order], *push.numbers, *moved.numbers, _pairs(at_rest)]
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
        u = np.full((nu.size, len(places), orders.size), np.nan, dtype=complex)
        shapes, left = rest.shapes[places].T, rest.left[places].T
        flexible, flexible_rate = c.flexible[places], c.flexible_rate[places]
        size = max(1, _AT_ONCE // max(rest.squares.size + rest.poles.size, 1))
        whole = np.abs(y).max(axis=(1, 2))
        for k, order in enumerate(orders):
            j = np.flatnonzero(self.orders == order)
            if order == 0:
                u[:, :, k] = self._at_rest(y[:, :, k], j, places, factors)
            else:
                for first in range(0, nu.size, size):
                    # Skip motions that were not found; their frequency is undefined.
                    part = np.flatnonzero(np.isfinite(y[first : first + size, :, k]).all(axis=1))
                    part += first
                    s = 1j * order * nu[part]
                    modes, poles, g = self._forced(
                        s, y[part, :, k], j, factors[part], Motions(nu, orders, y, k, part, whole)
                    )
                    u[part, :, k] = modes @ shapes + poles @ left
                    if rest.flexibility is not None:
                        u[part, :, k] += g @ flexible.T + (s[:, np.newaxis] * g) @ flexible_rate.T
                        u[part, :, k] += self._flexible_load(s, j, places, factors[part])
            if j.size and self.direction is not None:
                u[:, :, k] += np.outer(factors, self.direction[places] * self.base[j[0]])
        return u

    def reaction(
        self, nu: FloatArray, order: int, y: ComplexArray, factors: FloatArray
    ) -> ComplexArray:
        """Forces of the elements on the linear subsystem in one harmonic, shape (n, q).

        ``y``: this harmonic of the condensed coordinates, shape (n, q).
        """
        j = np.flatnonzero(self.orders == order)
        if order:
            s = np.asarray(1j * order * nu)
            return np.asarray(self._forced(s, y, j, factors)[2])
        static = self._static(j)
        return np.asarray(y @ static.stiffness.T - factors[:, np.newaxis] * static.load)

    def _static(self, j: Any) -> Static:
        c = self.condensation
        nothing = np.zeros(c.rest.squares.size, complex), np.zeros(c.rest.poles.size, complex)
        zero = np.zeros(c.q, complex)
        push = self.pushes[j[0]] if j.size else _Push(*nothing, zero, zero)
        return c.static(push.modes, push.poles, push.flexible)

    def _forced(
        self,
        s: ComplexArray,
        y: ComplexArray,
        j: Any,
        factors: FloatArray,
        motions: Motions | None = None,
    ) -> tuple[Any, Any, Any]:
        """Amplitudes of real and complex modes, and forces of the elements on the linear subsystem.

        ``motions``: all harmonics; they give the forces where H g = y - free loses digits.
        """
        c, rest = self.condensation, self.condensation.rest
        at = s[:, np.newaxis]
        apart = rest.squares * (1 + 1j * rest.losses) + rest.rates * at + at**2
        # At an undamped resonance the difference is a rounding error.
        apart = np.where(apart == 0, np.finfo(float).eps * np.abs(rest.squares), apart)
        # Motions that were not located, such as a crossing, have the frequency NaN.
        with np.errstate(invalid="ignore"):
            t, w = 1 / apart, 1 / (at - rest.poles)
        modes = np.zeros((s.size, rest.squares.size), dtype=complex)
        poles = np.zeros((s.size, rest.poles.size), dtype=complex)
        free = np.zeros_like(y)
        if j.size:
            push, moved = self.pushes[j[0]], self.inertial_pushes[j[0]]
            modes += push.modes - at**2 * moved.modes
            poles += push.poles - at**2 * moved.poles
            free += push.flexible + at * push.flexible_rate
            free -= at**2 * (moved.flexible + at * moved.flexible_rate)
            order = self.orders[j[0]]
            for values, i in self.varying_at(order, s.imag / order):
                value, varied = values[:, np.newaxis], self.varying_pushes[i]
                modes += value * varied.modes
                poles += value * varied.poles
                free += value * (varied.flexible + at * varied.flexible_rate)
            for part in (modes, poles, free):
                part *= factors[:, np.newaxis]
        # Modes near a resonance are separate unknowns: in H they would hide all other modes.
        loud = np.flatnonzero((np.abs(apart) < _NEAR * np.abs(rest.squares)).any(axis=0))
        quiet = np.delete(np.arange(rest.squares.size), loud)
        if self.linear and not (loud.size and any(c.laws.kernels)):
            g = np.zeros_like(y)
            for kernel, own in zip(c.laws.kernels, c.laws.stiffness, strict=True):
                if kernel is not None:
                    g += kernel.transform(s.imag)[:, np.newaxis] * (y @ own.T)
            return (modes + g @ c.seen.T) * t, (poles + g @ c.right.T) * w, g
        rigid = free.copy()
        pushed = modes[:, quiet] * t[:, quiet]
        free += pushed @ c.seen[quiet] + (poles * w) @ c.left
        h = compliance(c, s, t, w, quiet)
        if loud.size:
            forces, others = with_modes(h, c.seen[loud], apart[:, loud], y - free, modes[:, loud])
            amplitudes = np.asarray((modes + forces @ c.seen.T) * t)
            amplitudes[:, loud] = others
            return amplitudes, (poles + forces @ c.right.T) * w, forces
        by_compliance = g = solved(h, y - free)
        if motions is not None:
            g = forces_of_laws(c, g.copy(), h, t, w, pushed, poles * w, y, motions)
        amplitudes = np.asarray((modes + g @ c.seen.T) * t)
        of_laws = (g != by_compliance).any(axis=1)
        loads = (modes, poles, rigid)
        refine(c, s, (apart, t, w), loads, y, of_laws, (g, amplitudes))
        return amplitudes, (poles + g @ c.right.T) * w, g

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

    def _at_rest(self, y: ComplexArray, j: Any, places: Any, factors: FloatArray) -> ComplexArray:
        """Harmonic 0 of coordinates."""
        c, rest, rigid = self.condensation, self.condensation.rest, self.condensation._rigid
        nothing = np.zeros(rest.squares.size, complex), np.zeros(rest.poles.size, complex)
        zero = np.zeros(c.q, complex)
        push = self.pushes[j[0]] if j.size else _Push(*nothing, zero, zero)
        static = self._static(j)
        scale = factors[:, np.newaxis]
        h = y @ static.stiffness.T - scale * static.load
        modes = (scale * push.modes + h @ c.seen.T)[:, ~rigid] / rest.squares[~rigid]
        u = modes @ rest.shapes[places][:, ~rigid].T
        bodies = y @ static.rigid.T + scale * static.rigid_load
        still = c._still
        left = rest.left[places].T
        bodily = np.vstack([rest.shapes[places][:, rigid].T, (left[still].T / c._turn).T])
        u = u + bodies @ bodily
        poles = (scale * push.poles + h @ c.right.T)[:, ~still] / rest.poles[~still]
        u = u - poles @ left[~still]
        if rest.flexibility is not None:
            u = u + h @ c.flexible[places].T
            u = u + self._flexible_load(np.zeros(factors.size, dtype=complex), j, places, factors)
        return np.asarray(u)


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
