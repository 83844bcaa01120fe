"""Motions in time with constant step size, for every system."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.events import Event, Watch
from viscovib.analyses.memoryless import pendulum_runs
from viscovib.analyses.oscillator_motion import (
    BY_MODES,
    MOST_WHOLE,
    NODES,
    OscillatorMotion,
)
from viscovib.analyses.resume import (
    Maker,
    breaks_of,
    check_resumed,
    go_on,
    known,
    other_loads,
    with_delayed_jumps,
)
from viscovib.analyses.runs import (
    MAX_FIRST_STEPS,
    MAX_STEPS,
    ROUNDING,
    NotMetError,
    Run,
    Wanted,
)
from viscovib.analyses.shaft_motion import shaft_runs
from viscovib.analyses.step_search import by_tolerance, with_estimate
from viscovib.analyses.structure_motion import (
    StructureMotion,
    structure_motion_of,
)
from viscovib.analyses.whole_structure import whole_motion
from viscovib.common.mesh import Mesh
from viscovib.common.past import Past
from viscovib.errors import ConvergenceWarning, InputError, RangeWarning, caller
from viscovib.results.trajectory import Trajectory
from viscovib.systems.base_acceleration import BaseMotion, relative_loads
from viscovib.systems.load import LoadLike, at_frequency, base_by_order, in_components
from viscovib.systems.load_table import LoadTable, RunUp
from viscovib.systems.mount import Mount
from viscovib.systems.own_supports import SupportMotion, moves_apart, on_own_supports
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.shaft import USUAL_RTOL, DriveTorque, OnShaft, turns_shaft, with_shaft
from viscovib.systems.structure import Structure
from viscovib.systems.whole import MOST_IN_FRAME, lacks_wholeness

#: Motion of the base by its acceleration, and of supports, each or None.
_Moved = tuple[BaseMotion | None, SupportMotion | None]
#: Largest relative last coefficient of a step without a warning.
_ROUGH = 1e-2
#: Reduction of the tolerance of memory equations if no step size met the tolerance.
_SHARPER = 1e-4


def simulate(
    system: Pendulum | Mount | PolynomialSystem | Structure,
    t_end: float,
    *,
    dt: float | str = "auto",
    initial: npt.ArrayLike | None = None,
    resume: Trajectory | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    load: LoadLike | None = None,
    nu: float | None = None,
    base: LoadLike | LoadTable | None = None,
    force: LoadTable | DriveTorque | None = None,
    base_acceleration: Any = None,
    held: npt.ArrayLike | Past | None = None,
    memory: str = "auto",
    times: npt.ArrayLike | None = None,
    save_every: int = 1,
    keep: str = "all",
    tail: float | None = None,
    coordinates: Sequence[str] | None = None,
    events: Sequence[str | Event] | None = None,
    estimate_error: bool = False,
    progress: bool = False,
) -> Trajectory:
    """Integrate a motion from t = 0, or from the end of an earlier run, to t_end in equal steps.

    Parameters
    ----------
    system : Pendulum, Mount, PolynomialSystem or Structure
    t_end : float
        End time, after the start.
    dt : float or "auto"
        Step size, shortened so that a whole number of steps reaches t_end. "auto": the step size is
        halved, starting from about a quarter of the shortest linear period, until the error of the
        kept states is at most ``tolerance``, by the change in the last halving. The number of
        states kept (up to 100 000) is then large enough that no peak between them exceeds them by
        more than 1/500 of the largest displacement. Amplified rounding errors must also be within
        ``tolerance``.
    initial : array_like, shape (2 n_dof,)
        State at t = 0, each coordinate with its velocity: (x, x_dot, y, y_dot, ...), for a pendulum
        (z, z', phi, phi', psi, psi'). None: at rest, or the position ``held``. Required for a
        pendulum.
    resume : Trajectory
        Continue this run with its system, step size, method and history. Without new loads the
        result equals an uninterrupted run, bit for bit if all steps are equal (not with tables). A
        kernel that is fitted by exponentials is fitted for the first ``t_end``, so the two agree to
        the tolerance. If any of ``load``, ``base`` and ``force`` is given, these replace all
        previous loads from now on, with continuing time (``load=0``: none). A pendulum may have
        other loads. If a fitted kernel must resolve the jump, the earlier run is computed again.
    method : str
        For a pendulum: "gauss8", "gauss16", "gauss2", "gauss3": Gauss-Legendre collocation with
        this number of nodes (twice the order), symplectic; "rk4"; "dop8": Dormand and Prince, order
        8; "verner8", "verner9": Verner's efficient methods of order 8 and 9. "auto" is "gauss8",
        the fastest for one trajectory at every accuracy. For a mount: "gauss2", "gauss3", "gauss4",
        "gauss6" or "gauss8", collocation of the accelerations, with hereditary forces as
        polynomials through the nodes and both ends; "auto" is "gauss8". A polynomial system without
        memory, with at most 6 coordinates, under a ``force`` and a ``load`` with harmonics up to
        399 only, has both groups of methods. All other systems have those of a mount.
    tolerance : float
        Absolute error of the kept states, 1e-13 to 1. With ``dt="auto"`` it determines the step
        size; default: displacements within 1e-10 of the largest displacement, velocities within
        1e-10 of the largest displacement or velocity. With a given ``dt`` it is only the accuracy
        of the equations of a step and of the sums of exponentials (default: rounding error).
    rtol, atol : float
        With ``dt="auto"``, instead of ``tolerance``: the error of each coordinate and velocity is
        at most atol + rtol times its largest value in the run (rtol 1e-13 to 1; default of atol:
        0).
    load, nu, base
        Not for a pendulum: periodic load, its frequency and base motion, as for
        ``forced_response``; a constant force F is ``load={0: 1j * F}``. ``base`` may also be a
        `LoadTable` of displacements in time, or of a support by name, {"left": table, "right":
        1e-3}. States are absolute, not relative to the base. Without ``initial`` the body is at
        rest at 0.
    force : LoadTable or DriveTorque
        Not for a pendulum: any load in time, added to the periodic one. Steps end on its corners
        and ends. With a given ``dt`` the states kept are still equidistant. With a `DriveTorque`,
        and with a `RunUp` of a system whose matrices depend on the speed, the angle of
        the shaft is the additional coordinate "angle", its velocity the speed. Matrices are then
        those at the instantaneous speed. To resume such a run, pass its ``system``.
    base_acceleration : LoadTable, number or mapping
        Instead of ``base``: the acceleration of the base in m/s^2, or of a `LoadTable` or a shock
        such as `HalfSine` in its ``unit``. A number is an amplitude with the frequency ``nu``, as
        ``load``. All coordinates are then relative to the base, so the base may drift
        (`Trajectory.relative_to_base`). Where a coordinate may move with the base on its own, as
        for a `Body`, give {"z": ...}.
    held : array_like, shape (n_dof,), or Past
        For systems with memory: displacement relative to the base held for all t < 0, or any
        earlier motion; None: at rest. Without ``initial`` the body starts at this displacement
        for any position of a moving base at t = 0.
    memory : {"auto", "exponentials", "direct"}
        For kernels. "exponentials": each kernel is a sum of exponentials, with a cost that does not
        grow with time. "direct": the whole history at every step, exact for any kernel, with a cost
        that grows with the square of the time. "auto": exponentials if the kernels are or can be
        such sums, else direct.
    times : array_like, shape (n,)
        Keep the states at these ascending times instead; for a pendulum by separate steps, for a
        mount by the polynomial of the step.
    save_every : int
        Keep every n-th step.
    keep : {"all", "tail", "last"}
        "tail": states in the last ``tail`` units of time, and the state before; "last": the final
        state only.
    tail : float
        Length of the part for ``keep="tail"``.
    coordinates : sequence of str, optional
        For a structure: the coordinates kept; None: all up to 64, else those with loads and
        elements, at most 64. The deflections of the elements are kept too.
    events : sequence of str or Event, optional
        Functions of coordinates and velocities whose sign changes are located; see `Event` and
        `Trajectory.events`. Events shorter than a step are found too.
    estimate_error : bool
        With a given ``dt``: run again with half the step size from the first start, and report the
        largest difference of the kept states. If steps cross kinks of laws, also with a third of
        the step size, and the difference between both is added. If these runs do not show amplified
        rounding errors, a run with numbers changed by 1e-12 is added.
    progress : bool
        Show a progress bar.

    Warns
    -----
    ConvergenceWarning
        If the given step size does not resolve a motion with memory (``Trajectory.resolution``).
    StabilityWarning
        If a mount's kernel has an integral of 1 or more: free motion creeps away, and a run from
        rest does not settle on the steady response.

    Notes
    -----
    Phases of the loads are stored in two doubles, so long runs keep their accuracy. The state is
    summed with compensation. With memory, a first step that is not from rest without load consists
    of panels that double in length from 1e-13 of the step on, because the start is singular.

    The modes of the linear subsystem of a structure are exact in each step, under periodic loads
    and tables too. The step size only resolves the forces of its elements, which are polynomials
    through the nodes of a step. The cost of a step is the number of modes times its nodes. Its
    methods are those of a mount. With ``dt="auto"`` nonlinear structures of at most 64 coordinates
    and polynomial systems are treated alike: by modes if few of many coordinates have forces or if
    a strong damper or stiff spring would require short steps, else in all coordinates.

    If laws have kinks or internal states, steps end at their switches in structures and polynomial
    systems of at most 512 coordinates, except with ``memory="direct"``. The methods are those of a
    pendulum; more than 6 coordinates have "gauss8", "gauss2" and "gauss3", systems with memory
    "gauss8". Kernels that are not sums of exponentials are replaced by such sums, fitted for the
    step size; tables of points cannot be. If a table ends above 0 and the motion starts with a
    displacement, steps end at the times of the table.

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
    >>> longer = vv.simulate(mount, 40, resume=run)  # goes on where it ended
    """
    _check_system(system, coordinates)
    usual = tolerance is None and atol is None and dt == "auto"
    system, initial, table, rtol = _at_changing_speed(
        system, initial, force, rtol, usual, (resume, held)
    )
    if isinstance(force, DriveTorque) and (base is not None or base_acceleration is not None):
        raise InputError("base: must not move with a DriveTorque")
    if not isinstance(system, OnShaft):
        system = system._turned(_speed(nu, resume))
    end = _native.number("t_end", t_end)
    _native.flag("progress", progress)
    want = Wanted.checked(times, save_every, keep, tail)
    auto = _native.is_auto(dt)
    accuracy = Accuracy.checked(tolerance, rtol, atol, 1e-10 if auto else None)
    if not auto and (rtol is not None or atol is not None):
        raise InputError('rtol, atol: are for dt = "auto", must not be given with dt')
    estimated = _native.flag("estimate_error", estimate_error)
    given = load, nu, base, table
    load, nu, base, table, moved = _with_base(system, base_acceleration, *given, end)
    loads = Acting(load, nu, base, table, held, memory, coordinates)
    if resume is not None:
        if initial is not None:
            raise InputError("initial and resume are both given: must be one of them")
        check_resumed(
            resume,
            {"held": held, "tolerance": tolerance, "rtol": rtol, "atol": atol},
            {"dt": dt, "method": method, "memory": memory},
        )
        other = other_loads(system, resume, end, load, nu, base, table, coordinates)
        if events is not None:
            raise InputError(
                "events: taken from the run that is resumed, must not be given with resume"
            )
        run = go_on(resume, end, want, progress, other, estimated)
        supports = resume._supports if other is None else moved[1]
        return _heard(run, (moved[0] or resume._floor, supports))
    if end <= 0:
        raise InputError(f"t_end = {end:g}: must be greater than 0")
    breaks = breaks_of(table, base, len(system.dof_names))
    breaks = with_delayed_jumps(breaks, system, end, initial, held)

    def prepared(sharper: float = 1.0, by_modes: bool | None = None) -> tuple[_Steps, int]:
        make, n, at_first = runs_of(
            system, end, initial, method, loads, accuracy, auto, sharper, by_modes
        )
        watch = None if events is None else _watch_of(events, make, system)
        made = known(make, breaks, table, base, watch)
        return _Steps(made, end, breaks, at_first, want, progress), n

    if auto:
        assert accuracy is not None
        others = partial(_has_others, system, base, method)
        return _heard(_with_search(prepared, accuracy, others), moved)
    steps, _ = prepared()
    run = _with_step(steps, end, _native.number("dt", dt, " or 'auto'"), estimated)
    return _heard(run, moved)


def _with_base(
    system: Any, acceleration: object, load: Any, nu: Any, base: Any, force: Any, end: float
) -> tuple[Any, Any, Any, Any, _Moved]:
    """Return the loads, and the motions of a base or supports that are part of them."""
    # Scenes represent a base at rest by an empty mapping.
    if base is not None and isinstance(base, Mapping) and not base:
        base = None
    if acceleration is not None:
        load, force, floor = _on_moving_base(system, acceleration, base, load, nu, force)
        return load, nu, base, force, (floor, None)
    if not moves_apart(system, base):
        return load, nu, base, force, (None, None)
    load = at_frequency(load, nu)
    load, force, supports = on_own_supports(system, base, load, nu, force, end)
    return load, None if load is None else nu, None, force, (None, supports)


def _check_system(system: Any, coordinates: object) -> None:
    """Refuse other types, and coordinates that cannot be chosen."""
    _native.check_instance("system", system, Pendulum, Mount, PolynomialSystem, Structure)
    if coordinates is not None and not system._is_condensed:
        raise InputError("coordinates: is for a Structure; of other systems all are kept")


def _at_changing_speed(
    system: Any,
    initial: npt.ArrayLike | None,
    force: LoadTable | DriveTorque | None,
    rtol: float | None,
    usual: bool,
    others: tuple[Any, Any],
) -> tuple[Any, npt.ArrayLike | None, LoadTable | None, float | None]:
    """Return the system with the angle of its shaft if its speed changes, its start and load.

    ``usual``: no accuracy but perhaps ``rtol`` is given; ``others``: resumed run and history.
    """
    if not turns_shaft(system, force):
        assert not isinstance(force, DriveTorque)
        return system, initial, force, rtol
    if any(one is not None for one in others):
        raise InputError(
            "force: resume and held are not available while the speed changes; to resume a run, "
            "use simulate(run.system, ..., resume=run) without force"
        )
    assert isinstance(force, (DriveTorque, RunUp))
    whole, start, table = with_shaft(system, force, initial)
    return whole, start, table, USUAL_RTOL if usual and rtol is None else rtol


def _on_moving_base(
    system: Any, acceleration: object, base: object, load: Any, nu: Any, force: Any
) -> tuple[LoadLike | None, LoadTable | None, BaseMotion | None]:
    """Return the loads on coordinates relative to a base with an acceleration."""
    if base is not None:
        raise InputError("base and base_acceleration are both given: must be one of them")
    if system._has_own_loads:
        raise InputError("base_acceleration: is for a Mount; a Pendulum has its loads in itself")
    return relative_loads(system, acceleration, at_frequency(load, nu), nu, force)


def _speed(nu: float | None, resume: Trajectory | None) -> float | None:
    """Return the speed of a rotor: nu, or its speed in the run that is resumed."""
    # `resume` is checked later, with its name.
    return getattr(getattr(resume, "system", None), "speed", None) if nu is None else nu


def _heard(run: Trajectory, moved: _Moved) -> Trajectory:
    """Warn of events that could not be found: functions without a value, or too fine."""
    if moved != (None, None):
        run = replace(run, _floor=moved[0], _supports=moved[1])
    watch = None if run._resume is None else run._resume.watch
    if watch is None or not run.stats["steps"]:
        return run
    for i in watch.undefined:
        warnings.warn(
            f"events[{i}] = {watch.events[i].function!r}: has no value on the whole run, so no "
            "event was found",
            RangeWarning,
            stacklevel=caller(),
        )
    for i, lost in enumerate(watch.lost):
        if lost:
            warnings.warn(
                f"events[{i}] = {watch.events[i].function!r}: changes too fast in {lost} steps "
                "to find all events, some may be missing: use a smaller dt",
                RangeWarning,
                stacklevel=caller(),
            )
    return run


def _watch_of(events: object, make: Maker, system: object) -> Watch:
    return Watch.checked(events, observed(make(1.0)), system=system)


def kept_by(run: Run) -> tuple[str, ...]:
    """Names of the coordinates that a run keeps."""
    names: tuple[str, ...] = run.system.dof_names
    motion = structure_motion_of(run)
    return names if motion is None else tuple(names[i] for i in motion.places)


def observed(run: Run) -> tuple[str, ...]:
    """Names of the coordinates and deflections that a run keeps."""
    names = kept_by(run)
    others = range(run.state.size // 2 - len(names))
    return (*names, *(f"deflection{i + 1}" for i in others))


@dataclass(frozen=True)
class Acting:
    """Loads and past of a system, as passed to `simulate`."""

    load: LoadLike | None = None
    nu: float | None = None
    base: LoadLike | LoadTable | None = None
    force: LoadTable | None = None
    held: npt.ArrayLike | Past | None = None
    memory: str = "auto"
    coordinates: Sequence[str] | None = None


def runs_of(
    system: Any,
    end: float,
    initial: npt.ArrayLike | None,
    method: str,
    given: Acting,
    accuracy: Accuracy | None,
    auto: bool,
    sharper: float = 1.0,
    by_modes: bool | None = None,
) -> tuple[Maker, int, int]:
    """Maker of runs, first number of steps, and kind of the first step.

    ``sharper``: factor of the tolerance of memory equations; ``by_modes``: whether the equations
    are those of modes, None: as the core chooses.
    """
    load, nu = given.load, given.nu
    if load is not None and type(load) is not float:
        load = at_frequency(load, nu)
    base, force, held = given.base, given.force, given.held
    # The step alone decides the error: its equations are solved to rounding, which costs little.
    wanted = None if auto or accuracy is None else accuracy.absolute
    solved = ROUNDING if wanted is None else max(0.1 * wanted, ROUNDING)
    far = ROUNDING if accuracy is None else max(sharper * accuracy.solved, ROUNDING)
    if system._has_own_loads:
        others = {"load": load, "nu": nu, "base": base, "force": force, "held": held}
        for argument, value in others.items():
            if value is not None:
                raise InputError(f"{argument}: is for a Mount; a Pendulum has its loads in itself")
        _native.choice("memory", given.memory, ("auto",))
        return *pendulum_runs(system, end, initial, method, solved), 1
    if isinstance(system, OnShaft):
        turning = shaft_runs(
            system, end, initial, method, load, nu, force, solved, base, given.memory,
            given.coordinates,
        )  # fmt: skip
        return *turning, 1
    motion: OscillatorMotion | None = None
    if by_modes:
        pass
    elif system._is_condensed:
        motion = whole_motion(
            system, end, initial, method, load, nu, force, given.coordinates, base=base, held=held,
            memory=given.memory, may_have_modes=by_modes is None, auto=auto,
        )  # fmt: skip
    elif not is_large(system):
        motion = OscillatorMotion.checked(
            system, end, initial, method, load, nu, base, force, held, given.memory
        ).with_equations(may_have_modes=by_modes is None and _may_have_modes(system, base))
        if motion.chosen["equations"] == BY_MODES:
            motion = None if system._modes_in_time else motion.with_equations()
    if motion is not None:
        if not motion.remembers_all:
            return motion.runs(solved), motion.chosen["first"], 1
        make = motion.runs(far if motion.remembers or not auto else ROUNDING)
        return make, motion.chosen["first"], 2 if motion.remembers else 1
    shape = StructureMotion.checked(
        system, end, initial, method, load, nu, base, force, held, given.memory, given.coordinates
    )
    make = shape.runs(far if shape.remembers else ROUNDING)
    return make, shape.first_steps(), 2 if shape.remembers else 1


def is_large(system: Any) -> bool:
    """True if the core does not take a system in all its coordinates for motions in time."""
    n = len(system.dof_names)
    return n > MOST_WHOLE and not (system._has_kinks and n <= MOST_IN_FRAME)


def _has_others(system: Any, base: Any, method: object) -> bool:
    """True if a smooth motion may be computed by modes and in all coordinates."""
    if system._has_own_loads or isinstance(system, OnShaft) or system._has_kinks:
        return False
    if len(system.dof_names) > MOST_WHOLE or method not in ("auto", *NODES):
        return False
    if system._is_condensed:
        return lacks_wholeness(system) is None
    return _may_have_modes(system, base) and system._modes_in_time is not None


def _may_have_modes(system: Any, base: Any) -> bool:
    """True unless the base moves in a way that modes do not support: in several directions."""
    if base is None or len(system.dof_names) > MOST_WHOLE:
        return True
    if isinstance(base, LoadTable) or any(map(in_components, base_by_order(base).values())):
        return False
    return getattr(system, "_space", None) is None


@dataclass(frozen=True)
class _Steps:
    """Runs with any number of steps, equal or ending at corners of the loads."""

    make: Maker
    end: float
    breaks: FloatArray
    at_first: int
    want: Wanted
    progress: bool

    def first(self, n: int) -> Run:
        """The run at its start, with n steps, or the number that loads with corners need."""
        run = self.make(self.end / n)
        mesh = self.mesh(n)
        if mesh is not None:
            return run.on(mesh)
        run.goal = n, self.end
        return run

    def mesh(self, n: int) -> Mesh | None:
        """The ends of steps; None if they are equal."""
        if not self.breaks.size:
            return None
        mesh = Mesh.until(self.end, self.end / n, self.breaks, at_first=self.at_first)
        if mesh.count > MAX_STEPS:
            raise InputError(
                f"force, base: takes {mesh.count:.1e} steps, must be at most {MAX_STEPS:g}"
            )
        return mesh


def _with_search(
    prepared: Callable[..., tuple[_Steps, int]], accuracy: Accuracy, has_others: Callable[[], bool]
) -> Trajectory:
    """Run with a step size that meets the tolerance.

    ``has_others``: the motion may also be computed by modes, or in all coordinates.
    """

    def search(steps: _Steps, n: int, run: Run) -> Trajectory:
        return by_tolerance(run, n, steps.end, steps.want, accuracy, steps.progress)

    def first_of(steps: _Steps, n: int) -> tuple[_Steps, int, Run]:
        if n > MAX_FIRST_STEPS:
            raise InputError(
                f"t_end = {steps.end:g}: takes {n:.1e} steps of the fastest motion or load, must "
                f"be at most {MAX_FIRST_STEPS:g}: use a shorter run, slower loads or softer "
                "springs, or give dt"
            )
        n = steps.want.every * math.ceil(n / steps.want.every)
        return steps, n, steps.first(n)

    steps, n, first = first_of(*prepared())
    try:
        return by_tolerance(first, n, steps.end, steps.want, accuracy, steps.progress)
    except NotMetError as error:
        failed = error
    if steps.at_first > 1 or (first.has_layers and not first.layers.seen):
        # Steps may only be too large for layers of laws. An unstable motion with memory amplifies
        # the errors of equations and kernels.
        if first.has_layers:
            first.layers.seen = True
        else:
            steps, _ = prepared(_SHARPER)
        try:
            return search(steps, n, steps.first(n))
        except NotMetError as error:
            failed = error
    # Modes have smaller rounding errors. Steps in all coordinates follow self-excited motions.
    if has_others():
        with suppress(NotMetError):
            return search(*first_of(*prepared(by_modes=structure_motion_of(first) is None)))
    raise failed


def _with_step(steps: _Steps, end: float, step: float, estimated: bool) -> Trajectory:
    """Run with a given step size."""
    if not 0 < step <= end:
        raise InputError(f"dt = {step:g}: must be greater than 0 and not exceed t_end = {end:g}")
    if end / step > MAX_STEPS:
        raise InputError(f"dt = {step:g}: t_end / dt must be at most {MAX_STEPS:g}")
    n = math.ceil(end / step * (1 - 1e-12))
    run, want = steps.first(n), steps.want
    if run.mesh is not None and want.times is None and want.keep != "last":
        # Keep states after equal steps for all loads.
        times = np.multiply(np.arange(n + 1), end / n, dtype=float)
        times[-1] = end
        want = want.at(times[:: want.every])
    if estimated:
        result = with_estimate(run, n, end, want, steps.progress)
    else:
        result = run.steps(n if run.mesh is None else run.mesh.count, want, steps.progress)
    if result.resolution is not None and result.resolution > _ROUGH:
        warnings.warn(
            f"dt = {step:g}: steps do not resolve the motion (resolution "
            f"{result.resolution:.1e}, should be below {_ROUGH:g})",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    passed = None
    # Partial steps resolve layers.
    in_parts = result._resume is not None and result._resume.layers.seen
    if result.outcome == "completed":
        passed = result._pole_passed()
        if passed is None and not in_parts and _every_step(result.t, step):
            # Only the states of all steps show a layer inside a step.
            passed = result._layer_passed()
    if passed is not None:
        warnings.warn(f"dt = {step:g}: {passed}", ConvergenceWarning, stacklevel=caller())
    return result


def _every_step(t: FloatArray, step: float) -> bool:
    """True if the times include every step."""
    return t.size > 1 and bool(t[-1] - t[0] < 1.5 * step * (t.size - 1))
