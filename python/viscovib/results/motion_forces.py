"""Forces of mounts and elements along a motion in time, and motions of points of a body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Panel, Result, as_dataset, span

#: Local axes of a mount.
_AXES = ("x", "y", "z")


def integrated(t: FloatArray, power: FloatArray) -> FloatArray:
    """The integral of a power from the first time on, by a spline through its values."""
    columns = np.asfortranarray(power.reshape(t.size, math.prod(power.shape[1:])))
    found = _native.run("motion work", t=t, power=columns)["work"]
    return np.asarray(found.reshape(power.shape))


@dataclass(frozen=True, eq=False, repr=False)
class _ForcesInTime(Result):
    """Deflections and forces of elements or mounts along a motion in time."""

    t: FloatArray
    names: tuple[str, ...]
    deflection: FloatArray
    rate: FloatArray
    elastic: FloatArray
    damping: FloatArray
    memory: FloatArray

    @cached_property
    def force(self) -> FloatArray:
        """Force opposite to the deflection, in the shape of ``deflection``."""
        return self.elastic + self.damping + self.memory

    @cached_property
    def work(self) -> FloatArray:
        """Work done on each element or mount since the first time, in the shape of ``deflection``.

        It is the integral of force times rate, by a spline through the states kept. Work that an
        element stores returns; the work of a closed loop is its loss. The work of rotational
        stiffness of mounts is not included.
        """
        return integrated(self.t, self.force * self.rate)

    @cached_property
    def dissipated(self) -> FloatArray:
        """Energy dissipated by linear dampers since the first time, as ``work``."""
        return integrated(self.t, self.damping * self.rate)

    def of(self, name: str) -> FloatArray:
        """Force of one element, shape (n,), or of one mount along its local axes, (n, 3)."""
        return self.force[:, self.names.index(_native.choice("name", name, self.names))]


@dataclass(frozen=True, eq=False, repr=False)
class ElementForces(_ForcesInTime):
    """Deflections and forces of elements along a motion in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times (s).
    names : tuple of str
        Names of the elements.
    deflection, rate : ndarray, shape (n, m)
        Deflection d of each element relative to the base, and d'.
    elastic : ndarray, shape (n, m)
        Force of springs and laws without memory, k d + g(d, d').
    damping : ndarray, shape (n, m)
        Force c d' of linear dampers.
    memory : ndarray, shape (n, m)
        -R * (k d + g): reduction of the elastic force by relaxation.

    Examples
    --------
    >>> import viscovib as vv
    >>> spring = vv.Spring(on={"x1": 1, "x2": -1}, stiffness=3.0, damping=0.1)
    >>> pair = vv.Structure(mass=[[1, 0], [0, 1]], stiffness=[[2, 0], [0, 2]], elements=[spring])
    >>> run = vv.simulate(pair, 5, initial=[1, 0, 0, 0])
    >>> forces = run.element_forces()
    >>> forces.names, round(float(forces.force[0, 0]), 9)
    (('x1 - x2',), 3.0)
    """

    units: tuple[str, ...] = ()

    kind = "element forces"

    def _headline(self) -> str:
        return f"forces of {things(len(self.names), 'element')}, t: {span(self.t, 's')}"

    def panels(self) -> list[Panel]:
        """Return the force of each element over time."""
        units = self.units or ("",) * len(self.names)
        return [
            Panel(self.t, column, "$t$ (s)", name, unit)
            for name, unit, column in zip(self.names, units, self.force.T, strict=True)
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        parts = ("deflection", "rate", "elastic", "damping", "memory", "force")
        return as_dataset(
            {part: (("t", "element"), getattr(self, part)) for part in parts},
            coords={"t": ("t", self.t, {"units": "s"}), "element": list(self.names)},
        )


@dataclass(frozen=True, eq=False, repr=False)
class SupportReactions(Result):
    """Forces that hold or move the supports of a structure in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times (s).
    names : tuple of str
        Names of the supports.
    force : ndarray, shape (n, n_supports)
        Force on the structure at each support (N; a moment at a rotation).

    Examples
    --------
    >>> import viscovib as vv
    >>> bar = vv.Structure(
    ...     mass=[1.0, 0.0], stiffness=[[4.0, -4.0], [-4.0, 4.0]], supports=["x2"]
    ... )
    >>> run = vv.simulate(bar, 1, initial=[0.5, 0])
    >>> float(run.support_reactions().force[0, 0])
    -2.0
    """

    t: FloatArray
    names: tuple[str, ...]
    force: FloatArray
    units: tuple[str, ...]

    kind = "support reactions"

    def of(self, name: str) -> FloatArray:
        """Force at one support, shape (n,)."""
        return self.force[:, self.names.index(_native.choice("name", name, self.names))]

    def _headline(self) -> str:
        return f"forces at {things(len(self.names), 'support')}, t: {span(self.t, 's')}"

    def panels(self) -> list[Panel]:
        """Return the force at each support over time."""
        return [
            Panel(self.t, column, "$t$ (s)", f"reaction at {name}", unit)
            for name, unit, column in zip(self.names, self.units, self.force.T, strict=True)
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        return as_dataset(
            {"force": (("t", "support"), self.force)},
            coords={"t": ("t", self.t, {"units": "s"}), "support": list(self.names)},
        )


@dataclass(frozen=True, eq=False, repr=False)
class MountForcesInTime(_ForcesInTime):
    """Deflections, forces and moments of mounts in local axes along a motion in time.

    The quantities are those of `MountForces`, of the vibration without the static part.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times (s).
    names : tuple of str
        Names of the mounts.
    deflection : ndarray, shape (n, n_mounts, 3)
        Deflection relative to the base (m).
    rate : ndarray, shape (n, n_mounts, 3)
        Its rate (m/s).
    elastic, damping, memory : ndarray, shape (n, n_mounts, 3)
        Parts of the force (N): k d + g(d, d'), c d' and -R * (k d + g). The track of a fluid mount
        is part of ``elastic``.
    moment : ndarray, shape (n, n_mounts, 3)
        Moment of each mount opposite to the rotation of the body, by its ``rotational_stiffness``
        and its memory (N m).
    point, axes : ndarray, shape (n, n_mounts, 3) and (n_mounts, 3, 3)
        Where each force acts (m), and the local axes (columns), in the axes of the positions.

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(
    ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5), damping=(10, 10, 20),
    ...     rotational_stiffness=(1e3, 1e3, 1e3),
    ... )
    >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
    >>> forces = run.mount_forces()
    >>> forces.of("foot")[0].round(6).tolist()
    [0.0, 0.0, 200.0]
    """

    moment: FloatArray
    point: FloatArray
    axes: FloatArray
    #: Force and moment about the origin on the floor, shape (n, 6).
    _floor: FloatArray

    kind = "mount forces in time"

    def _headline(self) -> str:
        return f"forces of {things(len(self.names), 'mount')}, t: {span(self.t, 's')}"

    def panels(self) -> list[Panel]:
        """Return the force of each mount in the direction of its largest component."""
        found = []
        for i, name in enumerate(self.names):
            force = self.force[:, i]
            axis = int(np.argmax(np.abs(force).max(axis=0, initial=0.0)))
            found.append(Panel(self.t, force[:, axis], "$t$ (s)", f"{name} {_AXES[axis]}", "N"))
        return found

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        over = ("t", "mount", "axis")
        units = {
            "deflection": "m", "rate": "m/s", "elastic": "N", "damping": "N", "memory": "N",
            "force": "N", "moment": "N m",
        }  # fmt: skip
        return as_dataset(
            {name: (over, getattr(self, name), {"units": unit}) for name, unit in units.items()},
            coords={
                "t": ("t", self.t, {"units": "s"}),
                "mount": list(self.names),
                "axis": list(_AXES),
            },
        )


@dataclass(frozen=True, eq=False, repr=False)
class PointMotion(Result):
    """The motion of a point of a body in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times (s).
    displacement, velocity, acceleration : ndarray, shape (n, 3)
        Along the axes of the positions (m, m/s, m/s^2).

    Examples
    --------
    >>> import viscovib as vv
    >>> foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5))
    >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
    >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
    >>> run.motion_of((0.1, 0, 0)).acceleration[0].round(6).tolist()
    [0.0, 0.0, -40.0]
    """

    t: FloatArray
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    kind = "motion of a point"

    def _headline(self) -> str:
        return f"displacement, velocity and acceleration of a point, t: {span(self.t, 's')}"

    def panels(self) -> list[Panel]:
        """Return the accelerations over time."""
        return [
            Panel(self.t, column, "$t$ (s)", f"acceleration {axis}", "m/s^2")
            for axis, column in zip(_AXES, self.acceleration.T, strict=True)
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        units = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s^2"}
        return as_dataset(
            {n: (("t", "axis"), getattr(self, n), {"units": unit}) for n, unit in units.items()},
            coords={"t": ("t", self.t, {"units": "s"}), "axis": list(_AXES)},
        )


@dataclass(frozen=True, eq=False, repr=False)
class FloorForce(Result):
    """Resultant of all mounts of a body on the floor in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times (s).
    force : ndarray, shape (n, 3)
        Force on the floor along the axes of the positions (N), without the weight.
    moment : ndarray, shape (n, 3)
        Moment on the floor about ``about`` (N m).
    about : ndarray, shape (3,)
        The point (m).

    Examples
    --------
    >>> import viscovib as vv
    >>> spring = vv.MountPoint(name="a", position=(0, 0, 0), stiffness=(1e4, 1e4, 2e4))
    >>> body = vv.Body(mass=10, inertia=(0.3, 0.2, 0.4), mounts=[spring])
    >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
    >>> round(float(run.floor_force().force[0, 2]), 6)
    20.0
    """

    t: FloatArray
    force: FloatArray
    moment: FloatArray
    about: FloatArray

    kind = "floor force"

    def _headline(self) -> str:
        point = ", ".join(f"{x:g}" for x in self.about)
        return f"force and moment on the floor about ({point}) m, t: {span(self.t, 's')}"

    def panels(self) -> list[Panel]:
        """Return forces and moments over time."""
        return [
            Panel(self.t, column, "$t$ (s)", f"{what} {axis}", unit)
            for what, unit, columns in (("force", "N", self.force), ("moment", "N m", self.moment))
            for axis, column in zip(_AXES, columns.T, strict=True)
        ]

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset."""
        return as_dataset(
            {
                "force": (("t", "axis"), self.force, {"units": "N"}),
                "moment": (("t", "axis"), self.moment, {"units": "N m"}),
            },
            coords={"t": ("t", self.t, {"units": "s"}), "axis": list(_AXES)},
        )
