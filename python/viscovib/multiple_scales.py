"""The method of multiple scales to third order: modulation equations and what follows."""

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.cubic_system import CubicSystem
from viscovib.errors import InputError, RangeWarning
from viscovib.mount import Mount
from viscovib.pendulum import Pendulum
from viscovib.plan import Plan
from viscovib.scales_results import Modulation, Resonance, ScalesMotion, ScalesResponse

_MAX_TERMS = 4000
_MAX_FORM = 20_000
_MAX_RESONANCES = 5000
_OUTCOMES = ("complete", "overflow", "step limit", "cancelled")


@dataclass(frozen=True)
class FlowTerm:
    """A term of the modulation equations: mode ``mode`` changes by coefficient x product.

    ``factors`` are amplitudes as in "a1", "a2*" (conjugate) and loads "p3" (their wave).
    """

    mode: int
    factors: tuple[str, ...]
    coefficient: complex


class MultipleScales:
    """A system by the method of multiple scales, its nonlinear terms to the third degree.

    Parameters
    ----------
    system : Pendulum, Mount or CubicSystem
    load : float or array_like, shape (2,), optional
        For a Mount: amplitude of a harmonic force on x (N), or of that and a moment on phi (N m),
        times cos(nu t).
    nu : float, optional
        For a Mount: circular frequency of the load (rad/s), > 0.
    tolerance : float
        Frequencies that differ by less than this part of the highest of them count as resonant:
        their terms go into the modulation equations, and their divisors are not divided by.

    Attributes
    ----------
    frequencies : ndarray, shape (n,)
        Natural circular frequencies, damping included.
    decay : ndarray, shape (n,)
        Amplitudes fall as exp(-decay t); negative: unstable.
    mode_shapes : ndarray, shape (n_dof, n)
        Columns, the largest entry 1; complex if there is damping.
    interaction : ndarray, shape (n, n)
        gamma: the frequency of mode j is frequencies[j] + sum_k gamma[j, k] b_k^2 where mode k
        has the real amplitude b_k.
    nonlinear_decay : ndarray, shape (n, n)
        The same for the decay.

    Notes
    -----
    The expansion is carried to third order, so the error of a motion falls as the fourth power
    of its amplitude, as long as t stays within a fixed number of times amplitude^-2; loads near
    a natural frequency count as of third order, others as of first, and damping is exact
    in the linear part. Nothing else is assumed small (no coupling, no divisor).
    """

    dof_names: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        system: Pendulum | Mount | CubicSystem,
        *,
        load: npt.ArrayLike | None = None,
        nu: float | None = None,
        tolerance: float = 0.05,
    ) -> None:
        self.tolerance = _native.number("tolerance", tolerance)
        self.system = system
        if not isinstance(system, Pendulum | Mount | CubicSystem):
            raise InputError(
                f"system = {system!r:.60}: must be a Pendulum, a Mount or a CubicSystem"
            )
        if not isinstance(system, Mount) and not (load is None and nu is None):
            raise InputError("load, nu: are for a Mount, other systems hold their loads")
        self._names = system.dof_names
        nothing = np.zeros(1)
        self._kernels: tuple[int, FloatArray, int, FloatArray] = (0, nothing, 0, nothing)
        if isinstance(system, Pendulum):
            packed, length = _native.call(core.pendulum_form, system._flat, _MAX_FORM)
            self._packed: FloatArray = packed[:length].copy()
            self._load_names = {"p1": (1, 1), "p2": (2, 1), "p3": (3, 1), "f0": (1, 2),
                                "m01": (2, 2), "m02": (3, 2)}  # fmt: skip
        elif isinstance(system, Mount):
            self._kernels = system._kernels
            forces = _native.real_array("load", 0.0 if load is None else load)
            if forces.shape not in ((), (2,)):
                raise InputError(f"load: must be a number or two, got shape {forces.shape}")
            pair = np.append(forces, 0.0) if forces.ndim == 0 else forces
            frequency = _native.number("nu", 1.0 if nu is None else nu)
            if frequency <= 0:
                raise InputError(f"nu = {frequency:g}: must be greater than 0")
            packed, length = _native.call(
                core.mount_form, system._flat, *self._kernels, pair, frequency, _MAX_FORM
            )
            self._packed = packed[:length].copy()
            self._load_names = {"nu": (1, 1), "load": (1, 2)}
        else:
            self._packed = system._packed
            n_loads = int(self._packed[4])
            self._load_names = {f"p{k + 1}": (k + 1, 1) for k in range(n_loads)}
            self._load_names |= {f"f{k + 1}": (k + 1, 2) for k in range(n_loads)}
        self._n_dof, self._n = int(self._packed[1]), int(self._packed[3])
        (
            exponents, shapes, interaction, frame, autonomous, n_terms, terms, coefficients,
        ) = _native.call(
            core.scales_form, self._packed, *self._kernels, self.tolerance, self._n,
            int(self._packed[0]), _MAX_TERMS,
        )  # fmt: skip
        self.exponents: ComplexArray = exponents
        self.frequencies: FloatArray = exponents.imag.copy()
        self.decay: FloatArray = -exponents.real
        shapes = np.ascontiguousarray(shapes[: self._n_dof])
        self.mode_shapes = shapes if np.any(shapes.imag) else shapes.real.copy()
        self.interaction: FloatArray = np.ascontiguousarray(interaction.imag)
        self.nonlinear_decay: FloatArray = np.ascontiguousarray(-interaction.real)
        self.frame: FloatArray = frame
        self.autonomous = bool(autonomous)
        self.terms = tuple(
            FlowTerm(int(terms[0, i]) - 1, _factors(terms[1:, i]), complex(coefficients[i]))
            for i in range(n_terms)
        )
        if (self.decay < -1e-12 * self.frequencies).any():
            j = int(self.decay.argmin())
            warnings.warn(
                f"mode {j + 1} is unstable without load: its amplitude grows at the rate "
                f"{-self.decay[j]:.6g}",
                RangeWarning,
                stacklevel=2,
            )

    def resonances(self, tolerance: float = 0.05) -> tuple[Resonance, ...]:
        """List every condition of resonance up to third order, the nearest first.

        Natural frequencies are w1, w2, ..., those of loads that act p1, p2, ...; ``near`` where
        the divisor is within ``tolerance``.
        """
        limit = _native.number("tolerance", tolerance)
        if not 0 <= limit < 1:
            raise InputError(f"tolerance = {limit:g}: must be in [0, 1)")
        drives = self._drives
        acting = np.flatnonzero(np.any(self._loads != 0, axis=0))
        coefficients, orders, divisors, n = core.scales_resonances(
            self.frequencies, drives[acting], _MAX_RESONANCES
        )
        names = (*(f"w{j + 1}" for j in range(self._n)), *(f"p{k + 1}" for k in acting))
        order = np.argsort(divisors[:n], kind="stable")
        columns = (
            map(tuple, coefficients[:, order].T.tolist()),
            orders[order].tolist(),
            divisors[order].tolist(),
            (divisors[order] <= limit).tolist(),
        )
        return tuple(Resonance(names, *row) for row in zip(*columns, strict=True))

    def modulation(
        self,
        t: npt.ArrayLike,
        initial: npt.ArrayLike | None = None,
        *,
        amplitudes: npt.ArrayLike | None = None,
        accuracy: float = 1e-10,
    ) -> Modulation:
        """Amplitudes and phases at times t from a state, by integrating the modulation equations.

        Parameters
        ----------
        t : array_like, shape (n,)
            Times >= 0, ascending.
        initial : array_like, shape (2 n_dof,)
            State (q1, q1', q2, q2', ...) at t = 0.
        amplitudes : array_like, complex, shape (n_modes,)
            Instead of ``initial``: b_j exp(i phase_j) at t = 0.
        accuracy : float
            Error allowed in a step, relative to the largest amplitude, 1e-14 to 1e-2.
        """
        return self._run(t, initial, amplitudes, accuracy)[0]

    def motion(
        self,
        t: npt.ArrayLike,
        initial: npt.ArrayLike | None = None,
        *,
        amplitudes: npt.ArrayLike | None = None,
        accuracy: float = 1e-10,
    ) -> ScalesMotion:
        """Motion to third order at times t; arguments as for `modulation`."""
        modulation, state, sizes = self._run(t, initial, amplitudes, accuracy)
        first = np.maximum(sizes[:, 0], 1e-300)
        ratio = np.maximum(sizes[:, 1] / first, np.sqrt(sizes[:, 2] / first))
        # What the next order of the frequencies makes of the phases by and by.
        rate = np.abs(self.interaction + 1j * self.nonlinear_decay)
        shift = (modulation.amplitude**2 @ rate.T).max(axis=1) * ratio**2
        t = modulation.t
        steps = np.diff(t, prepend=0.0)
        drift = np.cumsum(shift * steps)
        result = ScalesMotion(
            t=modulation.t,
            state=state,
            modulation=modulation,
            order_sizes=sizes,
            error_estimate=first * (ratio**3 + drift),
            in_range=(ratio <= 0.3) & (ratio**3 + drift <= 0.3),
            mode_shapes=self.mode_shapes,
            dof_names=self._names,
            plan=modulation.plan,
        )
        if not result.in_range.all():
            at = int(np.argmin(result.in_range))
            warnings.warn(
                f"from t = {t[at]:g} the motion leaves the range of the expansion: orders are of "
                f"sizes {sizes[at, 0]:.3g}, {sizes[at, 1]:.3g}, {sizes[at, 2]:.3g}, estimated "
                f"error {result.error_estimate[at]:.3g}",
                RangeWarning,
                stacklevel=2,
            )
        return result

    def response(self, parameter: str, values: npt.ArrayLike) -> ScalesResponse:
        """All steady motions, stable or not, for values of a load's frequency or amplitude.

        Parameters
        ----------
        parameter : str
            For a Pendulum "p1", "p2", "p3" (frequencies) or "f0", "m01", "m02" (amplitudes); for a
            Mount "nu" or "load"; for a CubicSystem "p1", "p2", ... or "f1", "f2", ...: the
            load's largest entry.
        values : array_like, shape (n,)

        Notes
        -----
        If the load comes within the tolerance of a mode among the values, it counts as resonant
        with it at all of them; otherwise the expansion is made anew at each.
        """
        names = tuple(self._load_names)
        load, vary = self._load_names[_native.choice("parameter", parameter, names)]
        where = _native.real_array(parameter, values, ndim=1)
        if not where.size:
            raise InputError("values: must hold at least one number")
        if vary == 1 and not where.min() > 0:
            raise InputError(f"{parameter} = {where.min():g}: must be greater than 0")
        room = 3 * where.size + 40
        while True:
            cancel = np.zeros(1, dtype=np.intc)
            n, which, a, frames, eigenvalues, harmonics, sizes = _native.call_interruptibly(
                core.scales_response, cancel, self._packed, *self._kernels, self.tolerance, load,
                vary, where, self._n, room, cancel,
            )  # fmt: skip
            if n <= room:
                break
            room = n
        kept = slice(n)
        # What the next order of the exponents, and the distance from free undamped motion, make
        # of the shifts of the modes that move, and these of the amplitudes.
        first = np.maximum(sizes[0, kept], 1e-300)
        ratio = np.maximum(sizes[1, kept] / first, np.sqrt(sizes[2, kept] / first))
        rate = np.abs(self.interaction + 1j * self.nonlinear_decay)
        size = np.abs(2 * a[:, kept])
        moves = size > 1e-9 * size.max(axis=0)
        shift = ((rate @ size**2) * moves).max(axis=0)
        off = np.abs(1j * frames[:, kept] - self.exponents[:, np.newaxis])
        distance = (off / self.frequencies[:, np.newaxis] * moves).max(axis=0)
        # The part of the load's wave outside its mode, which products leave out.
        p = (where if vary == 1 else np.full(where.size, self._drives[load - 1]))[which[kept] - 1]
        own = np.abs(frames[:, kept] - p) <= 1e-9 * p
        rest = harmonics[: self._n_dof, kept] - 2 * self.mode_shapes @ (a[:, kept] * own)
        distance = distance + 2 * np.abs(rest).max(axis=0) / first
        slowest = np.maximum(np.abs(eigenvalues[:, kept]).min(axis=0), 1e-300)
        error = first * (ratio**3 + shift * (ratio**2 + distance) / slowest)
        return ScalesResponse(
            parameter=parameter,
            values=where,
            index=which[kept] - 1,
            amplitudes=2 * a.T[kept],
            frequencies=frames.T[kept].copy(),
            eigenvalues=eigenvalues.T[kept].copy(),
            harmonics=harmonics.T[kept, : self._n_dof].copy(),
            order_sizes=sizes.T[kept].copy(),
            error_estimate=error,
            in_range=(ratio <= 0.3) & (error <= 0.3 * first),
            dof_names=self._names,
            plan=self._plan(
                f"computes: steady motions to third order at {where.size} values of {parameter} "
                f"from {where[0]:g} to {where[-1]:g}, with stability"
            ),
        )

    def backbone(self, mode: int, amplitudes: npt.ArrayLike) -> FloatArray:
        """Frequency of free vibration in one mode (from 0) at real amplitudes, same shape."""
        j = _native.integer("mode", mode, 0, self._n - 1)
        b = _native.real_array("amplitudes", amplitudes)
        return np.asarray(self.frequencies[j] + self.interaction[j, j] * b**2)

    def _plan(self, first: str) -> Plan:
        """Return a plan that begins with this line."""
        n_loads, quadratic, cubic = (int(self._packed[i]) for i in (4, 5, 6))
        lines = [first, f"computes: {len(self.terms)} terms of the modulation equations"]
        if not quadratic:
            lines.append("skips: terms of second order (no quadratic terms)")
        if not cubic:
            lines.append("skips: cubic terms (there are none)")
        silent = n_loads - int(np.any(self._loads != 0, axis=0).sum())
        if silent:
            lines.append(f"skips: {silent} of {n_loads} loads (amplitude 0)")
        if not isinstance(self.system, Mount) or not self.system._active_kernels:
            lines.append("skips: kernel transforms (no memory)")
        return Plan("\n".join(lines))

    @property
    def _drives(self) -> FloatArray:
        n_loads = int(self._packed[4])
        return self._tail(n_loads)[1]

    @property
    def _loads(self) -> FloatArray:
        return self._tail(int(self._packed[4]))[0]

    def _tail(self, n_loads: int) -> tuple[FloatArray, FloatArray]:
        """Loads, shape (n, n_loads), and their frequencies out of the packed numbers."""
        n = int(self._packed[0])
        end = self._packed.size - self._n * (2 * n + 1)
        drives = self._packed[end - n_loads : end]
        loads = self._packed[end - n_loads * (n + 1) : end - n_loads]
        return loads.reshape(n, n_loads, order="F"), drives

    def _run(
        self,
        t: npt.ArrayLike,
        initial: npt.ArrayLike | None,
        amplitudes: npt.ArrayLike | None,
        accuracy: float,
    ) -> tuple[Modulation, FloatArray, FloatArray]:
        times = _native.real_array("t", t, ndim=1)
        if not times.size or times[0] < 0 or (np.diff(times) < 0).any():
            raise InputError("t: must be one or more times, not negative and ascending")
        error = _native.number("accuracy", accuracy)
        if not 1e-14 <= error <= 1e-2:
            raise InputError(f"accuracy = {error:g}: must be in [1e-14, 1e-2]")
        if (initial is None) == (amplitudes is None):
            raise InputError("initial or amplitudes: must be given, and only one of them")
        n = self._n
        start, state = np.zeros(n, complex), np.zeros((n, 2))
        if amplitudes is not None:
            start = _native.complex_array("amplitudes", amplitudes, ndim=1) / 2
            if start.shape != (n,):
                raise InputError(f"amplitudes: must have shape ({n},), got {start.shape}")
        else:
            given = _native.real_array("initial", initial, ndim=1)
            if given.shape != (2 * n,):
                raise InputError(f"initial: must have shape ({2 * n},), got {given.shape}")
            state = np.asfortranarray(given.reshape(n, 2))
        cancel = np.zeros(1, dtype=np.intc)
        a, motion, sizes, frame, reached, steps, outcome = _native.call_interruptibly(
            core.scales_motion, cancel, self._packed, *self._kernels, self.tolerance,
            int(amplitudes is not None), start, state, times, error, 10_000_000, cancel,
        )  # fmt: skip
        if outcome:
            warnings.warn(
                f"the modulation equations end at t = {times[reached - 1] if reached else 0:g} "
                f"({_OUTCOMES[outcome]}): amplitudes beyond the range of the expansion",
                RangeWarning,
                stacklevel=4,
            )
        kept = slice(reached)
        modulation = Modulation(
            t=times[kept],
            complex_amplitudes=2 * a.T[kept],
            frame=frame,
            steps=int(steps),
            outcome=_OUTCOMES[outcome],
            plan=self._plan(f"computes: amplitudes in time, {times.size} times to {times[-1]:g}"),
        )
        states = np.ascontiguousarray(motion.transpose(2, 0, 1)[kept].reshape(-1, 2 * n))
        return modulation, states, np.ascontiguousarray(sizes.T[kept])


def _factors(row: Any) -> tuple[str, ...]:
    """Names of the factors of a term: amplitudes, then loads."""
    amplitudes = [f"a{k}" if k > 0 else f"a{-k}*" for k in map(int, row[:3]) if k]
    loads = [f"p{k}" if k > 0 else f"p{-k}*" for k in map(int, row[3:]) if k]
    return (*amplitudes, *loads)
