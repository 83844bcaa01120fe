"""Basins of attraction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.ensemble import simulate_ensemble
from viscovib.analyses.transient import Acting, runs_of
from viscovib.common.counts import things
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.errors import InputError
from viscovib.systems.load import LoadLike
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.system import System, turned
from viscovib.systems.whole import in_all_coordinates

#: Label of motions that have not settled.
UNSETTLED = -1
_MOST_RUNS = 10_000_000
#: Largest number of coordinates.
_MOST_COORDINATES = 64
#: Largest number of coordinates for the full equations of a structure; a long time.
_FEW, _LONG = 6, 1e4
#: Number of motions for step size and scale; their tolerance for the step size.
_PROBES, _PROBED = 16, 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Basins(Result):
    """The attractor of each start of a grid.

    Attributes
    ----------
    labels : ndarray of int, shape (n_y, n_x)
        Index in ``attractors``; -1: not settled (slow, creeping, chaotic, a longer period, or a
        motion that does not attract, such as a saddle); -2: the run did not reach its end (it
        diverged).
    attractors : tuple of ndarray, shape (period, 2 n_dof)
        States of each attractor, one per period of the load, those with more starts first; without
        a load the equilibrium.
    share : ndarray, shape (n_attractors,)
        Fraction of the starts that settle on each attractor.
    rest : ndarray, shape (n_attractors,)
        Certainty of an attractor: the largest remaining fraction of a small perturbation after a
        second run of the same length (below 0.5, except with dry friction).
    moved : ndarray, shape (n_y, n_x)
        Certainty of a label: the change of a motion in its last period (or in the final part of the
        run), relative to the scale of ``tolerance``; NaN if the run did not reach its end.
    names : tuple of str
        Quantities that vary along x and y.
    x, y : ndarray
        The starts.
    tolerance : float
        Distance of states that count as equal.
    system : Pendulum, PolynomialSystem, Structure or Mount

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> wells = vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3")
    >>> grid = np.linspace(-1.5, 1.5, 8)
    >>> found = vv.basins(wells, {"x": grid, "x_dot": grid}, t_end=200.0)
    >>> sorted(found.attractors[i][0, 0].round(6).item() for i in range(2))
    [-1.0, 1.0]
    """

    labels: npt.NDArray[np.intp]
    attractors: tuple[FloatArray, ...]
    share: FloatArray
    rest: FloatArray
    moved: FloatArray
    names: tuple[str, str]
    x: FloatArray
    y: FloatArray
    tolerance: float
    system: Pendulum | PolynomialSystem | Structure | Mount

    kind = "basins"

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if every start settles on one of the attractors."""
        return bool((self.labels >= 0).all())

    def _headline(self) -> str:
        settled = int((self.labels >= 0).sum())
        found = things(len(self.attractors), "attractor")
        return f"{found}, {settled} of {things(self.labels.size, 'start')} settle"

    def _scope(self) -> list[str]:
        periods = ", ".join(
            f"period {a.shape[0]}: {100 * share:.3g} %"
            for a, share in zip(self.attractors, self.share, strict=True)
        )
        parts = [f"{self.names[0]} {span(self.x)}", f"{self.names[1]} {span(self.y)}", periods]
        return ["; ".join(part for part in parts if part)]

    def to_dataset(self) -> Dataset:
        """Return the labels over both starts."""
        x, y = self.names
        data: dict[str, Any] = {"label": ((y, x), self.labels), "moved": ((y, x), self.moved)}
        for i, states in enumerate(self.attractors):
            data[f"attractor{i}"] = ((f"period{i}", "quantity"), states)
        return as_dataset(data, coords={x: self.x, y: self.y})


