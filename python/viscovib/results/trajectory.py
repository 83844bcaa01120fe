"""A motion in time, by any integrator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.bodies.checks import checked_vector
from viscovib.common.counts import things
from viscovib.common.parameters import Flag
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset, named, span
from viscovib.common.tables import Table, listed_units
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.results.located_peaks import LocatedPeak, Quantity, find_peaks
from viscovib.results.motion_forces import (
    ElementForces,
    FloorForce,
    MountForcesInTime,
    PointMotion,
    SupportReactions,
    integrated,
)
from viscovib.systems.base_acceleration import BaseMotion
from viscovib.systems.law_ends import edges_text, law_end as end_of_law
from viscovib.systems.law_poles import (
    Layer,
    law_pole,
    layer_between,
    pole_between,
    pole_text,
)
from viscovib.systems.mount import Mount
from viscovib.systems.own_supports import SupportMotion
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem

OUTCOMES = ("completed", "diverged", "unphysical", "stopped", "step too large", "event")

#: Relative rounding error of the spacing of states.
_UNEVEN = 1e-9
#: Largest number of events in a summary.
_LISTED = 6
#: Relative rounding error of times beyond the end of a run.
_ROUNDING = 1e-14


def spacing(t: FloatArray) -> float:
    """Return the spacing of times; NaN if they are not equidistant or fewer than two."""
    if t.size < 2:
        return math.nan
    step = float(t[-1] - t[0]) / (t.size - 1)
    off = float(np.abs(t - (t[0] + step * np.arange(t.size))).max())
    return math.nan if off > _UNEVEN * max(step, abs(float(t[-1])) * 1e-6) else step


@dataclass(frozen=True, eq=False, repr=False)
class LocatedEvents(Value):
    """Times and states of an event.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times.
    state : ndarray, shape (n, 2 n_dof)
        States.
    error : ndarray, shape (n,), or None
        Estimated errors of the times; None if `Trajectory.error` is not estimated. NaN if a run
        with a different step size does not have this event and the errors of the states do not
        explain it. Near grazing the error grows as the square root of that of the states.
    state_error : ndarray, shape (n,), or None
        Estimated errors of the states: the largest error of a coordinate or velocity.

    Examples
    --------
    >>> import viscovib as vv
    >>> swing = vv.PolynomialSystem(mass=1, stiffness=1)
    >>> run = vv.simulate(swing, 20, initial=[0, 1], events=["x - 0.5"])
    >>> found = run.events[0]
    >>> bool(found.error.max() < 1e-11)
    True
    >>> times, states = found
    """

    t: FloatArray
    state: FloatArray
    error: FloatArray | None = None
    state_error: FloatArray | None = None

    def __iter__(self) -> Iterator[FloatArray]:
        """Iterate over times and states."""
        return iter((self.t, self.state))

    def note(self) -> str:
        """Return the number of events and their errors in one line."""
        text = things(self.t.size, "occurrence")
        if self.error is None or self.state_error is None:
            return f"{text}, errors not estimated" if self.t.size else text
        known = ~np.isnan(self.error)
        if known.any():
            late, off = self.error[known].max(), self.state_error[known].max()
            text = f"{text}, estimated errors up to {late:.1e} of times and {off:.1e} of states"
        if not known.all():
            unknown = things(int((~known).sum()), "occurrence")
            text = (
                f"{text}; the error of {unknown} is unknown, because the run with another step "
                "size does not have it"
            )
        return text


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Result):
    """A motion in time.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the states kept.
    state : ndarray, shape (n, 2 n_dof)
        Each coordinate and its velocity: (z, z', phi, phi', psi, psi') for a pendulum, (x, x', phi,
        phi') for a mount.
    outcome : str
        "completed"; "diverged": the motion escapes to infinity, exceeds the range of numbers or the
        domain of a force law (see `reason`), or an angle of a pendulum exceeds 1e6; "unphysical":
        the spring of a pendulum reaches its pivot, z = -1; "step too large": the motion continues,
        but a smaller step size is needed; "event": a terminal event ended the run. The states
        before the end are kept.
    t_reached : float
        Final time. If a motion diverges or becomes unphysical, this time is located inside the step
        to rounding error. ``keep="last"`` keeps the state at this time.
    step : float
        Step size of the integrator. The states kept have the spacing ``dt``.
    method : str
        Integrator.
    error : float or None
        Estimated largest error of the states kept and of ``t_reached``. None if a step size was
        given without ``estimate_error=True``, or for a resumed run with a given step size. It does
        not refer to the final state of an escape.
    resolution : float or None
        For motions with memory: the last Legendre coefficient of a displacement in a step, the
        largest of all steps, relative to the largest displacement. If it is 1e-2 or more, the step
        size is too large.
    stats : dict
        "steps"; for a pendulum "evaluations" (of all lanes), for systems with memory "iterations".
    system : Pendulum, Mount or PolynomialSystem
    events : tuple of LocatedEvents
        For each event the times ``t``, shape (m,), and states ``state``, shape (m, 2 n_dof), with
        estimated errors ``error`` and ``state_error``, shape (m,), if the run has an error
        estimate.

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> run = vv.simulate(mount, 20, load=0.1, nu=1.5)
    >>> x = run.coordinate("x")
    >>> run.outcome
    'completed'
    """

    t: FloatArray
    state: FloatArray
    outcome: str
    t_reached: float
    step: float
    method: str
    error: float | None
    stats: dict[str, int]
    system: Pendulum | Mount | PolynomialSystem
    _resume: Any = field(repr=False)
    _planned: Callable[..., Plan] = field(repr=False)
    resolution: float | None = None
    events: tuple[LocatedEvents, ...] = ()
    _floor: BaseMotion | None = field(default=None, repr=False)
    _supports: SupportMotion | None = field(default=None, repr=False)

    #: Whether its table contains accelerations.
    _accelerates = False
    kind = "transient"
    _form = "trajectory"

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """States at any times of the run, shape (2 n_dof,) or (n, 2 n_dof).

        Without memory a partial step of the method leads to each time, so the states have the order
        of the method. With memory the polynomial of the step is used (degree: nodes + 1), for a
        `Structure` that of its element forces (degree: nodes - 1). With few nodes such states are
        less accurate than the states at ends of steps, to which ``error`` refers. The steps are
        computed again: without memory from the last state kept before the first time, else from
        the start of the run.

        Parameters
        ----------
        t : float or array_like, shape (n,)
            From 0 to ``t_reached``.

        Examples
        --------
        >>> import viscovib as vv
        >>> system = vv.PolynomialSystem(mass=1, stiffness=1)
        >>> run = vv.simulate(system, 10, dt=0.5, initial=[0, 1])
        >>> float(run(1.23)[0].round(12))
        0.942488801932
        """
        times = _native.real_array("t", t)
        if times.ndim > 1:
            raise InputError(f"t: must be a number or have shape (n,), got {times.shape}")
        # The last step may end a rounding error before the requested time.
        ends = (times > self.t_reached) & (times <= self.t_reached * (1 + _ROUNDING))
        wanted, back = np.unique(np.where(ends, self.t_reached, times), return_inverse=True)
        if wanted.size and not (wanted[0] >= 0 and wanted[-1] <= self.t_reached):
            outside = wanted[0] if wanted[0] < 0 else wanted[-1]
            raise InputError(f"t = {outside:g}: must be in [0, {self.t_reached:g}], the run")
        width = self.state.shape[1]
        if not wanted.size:
            return np.empty((0, width))
        states = self._resume.states_at(wanted, self)[:, :width]
        return np.asarray(states[back.reshape(times.shape)])

    @property
    def dt(self) -> float:
        """Spacing of the states kept; NaN if they are not equidistant or fewer than two.

        The step size of the integrator is ``step``.
        """
        return spacing(self.t)

    @property
    def relative_to_base(self) -> bool:
        """True if the states are relative to the base, whose acceleration was given."""
        return self._floor is not None

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if the motion was followed to the end."""
        return self.outcome in ("completed", "event")

    @cached_property
    def reason(self) -> str | None:
        """Reason, location and time of an early end in one sentence; None for a complete run.

        If a force law has no value, such as a logarithm, the text contains the law and its
        argument.

        Examples
        --------
        >>> import viscovib as vv
        >>> system = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.3*log(1 + x)")
        >>> vv.simulate(system, 20, initial=[1.5, 0]).reason
        "the law '0.3*log(1 + x)' has no value beyond x = -1, reached at t = 2.11777"
        """
        when = f"at t = {self.t_reached:.6g}"
        if self.complete:
            return None
        if self.outcome == "stopped":
            return f"it was stopped {when}"
        if self.outcome == "unphysical":
            return f"the spring reaches its pivot (z = -1) {when}"
        ended = self._law_end
        pole = self._pole_passed() or self._pole_after(self.t.size - 1) if ended is None else None
        if pole is not None:
            return pole
        if ended is None and self.outcome == "step too large":
            layer = self._layer_passed(slice(-3, None)) if self.t.size else None
            note = "" if layer is None else f": {layer}"
            return (
                f"the motion continues, but the step size {self.step:.6g} does not resolve "
                f"it {when}{note}"
            )
        if ended is None:
            return f"the motion runs away {when}{edges_text(self.system)}"
        text, reads = ended
        where = ", ".join(f"{name} = {value:.6g}" for name, value in reads.items())
        if self.t_reached <= 1e-12 * self.step:
            return f"the law '{text}' has no value at the start, {where}"
        if self.outcome == "step too large":
            when = f"within a step of {self.step:.6g} after t = {self.t_reached:.6g}"
            return f"the law '{text}' has no value beyond {where}, reached {when}"
        return f"the law '{text}' has no value beyond {where}, reached {when}"

    @property
    def _law_end(self) -> tuple[str, dict[str, float]] | None:
        """The law whose domain the motion leaves, and its arguments at the edge; None: no edge."""
        state = None if self._resume is None else self._resume.state
        if state is None or not isinstance(self.system, PolynomialSystem):
            return None
        n = len(self.system.dof_names)
        # The state is the final state, which is located to rounding error.
        return end_of_law(self.system, (state[: 2 * n : 2], state[1 : 2 * n : 2]), 1e-6 * self.step)

    def _pole_after(self, row: int) -> str | None:
        """Sentence about a pole of a force law that the motion reaches after a kept state."""
        if not (0 <= row < self.t.size and self.system._all_laws):
            return None
        # Near a pole the force changes the motion: search beyond the next state.
        until = self.t[row + 1] if row + 1 < self.t.size else self.t_reached
        reach = float(max(until - self.t[row], 0.0)) + self.step
        rows = slice(max(row - 1, 0), row + 2)
        found = law_pole(self.system, self._read_by_laws(rows), self.t[rows], 2 * reach)
        return None if found is None else pole_text(*found)

    def _pole_passed(self) -> str | None:
        """Sentence about the first pole between two kept states."""
        if self.t.size < 2 or not self.system._all_laws:
            return None
        at = self._read_by_laws(slice(None))
        found = pole_between(self.system, at, self.t, self.step)
        return None if found is None else pole_text(*found)

    def _layer_passed(self, rows: slice = slice(None)) -> str | None:
        """Sentence about the largest change of a law between kept states."""
        found = self._layer(rows)
        return None if found is None else found.note()

    def _layer(self, rows: slice = slice(None)) -> Layer | None:
        """The layer of the largest change of a law between kept states."""
        t = self.t[rows]
        if t.size < 2 or not self.system._all_laws:
            return None
        return layer_between(self.system, self._read_by_laws(rows), t)

    def _read_by_laws(self, rows: slice) -> tuple[FloatArray, FloatArray]:
        """Arguments of laws at the kept states, and their rates."""
        return self.state[rows, ::2], self.state[rows, 1::2]

    def _headline(self) -> str:
        return f"{self.outcome} at t = {self.t_reached:g}, {things(self.t.size, 'state')}"

    def _scope(self) -> list[str]:
        return [
            f"t: {span(self.t, self.system.time_unit)}; "
            f"{named(self.dof_names, self.dof_units)}; {self.method}",
            *self._details(),
        ]

    def _details(self) -> list[str]:
        note = [] if self.reason is None else [self.reason]
        if self.relative_to_base:
            note.append("coordinates are relative to the base, whose acceleration is given")
        sure = "error not estimated" if self.error is None else f"estimated error {self.error:.1e}"
        return [*note, f"step {self.step:.6g}, {sure}", *self._event_lines()]

    def _event_lines(self) -> list[str]:
        """One line for each event function."""
        watch = None if self._resume is None else self._resume.watch
        texts = [] if watch is None else [event.function for event in watch.events]
        if len(texts) != len(self.events):
            texts = [""] * len(self.events)
        shown = self.events[:_LISTED]
        return [
            f"events[{i}] {text}: {one.note()}".replace(" :", ":")
            for i, (text, one) in enumerate(zip(texts, shown, strict=False))
        ]

    def numbers(self) -> dict[str, Number]:
        """Return ``max_x`` and ``rms_x``, ... over the second half, and ``outcome``."""
        late = self.t >= 0.5 * self.t_reached
        found: dict[str, Number] = {}
        columns = self.state[late, ::2].T
        for name, unit, column in zip(self.dof_names, self.dof_units, columns, strict=True):
            largest = float(np.abs(column).max()) if column.size else math.nan
            found[f"max_{name}"] = Number(largest, unit)
            found[f"rms_{name}"] = Number(_rms(self.t[late], column), unit)
        return found | {"outcome": Number(self.outcome)}

    def panels(self) -> list[Panel]:
        """Return the coordinates over time."""
        label = "$t$ (s)" if self.system.time_unit == "s" else r"$\tau$"
        return [
            Panel(self.t, self.state[:, 2 * d], label, name, unit)
            for d, (name, unit) in enumerate(zip(self.dof_names, self.dof_units, strict=True))
        ]

    def _pieces(self) -> tuple[int, str, str]:
        n = self.stats["steps"]
        return n, things(n, "step"), f"step of {self.method}"

    @cached_property
    def plan(self) -> Plan:
        """What was computed, and what was skipped and why."""
        return self._planned()

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return self.system.dof_names

    @property
    def dof_units(self) -> tuple[str, ...]:
        """Units of the coordinates."""
        return self.system.dof_units

    @property
    def rate_units(self) -> tuple[str, ...]:
        """Units of the velocities."""
        if self.dof_units == self.system.dof_units:
            return self.system.rate_units
        return tuple(f"{unit}/s" for unit in self.dof_units)

    @property
    def acceleration_units(self) -> tuple[str, ...]:
        """Units of their accelerations."""
        if self.system.time_unit != "s":
            return tuple(f"{unit}^2" for unit in self.rate_units)
        return tuple(f"{unit}/s^2" for unit in self.dof_units)

    @cached_property
    def _known(self) -> Any:
        """What acts along the motion; not part of pickles."""
        found = self._resume.along(self)
        if self._supports is not None:
            found = replace(found, supports=self._supports.at(self.t))
        return found

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_known"}

    @cached_property
    def acceleration(self) -> FloatArray:
        """Accelerations of the states kept, shape (n, n_dof), in `acceleration_units`.

        They follow from the equations of motion, not from differences, and are as exact as the
        states. They are absolute, also with a moving base or a ``base_acceleration``. At a jump of
        the load or the base they are those after it. With memory, the run is computed once more, at
        the points of its steps.

        Raises
        ------
        InputError
            For structures of more than 512 coordinates, reduced ones, and those with coordinates
            without mass.

        Examples
        --------
        >>> import viscovib as vv
        >>> system = vv.PolynomialSystem(mass=2, stiffness=8)
        >>> run = vv.simulate(system, 10, dt=0.1, initial=[1, 0])
        >>> float(run.acceleration[0, 0])
        -4.0
        """
        found = np.asarray(self._equations("acceleration").accelerations(self))
        if self._floor is not None:
            names = self.system.dof_names
            places = [names.index(name) for name in self.dof_names]
            found = found + self._floor.push(self.t)[:, places]
        found.setflags(write=False)
        return found

    def mount_forces(self) -> MountForcesInTime:
        """Return deflections, forces and moments of the mounts of a body along the motion.

        They are those of `Body.mount_forces`, in time: along the local axes of each mount, without
        the static part, with their elastic, damping and memory parts. With memory, the run is
        computed once more, at the points of its steps.

        Raises
        ------
        InputError
            For systems other than a `Body`.

        Examples
        --------
        >>> import viscovib as vv
        >>> foot = vv.MountPoint(
        ...     name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5),
        ...     rotational_stiffness=(1e3, 1e3, 1e3),
        ... )
        >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
        >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
        >>> run.mount_forces().force.shape == (run.t.size, 1, 3)
        True
        """
        return self._mount_forces

    @cached_property
    def _mount_forces(self) -> MountForcesInTime:
        found: MountForcesInTime = self._equations("mount_forces").mount_forces(self)
        return found

    def element_forces(self) -> ElementForces:
        """Return deflections and forces of elements and springs along the motion.

        Of a `Structure` these are its elements (without `Coupling`), with the forces of friction
        and hysteresis as the run has them. Of a `PolynomialSystem` they are the forces of each
        group of springs on each coordinate; the damping matrix acts with the first group. Of a
        `Mount` they are the springs of x and phi, without the damping matrix.

        Raises
        ------
        InputError
            For a `Body` (see `mount_forces`) and a `Pendulum`.

        Examples
        --------
        >>> import viscovib as vv
        >>> system = vv.PolynomialSystem(mass=1, stiffness=4, damping=0.1)
        >>> run = vv.simulate(system, 5, dt=0.1, initial=[1, 0])
        >>> float(run.element_forces().force[0, 0])
        4.0
        """
        found: ElementForces = self._equations("element_forces").element_forces(self)
        return found

    def support_reactions(self) -> SupportReactions:
        """Return the forces that hold or move the supports of a `Structure` along the motion.

        R = M_s u'' + C_s u' + K_s u + forces of elements; modal damping, Rayleigh damping and the
        loss factor do not act on supports. With memory, the run is computed once more, at the
        points of its steps.

        Raises
        ------
        InputError
            For systems without supports, and as for `acceleration`; if a `Coupling` or a layer with
            memory acts on a support.

        Examples
        --------
        >>> import viscovib as vv
        >>> bar = vv.Structure(
        ...     mass=[1.0, 0.0], stiffness=[[4.0, -4.0], [-4.0, 4.0]], supports=["x2"]
        ... )
        >>> run = vv.simulate(bar, 1, initial=[0.5, 0])
        >>> round(float(run.support_reactions().of("x2")[-1]), 9)  # -2 cos 2
        0.832293673
        """
        found: SupportReactions = self._equations("support_reactions").support_reactions(self)
        return found

    def motion_of(self, point: str | npt.ArrayLike, *, relative: bool = False) -> PointMotion:
        """Return displacement, velocity and acceleration of a point of a body.

        Parameters
        ----------
        point : str or array_like, shape (3,)
            The name of a mount, or a point (m) in the axes of the mounts' positions.
        relative : bool
            Relative to the floor at this point, instead of absolute.

        Returns
        -------
        PointMotion
            Arrays of shape (n, 3), along the axes of the positions.

        Examples
        --------
        >>> import viscovib as vv
        >>> foot = vv.MountPoint(name="foot", position=(0, 0, 0), stiffness=(1e5, 1e5, 2e5))
        >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
        >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
        >>> run.motion_of("foot").velocity.shape == (run.t.size, 3)
        True
        """
        body = self._body("motion_of")
        Flag("relative").check(relative)
        if isinstance(point, str):
            names = tuple(mount.name for mount in body.mounts)
            _native.choice("point", point, names)
            point = np.asarray(body.mounts[names.index(point)].position)
        arm = body._arm("point", point)
        moved = [self.state[:, ::2], self.state[:, 1::2], self.acceleration]
        floor = None if self._floor is None else self._floor.at(self.t)
        if floor is not None:
            moved[:2] = [one + base for one, base in zip(moved[:2], floor[:2], strict=True)]
        u, rate, push = (np.asfortranarray(one) for one in moved)
        found = _native.run(
            "motion at point", arm=arm, exact=body._turns, u=u, rate=rate, push=push
        )["moved"].transpose(2, 0, 1)
        if relative:
            floor = floor or self._equations("motion_of").floor(self)
            found = tuple(
                one - (base[:, :3] + np.cross(base[:, 3:6], arm))
                for one, base in zip(found, floor, strict=True)
            )
        return PointMotion(self.t, *found)

    def floor_force(self, about: npt.ArrayLike = (0.0, 0.0, 0.0)) -> FloorForce:
        """Return the resultant force and moment of all mounts of a body on the floor.

        Parameters
        ----------
        about : array_like, shape (3,)
            Point about which the moment is taken (m), in the axes of the mounts' positions.

        Returns
        -------
        FloorForce
            Arrays of shape (n, 3), without the static part.

        Examples
        --------
        >>> import viscovib as vv
        >>> foot = vv.MountPoint(name="foot", position=(0.1, 0, 0), stiffness=(1e5, 1e5, 2e5))
        >>> body = vv.Body(mass=5, inertia=(0.1, 0.2, 0.3), mounts=[foot])
        >>> run = vv.simulate(body, 0.1, initial=[0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 0, 0, 0])
        >>> on_floor = run.floor_force()
        >>> on_floor.force[0].round(6).tolist(), on_floor.moment[0].round(6).tolist()
        ([0.0, 0.0, 200.0], [0.0, -20.0, 0.0])
        """
        self._body("floor_force")
        return self._floor_about(checked_vector("about", about))

    @cached_property
    def _floor_force(self) -> FloorForce:
        return self._floor_about(np.zeros(3))

    def _floor_about(self, point: FloatArray) -> FloorForce:
        force, moment = np.hsplit(self._mount_forces._floor, 2)
        return FloorForce(self.t, force, moment - np.cross(point, force), point)

    @overload
    def peak(self, quantity: Quantity) -> LocatedPeak: ...

    @overload
    def peak(self, quantity: list[Quantity]) -> list[LocatedPeak]: ...

    def peak(self, quantity: Quantity | list[Quantity]) -> LocatedPeak | list[LocatedPeak]:
        """Return the largest magnitude of a quantity, located between the states kept.

        The polynomial through 13 values near each of the largest gives the peak, and a polynomial
        through fewer values its error. If the error exceeds 1e-9 of the peak, the motion is
        computed at more points there. Peaks narrower than the spacing of the states are not seen.

        Parameters
        ----------
        quantity : str, function, or list of these
            "x", "x_dot", "x_ddot": a coordinate, its velocity and its acceleration; of a `Body`
            also "foot.z": a mount's force along a local axis, and "floor.z": the force on the
            floor. A function takes a `Trajectory` and returns an array of shape (n,), such as
            ``lambda run: run.motion_of(point).acceleration[:, 2]``.

        Returns
        -------
        LocatedPeak or list of LocatedPeak
            Value with its sign, time and estimated error. A list is computed in one pass.

        Examples
        --------
        >>> import viscovib as vv
        >>> system = vv.PolynomialSystem(mass=2, stiffness=8)
        >>> run = vv.simulate(system, 4, dt=0.2, initial=[0, 1])
        >>> [round(one.value, 9) for one in run.peak(["x", "x_ddot"])]
        [0.5, -2.0]
        """
        if isinstance(quantity, list):
            return find_peaks(self, quantity)
        return find_peaks(self, [quantity])[0]

    def _body(self, name: str) -> Any:
        if not hasattr(self.system, "mounts"):
            kind = type(self.system).__name__
            raise InputError(f"{name}: is for motions of a Body, this is one of a {kind}")
        return self.system

    def _equations(self, name: str) -> Any:
        if self._resume is None:
            raise InputError(f"{name}: this motion does not contain its equations")
        return self._resume

    def coordinate(self, name: str) -> FloatArray:
        """Return a coordinate by name, "phi", or its velocity, "phi_dot", shape (n,)."""
        names = tuple(f"{d}{dot}" for d in self.dof_names for dot in ("", "_dot"))
        return self.state[:, names.index(_native.choice("name", name, names))]

    def energy_defect(self) -> FloatArray:
        """Return the change of energy minus the work done since the first state, shape (n,).

        The work is that of the loads minus dissipation, from a spline through the power at the
        states kept. The defect shows the error of the motion if the states are close enough for the
        spline. It refers to the exact equations; `cubic` and `printed` equations do not satisfy
        this balance. Available for pendulums and for polynomial systems without memory whose forces
        have a potential.
        """
        power = getattr(self._resume, "power", None)
        if power is None:
            raise InputError(
                "trajectory: the balance of energy is for pendulums only, and for polynomial "
                "systems without memory"
            )
        system: Any = self.system
        energy = system.energy(self.state)
        if self.t.size < 4:
            raise InputError(f"trajectory: {self.t.size} states kept, must be at least 4")
        return np.asarray(energy - energy[0] - integrated(self.t, power(self.t, self.state)))

    def _base_frequencies(self) -> dict[str, float] | None:
        body: Any = self.system
        if not body._has_own_loads:
            return None
        loads = {"p1": (body.f0, body.p1), "p2": (body.m01, body.p2), "p3": (body.m02, body.p3)}
        return {name: p for name, (size, p) in loads.items() if size and p} or None

    def to_dataset(self, *, physical: bool = False) -> Dataset:
        """Return coordinates and velocities as an xarray Dataset over t.

        With ``physical=True`` units are s, m and rad: always for a mount, for a pendulum if it was
        created from physical units. z is then the extension beyond the static one.
        """
        Flag("physical").check(physical)
        time, length = 1.0, 1.0
        system = self.system
        time_unit, units, rates = system.time_unit, self.dof_units, self.rate_units
        if physical and isinstance(system, Pendulum):
            if system.scales is None:
                raise InputError(
                    "physical = True: this pendulum was not built by Pendulum.from_physical"
                )
            time, length = system.scales.time, system.scales.length
            time_unit, units, rates = "s", ("m", "rad", "rad"), ("m/s", "rad/s", "rad/s")
        variables = {}
        for d, name in enumerate(self.dof_names):
            size = length if d == 0 else 1.0
            at, dot = self.state[:, 2 * d] * size, self.state[:, 2 * d + 1] * (size / time)
            variables[name] = ("t", at, {"units": units[d]})
            variables[f"{name}_dot"] = ("t", dot, {"units": rates[d]})
        attributes = {
            "outcome": self.outcome,
            "step": self.step * time,
            "method": self.method,
            "plan": str(self.plan),
        }
        if self.error is not None:
            attributes["error"] = self.error
        if self.relative_to_base:
            attributes["relative_to"] = "base"
        coordinates = {"t": ("t", self.t * time, {"units": time_unit})}
        return as_dataset(variables, coords=coordinates, attrs=attributes)

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        sure = "" if self.error is None else f", estimated error {self.error:.16e}"
        table = Table(
            [f"method {self.method}, step {self.step:.16e}, {self.outcome}{sure}"], {"t": self.t}
        )
        wanted = wanted_places(coordinates, self.dof_names)
        names = [self.dof_names[d] for d in wanted]
        units = listed_units(names, [self.dof_units[d] for d in wanted])
        what = "units" if self.system.time_unit == "s" else "dimensionless"
        table.notes.append(f"{what}: t in {self.system.time_unit}, {units}")
        for d in wanted:
            table.columns[self.dof_names[d]] = self.state[:, 2 * d]
            table.columns[f"{self.dof_names[d]}_dot"] = self.state[:, 2 * d + 1]
            if self._accelerates:
                table.columns[f"{self.dof_names[d]}_ddot"] = self.acceleration[:, d]
        return table


def _rms(t: FloatArray, values: FloatArray) -> float:
    """Root mean square over time for any spacing of the states; NaN without states."""
    if t.size < 2:
        return float(np.abs(values[0])) if t.size else math.nan
    return math.sqrt(np.trapezoid(values**2, t) / (t[-1] - t[0]))
