"""Mount forces of a body in a periodic motion: deflections, forces, lost power."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.bodies.mount_point import MountPoint
from viscovib.bodies.springs import MountSprings
from viscovib.bodies.turning import further_moved
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Panel, Result, as_dataset, span
from viscovib.kernels.relaxation import Kernel
from viscovib.systems.laws import Law

#: Local axes of a mount.
_AXES = ("x", "y", "z")
#: Samples per harmonic and smallest number of samples, for laws that are not polynomials.
_FINE, _FINEST = 32, 512


@dataclass(frozen=True, eq=False, repr=False)
class MountForces(Result):
    """Deflections, forces and moments of mounts in local axes, as Fourier coefficients.

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies (rad/s).
    harmonics : ndarray, shape (n_harmonics,)
        Harmonics k.
    names : tuple of str
        Names of the mounts.
    deflection : ndarray, shape (n, n_mounts, 3, n_harmonics)
        d = Im sum_k D_k exp(i k nu t) (m).
    force : ndarray, shape (n, n_mounts, 3, n_harmonics)
        Force of each mount opposite to its deflection (N), including the track of a fluid mount,
        for the harmonics kept.
    rotation : ndarray, shape (n, n_mounts, 3, n_harmonics)
        Rotation of the body about the local axes (rad).
    moment : ndarray, shape (n, n_mounts, 3, n_harmonics)
        Moment of each mount opposite to its rotation (N m), by its ``rotational_stiffness``;
        without the moment of ``force`` about other points.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    >>> r = vv.forced_response(body, [1e-3], load=body.load((0, 0, 10)), method="linear")
    >>> body.mount_forces(r).amplitude("foot").round(6).tolist()  # slowly: the load itself
    [[0.0, 0.0, 10.0]]
    """

    nu: FloatArray
    harmonics: FloatArray
    names: tuple[str, ...]
    deflection: ComplexArray
    force: ComplexArray
    rotation: ComplexArray
    moment: ComplexArray

    kind = "mount forces"

    def _headline(self) -> str:
        ends = span(self.nu, "rad/s")
        nu = things(self.nu.size, "frequency", "frequencies")
        return f"forces of {things(len(self.names), 'mount')} at {nu}, {ends}"

    def panels(self) -> list[Panel]:
        """Return the amplitudes of each mount's force in the direction of its largest component."""
        found = []
        for name in self.names:
            sizes = self.amplitude(name)
            axis = int(np.nanargmax(np.nanmax(sizes, axis=0)))
            found.append(
                Panel(self.nu, sizes[:, axis], "frequency (rad/s)", f"{name} {_AXES[axis]}", "N", 1)
            )
        return found

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        over = ("nu", "mount", "axis", "harmonic")
        return as_dataset(
            {
                "deflection": (over, self.deflection, {"units": "m"}),
                "force": (over, self.force, {"units": "N"}),
                "rotation": (over, self.rotation, {"units": "rad"}),
                "moment": (over, self.moment, {"units": "N m"}),
                "lost_power": (over[:3], self.lost_power, {"units": "W"}),
                "lost_in_turning": (over[:3], self.lost_in_turning, {"units": "W"}),
            },
            coords={
                "nu": ("nu", self.nu, {"units": "rad/s"}),
                "mount": list(self.names),
                "axis": list(_AXES),
                "harmonic": self.harmonics,
            },
        )

    @property
    def lost_power(self) -> FloatArray:
        """Mean power lost in each direction of each mount (W), shape (n, n_mounts, 3).

        The loss by rotational stiffness is not included.
        """
        return self._mean_power(self.force, self.deflection)

    @property
    def lost_in_turning(self) -> FloatArray:
        """Mean power lost about each axis of each mount (W), shape (n, n_mounts, 3).

        It is the loss by the memory of the rotational stiffness.
        """
        return self._mean_power(self.moment, self.rotation)

    def _mean_power(self, force: ComplexArray, moved: ComplexArray) -> FloatArray:
        rate = 1j * self.nu[:, None, None, None] * self.harmonics * moved
        return np.asarray(0.5 * (force * rate.conj()).real.sum(axis=-1))

    def amplitude(self, name: str, harmonic: int = 1) -> FloatArray:
        """Force amplitudes of one mount along its local axes (N), shape (n, 3)."""
        place = np.flatnonzero(self.harmonics == _native.number("harmonic", harmonic))
        force = self.force[:, self.names.index(_native.choice("name", name, self.names))]
        return np.asarray(np.abs(force[..., place].sum(axis=-1)))