def basins(
    system: Pendulum | PolynomialSystem | Structure | Mount,
    starts: Mapping[str, npt.ArrayLike],
    *,
    n_periods: int | None = None,
    t_end: float | None = None,
    load: LoadLike | None = None,
    nu: float | None = None,
    others: npt.ArrayLike | None = None,
    sections: int = 1,
    max_period: int = 8,
    tolerance: float = 1e-4,
    dt: float | str = "auto",
    n_threads: int | None = None,
    progress: bool = False,
) -> Basins:
    """Find the attractors of motions from a grid of starts.

    Under a load the states after each period are compared: a motion has settled on period p if its
    state repeats after p periods. Without a load the state must be constant.

    Parameters
    ----------
    system : Pendulum, PolynomialSystem, Structure or Mount
        As for `simulate_ensemble`.
    starts : mapping of two names to array_like
        {"x": values, "x_dot": values}: coordinates or velocities and their initial values, x and y.
        A start is the state at t = 0 with no history: kernels are not relaxed, and sliders follow
        their first loading from the undeformed position to the start.
    n_periods : int
        Length of the runs in periods of the load, more than twice ``max_period``.
    t_end : float
        Length in time for a system without a load, such as a pendulum without f0, m01 and m02.
    load, nu
        For a polynomial system: as for `simulate`.
    others : array_like, shape (2 n_dof,), optional
        Initial values of all remaining quantities; None: 0.
    sections : {1, 2, 3}
        For a pendulum: the load whose period is used.
    max_period : int
        The longest period that is searched.
    tolerance : float
        Distance of states that count as equal, relative to the largest value of each coordinate in
        the starts, in some whole motions and at the ends; for velocities times the highest
        frequency.
    dt : float or "auto"
        Step size. "auto": some of the motions are accurate to 1e-6 over three periods. Motions that
        settle forget the errors of their steps.
    n_threads, progress
        As for `simulate_ensemble`.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.05, forces="x^3")
    >>> grid = np.linspace(-3, 3, 6)
    >>> found = vv.basins(
    ...     duffing, {"x": grid, "x_dot": grid}, load=0.3, nu=1.4, n_periods=150
    ... )
    >>> len(found.attractors)
    2
    """
    _native.check_instance("system", system, Pendulum, PolynomialSystem, Structure, Mount)
    if len(system.dof_names) > _MOST_COORDINATES:
        raise InputError(
            f"system: has {len(system.dof_names)} coordinates, must have at most "
            f"{_MOST_COORDINATES}"
        )
    system = turned(system, nu)
    names, x, y, states = _grid(system, starts, others)
    near = _native.number("tolerance", tolerance)
    if not 0 < near < 1:
        raise InputError(f"tolerance = {near:g}: must be between 0 and 1")
    most = _native.integer("max_period", max_period, 1, 1000)
    loaded = load is not None
    if system._has_own_loads:
        # A pendulum without a load settles too; a load whose values include 0 keeps its periods.
        loads = (getattr(system, name) for name in ("f0", "m01", "m02"))
        loaded = n_periods is not None or any(loads)
    call: dict[str, Any] = {"n_threads": n_threads, "progress": progress}
    if not system._has_own_loads:
        call |= {"load": load, "nu": nu}
    call["dt"] = _step(system, states, call) if _native.is_auto(dt) else dt
    if t_end is not None and _native.is_auto(dt):
        call["dt"] = min(call["dt"], _native.number("t_end", t_end))
    length: dict[str, Any]
    stays = np.ones(len(states), dtype=bool)
    if loaded:
        if t_end is not None or n_periods is None:
            raise InputError("n_periods: must be given under a load, instead of t_end")
        count = _native.integer("n_periods", n_periods, 2 * most + 1, 10**9)
        length = {"n_periods": count, "sections": sections, "discard": count - 1}
        run = simulate_ensemble(
            system, initial=states, n_periods=count, sections=sections,
            discard=count - 2 * most, **call,
        )  # fmt: skip
        assert run.sections is not None
        points = run.sections
    else:
        if n_periods is not None or t_end is None:
            raise InputError("t_end: must be given without a load, instead of n_periods")
        end = _native.number("t_end", t_end)
        length = {"t_end": end}
        run = simulate_ensemble(system, initial=states, t_end=end, **call)
        if _remembers(system):
            # The state does not contain the memory: run again from the start.
            more = simulate_ensemble(system, initial=states, t_end=1.1 * end, **call)
        else:
            # A tenth of a short run may be less than a step.
            finer = {"dt": min(float(run.step[0]), 0.1 * end)}
            more = simulate_ensemble(system, initial=run.state, t_end=0.1 * end, **(call | finer))
        points, most = np.stack([run.state, more.state], axis=1), 1
        # A motion that diverges within this time has no final state.
        stays = more.outcome == "completed"
    ended = stays & (run.outcome == "completed")
    largest = _largest(system, states, call | {"t_end": float(run.t_end[0])})
    fastest = _fastest(system, call)
    # All starts are compared with all attractors, which takes long if there are many.
    given = {"largest": largest, "points": np.transpose(points, (2, 1, 0)), "ended": ended}
    given |= {"most": most, "near": near, "fastest": fastest}
    found = _native.apart(lambda: _native.run("ensemble orbits", **given))
    names_found = "scale", "labels", "shown", "periods", "moved"
    scale, labels, shown, periods, moved = (found[name] for name in names_found)
    attractors = tuple(np.array(points[i, -periods[i] :]) for i in shown)
    begun = states[shown] if _remembers(system) else None
    if begun is not None and attractors and not system._all_kernels:
        stop = _come_to_rest(system, begun, points[shown], attractors, scale, call | length)
        labels, attractors = _only(stop, labels, attractors)
        begun = begun[stop]
    good, rest = _stable(system, attractors, near, scale, call | length, begun)
    labels, attractors = _only(good, labels, attractors)
    share = np.array([(labels == i).mean() for i in range(len(attractors))])
    shape = (y.size, x.size)
    return Basins(
        labels.reshape(shape).astype(np.intp), attractors, share, rest[good], moved.reshape(shape),
        names, x, y, near, system,
    )  # fmt: skip


