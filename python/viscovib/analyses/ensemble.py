"""Ensembles of motions, in the vector unit and in several threads."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.accuracy import Accuracy, rounding_of
from viscovib.analyses.events import Event
from viscovib.analyses.gathering import members_of
from viscovib.analyses.members import Members, Sections
from viscovib.analyses.memoryless import SIDE_BY_SIDE, TAYLOR
from viscovib.analyses.singles import SingleMembers
from viscovib.analyses.transient import simulate
from viscovib.common.cluster import Cluster, Lost
from viscovib.common.column_notes import NOTES
from viscovib.common.counts import things
from viscovib.common.plan import Plan
from viscovib.common.progress import progress_bar
from viscovib.errors import InputError, ViscovibError
from viscovib.results.ensemble import Ensemble
from viscovib.results.located_peaks import (
    LocatedPeaks,
    Quantity,
    find_peaks,
    named_quantities,
)
from viscovib.results.trajectory import OUTCOMES
from viscovib.systems.law_ends import force_at_rest
from viscovib.systems.load import LoadLike
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.system import turned

#: Motions computed together: in a block of vector lanes, and by Taylor's method.
_LANES, _WIDE = 8, 32
_MAX_STEPS = 10**12
#: Largest number of steps between samples, as in scenes.
_MOST_APART = 10**9
#: Largest number of trajectories per native call, which sets the interval of progress.
_MAX_PIECE = 1024
#: Largest number of steps of all runs (a tenth of a second) for a direct call, without a second
#: thread for Ctrl-C.
_SHORT = 2 * 10**5
#: Largest number of trajectories per call if they are computed one by one.
_MAX_SINGLE = 32
#: Number of repetitions of runs whose Dask worker failed.
_RETRIES = 2
#: What `simulate_ensemble` sets in members.
_OF_MEMBERS = ("discarded", "gathered_since", "step_is_sought")
#: Default of the tolerance.
_TOLERANCE = 1e-8
#: Smallest number of steps with samples, in units of the first number (four per fastest period).
_SAMPLED = 8
#: Change of runs that do not end in the same way.
_ENDLESS = float(np.finfo(float).max)


def simulate_ensemble(
    system: Pendulum | PolynomialSystem | Structure | Mount,
    *,
    initial: npt.ArrayLike,
    t_end: float | None = None,
    n_periods: int | None = None,
    dt: float | str = "auto",
    parameters: Mapping[str, npt.ArrayLike] | None = None,
    load: LoadLike | None = None,
    nu: float | None = None,
    method: str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    discard: float = 0.0,
    statistics: bool = False,
    amplitudes_at: npt.ArrayLike | None = None,
    peaks: Sequence[Quantity] = (),
    sections: int | str | Event | None = None,
    lyapunov: bool | str = False,
    sample_every: int = 1,
    n_threads: int | None = None,
    progress: bool = False,
    client: Any = None,
) -> Ensemble:
    """Integrate many motions from t = 0 and return selected results without storing the motions.

    Parameters
    ----------
    system : Pendulum, PolynomialSystem, Structure or Mount
        Any system that `simulate` accepts. Pendulums, and systems without memory, with at most 6
        coordinates and smooth laws, are computed eight together in the vector unit. All other
        systems (kinks, jumps, stops, hysteresis, kernels, more coordinates, finite rotations, laws
        with layers thinner than a step) are computed run by run.
    initial : array_like, shape (n, 2 n_dof) or (2 n_dof,)
        States at t = 0, or a single state for all runs.
    t_end : float
        End of the runs; with ``sections`` of a load the nearest whole number of its periods.
    n_periods : int
        Length of the runs in periods of the load of ``sections``, instead of ``t_end``. Required if
        the frequency of this load varies.
    dt : float or "auto"
        Step size, shortened to fit t_end or the period. "auto": halved until the final states
        change by at most ``tolerance``.
    tolerance : float
        Absolute error of the final states, 1e-13 to 1 (default 1e-8).
    rtol, atol : float
        Instead of ``tolerance``: the error of each coordinate and velocity of the final states is
        at most atol + rtol times its largest value of all runs (rtol 1e-13 to 1; default of atol:
        0).
    parameters : mapping of str to array_like, shape (n,)
        Parameters that vary, by name. Pendulum: for example {"p1": values}. Polynomial system:
        "nu", "load_scale", "stiffness_scale" (K of all springs, without the linear part of laws),
        "damping_scale", "forces_scale" (the nonlinear part) and its own ``parameters``. Structure:
        "nu", "load_scale" and numbers of elements, "elements[0].limit" or "elements[0].k3". Mount:
        "nu", "load_scale" and its numbers. `Body`: "nu", "load_scale", "mass", "inertia_scale",
        "center[x]", "mounts[front].stiffness[z]" (also damping and position),
        "mounts[front].stiffness_scale", and "mounts[front].k3" (k3 a parameter of its laws).
        Parameters of smooth laws and numbers of elements and bodies are computed together in the
        vector unit; those of a `Mount` run by run.
    load, nu
        Not for a pendulum: as for `simulate`.
    method : {"auto", "rk4", "dop8", "verner8", "verner9", "gauss8", "gauss16", "taylor8" ...}
        "auto" is "verner9", accurate to 1e-14. "gauss8" and "gauss16" (orders 16 and 32) take
        larger steps, whose equations are solved to rounding error; for a pendulum "gauss8" is the
        fastest from about 1e-9 on. A step that cannot be solved ends its run ("step too large").
        "taylor8", "taylor12", "taylor16", "taylor20" and "taylor24" sum the power series of the
        motion in time up to this order, 32 motions together: the fastest methods for large
        ensembles of polynomial systems and text laws (not for pendulums and exponents). A series
        that does not converge within a step ends its run ("step too large"). Order 8 is the fastest
        to about 1e-7, order 12 to 1e-12. Run by run: any method of `simulate`.
    discard : float
        Results start at this time (or after this number of periods, with ``n_periods``); with
        ``sections`` of a load at the end of the period that contains it.
    statistics : bool
        Return peak, mean and rms of the motion from ``discard`` on, including the motion between
        steps and at kinks and impacts. ``error`` includes them.
    amplitudes_at : array_like, shape (m,)
        Circular frequencies of amplitudes (projection with a Hann window).
    peaks : list of str or functions
        Quantities of `Trajectory.peak`, such as "x_ddot" or, of a `Body`, "foot.z". Each run is
        computed once more by `simulate`, with the same accuracy or step size, in threads.
    sections : {1, 2, 3}, str or Event
        Keep the states at each whole period of load 1 (p1), 2 (p2) or 3 (p3); for all systems other
        than a pendulum 1 (nu). Or on a surface in the state space: a text such as "x_dot", or an
        `Event`, at whose sign changes states are kept (run by run).
    lyapunov : bool or "all"
        Compute the largest Lyapunov exponent by the variational equation (about three times the
        work); "all": all 2 n_dof exponents of repeatedly orthonormalized perturbations (Gram and
        Schmidt; Benettin et al., Meccanica 15, 1980; 6 n_dof times the work). Perturbations are
        measured in the units of the states, with velocities and displacements combined. So for
        motions with a frequency omega far from 1 rad/s an exponent has the uncertainty ln(omega)/T
        after a time T: use a unit of time in which omega is about 1, or long runs. Run by run, and
        for more than 3 coordinates, neighbouring motions at a distance of 1e-7 of the recent size
        are used, with their own switching times. The exponents are then accurate to about 1e-6 of
        the fastest rate (less if a motion grazes a corner). -inf: a perturbation vanishes (friction
        that sticks). NaN: no step remains after ``discard``, or the perturbation exists in the
        history only. With memory or internal states the state is the whole history: a perturbation
        changes coordinates and velocities at t = 0, its history is rescaled with it, and "all" are
        the 2 n_dof largest of infinitely many exponents.
    sample_every : int
        Steps between the samples of amplitudes. Use two or more samples per period of the highest
        frequency, because higher frequencies appear at wrong frequencies.
    n_threads : int
        Default: the number of processors. Results do not depend on it, to the last bit.
    progress : bool
        Show a progress bar.
    client : dask.distributed.Client, optional
        Compute on its cluster instead of in threads, with the same results to the last bit. Workers
        return the statistics of their runs, not the motions.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> many = vv.simulate_ensemble(
    ...     body,
    ...     initial=np.zeros((4, 6)),
    ...     t_end=20.0,
    ...     parameters={"f0": [0.001, 0.002, 0.003, 0.004]},
    ... )
    """
    varies = isinstance(parameters, Mapping) and "nu" in parameters
    system = turned(system, None if varies else nu)
    surface = None
    if isinstance(sections, (str, Event)):
        surface, sections = (Event(sections) if isinstance(sections, str) else sections), None
    some, all_of_them = _exponents(lyapunov)
    arguments = system, initial, parameters, load, nu, method, surface, some
    members = members_of(*arguments)
    exponents = 2 * len(members.dof_names) if all_of_them else int(some)
    place = SIDE_BY_SIDE.get(members.method_name, 0)
    wanted = Accuracy.checked(tolerance, rtol, atol, None) or Accuracy(_TOLERANCE)
    every = _native.integer("sample_every", sample_every, 1, _MOST_APART)
    lines = np.empty(0)
    if amplitudes_at is not None:
        lines = _native.real_array("amplitudes_at", amplitudes_at, ndim=1)
        if np.any(lines <= 0):
            raise InputError(f"amplitudes_at: must be greater than 0, got {lines.min():g}")
    named_quantities(members, peaks)
    _native.flag("progress", progress)
    length = _Length.checked(members, t_end, n_periods, discard, sections)
    members.discarded = length.discarded
    job = _Job(
        members,
        place,
        length,
        lines,
        _native.flag("statistics", statistics),
        exponents,
        every,
        _threads(n_threads, client),
    )
    if job.statistics:
        members.gathered_since = members.discarded
    members.step_is_sought = _native.is_auto(dt)
    sought = wanted if _native.is_auto(dt) else None
    if client is not None:
        job.cluster = Cluster(_InWorker(job, arguments), client, _RETRIES)
        job.threads = job.cluster.threads
    raw, n, error, nearby = _computed(job, length.steps(dt, members), sought, progress)
    h = length.span / n
    apart = every * float(np.max(h))
    if lines.size and lines.max() * apart >= np.pi:
        raise InputError(
            f"sample_every = {every}: states {apart:.4g} apart resolve no frequency of "
            f"{np.pi / apart:.4g} or more, amplitudes_at has {lines.max():g}: must be smaller"
        )
    names = np.array(OUTCOMES)
    points, times = members.passages(raw.sections)
    return Ensemble(
        t_end=length.span,
        t_reached=raw.t_reached,
        state=raw.state,
        outcome=names[raw.ended],
        step=h,
        dt=length.spacing,
        peak=raw.peak,
        mean=raw.mean,
        rms=raw.rms,
        amplitudes=raw.amplitudes,
        sections=points,
        **_exponents_of(raw),
        error=error,
        section_error=nearby.sections,
        amplitude_error=nearby.amplitudes,
        method=members.method_name,
        parameters=members.varied,
        system=members.system,
        plan=_plan(job, n, sought, points is not None, force_at_rest(system)),
        section_times=times,
        peaks=_located(job, arguments, peaks, (tolerance, rtol, atol, sought or h), progress),
        _names=members.dof_names,
    )


def _located(
    job: _Job,
    arguments: tuple[Any, ...],
    peaks: Sequence[Quantity],
    steps: tuple[Any, ...],
    progress: bool,
) -> tuple[LocatedPeaks, ...]:
    """Peaks of quantities along each run, which is made once more.

    ``arguments``: those of `members_of`. ``steps``: ``tolerance``, ``rtol``, ``atol``, and the step
    sizes if they are given.
    """
    if not peaks:
        return ()
    system, initial, parameters, load, nu, method, *_ = arguments
    own = "auto" if method in TAYLOR or system._is_condensed else method
    single = SingleMembers(system, initial, parameters or {}, load, nu, own, None)
    *accuracy, h = steps
    if accuracy == [None, None, None]:
        accuracy = [_TOLERANCE, None, None]
    found = np.full((single.n, len(peaks), 3), np.nan)
    since = job.length.discarded

    def one(i: int, cancel: npt.NDArray[np.intc]) -> None:
        _native.listen(cancel)
        loads, end = single._acting(i), float(job.length.span[i])
        by: dict[str, Any] = dict(zip(("tolerance", "rtol", "atol"), accuracy, strict=True))
        if isinstance(h, np.ndarray):
            by = {"dt": float(h[i])}
        run = simulate(
            single._one(i), end, initial=single.states[i], load=loads.load, nu=loads.nu,
            method=single.method, **by,
        )  # fmt: skip
        if run.outcome != "completed":
            return
        if since[i] > 0:
            late = run.t > since[i]
            begin = run(since[i : i + 1])
            run = replace(
                run, t=np.append(since[i], run.t[late]), state=np.vstack([begin, run.state[late]])
            )
        for k, top in enumerate(find_peaks(run, peaks)):
            found[i, k] = top.value, top.t, top.error

    job.each(one, progress)
    names = [name for name, _ in named_quantities(single, peaks)]
    return tuple(LocatedPeaks(name, *found[:, k].T.copy()) for k, name in enumerate(names))


def _plan(job: _Job, n_steps: int, sought: Accuracy | None, sections: bool, preload: float) -> Plan:
    n = job.members.n
    how = f"{job.lanes} side by side" if job.members.side_by_side else "one after another"
    lines = [f"computes: {things(n, 'motion')} of {things(n_steps, 'step')}, {how}"]
    steps = NOTES["step_given"] if sought is None else f"{NOTES['step_halved']}{sought.text}"
    lines.append(steps)
    if preload > 0:
        lines.append(
            "computes: the static preload of laws that are not 0 at rest (up to "
            f"{float(f'{preload:.6g}'):g})"
        )
    lines.append("skips: storing states on the way (an ensemble keeps what is gathered)")
    given = (
        things(job.lines.size, "frequency", "frequencies") if job.lines.size else "any frequencies"
    )
    for wanted, what in (
        (job.statistics, "peaks, means and rms"),
        (job.lines.size > 0, f"amplitudes at {given}"),
        (sections, "sections"),
        (job.exponents > 0, "Lyapunov exponents"),
    ):
        lines.append(f"computes: {what}" if wanted else f"skips: {what} (not requested)")
    return Plan("\n".join(lines))


def _threads(n_threads: int | None, client: Any) -> int:
    """Number of threads of this process."""
    if n_threads is None:
        return os.cpu_count() or 1
    if client is not None:
        raise InputError("n_threads: is for threads of this process, must not be given with client")
    return _native.integer("n_threads", n_threads, 1, 4096)


def _exponents(lyapunov: object) -> tuple[bool, bool]:
    """Two flags: exponents are requested, and all of them."""
    if isinstance(lyapunov, str) and lyapunov == "all":
        return True, True
    if not isinstance(lyapunov, (bool, np.bool_)):
        raise InputError(f"lyapunov = {_native.shown(lyapunov)}: must be True, False or 'all'")
    return bool(lyapunov), False


def _exponents_of(raw: _Raw) -> dict[str, FloatArray | None]:
    """Exponents with their errors, the largest first."""
    names = ("lyapunov", "lyapunov_error", "spectrum", "spectrum_error")
    if raw.lyapunov is None or raw.lyapunov_error is None:
        return dict.fromkeys(names)
    order = np.argsort(-raw.lyapunov, axis=1, kind="stable")
    all_of_them = np.take_along_axis(raw.lyapunov, order, axis=1)
    errors = np.take_along_axis(raw.lyapunov_error, order, axis=1)
    whole = (all_of_them, errors) if order.shape[1] > 1 else (None, None)
    return dict(zip(names, (all_of_them[:, 0], errors[:, 0], *whole), strict=True))


@dataclass(frozen=True)
class _Length:
    """Length of each run, in time and, with sections, in periods."""

    span: FloatArray
    discard: float
    periods: int | None = None
    discarded_periods: int = 0

    @classmethod
    def checked(
        cls,
        members: Members,
        t_end: float | None,
        n_periods: int | None,
        discard: float,
        sections: int | None,
    ) -> _Length:
        before = _native.number("discard", discard)
        if before < 0:
            raise InputError(f"discard = {before:g}: must not be negative")
        if (t_end is None) == (n_periods is None):
            raise InputError("t_end or n_periods: give exactly one of them")
        end = 0.0 if t_end is None else _native.number("t_end", t_end)
        if t_end is not None and end <= 0:
            raise InputError(f"t_end = {end:g}: must be greater than 0")
        if sections is None:
            if n_periods is not None:
                raise InputError(
                    "n_periods: sections must name the load whose periods are meant, as sections=1"
                )
            if before >= end:
                raise InputError(f"discard = {before:g}: must be less than t_end = {end:g}")
            return cls(np.full(members.n, end), before)
        name, frequencies = members.load_frequencies(sections)
        if np.any(frequencies <= 0):
            raise InputError(f"sections = {sections}: {name} must be greater than 0")
        period = 2 * math.pi / frequencies
        if n_periods is not None:
            periods = _native.integer("n_periods", n_periods, 1, _MAX_STEPS)
            skipped = math.ceil(before)
        else:
            if np.any(period != period[0]):
                raise InputError(f"t_end: {name} varies, give n_periods instead")
            periods = max(1, round(min(end / period[0], 2.0 * _MAX_STEPS)))
            skipped = math.ceil(min(before / period[0], 2.0 * _MAX_STEPS))
        if skipped >= periods:
            raise InputError(f"discard: {skipped} of {periods} periods, must be fewer")
        return cls(periods * period, 0.0, periods, skipped)

    @property
    def spacing(self) -> FloatArray:
        """Times between sections; NaN without sections."""
        return self.span / (math.nan if self.periods is None else self.periods)

    def steps(self, dt: float | str, members: Members) -> int:
        """Number of steps of each run, a multiple of the number of periods."""
        longest = float(self.span.max())
        if _native.is_auto(dt):
            n = members.first_steps(self.span)
        else:
            step = _native.number("dt", dt, " or 'auto'")
            if not 0 < step <= longest:
                raise InputError(
                    f"dt = {step:g}: must be greater than 0 and not exceed the run's {longest:g}"
                )
            n = math.ceil(min(longest / step, 2.0 * _MAX_STEPS) * (1 - 1e-12))
        if self.periods is not None:
            n = self.periods * math.ceil(n / self.periods)
        return _native.integer("t_end / dt", n, 1, _MAX_STEPS)

    @property
    def discarded(self) -> FloatArray:
        """Discarded time of each run."""
        if self.periods is None:
            return np.full(self.span.size, self.discard)
        return np.asarray(self.discarded_periods * self.spacing)

    def discarded_steps(self, n: int) -> int:
        if self.periods is not None:
            return self.discarded_periods * (n // self.periods)
        return math.ceil(self._discarded_part(n) * (1 - 1e-12))

    def ahead(self, n: int) -> float:
        """Fraction of the last discarded step that lies after the discarded time."""
        if self.periods is not None:
            return 0.0
        return max(0.0, self.discarded_steps(n) - self._discarded_part(n))

    def _discarded_part(self, n: int) -> float:
        return self.discard / float(self.span[0]) * n


@dataclass(frozen=True)
class _Raw:
    """Results of the core, with the run as first axis."""

    state: FloatArray
    ended: npt.NDArray[np.intc]
    t_reached: FloatArray
    peak: FloatArray | None
    mean: FloatArray | None
    rms: FloatArray | None
    amplitudes: ComplexArray | None
    sections: FloatArray | None
    lyapunov: FloatArray | None
    lyapunov_error: FloatArray | None

    @cached_property
    def as_object(self) -> _native.Handle:
        """An object of the core with the results that runs are compared by."""
        names = "state", "peak", "mean", "rms", "lyapunov", "lyapunov_error"
        found = {name: getattr(self, name) for name in names}
        nothing = np.empty((0, self.ended.size))
        whole = {name: nothing if one is None else one.T for name, one in found.items()}
        return _native.Handle("values", ended=self.ended, t_reached=self.t_reached, **whole)


@dataclass(frozen=True)
class _Neighbour:
    """Errors of results except the final states; None: no result, or a given step size."""

    sections: float | None = None
    amplitudes: float | None = None


def _errors_by_neighbours(
    coarse: _Raw, fine: _Raw, before: Sections, after: Sections, runs: npt.NDArray[np.bool_]
) -> _Neighbour:
    """Changes of sections and amplitudes by halved steps, with their rounding errors."""
    sections, amplitudes = None, None
    if before[0] is not None and after[0] is not None:
        sections = 0.0
        for early, late in zip(before, after, strict=True):
            if early is None or late is None:
                continue
            a, b = early[runs], late[runs]
            # If the numbers of crossings differ, the error is unknown.
            alike = a.shape == b.shape and bool((np.isnan(a) == np.isnan(b)).all())
            moved = float(np.nanmax(np.abs(b - a), initial=0.0)) if alike else math.inf
            known = b[~np.isnan(b)]
            sections = max(sections, moved, rounding_of(known) if known.size else 0.0)
    if coarse.amplitudes is not None and fine.amplitudes is not None:
        lines = fine.amplitudes[runs]
        amplitudes = max(
            float(np.abs(lines - coarse.amplitudes[runs]).max(initial=0.0)),
            rounding_of(np.abs(lines)) if lines.size else 0.0,
        )
    return _Neighbour(sections, amplitudes)


class _Job:
    """All data of the runs except the step size."""

    def __init__(
        self,
        members: Members,
        method: int,
        length: _Length,
        lines: FloatArray,
        statistics: bool,
        exponents: int,
        every: int,
        threads: int,
    ) -> None:
        self.members, self.method, self.length = members, method, length
        self.lines, self.statistics, self.exponents = lines, statistics, exponents
        self.every, self.threads = every, threads
        #: Where the runs are computed, if not in threads.
        self.cluster: Cluster | None = None

    @property
    def lanes(self) -> int:
        """Number of motions that are computed together."""
        return _WIDE if self.members.method_name in TAYLOR else _LANES

    def run(self, n_steps: int, progress: bool) -> _Raw:
        """Compute all runs with a number of steps."""
        n = self.members.n
        piece = self._piece_size(progress)
        cancel = np.zeros(1, dtype=np.intc)
        slices = [slice(i, min(i + piece, n)) for i in range(0, n, piece)]
        work = n * n_steps * (1 + self.exponents)
        try:
            if self.cluster is not None:
                parts = self._on_cluster(self.cluster, slices, n_steps, progress)
            elif self.members.side_by_side and work <= _SHORT:
                parts = [self.piece(slice(0, n), n_steps, cancel)]
            else:
                parts = self._in_threads(slices, n_steps, cancel, progress)
            whole = [np.concatenate(pieces, axis=-1) for pieces in zip(*parts, strict=True)]
        except MemoryError:
            raise InputError(
                f"sections: {self.length.periods} periods of {n} runs do not fit into memory, "
                "must be fewer"
            ) from None
        state, ended, reached, peak, mean, rms, amplitudes, sections, lyapunov, unsure = whole
        return _Raw(
            state=np.ascontiguousarray(state.T),
            ended=ended,
            t_reached=reached,
            peak=peak.T if self.statistics else None,
            mean=mean.T if self.statistics else None,
            rms=rms.T if self.statistics else None,
            amplitudes=amplitudes.T if self.lines.size else None,
            sections=sections.T if self.length.periods is not None else None,
            lyapunov=lyapunov.T if self.exponents else None,
            lyapunov_error=unsure.T if self.exponents else None,
        )

    def _piece_size(self, progress: bool) -> int:
        """Number of runs per native call."""
        n = self.members.n
        if not self.members.side_by_side:
            return max(1, min(n // (8 * self.threads), _MAX_SINGLE))
        if self.threads == 1 and not progress:
            return _MAX_PIECE
        share = math.ceil(n / (4 * self.threads) / self.lanes) * self.lanes
        return min(max(share, self.lanes), _MAX_PIECE)

    def _in_threads(
        self, slices: list[slice], n_steps: int, cancel: npt.NDArray[np.intc], progress: bool
    ) -> list[tuple[Any, ...]]:
        """Compute the runs of each slice; Ctrl-C works."""
        pool = ThreadPoolExecutor(self.threads)
        try:
            futures = [pool.submit(self._heard, part, n_steps, cancel) for part in slices]
            with progress_bar(self.members.n, "runs", progress) as bar:
                for future in as_completed(futures):
                    bar.update(future.result()[0].shape[1])
            return [future.result() for future in futures]
        finally:
            # After Ctrl-C or an error the threads stop.
            cancel[0] = 1
            pool.shutdown(cancel_futures=True)

    def each(self, one: Callable[[int, npt.NDArray[np.intc]], None], progress: bool) -> None:
        """Call a function for each run in threads; Ctrl-C works."""
        cancel = np.zeros(1, dtype=np.intc)
        pool = ThreadPoolExecutor(self.threads)
        try:
            futures = [pool.submit(one, i, cancel) for i in range(self.members.n)]
            with progress_bar(self.members.n, "peaks", progress) as bar:
                for future in as_completed(futures):
                    future.result()
                    bar.update(1)
        finally:
            cancel[0] = 1
            pool.shutdown(cancel_futures=True)

    def _on_cluster(
        self, cluster: Cluster, slices: list[slice], n_steps: int, progress: bool
    ) -> list[tuple[Any, ...]]:
        """Compute the runs of each slice on a cluster."""
        for i, part in enumerate(slices):
            cluster.submit(i, part, n_steps, self.members.found_so_far(part, results=False))
        parts: dict[int, tuple[Any, ...]] = {}
        with progress_bar(self.members.n, "runs", progress) as bar:
            while len(parts) < len(slices):
                i, done = cluster.next()
                if isinstance(done, Lost):
                    first, last = slices[i].start, slices[i].stop - 1
                    raise ViscovibError(f"client: runs {first} to {last}: {done.why}")
                parts[i], found = done
                self.members.add_findings(found)
                bar.update(slices[i].stop - slices[i].start)
        return [parts[i] for i in range(len(slices))]

    def _heard(self, part: slice, n_steps: int, cancel: npt.NDArray[np.intc]) -> tuple[Any, ...]:
        """Compute a slice in a thread, which stops when the flag is 1."""
        _native.listen(cancel)
        return self.piece(part, n_steps, cancel)

    def piece(self, part: slice, n_steps: int, cancel: npt.NDArray[np.intc]) -> tuple[Any, ...]:
        """Compute a slice of the runs."""
        n = part.stop - part.start
        periods, points = self.length.periods, 0
        if periods is not None:
            points = periods - self.length.discarded_periods
        width = 2 * len(self.members.dof_names)
        sections = np.full((width, points, n if points else 0), np.nan, order="F")
        *found, lyapunov, unsure = self.members.call(
            part,
            self.length.span[part] / n_steps,
            self.method,
            n_steps,
            self.length.discarded_steps(n_steps),
            self.length.ahead(n_steps),
            self.every,
            0 if periods is None else n_steps // periods,
            n if self.statistics else 0,
            self.exponents,
            self.lines,
            cancel,
            sections,
        )
        return *found, sections, lyapunov, unsure


class _InWorker:
    """The runs in a worker of a cluster, which makes them from the arguments of `members_of`."""

    def __init__(self, job: _Job, arguments: tuple[Any, ...]) -> None:
        self._arguments, self._job = arguments, job

    def __getstate__(self) -> tuple[Any, ...]:
        members = {name: getattr(self._job.members, name) for name in _OF_MEMBERS}
        rest = {n: v for n, v in self._job.__dict__.items() if n not in ("members", "cluster")}
        return self._arguments, members, rest

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self._arguments, of_members, rest = state
        members = members_of(*self._arguments)
        for name, value in of_members.items():
            setattr(members, name, value)
        self._job = _Job.__new__(_Job)
        self._job.__dict__.update(rest, members=members, cluster=None)

    def __call__(self, part: slice, n_steps: int, found: Any) -> tuple[Any, Any]:
        members = self._job.members
        if found is not None:
            members.add_findings(found)
        parts = self._job.piece(part, n_steps, np.zeros(1, dtype=np.intc))
        return parts, members.found_so_far(part, results=True)


def _computed(
    job: _Job, n: int, sought: Accuracy | None, progress: bool
) -> tuple[_Raw, int, float | None, _Neighbour]:
    """Compute the runs with n steps, or with as many as their accuracy needs."""
    try:
        raw = job.run(n, progress)
        if sought is None:
            return raw, n, None, _Neighbour()
        return _refine(job, raw, n, sought, progress)
    finally:
        if job.cluster is not None:
            job.cluster.close()


def _refine(
    job: _Job, coarse: _Raw, n: int, wanted: Accuracy, progress: bool
) -> tuple[_Raw, int, float, _Neighbour]:
    """Halve the step size until the final states no longer change."""
    before = job.members.passages(coarse.sections)
    changes: list[float] = []
    factor, error, goes_on = 1, None, True
    while goes_on:
        factor = _SAMPLED if error is not None else 2 * factor
        fine = job.run(n * factor, progress)
        after = job.members.passages(fine.sections)
        found = _native.run(
            "ensemble comparison", coarse.as_object, fine.as_object, changes=np.array(changes),
            absolute=wanted.absolute, relative=wanted.relative,
        )  # fmt: skip
        if found["met"] and error is None:
            error = found["change"]
        # Samples for amplitudes need shorter steps than the states.
        if error is not None and not (job.lines.size and factor < _SAMPLED):
            if fine.lyapunov is not None:
                fine = replace(fine, lyapunov_error=found["lyapunov_error"].T)
            both = (coarse.ended == 0) & (fine.ended == 0)
            nearby = _errors_by_neighbours(coarse, fine, before, after, both)
            return fine, n * factor, error, nearby
        changes.append(found["change"])
        goes_on = error is not None or bool(found["goes_on"])
        coarse, before = fine, after
    change = changes[-1]
    note = f"still changes by {change:.1e}" if change < _ENDLESS else "fails"
    raise InputError(
        f"{wanted}: not met with {n * factor} steps (run {found['worst']} {note}); that motion may "
        "be chaotic: give dt, or use a shorter run or a larger tolerance"
    )