def mount_forces(
    mounts: Sequence[MountPoint],
    springs: MountSprings,
    result: Any,
    relative: ComplexArray,
    *,
    turns: bool = False,
) -> MountForces:
    """Return f_k = [1 - R(k nu)] [k d + g(d)]_k + i k nu c d_k of every spring.

    g(d) has enough samples to avoid aliasing of polynomials in the harmonics kept. A linear
    response does not include it. ``turns``: rotations are finite.
    """
    nu = np.asarray(result.nu, dtype=float)
    orders = np.asarray(result.harmonics)
    deflection = np.einsum("jd,ndk->njk", springs.rows, relative)
    if turns and getattr(result, "method", "newton") != "linear":
        for j, row in enumerate(springs.rows):
            if row[:3].any():
                further = further_moved(orders, relative[:, 3:6], springs.arms[j])
                deflection[:, j] += np.einsum("a,nak->nk", row[:3], further)
    elastic = springs.stiffness[:, None] * deflection
    for j, law in enumerate(springs.laws):
        if law and getattr(result, "method", "newton") != "linear":
            elastic[:, j] += _of_law(law, nu, orders, deflection[:, j])
    force = elastic.copy()
    for kernel in {kernel for kernel in springs.kernels if kernel is not None}:
        retained = _retained(kernel, nu, orders)
        these = [j for j, one in enumerate(springs.kernels) if one is kernel]
        force[:, these] = retained[:, None, :] * elastic[:, these]
    at = 1j * nu[:, None, None] * orders
    force += at * springs.damping[:, None] * deflection
    places = np.array(springs.first)[:, None] + np.arange(3)
    d, f = deflection[:, places], force[:, places]
    # The track of a mount comes after its other springs.
    ends = [*springs.first[1:], len(springs.laws)]
    for i, (mount, end) in enumerate(zip(mounts, ends, strict=True)):
        if mount.track is not None:
            f[:, i, mount.track.axis] += force[:, end - 1]
    turned = np.array([mount.rotation.T for mount in mounts])
    rotation = np.einsum("iad,ndk->niak", turned, relative[:, 3:6])
    moment = np.zeros_like(f)
    for i, (mount, begin) in enumerate(zip(mounts, springs.first, strict=True)):
        # Springs of rotations come after the three directions; some rotations have no spring.
        held = np.flatnonzero(np.asarray(mount.rotational_stiffness))
        moment[:, i, held] = force[:, begin + 3 : begin + 3 + held.size]
    names = tuple(mount.name for mount in mounts)
    return MountForces(nu, orders, names, d, f, rotation, moment)


def _retained(kernel: Kernel, nu: FloatArray, orders: FloatArray) -> ComplexArray:
    """Return 1 - R(k nu), shape (n, n_harmonics)."""
    at = nu[:, None] * orders
    kept = np.ones(at.shape, dtype=complex)
    usable = np.isfinite(at)
    if not np.isfinite(kernel.integral):
        usable &= at != 0
    kept[usable] = 1 - np.asarray(kernel.transform(at[usable]))
    return kept


def _of_law(
    law: dict[int, float] | Law, nu: FloatArray, orders: FloatArray, d: ComplexArray
) -> ComplexArray:
    """Return the harmonics kept of a law of d = Im sum_k D_k exp(i k nu t) and its rate."""
    highest = int(orders.max())
    if isinstance(law, Law):
        samples = max(_FINE * highest, _FINEST)
    else:
        samples = (max(law) + 1) * highest + 2
    theta = 2 * np.pi * np.arange(samples) / samples
    waves = np.exp(1j * np.outer(orders, theta))
    motion = (d @ waves).imag
    if isinstance(law, Law):
        rate = ((1j * nu[:, None] * orders * d) @ waves).imag
        both = np.stack([motion.ravel(), rate.ravel()], axis=1)
        force: Any = law(both[:, : len(law.arguments)])[0].reshape(motion.shape)
    else:
        force = sum(c * motion**power for power, c in law.items())
    weights = np.where(orders == 0, 1j, 2j) / samples
    return np.asarray((force @ waves.conj().T) * weights)