def _largest(system: Any, states: FloatArray, call: Mapping[str, Any]) -> FloatArray:
    """Largest value of each state component in all starts, and in motions from some of them.

    A component that is 0 at the start and the end may be large in between.
    """
    run = simulate_ensemble(system, initial=_some(states), statistics=True, **call)
    assert run.peak is not None
    # Runs that did not reach their end have NaN peaks.
    return np.asarray(np.fmax(np.abs(states).max(axis=0), np.fmax.reduce(run.peak, axis=0)))


def _remembers(system: System) -> bool:
    """True if coordinates and velocities are not the whole state: kernels or hysteresis."""
    return bool(system._all_kernels) or any(law.state for law in system._all_laws)


def _fastest(system: Any, call: Mapping[str, Any]) -> float:
    """Frequency of the fastest linear motion or of a load."""
    nu = call.get("nu")
    small = len(system.dof_names) <= _FEW and not _remembers(system)
    few = in_all_coordinates(system, always=small)
    if not isinstance(few, Structure | Mount):
        own: float = few._fastest()
    else:
        # The initial step size corresponds to two steps per period, to four without memory.
        start = np.zeros(2 * len(system.dof_names))
        make, steps, _ = runs_of(system, _LONG, start, "auto", Acting(), None, False)
        run: Any = make(1.0)
        own = (1.0 if run.by_nodes else 0.5) * np.pi * steps / _LONG
    return max(own, 0.0 if nu is None else _native.number("nu", nu))


