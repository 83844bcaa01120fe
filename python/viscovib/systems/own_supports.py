"""Supports of a structure that move each on its own.

Their displacements y_s act on the free coordinates, which are absolute, by the forces
-M_fs y_s'' - C_fs y_s' - K_fs y_s. The linear elements between both are part of C_fs and K_fs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.systems.elements import CouplingTerms
from viscovib.systems.load import LoadLike, VaryingForce, load_series
from viscovib.systems.load_table import LoadTable
from viscovib.systems.piecewise import values_at
from viscovib.systems.structure_matrices import is_sparse
from viscovib.systems.supports import Supports, block, pulled


@dataclass(frozen=True)
class SupportMotion(Value):
    """Displacements of supports in time: sinusoids (n_held, m), and polynomials of some supports.

    ``tables``: of each the index of the support, the times and the polynomials (n_powers, k).
    """

    frequencies: FloatArray
    amplitudes: ComplexArray
    tables: tuple[tuple[int, FloatArray, FloatArray], ...]

    def at(self, t: FloatArray) -> tuple[FloatArray, ...]:
        """Displacements, velocities and accelerations at times, each of shape (n_times, n_held)."""
        w = self.frequencies
        waves = np.exp(1j * np.outer(t, w))
        found = tuple((waves @ (f * self.amplitudes).T).imag for f in (1.0, 1j * w, -(w**2)))
        for j, times, pieces in self.tables:
            for part, own in zip(found, values_at(times, pieces[np.newaxis], t), strict=True):
                part[:, j] += own[:, 0]
        return found


def moves_apart(system: Any, base: Any) -> bool:
    """True if a base motion is given by the names of supports."""
    supports: Supports | None = getattr(system, "_held", None)
    if supports is None or not isinstance(base, Mapping) or not base:
        return False
    if not all(isinstance(name, str) for name in base):
        return False
    for name in base:
        _native.choice("base", name, supports.names)
    return True


def on_own_supports(
    system: Any, base: Any, load: Any, nu: Any, force: LoadTable | None, end: float
) -> tuple[LoadLike | None, LoadTable | None, SupportMotion]:
    """Return the loads in time with those of supports, and the motion of the supports."""
    supports: Supports = system._held
    n = supports.held.size
    waves: dict[int, ComplexArray] = {}
    tables = []
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    for name, part in base.items():
        j = supports.names.index(name)
        alone = _alone(system, name)
        if isinstance(part, LoadTable):
            tables.append((j, np.asarray(part.times), part._base_pieces()[:, 0]))
        else:
            for order, value in _harmonics(name, part).items():
                waves.setdefault(order, np.zeros(n, dtype=complex))[j] = value
        load, force = pulled(alone, system.dof_names, end, load, frequency, part, force)
    orders = np.array(list(waves), dtype=float)
    amplitudes = np.array(list(waves.values()), dtype=complex).reshape(-1, n).T
    return load, force, SupportMotion(orders * frequency, amplitudes, tuple(tables))


def harmonics_apart(
    system: Any, base: Any
) -> tuple[dict[int, ComplexArray], dict[int, ComplexArray], list[VaryingForce]]:
    """Motions of supports by order (n_held,), and their forces on the free coordinates.

    These are constant, or multiplied by a formula in the frequency.
    """
    supports: Supports = system._held
    motions: dict[int, ComplexArray] = {}
    forces: dict[int, ComplexArray] = {}
    varying = []
    for name, given in base.items():
        alone = _alone(system, name)
        for order, value in _harmonics(name, given).items():
            moved = motions.setdefault(order, np.zeros(supports.held.size, dtype=complex))
            moved[supports.names.index(name)] = value
            forces.setdefault(order, np.zeros(alone.place.size, dtype=complex))
            forces[order] -= value * alone.place
            for formula, part in (
                ("nu", -1j * order * alone.rate),
                ("nu^2", order**2 * alone.mass),
            ):
                if part.any():
                    varying.append(VaryingForce(formula, order, np.asarray(value * part)))
    return motions, forces, varying


def with_forces(
    orders: npt.NDArray[np.int32], series: ComplexArray, forces: Mapping[int, ComplexArray]
) -> tuple[npt.NDArray[np.int32], ComplexArray]:
    """Return the orders and coefficients of `load_series` with forces by order, shape (n,)."""
    if not forces:
        return orders, series
    both = sorted({*orders.tolist(), *forces})
    found = np.zeros((series.shape[0], len(both)), dtype=complex, order="F")
    found[:, np.searchsorted(both, orders)] = series
    for order, force in forces.items():
        found[:-1, both.index(order)] += force
    return np.array(both, dtype=np.int32), found


def _harmonics(name: str, part: Any) -> dict[int, complex]:
    """Amplitudes of a support by harmonic order."""
    if part is None or isinstance(part, (str, bytes, LoadTable)):
        raise InputError(
            f"base[{name!r}] = {_native.shown(part)}: must be a number or {{order: number}}; in "
            "time also a LoadTable"
        )
    orders, series = load_series(None, part, 0)
    return dict(zip(orders.tolist(), series[0].tolist(), strict=True))


def _alone(system: Any, name: str) -> Supports:
    """The supports of which one moves, with its columns of M, C and K."""
    supports: Supports = system._held
    if system._turns_supports:
        raise InputError(
            f"base[{name!r}]: supports must not move if gyroscopic, circulatory or centrifugal act "
            "on them"
        )
    j = supports.names.index(name)
    where = supports.held[j : j + 1]
    mass, rate, place = (
        np.array(one.toarray() if is_sparse(one) else one, dtype=float)[:, 0]
        for one in (block(matrix, supports.free, where) for matrix in supports.matrices)
    )
    if supports.layered:
        raise InputError(f"base[{name!r}]: a layer with memory acts on a support")
    for i, (terms, ends) in enumerate(zip(system._terms_in_order, supports.ends, strict=True)):
        if not ends[:, j].any():
            continue
        if isinstance(terms, CouplingTerms) or terms.active or terms.series is not None:
            raise InputError(
                f"base[{name!r}]: elements[{i}] is not a linear spring or damper and acts on this "
                "support: give all supports one motion by base_direction"
            )
        place += terms.powers.get(1, 0.0) * ends[0, j] * terms.direction
        rate += terms.damping * ends[0, j] * terms.direction
    motion = np.zeros(len(supports.all_names))
    motion[where] = 1.0
    return replace(supports, motion=motion, mass=mass, rate=rate, place=place)
