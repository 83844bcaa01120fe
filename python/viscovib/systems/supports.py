"""Supports of a structure: coordinates that are fixed or move with the base."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError
from viscovib.systems.elements import CouplingTerms, ElementTerms
from viscovib.systems.layers import Layers
from viscovib.systems.load import LoadLike, load_series, name_places
from viscovib.systems.load_table import LoadTable, PiecewiseTable, added
from viscovib.systems.piecewise import derivative, values_at
from viscovib.systems.structure_matrices import is_sparse

#: Largest relative stretch of an element that counts as rounding error.
_UNSTRETCHED = 1e-12
#: Relative size of forces of a base motion that are rounding errors, and that deform something.
_ROUNDING, _STRAINED = 1e-13, 1e-9


@dataclass(frozen=True, eq=False)
class Supports:
    """The matrices of a structure with its supports, and the motion of all coordinates.

    The coordinates are u_s = d y at the supports and u_f = r y + w elsewhere, with the motion y of
    the base. Then

        M_ff w'' + C_ff w' + K_ff w + elements(w) = p - m y'' - c y' - k y,
        (m, c, k) = (M_ff r + M_fs d, C_ff r + C_fs d, K_ff r + K_fs d).

    r is any vector for which no element is stretched, e_f . r + e_s . d = 0: the static deflection
    of the structure, corrected at the elements.
    """

    names: tuple[str, ...]
    #: All coordinates and their units, and indices of the free ones and of the supports.
    all_names: tuple[str, ...]
    all_units: tuple[str, ...]
    free: Any
    held: Any
    #: M, C and K of all coordinates, without elements.
    matrices: tuple[Any, Any, Any]
    #: (r, d) in the order of all coordinates; None: the supports do not move.
    motion: FloatArray | None
    #: ``base_direction`` as given.
    given: Any
    #: M_fs d, c and k, shape (n_free,); zeros if the supports do not move.
    mass: FloatArray
    rate: FloatArray
    place: FloatArray
    #: Weights of the supports in the deflections of each element, in order, shape (n_own, n_held).
    ends: tuple[FloatArray, ...]
    #: True if the base motion deforms springs or dampers, beyond rounding errors.
    strains: bool = False
    #: True if a layer with memory acts on a support.
    layered: bool = False
    #: Rows of C and K by gyroscopic, circulatory and centrifugal matrices, shape
    #: (2, n_held, n_free), and whether these act on supports at a speed that is not constant.
    turning: Any = 0.0
    is_turned: bool = False

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the forces at the supports."""
        own = [self.all_units[i] for i in self.held]
        return tuple({"m": "N", "rad": "N m"}.get(unit, f"N m/{unit}") for unit in own)

    @property
    def touched(self) -> list[int]:
        """Indices of the elements that act on supports."""
        return [i for i, one in enumerate(self.ends) if one.any()]

    def rows(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Weights of the forces of `touched` elements on the supports, and rows of M, C and K.

        Shapes (n_touched, n_held) and (3, n_held, n). ``name``: the caller, for messages.
        """
        if self.layered:
            raise InputError(f"{name}: a layer with memory acts on a support")
        if self.is_turned:
            raise InputError(
                f"{name}: gyroscopic, circulatory or centrifugal act on a support: give speed"
            )
        for i in self.touched:
            if self.ends[i].shape[0] > 1:
                raise InputError(f"{name}: elements[{i}] is a Coupling that acts on a support")
        weights = np.array([self.ends[i][0] for i in self.touched]).reshape(-1, self.held.size)
        found = [block(matrix, self.held, _all(matrix)) for matrix in self.matrices]
        rows = np.array([one.toarray() if is_sparse(one) else one for one in found])
        rows[1:, :, self.free] += self.turning
        return weights, rows

    def at_speed(self, speed: float | None, matrices: Sequence[Any]) -> Supports:
        """The same with the gyroscopic, circulatory and centrifugal matrix, or None, of each."""
        rows = np.zeros((3, self.held.size, self.free.size))
        for row, matrix in zip(rows, matrices, strict=True):
            if matrix is not None:
                found = block(matrix, self.held, self.free)
                row[:] = found.toarray() if is_sparse(found) else found
        if speed is None:
            return replace(self, is_turned=bool(rows.any()))
        turning = [speed * rows[0], speed * (rows[1] + speed * rows[2])]
        return replace(self, turning=np.array(turning))

    def cut(self, terms: Any) -> Any:
        """An element with directions of the free coordinates."""
        if isinstance(terms, CouplingTerms):
            return terms._replace(directions=tuple(e[self.free] for e in terms.directions))
        series = terms.series and terms.series._replace(direction=terms.series.direction[self.free])
        return terms._replace(direction=terms.direction[self.free], series=series)

    def with_layers(self, layers: Layers, n_elements: int) -> Supports:
        """The same with layers, which the base motion must not deform."""
        for i, (matrix, _) in enumerate(layers.whole):
            rows = block(matrix, self.free, _all(matrix))
            if self.motion is not None and _pull(rows, self.motion)[1]:
                raise InputError(
                    f"layers[{i}]: the base motion deforms it, must be free of the supports or "
                    "move with them without deformation (base_direction)"
                )
        on_supports = [abs(block(matrix, self.held, self.free)).max() for matrix, _ in layers.whole]
        on_supports += [np.abs(one).max(initial=0.0) for one in self.ends[n_elements:]]
        return replace(self, ends=self.ends[:n_elements], layered=max(on_supports, default=0.0) > 0)

    @property
    def pulls(self) -> bool:
        """True if the base acts by dampers or springs besides its inertia."""
        return bool(self.rate.any() or self.place.any())

    def force(self, order: int, nu: float) -> ComplexArray:
        """Force of dampers and springs per harmonic of the base motion, shape (n_free,)."""
        return np.asarray(-1j * order * nu * self.rate - self.place)

    def pulls_of(
        self, times: FloatArray, pieces: FloatArray
    ) -> list[tuple[FloatArray, tuple[FloatArray, FloatArray]]]:
        """Loads of dampers and springs for a base motion by polynomials (n_powers, n).

        Each is a direction (n_free,), with its times and polynomials (1, n_powers, n).
        """
        if times[0] > 0 and pieces[-1, 0]:
            # Before the table the base is held at its first value.
            begin = np.zeros((pieces.shape[0], 1))
            begin[-1] = pieces[-1, 0]
            times, pieces = np.append(0.0, times), np.hstack([begin, pieces])
        place = pieces[np.newaxis]
        parts = ((self.rate, derivative(place)), (self.place, place))
        return [(-push, (times, np.asfortranarray(part))) for push, part in parts if push.any()]


def split(names: Sequence[str], all_names: tuple[str, ...]) -> tuple[Any, Any]:
    """Indices of the free coordinates and of the supports."""
    if isinstance(names, str) or not isinstance(names, Sequence):
        raise InputError(f"supports = {_native.shown(names)}: must be a list of names")
    places = name_places(all_names)
    for name in names:
        if not isinstance(name, str) or name not in places:
            raise InputError(
                f"supports: {_native.shown(name)} must be one of the {len(all_names)} coordinates "
                f"{all_names[0]}, ..."
            )
    if len(set(names)) < len(names):
        raise InputError("supports: must differ")
    held = np.array([places[name] for name in names])
    free = np.setdiff1d(np.arange(len(all_names)), held)
    if not free.size:
        raise InputError("supports: all coordinates are supports, at least one must be free")
    return free, held


def block(matrix: Any, rows: Any, columns: Any) -> Any:
    """Rows and columns of a dense or sparse matrix."""
    found = matrix[np.ix_(rows, columns)]
    if is_sparse(found):
        from scipy.sparse import csc_array

        return csc_array(found)
    found.setflags(write=False)
    return found


def _all(matrix: Any) -> Any:
    return np.arange(matrix.shape[0])


def supports_of(
    names: tuple[str, ...],
    of_all: tuple[tuple[str, ...], tuple[str, ...]],
    places: tuple[Any, Any],
    matrices: tuple[Any, Any, Any],
    direction: Any,
    elements: Sequence[ElementTerms | CouplingTerms],
) -> Supports:
    """Return the supports of a structure.

    ``of_all``: names and units of all coordinates. ``direction``: motion of the supports, shape
    (n_supports,), or of all coordinates without deformation, shape (n,); None: they are fixed.
    ``elements``: in order, with directions of shape (n,), and layers as elements after them.
    """
    free, held = places
    n = len(of_all[0])
    still = np.zeros(free.size)
    of_each = [
        np.array(one.directions if isinstance(one, CouplingTerms) else [one.direction])
        for one in elements
    ]
    ends = tuple(one[:, held] for one in of_each)
    for i, one in enumerate(of_each):
        if not one[:, free].any(axis=1).all():
            raise InputError(f"elements[{i}]: acts on supports only, must act on a free coordinate")
    if direction is None:
        return Supports(names, *of_all, free, held, matrices, None, None, still, still, still, ends)
    given = _native.real_array("base_direction", direction)
    if given.shape not in ((held.size,), (n,)):
        raise InputError(
            f"base_direction: must have shape ({held.size},), the motion of the supports, or "
            f"({n},), got {given.shape}"
        )
    motion = np.zeros(n)
    directions = [e for one in of_each for e in one]
    if given.shape == motion.shape:
        motion = given.copy()
    else:
        motion[held] = given
        motion[free] = _static(matrices[2], free, held, given, elements)
    _unstretch(motion, free, directions)
    motion.setflags(write=False)
    rows = [block(matrix, free, _all(matrix)) for matrix in matrices]
    pulled = [_pull(row, motion) for row in rows[1:]]
    (rate, _), (place, _) = pulled
    strains = any(strained for _, strained in pulled)
    mass = np.asarray(block(matrices[0], free, held) @ motion[held], dtype=float)
    return Supports(
        names, *of_all, free, held, matrices, motion, given, mass, rate, place, ends, strains
    )


def _static(
    stiffness: Any, free: Any, held: Any, moved: FloatArray, elements: Sequence[Any]
) -> FloatArray:
    """Static deflection of the free coordinates, with linear elements; 0 if they are not held."""
    added: Any = stiffness
    linear = [(one.powers.get(1, 0.0), one.direction) for one in elements if hasattr(one, "powers")]
    if is_sparse(stiffness):
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        for k, e in linear:
            if k:
                column = csc_array(e[:, np.newaxis])
                added = added + k * (column @ column.T)
        added = csc_array(added)
        pull = -(block(added, free, held) @ moved)
        try:
            found = splu(block(added, free, free)).solve(np.asarray(pull))
        except RuntimeError:
            return np.zeros(free.size)
    else:
        added = np.array(stiffness)
        for k, e in linear:
            added += k * np.outer(e, e)
        pull = -(added[np.ix_(free, held)] @ moved)
        try:
            found = np.linalg.solve(added[np.ix_(free, free)], pull)
        except np.linalg.LinAlgError:
            return np.zeros(free.size)
    largest = np.abs(moved).max(initial=0.0)
    fits = np.isfinite(found).all() and np.abs(found).max(initial=0.0) <= 1e6 * largest
    return np.asarray(found) if fits else np.zeros(free.size)


def _unstretch(motion: FloatArray, free: Any, directions: Sequence[FloatArray]) -> None:
    """Change the motion of the free coordinates so that the base stretches no element."""
    if not directions:
        return
    q = np.array(directions)
    stretched = q @ motion
    size = np.abs(q) @ np.abs(motion)
    if (np.abs(stretched) <= _UNSTRETCHED * size).all():
        return
    motion[free] -= np.linalg.lstsq(q[:, free], stretched, rcond=None)[0]
    left = np.abs(q @ motion)
    size = np.maximum(size, np.abs(q) @ np.abs(motion))
    if (left > 1e3 * _UNSTRETCHED * size).any():
        i = int(np.argmax(left - 1e3 * _UNSTRETCHED * size))
        raise InputError(
            f"elements: the base stretches deflection {i} by {left[i]:g} of its motion, whatever "
            "the free coordinates do, must leave one of each element free"
        )


def _pull(rows: Any, motion: FloatArray) -> tuple[FloatArray, bool]:
    """Forces of a motion of all coordinates on the free ones; rounding errors are 0.

    Also true if they are above the rounding errors of a solution.
    """
    found = np.asarray(rows @ motion, dtype=float)
    size = np.asarray(abs(rows) @ np.abs(motion), dtype=float)
    found[np.abs(found) <= _ROUNDING * size] = 0.0
    return found, bool((np.abs(found) > _STRAINED * size).any())


def with_base_loads(
    system: Any, end: float, load: LoadLike | None, nu: float, base: Any, force: LoadTable | None
) -> tuple[LoadLike | None, LoadTable | None]:
    """Return the loads in time with all forces of a base motion through supports.

    The inertia of the free coordinates relative to the base is not among them.
    """
    supports: Supports | None = system._held
    if base is None or supports is None:
        return load, force
    return pulled(supports, system.dof_names, end, load, nu, base, force)


def pulled(
    supports: Supports,
    names: Sequence[str],
    end: float,
    load: LoadLike | None,
    nu: float,
    base: Any,
    force: LoadTable | None,
) -> tuple[LoadLike | None, LoadTable | None]:
    """Return the loads in time on the coordinates with these names with those of supports."""
    n = len(names)
    if isinstance(base, LoadTable):
        times, pieces = np.asarray(base.times), base._base_pieces()[:, 0]
        if supports.mass.any():
            _refuse_kinks(times, pieces, end)
        parts = supports.pulls_of(times, pieces)
        bent = np.asfortranarray(derivative(derivative(pieces[np.newaxis])))
        if supports.mass.any():
            parts.append((-supports.mass, (times, bent)))
        for push, (at, part) in parts:
            own = at, np.einsum("n,opt->npt", push, part)
            if force is not None:
                own = added((np.asarray(force.times), force._pieces(n)), own)
            force = PiecewiseTable.of(*own)
        return load, force
    orders, series = load_series(load, base, n, name_places(names))
    loads = {}
    for order, column in zip(orders.tolist(), series.T, strict=True):
        moved = (order * nu) ** 2 * supports.mass + supports.force(order, nu)
        loads[order] = column[:n] + column[n] * moved
    return loads, force


def _refuse_kinks(times: FloatArray, pieces: FloatArray, end: float) -> None:
    """Refuse a base whose velocity jumps before ``end``: M_fs would act by an impulse."""
    speed = derivative(pieces[np.newaxis])
    _, after, _ = values_at(times, pieces[np.newaxis], times)
    ends = np.zeros(times.size)
    for p in range(speed.shape[1]):
        ends[1:] = ends[1:] * np.diff(times) + speed[0, p, :-1]
    jumps = np.abs(after[:, 0] - ends)
    jumps[(times <= 0) | (times >= end)] = 0.0
    largest = np.abs(speed[0, -1]).max(initial=0.0)
    if (jumps > 1e-9 * largest).any():
        i = int(np.argmax(jumps))
        raise InputError(
            f"base: its velocity jumps by {jumps[i]:g} at t = {times[i]:g}, and the mass matrix "
            "couples the supports to the structure: use interpolation = 'cubic'"
        )