def _stable(
    system: Pendulum | PolynomialSystem | Structure | Mount,
    orbits: tuple[FloatArray, ...],
    near: float,
    scale: FloatArray,
    call: Mapping[str, Any],
    starts: FloatArray | None,
) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Mask of attracting periodic motions, and the remaining part of a perturbation of each.

    The core (``fortran/transient/basin_rules.f90``) decides by a second run of the same length. If
    a state includes memory, a start that settles on the orbit is perturbed instead (``starts``, one
    for each orbit).
    """
    if not orbits:
        return np.zeros(0, dtype=bool), np.zeros(0)
    found = _native.run("ensemble disturbances", near=near, width=scale.size)
    pushes = found["pushes"].T * scale
    places = [orbit[-1] for orbit in orbits] if starts is None else list(starts)
    run = simulate_ensemble(
        system, initial=np.concatenate([place + pushes for place in places]), **call
    )
    ends = run.state.reshape(len(orbits), *pushes.shape)
    ended = (run.outcome == "completed").reshape(ends.shape[:2])
    by_starts, kernels = starts is not None, starts is not None and bool(system._all_kernels)
    assessed = [
        _native.run(
            "ensemble judgement",
            ends=one.T,
            ended=its,
            orbit=orbit.T,
            scale=scale,
            near=near,
            of_starts=by_starts,
            has_kernels=kernels,
        )
        for one, its, orbit in zip(ends, ended, orbits, strict=True)
    ]
    good = np.array([bool(one["attracts"]) for one in assessed])
    return good, np.array([one["rest"] for one in assessed])


def _come_to_rest(
    system: Any,
    starts: FloatArray,
    points: FloatArray,
    orbits: tuple[FloatArray, ...],
    scale: FloatArray,
    call: Mapping[str, Any],
) -> npt.NDArray[np.bool_]:
    """Mask of motions, one of each orbit, that come to rest in a run twice as long."""
    longer = dict(call)
    if "t_end" in call:
        ends = []
        for end in (2.0, 2.1):
            longer["t_end"] = end * call["t_end"]
            ends.append(simulate_ensemble(system, initial=starts, **longer).state)
        later = np.stack(ends, axis=1)
    else:
        count = 2 * call["n_periods"]
        longer |= {"n_periods": count, "discard": count - points.shape[1]}
        found = simulate_ensemble(system, initial=starts, **longer).sections
        assert found is not None
        later = found
    comes = [
        _native.run("ensemble rest", points=one.T, later=other.T, period=len(orbit), scale=scale)[
            "comes"
        ]
        for one, other, orbit in zip(points, later, orbits, strict=True)
    ]
    return np.array(comes, dtype=bool)


def _only(
    good: npt.NDArray[np.bool_], labels: npt.NDArray[np.intp], orbits: tuple[FloatArray, ...]
) -> tuple[npt.NDArray[np.intp], tuple[FloatArray, ...]]:
    """Keep some orbits; motions on dropped orbits are labelled as not settled."""
    place = np.where(good, np.cumsum(good) - 1, UNSETTLED)
    if good.size:
        labels = np.where(labels >= 0, place[np.maximum(labels, 0)], labels)
    return labels, tuple(orbit for orbit, keep in zip(orbits, good, strict=True) if keep)


def _step(system: Any, states: FloatArray, call: Mapping[str, Any]) -> float:
    """Step size for some motions over three periods of the fastest linear motion."""
    fastest = _fastest(system, call)
    if not fastest > 0:
        raise InputError('dt = "auto": the system has no linear period, must be a number')
    probe = simulate_ensemble(
        system, initial=_some(states), t_end=3 * 2 * np.pi / fastest, rtol=_PROBED, **call
    )
    return float(probe.step[0])


def _some(states: FloatArray) -> FloatArray:
    """A representative subset of the starts."""
    return states[:: max(1, states.shape[0] // _PROBES)]


def _grid(
    system: Pendulum | PolynomialSystem | Structure | Mount,
    starts: Mapping[str, npt.ArrayLike],
    others: npt.ArrayLike | None,
) -> tuple[tuple[str, str], FloatArray, FloatArray, FloatArray]:
    """Return both names, their values, and all starts, with x varying fastest."""
    quantities = [f"{name}{dot}" for name in system.dof_names for dot in ("", "_dot")]
    given = _native.mapping("starts", starts)
    if len(given) != 2:
        raise InputError(f"starts: {len(given)} names, must be two of {', '.join(quantities)}")
    first, second = given
    for name in given:
        if name not in quantities:
            raise InputError(f"starts: {name!r} must be one of {', '.join(quantities)}")
    x, y = (_native.real_array(f"starts[{name!r}]", given[name], ndim=1) for name in given)
    if not 0 < x.size * y.size <= _MOST_RUNS:
        raise InputError(f"starts: {x.size * y.size} of them, must be 1 to {_MOST_RUNS}")
    rest = np.zeros(len(quantities))
    if others is not None:
        rest = _native.real_array("others", others)
        if rest.shape != (len(quantities),):
            raise InputError(f"others: must have shape ({len(quantities)},), got {rest.shape}")
    states = np.tile(rest, (x.size * y.size, 1))
    states[:, quantities.index(first)] = np.tile(x, y.size)
    states[:, quantities.index(second)] = np.repeat(y, x.size)
    return (first, second), x, y, states
