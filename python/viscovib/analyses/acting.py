"""What acts along a motion in time that is known: loads, the base, and what springs remember."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.mesh import Mesh
from viscovib.errors import InputError
from viscovib.systems.load_table import table_at
from viscovib.systems.piecewise import values_at

#: Gauss nodes of a panel, as in the core, and the places of a panel's points.
PANEL_POINTS = 8
_PLACES = np.concatenate([[0.0], (np.polynomial.legendre.leggauss(PANEL_POINTS)[0] + 1) / 2, [1.0]])
#: Parts of each piece of a past that is known.
_OF_PAST = 4
#: Numbers of a motion at the points of panels, at most: 1 GiB.
_MOST = 2**27


def along(frequencies: FloatArray, amplitudes: ComplexArray, t: FloatArray) -> FloatArray:
    """Return Im sum_k a_k exp(i w_k t), shape (n_times, n), of amplitudes (n, m)."""
    used = amplitudes.any(axis=0)
    return np.asarray((np.exp(1j * np.outer(t, frequencies[used])) @ amplitudes[:, used].T).imag)


@dataclass(frozen=True)
class Acting:
    """Loads on coordinates relative to the base, and how it moves them, at times (n_times, n)."""

    load: FloatArray
    place: FloatArray
    speed: FloatArray
    push: FloatArray


@dataclass(frozen=True)
class Loads:
    """Sinusoids and piecewise polynomials that act on n coordinates, and that their base moves by.

    Of the base amplitudes (n, m), with the frequencies of the load, and polynomials (n, p, k).
    """

    frequencies: FloatArray
    amplitudes: ComplexArray
    breaks: FloatArray
    pieces: FloatArray
    base: ComplexArray | None = None
    base_breaks: FloatArray = field(default_factory=lambda: np.zeros(0))
    base_pieces: FloatArray = field(default_factory=lambda: np.zeros((0, 4, 0)))

    def at(self, t: FloatArray) -> Acting:
        """What acts at times."""
        load = along(self.frequencies, self.amplitudes, t)
        if self.breaks.size > 1:
            load = load + table_at(self.breaks, self.pieces, t)
        return Acting(load, *self.moved(t))

    def moved(self, t: FloatArray) -> Sequence[FloatArray]:
        """Displacements, velocities and accelerations by the base at times."""
        w = self.frequencies
        if self.base is None:
            return (np.zeros((t.size, self.amplitudes.shape[0])),) * 3
        moved = [along(w, factor * self.base, t) for factor in (1.0, 1j * w, -(w**2))]
        if self.base_breaks.size:
            others = values_at(self.base_breaks, self.base_pieces, t)
            moved = [one + other for one, other in zip(moved, others, strict=True)]
        return moved


@dataclass(frozen=True)
class EarlierMotion:
    """The motion before t = 0: held until the first of the times, straight lines between them."""

    held: FloatArray
    before: FloatArray
    moved: FloatArray


def panel_ends(mesh: Mesh | None, h: float, until: float) -> FloatArray:
    """Ends of panels from 0 on: the steps."""
    if mesh is None:
        ends = h * np.arange(np.ceil(until / h * (1 - 1e-12)) + 1)
    else:
        ends = mesh.times(np.arange(mesh.count + 1))
    return np.append(ends[ends < until * (1 - 1e-14)], until)


@cache
def _from_equal_parts(parts: int) -> FloatArray:
    """From states at the ends of equal parts of a panel to those at its first points.

    By the polynomial with these values and slopes: shape (2 (PANEL_POINTS + 1), 2 (parts + 1)).
    """
    chebyshev = np.polynomial.chebyshev
    orders = np.eye(2 * parts + 2)

    def both(x: FloatArray) -> FloatArray:
        slopes = 2 * chebyshev.chebval(2 * x - 1, chebyshev.chebder(orders))
        return np.concatenate([chebyshev.chebval(2 * x - 1, orders), slopes], axis=1)

    at_parts, at_points = both(np.arange(parts + 1) / parts), both(_PLACES[:-1])
    return np.asarray(np.linalg.solve(at_parts, at_points).T)


def at_panels(ends: FloatArray, t: FloatArray, state: FloatArray) -> FloatArray | None:
    """States at the points of panels from those kept; None: too few in each panel."""
    n, h = ends.size - 1, np.diff(ends)[:, np.newaxis]
    parts = (t.size - 1) // n
    if parts < PANEL_POINTS // 2 or t.size != parts * n + 1 or t[0] != ends[0]:
        return None
    places = (ends[:-1, np.newaxis] + h * (np.arange(parts) / parts)).ravel()
    if np.abs(places - t[:-1]).max() > 1e-13 * ends[-1]:
        return None
    each = np.arange(n) * parts + np.arange(parts + 1)[:, np.newaxis]
    known = np.concatenate([state[each, ::2], h * state[each, 1::2]])
    # One product of matrices, with a column for each coordinate in each panel.
    found = _from_equal_parts(parts) @ known.reshape(2 * parts + 2, -1)
    u, rate = found.reshape(2, PANEL_POINTS + 1, n, -1).swapaxes(1, 2)
    states = np.empty((n * (PANEL_POINTS + 1) + 1, state.shape[1]))
    states[:-1, ::2] = u.reshape(-1, state.shape[1] // 2)
    states[:-1, 1::2] = (rate / h[:, np.newaxis]).reshape(-1, state.shape[1] // 2)
    states[-1] = state[-1]
    return states


@dataclass(frozen=True)
class Panels:
    """A motion relative to the base on panels: their ends, and states at the points of each."""

    ends: FloatArray
    u: FloatArray
    rate: FloatArray
    held: FloatArray
    #: Forces of laws that states alone do not give, shape (n_points, n_laws); nan before t = 0.
    laws: FloatArray

    @classmethod
    def of(
        cls,
        ends: FloatArray,
        past: EarlierMotion,
        states: Callable[[FloatArray], tuple[FloatArray, ...]],
    ) -> Panels:
        """From what gives coordinates and velocities at ascending times, relative to the base."""
        n = past.held.size
        if 2 * n * (ends.size - 1) * _PLACES.size > _MOST:
            raise InputError(
                f"a motion of {ends.size - 1} steps with memory and {n} coordinates: is too "
                "long for its accelerations and forces: use a shorter run"
            )
        # The end of a panel is the begin of the next one.
        t = (ends[:-1, np.newaxis] + np.diff(ends)[:, np.newaxis] * _PLACES[:-1]).ravel()
        first = np.arange(ends.size - 1)[:, np.newaxis] * (PANEL_POINTS + 1)
        each = first + np.arange(PANEL_POINTS + 2)
        u, rate, laws = (one[each.ravel()] for one in states(np.append(t, ends[-1])))
        cuts = past.before
        if cuts.size > 1:
            parts = np.linspace(cuts[:-1], cuts[1:], _OF_PAST, endpoint=False, axis=1)
            early = np.append(parts.ravel(), cuts[-1])
            speeds = np.diff(past.moved, axis=1) / np.diff(cuts)
            at = (early[:-1, np.newaxis] + np.diff(early)[:, np.newaxis] * _PLACES).ravel()
            old = np.stack([np.interp(at, cuts, one) for one in past.moved], axis=1)
            speed = np.repeat(speeds, _OF_PAST * _PLACES.size, axis=1).T
            u, rate = np.concatenate([old, u]), np.concatenate([speed, rate])
            laws = np.concatenate([np.full((at.size, laws.shape[1]), np.nan), laws])
            ends = np.concatenate([early[:-1], ends])
        return cls(ends, u, rate, past.held, laws)

    @property
    def given(self) -> dict[str, FloatArray]:
        """The motion for the core."""
        return {
            "ends": self.ends, "panel_u": np.asfortranarray(self.u),
            "panel_rate": np.asfortranarray(self.rate), "held": self.held,
        }  # fmt: skip


@dataclass(frozen=True)
class KnownMotion:
    """A motion relative to the base at ascending times, and what acts along it."""

    system: _native.Handle
    t: FloatArray
    #: Shape (n_times, n).
    u: FloatArray
    rate: FloatArray
    acting: Acting
    #: Makes the motion until then; None: the system has no memory.
    make_panels: Callable[[], Panels] | None
    #: Accelerations relative to the base and forces of laws, of motions on surfaces of laws.
    push: FloatArray | None = None
    laws: FloatArray | None = None
    #: Forces of the mounts of a body, if they are known already.
    mounts: list[dict[str, Any]] = field(default_factory=list)
    #: Displacements, velocities and accelerations of supports that move each on its own.
    supports: tuple[FloatArray, ...] | None = None

    @cached_property
    def panels(self) -> Panels | None:
        """The motion until then; None: the system has no memory."""
        return None if self.make_panels is None else self.make_panels()


def accelerations(motion: KnownMotion, remembered: FloatArray | None = None) -> FloatArray:
    """Return accelerations of the body, shape (n_times, n), by the equations of motion.

    ``remembered``: forces -R * g on the coordinates, shape (n_times, n), if these are known.
    """
    acting = motion.acting
    if motion.push is not None:
        return motion.push + acting.push
    load = acting.load if remembered is None else acting.load - remembered
    panels = motion.panels if remembered is None else None
    given = {"u": motion.u, "rate": motion.rate, "load": load}
    flags = {} if remembered is None else {"is_remembered": True}
    if panels is not None:
        given |= panels.given | {"times": motion.t}
    found = _native.run_either(
        panels is not None, "motion accelerations", motion.system,
        **flags, **{name: np.asfortranarray(value) for name, value in given.items()},
    )  # fmt: skip
    if found["singular"]:
        raise InputError("mass: is singular, so the equations of motion give no accelerations")
    return np.asarray(found["accelerations"] + acting.push)
