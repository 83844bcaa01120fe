"""Motion with memory: what a run of a mount needs, checked, and its steps."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.errors import InputError, StabilityWarning
from viscovib.load import LoadLike, load_series
from viscovib.load_table import LoadTable
from viscovib.mount import Mount
from viscovib.runs import Piece, Run, Wanted
from viscovib.trajectory import Trajectory

#: Nodes of a step, and steps a fastest period to begin with when the step is to be found.
NODES = {"gauss2": 2, "gauss3": 3, "gauss4": 4, "gauss6": 6, "gauss8": 8}
_FIRST = {"gauss2": 12, "gauss3": 8, "gauss4": 6, "gauss6": 3, "gauss8": 2}
#: Ways to keep the past, by their place in the core.
_PASTS = ("exponentials", "direct")
_BEGUN, _NO_EXPONENTIALS, _STEP_TOO_LARGE, _NO_INTEGRAL = range(4)
_DIVERGED = 1
#: Steps up to which all of the past is affordable without being asked for.
_DIRECT_STEPS = 20_000
#: How far beyond its end a run may go on: kernels as exponentials reach as far.
_REACH = 100.0
#: Numbers a run needs to go on, to begin with.
_MEMORY = 1024


@dataclass(frozen=True)
class MountMotion:
    """A motion of a mount that is wanted: all but its step."""

    mount: Mount
    end: float
    state: FloatArray
    method: str
    frequencies: FloatArray
    amplitudes: ComplexArray
    base: ComplexArray
    breaks: FloatArray
    pieces: FloatArray
    held: FloatArray
    memory: str

    @classmethod
    def checked(
        cls,
        mount: Mount,
        end: float,
        initial: npt.ArrayLike | None,
        method: str,
        load: LoadLike | None,
        nu: float | None,
        base: LoadLike | None,
        force: LoadTable | None,
        held: npt.ArrayLike | None,
        memory: str,
    ) -> "MountMotion":
        """Check every argument of ``simulate`` that a mount has."""
        n = len(mount.dof_names)
        before = _vector("held", held, n) if held is not None else np.zeros(n)
        if initial is None:
            state = np.zeros(2 * n)
            state[::2] = before
        else:
            state = _vector("initial", initial, 2 * n)
        name = _native.choice("method", method, ("auto", *NODES))
        name = "gauss8" if name == "auto" else name
        _native.choice("memory", memory, ("auto", *_PASTS))
        frequencies, amplitudes, moved = _sinusoids(mount, load, nu, base)
        breaks, pieces = np.zeros(1), np.zeros((n, 4, 1), order="F")
        if force is not None:
            if not isinstance(force, LoadTable):
                raise InputError(f"force = {force!r}: must be a LoadTable")
            breaks, pieces = np.asarray(force.times), force._pieces(n)
        _warn_of_slow_mode(mount)
        motion = cls(
            mount, end, state, name, frequencies, amplitudes, moved, breaks, pieces, before, memory
        )
        # The core works on coordinates relative to the base.
        return replace(motion, state=state - motion.base_state(np.zeros(1))[0])

    def base_state(self, t: FloatArray) -> FloatArray:
        """Motion of the base as states of the body, shape (n, 2 n_dof)."""
        state = np.zeros((t.size, self.state.size))
        if self.base.any():
            waves = self.base * np.exp(1j * np.outer(t, self.frequencies))
            state[:, 0] = waves.imag.sum(axis=1)
            state[:, 1] = (1j * self.frequencies * waves).imag.sum(axis=1)
        return state

    def first_steps(self) -> int:
        """Steps to begin with when the step is to be found."""
        fastest = max(float(self.mount.natural_frequencies().max()), float(self.frequencies.max()))
        per_period = _FIRST[self.method]
        return max(4, math.ceil(float(self.end * fastest) * per_period / (2 * math.pi)))

    def runs(self, tolerance: float) -> Callable[[float], Run]:
        """Return what makes a run with a step."""
        return lambda h: _MountRun(self, h, tolerance)


class _MountRun(Run):
    """A run of a mount."""

    counts = "iterations"

    def __init__(self, motion: MountMotion, h: float, tolerance: float) -> None:
        super().__init__(motion.mount, motion.method, motion.state, h, tolerance)
        self.motion = motion
        self.past = "exponentials"
        if motion.memory == "direct":
            self._keep_all()

    def steps(self, n: int, want: Wanted, progress: bool) -> Trajectory:
        """Make n steps; states are those of the body, not relative to the base."""
        run = super().steps(n, want, progress)
        if not self.motion.base.any():
            return run
        return replace(run, state=run.state + self.motion.base_state(run.t))

    def _native_steps(self, count: int, every: int, columns: int, times: FloatArray) -> Piece:
        if (self.done + count) * self.h > _REACH * self.motion.end * (1 + 1e-9):
            raise InputError(
                f"t_end = {(self.done + count) * self.h:g}: a run made for t_end = "
                f"{self.motion.end:g} may go on to {_REACH * self.motion.end:g} at most"
            )
        n_memory = _MEMORY if self.memory is None else max(self.memory.size, _MEMORY)
        while True:
            part, n_kept, reason = self._call(count, every, columns, times, n_memory)
            if reason == _NO_EXPONENTIALS:
                self._turn_direct()
            elif n_kept > n_memory:
                n_memory = n_kept
            else:
                return part

    def _call(
        self, count: int, every: int, columns: int, times: FloatArray, n_memory: int
    ) -> tuple[Piece, int, int]:
        motion, mount = self.motion, self.motion.mount
        memory = np.zeros(n_memory)
        if self.memory is not None:
            memory[: self.memory.size] = self.memory
        states, at_times, last, kept, n_kept, made, _, ended, counted, reason = _native.call(
            core.mount_simulate,
            mount._flat,
            *mount._kernels,
            motion.frequencies,
            motion.amplitudes,
            motion.breaks,
            motion.pieces,
            NODES[self.method],
            _PASTS.index(self.past) + 1,
            motion.held,
            self.state,
            self.h,
            _REACH * motion.end,
            self.solved,
            self.done,
            count,
            every,
            int(self.memory is not None),
            memory,
            times,
            columns,
        )
        if reason == _NO_INTEGRAL:
            raise InputError(
                "held: a kernel has no integral, and what was held for ever would be forgotten "
                "wholly; must be None"
            )
        if reason == _STEP_TOO_LARGE:
            ended = _DIVERGED
        part = Piece(states, at_times, last, kept[:n_kept], made, ended, counted)
        return part, n_kept, reason

    def _keep_all(self) -> None:
        """All of the past, in shorter pieces since each is set up anew."""
        self.past, self.piece = "direct", 1000

    def _turn_direct(self) -> None:
        n = math.ceil(self.motion.end / self.h)
        if self.motion.memory == "exponentials":
            raise InputError(
                'memory = "exponentials": a kernel is no sum of exponentials (tables of points '
                'never are); must be "direct" or "auto"'
            )
        if n > _DIRECT_STEPS:
            raise InputError(
                f'memory = "auto": a kernel is no sum of exponentials, and {n} steps of all the '
                f'past are more than {_DIRECT_STEPS}; ask for "direct", or fit the kernel by '
                "sum_of_exponentials"
            )
        self._keep_all()


def _vector(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    vector = _native.real_array(name, value)
    if vector.shape != (n,):
        raise InputError(f"{name}: must have shape ({n},), got {vector.shape}")
    return vector


def _sinusoids(
    mount: Mount, load: LoadLike | None, nu: float | None, base: LoadLike | None
) -> tuple[FloatArray, ComplexArray, ComplexArray]:
    """Return frequencies, amplitudes of the load, shape (n_dof, m), and of the base.

    Of the motion of the base its acceleration acts, on coordinates relative to it.
    """
    n = len(mount.dof_names)
    if load is None and base is None:
        if nu is not None:
            raise InputError("nu: must not be given without load or base")
        nothing = np.zeros((n, 1), dtype=complex, order="F")
        return np.zeros(1), nothing, nothing[0]
    orders, series = load_series(load, base, n)
    frequency = 0.0 if nu is None else _native.number("nu", nu)
    if frequency < 0 or (frequency == 0 and (orders > 0).any() and series.any()):
        given = "None" if nu is None else f"{frequency:g}"
        raise InputError(f"nu = {given}: must be greater than 0 with a load of order 1 or more")
    frequencies = np.asarray(orders * frequency, dtype=np.float64)
    amplitudes = np.array(series[:n], order="F")
    amplitudes[0] += mount.mass * frequencies**2 * series[n]
    return frequencies, amplitudes, np.array(series[n])


def _warn_of_slow_mode(mount: Mount) -> None:
    """Warn that a run does not settle where a kernel's integral is 1 or more."""
    if all(mount.memory_scale * kernel.integral < 1 for kernel in mount._active_kernels):
        return
    real = mount.characteristic_roots().real
    rate = f"like exp({real[0]:.4g} t)" if real.size else "slowly"
    warnings.warn(
        f"a slow mode grows {rate}: a run does not settle on the steady response",
        StabilityWarning,
        stacklevel=4,
    )
