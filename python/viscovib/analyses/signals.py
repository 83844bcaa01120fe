"""Signals for spectra: equidistant samples, or coordinates of a trajectory."""

import math
import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Names
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.results.trajectory import Trajectory

_WANTED = Names("coordinates")


@dataclass(frozen=True)
class Signal:
    """Equidistant samples, shape (n,) or (n, m), their spacing, start time and names."""

    samples: FloatArray
    step: float
    start: float
    names: tuple[str, ...] | None
    #: Coordinates that oscillate too fast for the samples.
    aliased: tuple[str, ...] = ()


def read_signal(
    signal: "npt.ArrayLike | Trajectory",
    dt: float | None,
    *,
    start: float | None = None,
    coordinates: str | tuple[str, ...] | None = None,
    most: int,
) -> Signal:
    """Check a signal; for a trajectory use the named coordinates and the spacing of its states.

    ``most``: largest number of dimensions, 2 for several signals.
    """
    if isinstance(signal, Trajectory):
        return _of_trajectory(signal, dt, start, coordinates, most)
    if coordinates is not None:
        raise InputError("coordinate: only a Trajectory has coordinates; got an array as signal")
    if dt is None:
        raise InputError("dt: must be given with an array: the time between samples")
    samples = _native.real_array("signal", signal)
    if not 1 <= samples.ndim <= most or samples.shape[0] == 0:
        shapes = "(n,)" if most == 1 else "(n,) or (n, m)"
        raise InputError(f"signal: must have shape {shapes} with n >= 1, got {samples.shape}")
    if samples.size and float(np.abs(samples).max()) > 1e150:
        raise InputError("signal: values beyond 1e150 exceed the range of numbers")
    step = _native.number("dt", dt)
    if not 1e-300 <= step <= 1e300:
        raise InputError(f"dt = {step:g}: must be greater than 0, and within 1e-300 to 1e300")
    return Signal(samples, step, 0.0 if start is None else _native.number("start", start), None)


def _of_trajectory(
    run: Trajectory,
    dt: float | None,
    start: float | None,
    coordinates: str | tuple[str, ...] | None,
    most: int,
) -> Signal:
    if dt is not None or start is not None:
        raise InputError("dt, start: must not be given with a Trajectory, which has its own times")
    names: tuple[str, ...]
    if coordinates is None and most == 1 and len(run.dof_names) == 1:
        coordinates = run.dof_names[0]
    if isinstance(coordinates, str):
        columns, names = run.coordinate(coordinates), (coordinates,)
    elif most == 1:
        raise InputError(
            f"coordinate = {_native.shown(coordinates)}: must be a name, such as "
            f"{run.dof_names[0]!r}, of the coordinate of the Trajectory that is wanted"
        )
    else:
        names = run.dof_names if coordinates is None else _WANTED.check(coordinates)
        if not names:
            raise InputError("coordinates: must name at least one coordinate")
        columns = np.stack([run.coordinate(name) for name in names], axis=1)
    if run.t.size < 2:
        raise InputError(f"signal: {run.t.size} states kept, must be at least 2")
    step = run.dt
    if math.isnan(step):
        apart = np.diff(run.t)
        raise InputError(
            f"signal: the states of this Trajectory are {apart.min():g} to {apart.max():g} "
            "apart: must be in equal steps; run with dt= a number"
        )
    if not math.isfinite(float(np.abs(columns).max())) or float(np.abs(columns).max()) > 1e150:
        raise InputError("signal: values beyond 1e150 exceed the range of numbers")
    aliased = []
    for name in dict.fromkeys(one.removesuffix("_dot") for one in names):
        if warn_of_aliases(name, run.coordinate(name), run.coordinate(f"{name}_dot"), step):
            aliased.append(name)
    return Signal(columns, step, float(run.t[0]), names, tuple(aliased))


def warn_of_aliases(name: str, u: FloatArray, v: FloatArray, step: float) -> bool:
    """Warn of a coordinate that oscillates too fast for its states, based on its velocity."""
    share, is_large = aliased_part(u, v, step)
    if is_large:
        warnings.warn(
            f"states {step:.4g} apart are too far for {name}: by its velocity "
            f"{100 * min(share, 1.0):.0f} % of it is faster than {math.pi / step:.4g} rad/s, "
            "which appears at wrong frequencies: keep more states",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    return is_large


def aliased_part(u: FloatArray, v: FloatArray, step: float) -> tuple[float, bool]:
    """Fraction of a displacement that is aliased, estimated from its velocity.

    Also True if a warning is needed.
    """
    found = _native.run("spectrum aliased", u=u, v=v, step=step)
    return found["share"], bool(found["is_large"])


def windowed(columns: FloatArray, window: int) -> tuple[ComplexArray, float]:
    """One-sided spectra of signals (columns), and the noise bandwidth of the window."""

    def work() -> tuple[ComplexArray, float]:
        found = _native.run("spectrum windowed", signals=columns, window=window)
        return found["spectra"], found["bandwidth"]

    return _native.apart(work) if columns.size > _native.MANY_SAMPLES else work()
