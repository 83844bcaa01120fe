"""The springs of the mounts of a body as rows: deflections, stiffness and laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import comb, factorial, prod

import numpy as np
import numpy.typing as npt

from viscovib._native import FloatArray
from viscovib.bodies.mount_point import MountPoint, crossing
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.condensed import Condensation
from viscovib.systems.element_laws import element_laws
from viscovib.systems.elements import ElementTerms
from viscovib.systems.laws import Law
from viscovib.systems.spring_groups import Monomial, Springs
from viscovib.systems.structure_rest import dense_rest


@dataclass(frozen=True)
class MountSprings:
    """All springs of all mounts, one row each: d_j = rows[j] . u."""

    #: Shape (n_springs, n_dof).
    rows: FloatArray
    #: Points of action relative to the mass centre (m), shape (n_springs, 3); 0 for rotations.
    arms: FloatArray
    #: k_j and c_j, shape (n_springs,).
    stiffness: FloatArray
    damping: FloatArray
    kernels: tuple[Kernel | None, ...]
    #: Coefficients of d^2, d^3, ... by power, or a compiled law.
    laws: tuple[dict[int, float] | Law, ...]
    #: Index of the first of the three directions of each mount.
    first: tuple[int, ...]
    #: Mass and damping of the coordinates of tracks, shape (n_dof, n_dof).
    mass_of_tracks: FloatArray
    damping_of_tracks: FloatArray
    #: Force of each spring at zero coordinates (N, N m), shape (n_springs,).
    preload: FloatArray

    @property
    def mount_of(self) -> npt.NDArray[np.intp]:
        """Index of the mount of each spring, from 1."""
        return np.searchsorted(self.first, np.arange(len(self.laws)), side="right")

    @property
    def damping_matrix(self) -> FloatArray:
        """C, shape (n_dof, n_dof)."""
        return np.asarray((self.rows.T * self.damping) @ self.rows + self.damping_of_tracks)

    def about(self, deflections: FloatArray) -> MountSprings:
        """Return the springs about deflected positions, with k d + g(d) expanded there."""
        stiffness = self.stiffness.copy()
        laws: list[dict[int, float] | Law] = []
        for j, (law, at) in enumerate(zip(self.laws, deflections.tolist(), strict=True)):
            if isinstance(law, Law):
                laws.append(law.about("d", at))
                continue
            series: dict[int, float] = {}
            for power, c in law.items():
                for p in range(1, power + 1):
                    series[p] = series.get(p, 0.0) + comb(power, p) * c * at ** (power - p)
            stiffness[j] += series.pop(1, 0.0)
            laws.append({p: c for p, c in series.items() if c})
        return replace(self, stiffness=stiffness, laws=tuple(laws))


def mount_springs(mounts: Sequence[MountPoint], center: FloatArray) -> MountSprings:
    """Return rows for each mount: three directions, springs of rotations, and the track."""
    n = 6 + sum(mount.track is not None for mount in mounts)
    rows: list[FloatArray] = []
    arms: list[FloatArray] = []
    stiffness: list[float] = []
    damping: list[float] = []
    kernels: list[Kernel | None] = []
    laws: list[dict[int, float] | Law] = []
    first: list[int] = []
    mass_of_tracks, damping_of_tracks = np.zeros((n, n)), np.zeros((n, n))
    own = 6
    for mount in mounts:
        turned = mount.rotation.T
        local = turned @ np.hstack([np.eye(3), -crossing(np.asarray(mount.position) - center)])
        first.append(len(rows))
        arm = np.asarray(mount.position) - center
        for j in range(3):
            arms.append(arm)
            rows.append(np.concatenate([local[j], np.zeros(n - 6)]))
            stiffness.append(float(mount._elastic[j]))
            damping.append(float(np.asarray(mount.damping)[j]))
            kernels.append(mount.kernels[j])
            laws.append(mount.laws[j])
        for j, k in enumerate(np.asarray(mount.rotational_stiffness)):
            if k:
                arms.append(np.zeros(3))
                rows.append(np.concatenate([np.zeros(3), turned[j], np.zeros(n - 6)]))
                stiffness.append(float(k))
                damping.append(0.0)
                kernels.append(mount.kernels[j])
                laws.append({})
        if mount.track is not None:
            row = np.concatenate([local[mount.track.axis], np.zeros(n - 6)])
            row[own] = -1.0
            rows.append(row)
            arms.append(arm)
            stiffness.append(mount.track.stiffness)
            damping.append(0.0)
            kernels.append(None)
            laws.append({})
            mass_of_tracks[own, own] = mount.track.mass
            damping_of_tracks[own, own] = mount.track.damping
            own += 1
    return MountSprings(
        np.array(rows).reshape(-1, n), np.array(arms).reshape(-1, 3), np.array(stiffness),
        np.array(damping), tuple(kernels), tuple(laws), tuple(first), mass_of_tracks,
        damping_of_tracks, np.zeros(len(rows)),
    )  # fmt: skip


def spring_groups(
    springs: MountSprings, preload: FloatArray, names: Sequence[str]
) -> list[Springs]:
    """Return springs by kernel; the first group has no memory and includes the preload."""
    kernels: list[Kernel | None] = [None]
    for kernel in springs.kernels:
        if kernel not in kernels:
            kernels.append(kernel)
    groups = []
    for kernel in kernels:
        these = [j for j, one in enumerate(springs.kernels) if one is kernel or one == kernel]
        rows, k = springs.rows[these], springs.stiffness[these]
        matrix = (rows.T * k) @ rows + (preload if kernel is None else 0.0)
        terms: dict[tuple[int, tuple[int, ...]], float] = {}
        others = []
        for j in these:
            law = springs.laws[j]
            if isinstance(law, Law):
                others += [
                    Springs(forces=texts, kernel=kernel)
                    for texts in _in_coordinates(law, springs.rows[j], names)
                ]
                continue
            for power, c in law.items():
                _add_power(terms, springs.rows[j], power, c)
        forces = [
            Monomial(coefficient=c, powers=powers, on=on) for (on, powers), c in terms.items()
        ]
        groups += [Springs(stiffness=matrix, forces=forces or None, kernel=kernel), *others]
    return groups


def condensed_springs(
    springs: MountSprings, mass: FloatArray, damping: FloatArray, stiffness: FloatArray
) -> Condensation | None:
    """Condense a body to the deflections of its mounts; None: not condensed.

    Deflections with laws come first: stability uses only these (`viscovib_condensed_waves`), which
    is faster than all coordinates if they are few.
    """
    elements = []
    for row, k, law, kernel in zip(
        springs.rows, springs.stiffness.tolist(), springs.laws, springs.kernels, strict=True
    ):
        slope = float(law.slopes_at_rest[0]) if isinstance(law, Law) else 0.0
        powers = {1: k + slope} | ({} if isinstance(law, Law) else law)
        remembers = kernel is not None
        rest = law.remainder(remembers=remembers) if isinstance(law, Law) else None
        elements.append(ElementTerms(row, powers, 0.0, kernel, rest))
    bent = [e.direction for e in elements if e.law is not None or max(e.powers) > 1]
    if not bent or 2 * np.linalg.matrix_rank(np.array(bent)) > mass.shape[0]:
        return None
    try:
        rest_of_all = dense_rest(mass, damping, stiffness, quiet=True)
    except InputError:
        # Defective modes: the compliance is not a sum over modes.
        return None
    return Condensation(rest_of_all, element_laws(elements, mass.shape[0]))


def _in_coordinates(law: Law, row: FloatArray, names: Sequence[str]) -> list[dict[str, str]]:
    """Return e g(e . u) as texts by equation."""
    weights = {name: float(w) for name, w in zip(names, row, strict=True) if w}
    deflection = " + ".join(f"({w!r})*{name}" for name, w in weights.items())
    rate = " + ".join(f"({w!r})*{name}_dot" for name, w in weights.items())
    text = law.with_arguments({"d": deflection, "v": rate})
    return [{name: f"({w!r})*({text})" for name, w in weights.items()}]


def _add_power(
    terms: dict[tuple[int, tuple[int, ...]], float], row: FloatArray, power: int, c: float
) -> None:
    """Add e c (e . u)^power, expanded in products of the coordinates."""
    places = np.flatnonzero(row)
    for chosen in combinations_with_replacement(places.tolist(), power):
        powers = tuple(chosen.count(i) for i in range(row.size))
        ways = factorial(power) // prod(map(factorial, powers))
        value = c * ways * prod(float(row[i]) for i in chosen)
        for on in places.tolist():
            key = (on, powers)
            terms[key] = terms.get(key, 0.0) + value * float(row[on])
