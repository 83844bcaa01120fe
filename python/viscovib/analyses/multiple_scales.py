"""The method of multiple scales to third order: modulation equations and their solutions."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, get_args

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.beat_stability import growth_of_neighbours
from viscovib.analyses.scales_form import ORDERINGS, ScalesForm
from viscovib.analyses.scales_terms import FlowTerm, formula, free_frequencies
from viscovib.common.counts import things
from viscovib.common.plan import Plan
from viscovib.errors import InputError, RangeWarning, caller
from viscovib.results.modulation import Modulation, Resonance
from viscovib.results.scales import (
    LEAST_FALL,
    ScalesMotion,
    ScalesResponse,
    falling,
)
from viscovib.systems.cubic_system import CubicSystem
from viscovib.systems.few_modes import few_modes
from viscovib.systems.oscillators import Oscillator
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.structure import Structure

#: Largest number of steps of the modulation equations.
_MOST_STEPS = 10_000_000
#: Points at which the error of a motion is computed, with interpolation between them: smallest and
#: largest number, and steps per point. Amplitudes are interpolated by cubics.
_KNOTS, _MOST_KNOTS, _STEPS_A_KNOT = 65, 1025, 5
#: Accuracy of the reference run for the error, relative to the accuracy and absolute.
_FINER, _FINEST = 1e-3, 3e-15
#: Tolerance that selects resonances by their influence.
_BY_INFLUENCE = -float(np.finfo(float).max)
#: Relative distance of internal resonances that free vibrations include.
_FREE_BAND = 0.2
#: Growth of modes at rest that the core returns without a nearby resonance.
_NOT_NEAR = -1e300
#: Largest amplitude whose powers do not overflow.
_MOST_AMPLITUDE = 1e75
#: Largest part of deflections that omitted modes may have without a warning.
_FEW_MODES = 1e-2
_OUTCOMES = ("complete", "overflow", "step limit", "cancelled")


class MultipleScales:
    """Multiple scales to third order for a system with nonlinear terms up to the third degree.

    Parameters
    ----------
    system : Pendulum, Mount, PolynomialSystem, CubicSystem or Structure
        A structure, reduced or not, in at most 6 of its modes.
    load : float or array_like, shape (n_dof,), optional
        For a Mount or a PolynomialSystem: amplitude of a harmonic force on the first coordinate, or
        of the forces on all, times cos(nu t). For a Structure the forces on all coordinates, or by
        name.
    nu : float, optional
        Circular frequency of this load (rad/s), > 0.
    tolerance : float, optional
        By default resonant terms are selected for each value of a response by their influence:
        coupling times amplitudes divided by the divisor, including parametric excitation of modes
        at rest. They enter the modulation equations in this order, as long as their frequencies are
        compatible. With a tolerance, frequencies that differ by less than this fraction of the
        highest frequency are resonant.
    ordering : {"general", "weak_coupling"}
        For a Pendulum: "weak_coupling" treats e as small, of the order of the amplitudes, as the
        paper on the pendulum does.
        Frequencies and shapes are then those of e = 0; e shifts them by terms up to e^2 in the
        modulation equations; e times cubic, e^2 times quadratic, e^3 times linear terms are
        dropped.
    modes : sequence of int, optional
        For a Structure: selected modes, by increasing frequency from 0; None: all, if there are at
        most 6. Results contain as many coordinates, those of elements first.

    Attributes
    ----------
    frequencies : ndarray, shape (n,)
        Natural circular frequencies, including damping.
    decay : ndarray, shape (n,)
        Amplitudes decrease as exp(-decay t); negative: unstable.
    mode_shapes : ndarray, shape (n_dof, n)
        Columns, the largest entry 1; complex with damping.
    interaction : ndarray, shape (n, n)
        gamma: the frequency of mode j is frequencies[j] + sum_k gamma[j, k] b_k^2 for real
        amplitudes b_k of the modes k.
    nonlinear_decay : ndarray, shape (n, n)
        The same for the decay.
    modes_left_out : float
        For a Structure: fraction of its elements' linear deflections under the load at nu that the
        selected modes do not contain; else 0.

    Notes
    -----
    The expansion is of third order, so the error of a motion decreases as the fourth power of its
    amplitude, as long as t stays within a fixed multiple of amplitude^-2. Loads near a natural
    frequency are of third order, other loads of first order, and damping is exact in the linear
    part. No other quantity is assumed to be small (no coupling, no divisor).

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> body = vv.Pendulum(
    ...     e=0.1, w2=0.4, w3=0.8, alpha=0.5, c1=0.01, c2=0.01, c3=0.01, f0=0.002, p1=1.02
    ... )
    >>> scales = vv.MultipleScales(body)
    >>> steady = scales.response("p1", np.linspace(1.0, 1.05, 20))
    """

    dof_names: ClassVar[tuple[str, ...]]

    def __init__(
        self,
        system: Pendulum | Oscillator | CubicSystem | Structure,
        *,
        load: npt.ArrayLike | Mapping[str, float] | None = None,
        nu: float | None = None,
        tolerance: float | None = None,
        ordering: str = "general",
        modes: Sequence[int] | None = None,
    ) -> None:
        self.tolerance = None if tolerance is None else _native.number("tolerance", tolerance)
        if self.tolerance is not None and not 0 <= self.tolerance < 1:
            raise InputError(f"tolerance = {self.tolerance:g}: must be in [0, 1)")
        #: The tolerance for the core.
        self._tolerance = _BY_INFLUENCE if self.tolerance is None else self.tolerance
        names: tuple[str, ...] | None = None
        forces: Any = load
        if isinstance(load, np.ndarray) and np.iscomplexobj(load) and not load.imag.any():
            forces = load.real  # as `Body.load` returns it
        self.modes_left_out = 0.0
        if isinstance(system, Structure):
            few = few_modes(system, modes, load, None if nu is None else _native.number("nu", nu))
            system, forces, names = few.system, few.load, few.names
            self.modes_left_out = few.left_out
            self._warn_of_modes()
        elif modes is not None:
            raise InputError("modes: are for a Structure, must be None")
        self.system = system
        self.ordering = _native.choice("ordering", ordering, ORDERINGS)
        known = (Pendulum, *get_args(Oscillator), CubicSystem, Structure)
        _native.check_instance("system", system, *known)
        if not isinstance(system, Oscillator) and not (load is None and nu is None):
            raise InputError(
                "load, nu: are for a Mount or a PolynomialSystem, other systems contain their loads"
            )
        if not isinstance(system, Pendulum) and ordering != "general":
            raise InputError(f"ordering = {ordering!r}: is for a Pendulum, must be 'general'")
        self._names = system.dof_names if names is None else names
        self._form = ScalesForm.of(system, forces, nu, self.ordering)
        self._n_dof, self._n = self._form.n_dof, self._form.n
        found = self._form.equations(self._tolerance)
        exponents, interaction = found["exponents"], found["interaction"]
        self.exponents: ComplexArray = exponents
        self.frequencies: FloatArray = exponents.imag.copy()
        self.decay: FloatArray = -exponents.real
        shapes = np.ascontiguousarray(found["shapes"][: self._n_dof])
        self.mode_shapes = shapes if np.any(shapes.imag) else shapes.real.copy()
        self.interaction: FloatArray = np.ascontiguousarray(interaction.imag)
        self.nonlinear_decay: FloatArray = np.ascontiguousarray(-interaction.real)
        self.frame: FloatArray = found["frame"]
        #: Units for the comparison of different coordinates.
        self._units: FloatArray = found["units"][: self._n_dof].copy()
        self.autonomous = bool(found["autonomous"])
        self.terms: tuple[FlowTerm, ...] = found["terms"]
        if (self.decay < -1e-12 * self.frequencies).any():
            j = int(self.decay.argmin())
            warnings.warn(
                f"mode {j + 1} is unstable without load: its amplitude grows at the rate "
                f"{-self.decay[j]:.6g}",
                RangeWarning,
                stacklevel=caller(),
            )

    def _repr_latex_(self) -> str:
        return f"$${self.formula()}$$"

    def formula(self) -> str:
        """Return the solution with its orders in LaTeX; notebooks show it as a formula.

        The coordinates are sums of the modes with slow complex amplitudes a_j. The modulation
        equations follow, ordered by the number of amplitudes and loads p_k in each term.
        """
        return formula(self.terms, self._names, self._n)

    def _warn_of_modes(self) -> None:
        if self.modes_left_out > _FEW_MODES:
            warnings.warn(
                f"modes: the selected modes do not contain {self.modes_left_out:.2g} of the "
                "deflections of the elements under the load",
                RangeWarning,
                stacklevel=caller(),
            )

    def resonances(self, tolerance: float = 0.05) -> tuple[Resonance, ...]:
        """List all resonance conditions up to third order, the nearest first.

        Natural frequencies are w1, w2, ..., frequencies of loads p1, p2, ...; ``near`` is True if
        the divisor is within ``tolerance``.
        """
        limit = _native.number("tolerance", tolerance)
        if not 0 <= limit < 1:
            raise InputError(f"tolerance = {limit:g}: must be in [0, 1)")
        # The constant load that represents e is not a load of the user.
        loads = [load for load, _ in self._form.load_names.values()]
        drives = self._form.drives[: max(loads, default=0)]
        acting = np.flatnonzero(np.any(self._form.loads[:, : drives.size] != 0, axis=0))
        found = _native.run("scales resonances", natural=self.frequencies, drives=drives[acting])
        divisors = found["divisors"]
        names = (*(f"w{j + 1}" for j in range(self._n)), *(f"p{k + 1}" for k in acting))
        order = np.argsort(divisors, kind="stable")
        columns = (
            map(tuple, found["coefficients"][:, order].T.tolist()),
            found["orders"][order].tolist(),
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
        """Integrate the modulation equations: amplitudes and phases at times t.

        Parameters
        ----------
        t : array_like, shape (n,)
            Times >= 0, ascending.
        initial : array_like, shape (2 n_dof,)
            State (q1, q1', q2, q2', ...) at t = 0.
        amplitudes : array_like, complex, shape (n_modes,)
            Instead of ``initial``: b_j exp(i phase_j) at t = 0.
        accuracy : float
            Allowed error per step, relative to the largest amplitude, 1e-14 to 1e-2.
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
        """Return the motion to third order at times t; arguments as for `modulation`."""
        modulation, state, sizes, _ = self._run(t, initial, amplitudes, accuracy)
        result = ScalesMotion(
            t=modulation.t,
            state=state,
            modulation=modulation,
            order_sizes=sizes[:, :3].copy(),
            _units=self._units / sizes[:, 3:],
            mode_shapes=self.mode_shapes,
            dof_names=self._names,
            _errors=partial(self._motion_errors, modulation),
            plan=modulation.plan,
        )
        ratio = falling(sizes)
        if ratio.size and ratio.max() > LEAST_FALL:
            at = int(np.argmax(ratio > LEAST_FALL))
            warnings.warn(
                f"at t = {modulation.t[at]:g} the motion leaves the range of the expansion: "
                f"the sizes of the orders are {sizes[at, 0]:.3g}, {sizes[at, 1]:.3g}, "
                f"{sizes[at, 2]:.3g}",
                RangeWarning,
                stacklevel=caller(),
            )
        return result

    def _motion_errors(self, modulation: Modulation) -> FloatArray:
        """Estimated error of each coordinate at the times of a motion, shape (n, n_dof)."""
        t = modulation.t
        n_knots = min(max(_KNOTS, modulation.steps // _STEPS_A_KNOT), _MOST_KNOTS)
        knots = np.unique(np.concatenate([[0.0], np.linspace(0, t[-1], n_knots)]))
        if knots.size == 1:
            knots = np.array([0.0, 1e-9 / self.frequencies.max()])
        start = modulation.initial
        at_knots, _, _, expected = self._run(knots, None, start, 1e-8)
        found = self._found(
            "errors", times=at_knots.t, amplitudes=at_knots.complex_amplitudes.T / 2,
            expected=expected,
        )  # fmt: skip
        return np.column_stack([np.interp(t, at_knots.t, row) for row in found["errors"]])

    def _found(self, task: str, **values: Any) -> dict[str, Any]:
        """Run a task on the expansion such that Ctrl-C works."""
        handle, tolerance = self._form.handle, float(self._tolerance)
        return _native.interruptible(
            lambda: _native.run(f"scales {task}", handle, tolerance=tolerance, **values)
        )

    def response(self, parameter: str, values: npt.ArrayLike) -> ScalesResponse:
        """Return all steady motions, stable or not, over a load's frequency or amplitude.

        Parameters
        ----------
        parameter : str
            For a Pendulum "p1", "p2", "p3" (frequencies) or "f0", "m01", "m02" (amplitudes); for a
            Mount "nu" or "load"; for a CubicSystem "p1", "p2", ... or "f1", "f2", ...: the largest
            entry of the load.
        values : array_like, shape (n,)

        Notes
        -----
        The expansion is computed for each value separately, about the static equilibrium under
        constant loads.

        If the amplitudes beat, the modulation equations are integrated from rest and from
        stationary amplitudes until they settle. The motion then consists of lines:
        ``beating(point)``. Only attracting beating motions are found.
        """
        names = tuple(self._form.load_names)
        load, vary = self._form.load_names[_native.choice("parameter", parameter, names)]
        where = _native.real_array(parameter, values, ndim=1)
        if not where.size:
            raise InputError("values: must contain at least one number")
        if vary == 1 and not where.min() > 0:
            raise InputError(f"{parameter} = {where.min():g}: must be greater than 0")
        found = self._steady(load, vary, where, False)
        sizes, resting = found["sizes"].T, found["resting"]
        self._warn_of_beats(found["left_out"])
        may_lack = found["may_lack"] != 0
        self._warn_of_lack(parameter, where[may_lack])
        acting = np.flatnonzero(self._form.drives > 0)
        return ScalesResponse(
            parameter=parameter,
            values=where,
            index=found["which"] - 1,
            amplitudes=2 * found["amplitudes"].T,
            frequencies=found["frames"].T.copy(),
            eigenvalues=found["eigenvalues"].T.copy(),
            harmonics=found["harmonics"].T.copy(),
            order_sizes=sizes[:, :3].copy(),
            left_out=found["left_out"],
            resting_growth=np.where(resting > _NOT_NEAR, resting, -np.inf),
            n_beats=found["beats"],
            may_lack=may_lack,
            _lines=(found["line_of"] - 1, found["line_frequencies"], found["lines"].T),
            _loads={f"p{k + 1}": float(self._form.drives[k]) for k in acting},
            _varied=f"p{load}" if vary == 1 else "",
            _perturbed=partial(self._growth_nearby, parameter),
            _units=self._units / sizes[:, 3:],
            dof_names=self._names,
            _errors=partial(self._steady_errors, load, vary, where),
            plan=self._plan(
                f"computes: steady motions to third order at {things(where.size, 'value')} of "
                f"{parameter} from {where[0]:g} to {where[-1]:g}, with stability"
            ),
        )

    def _growth_nearby(
        self,
        parameter: str,
        value: float,
        frequencies: FloatArray,
        harmonics: ComplexArray,
        errors: FloatArray,
    ) -> tuple[float, float]:
        return growth_of_neighbours(
            self.system, {parameter: value}, frequencies, harmonics, errors, self.decay.min()
        )

    def _steady_errors(
        self, load: int, vary: int, where: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        found = self._steady(load, vary, where, True)
        return (
            np.ascontiguousarray(found["harmonic_errors"].T),
            np.ascontiguousarray(found["motion_errors"].T),
            found["growth_errors"],
        )

    def _steady(self, load: int, vary: int, where: FloatArray, errors: bool) -> dict[str, Any]:
        return self._found("response", load=load, vary=vary, values=where, with_errors=errors)

    def backbone(self, mode: int, amplitudes: npt.ArrayLike) -> FloatArray:
        """Return the frequency of free vibration in one mode (from 0) at real amplitudes.

        The shape is that of ``amplitudes``. If an internal resonance couples the mode with a second
        mode (as w2 ~ 2 w1 does for mode 1), both move together in several ways: the result then has
        one more axis over these, frequencies ascending, NaN for missing ones. A warning is printed
        for amplitudes beyond the range of the expansion. Damping is omitted.
        """
        j = _native.integer("mode", mode, 0, self._n - 1)
        b = _native.real_array("amplitudes", amplitudes)
        if not b.size:
            raise InputError("amplitudes: must not be empty")
        if np.abs(b).max() > _MOST_AMPLITUDE:
            raise InputError(
                f"amplitudes: {np.abs(b).max():g} is out of range, must be at most "
                f"{_MOST_AMPLITUDE:g}"
            )
        self._warn_beyond(j, float(np.abs(b).max()))
        wide = _FREE_BAND if self.tolerance is None else self.tolerance
        terms = [
            x for x in self._form.equations(wide)["terms"] if not any("p" in f for f in x.factors)
        ]
        return free_frequencies(j, b, terms, self.frequencies, self.interaction)

    def _n_loads(self) -> int:
        """Number of loads that act, without constant loads."""
        return int((self._form.loads.any(axis=0) & (self._form.drives != 0)).sum())

    def _warn_of_lack(self, parameter: str, values: FloatArray) -> None:
        """Warn of values at which motions do not fit the common set of frequencies."""
        if values.size:
            warnings.warn(
                f"at {things(values.size, 'value')} of {parameter} (the first is {values[0]:g}) "
                "subharmonic or superharmonic motions of one load may be missing, since their "
                "frequency contradicts that of resonances with other loads: compute them with "
                "one load at a time, or by simulate",
                RangeWarning,
                stacklevel=caller(),
            )

    def _warn_of_beats(self, left_out: FloatArray) -> None:
        """Warn of beating motions, and name a function that computes them."""
        beats = int((left_out > LEAST_FALL).sum())
        if not beats or self._n_loads() < 2:
            return
        exact = "forced_response" if isinstance(self.system, Pendulum) else "simulate"
        warnings.warn(
            f"{beats} of {left_out.size} motions are quasi-periodic with beating amplitudes, "
            "but no beats with the frequencies of the loads were found (in_range is False): "
            f"use motion(t), or {exact} for the full equations",
            RangeWarning,
            stacklevel=caller(),
        )

    def _warn_beyond(self, j: int, amplitude: float) -> None:
        """Warn if the orders do not decrease at this amplitude of mode j."""
        start = np.zeros(self._n, dtype=complex)
        start[j] = amplitude
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RangeWarning)
            sizes = self._run([0.0], None, start, 1e-8)[2]
        if not sizes.size or falling(sizes).max() > LEAST_FALL:
            warnings.warn(
                f"amplitude {amplitude:g} of mode {j} is beyond the range of the expansion: "
                "the orders do not decrease",
                RangeWarning,
                stacklevel=caller(),
            )

    def _plan(self, first: str) -> Plan:
        """Return a plan that begins with this line."""
        n_loads, quadratic, cubic = (int(self._form.packed[i]) for i in (4, 5, 6))
        lines = [first, f"computes: {things(len(self.terms), 'term')} of the modulation equations"]
        if not quadratic:
            lines.append("skips: terms of second order (no quadratic terms)")
        if not cubic:
            lines.append("skips: cubic terms (there are none)")
        silent = n_loads - int(np.any(self._form.loads != 0, axis=0).sum())
        if silent:
            lines.append(f"skips: {silent} of {n_loads} loads (amplitude 0)")
        if not isinstance(self.system, Oscillator) or not self.system._active_kernels:
            lines.append("skips: kernel transforms (no memory)")
        return Plan("\n".join(lines))

    def _run(
        self,
        t: npt.ArrayLike,
        initial: npt.ArrayLike | None,
        amplitudes: npt.ArrayLike | None,
        accuracy: float,
    ) -> tuple[Modulation, FloatArray, FloatArray, FloatArray]:
        times = _native.real_array("t", t, ndim=1)
        if not times.size or times[0] < 0 or (np.diff(times) < 0).any():
            raise InputError("t: must be one or more times, not negative and ascending")
        error = _native.number("accuracy", accuracy)
        if not 1e-14 <= error <= 1e-2:
            raise InputError(f"accuracy = {error:g}: must be in [1e-14, 1e-2]")
        if (initial is None) == (amplitudes is None):
            raise InputError("initial or amplitudes: give exactly one of them")
        n = self._n
        given_start: dict[str, Any]
        if amplitudes is not None:
            start = _native.complex_array("amplitudes", amplitudes, ndim=1) / 2
            if start.shape != (n,):
                raise InputError(f"amplitudes: must have shape ({n},), got {start.shape}")
            given_start = {"start": start}
        else:
            given = _native.real_array("initial", initial, ndim=1)
            if given.shape != (2 * n,):
                raise InputError(f"initial: must have shape ({2 * n},), got {given.shape}")
            given_start = {"state": given.reshape(n, 2)}
        found = self._found(
            "motion", **given_start, times=times, accuracy=error, max_steps=_MOST_STEPS
        )
        outcome, reached = found["outcome"], found["amplitudes"].shape[1]
        if outcome:
            warnings.warn(
                f"the modulation equations end at t = {times[reached - 1] if reached else 0:g} "
                f"({_OUTCOMES[outcome]}): amplitudes beyond the range of the expansion",
                RangeWarning,
                stacklevel=caller(),
            )
        reached_ones = 2 * found["amplitudes"].T
        modulation = Modulation(
            t=times[:reached],
            complex_amplitudes=reached_ones,
            frame=found["frame"],
            initial=2 * found["first"],
            error=self._integration_error(reached_ones, given_start, times, error),
            steps=found["n_steps"],
            outcome=_OUTCOMES[outcome],
            plan=self._plan(
                f"computes: amplitudes in time, {things(times.size, 'time')} to {times[-1]:g}"
            ),
        )
        states = np.ascontiguousarray(found["motion"].transpose(2, 0, 1).reshape(-1, 2 * n))
        return modulation, states, np.ascontiguousarray(found["sizes"].T), found["expected"]

    def _integration_error(
        self,
        amplitudes: ComplexArray,
        given: dict[str, Any],
        times: FloatArray,
        accuracy: float,
    ) -> FloatArray:
        """Error of amplitudes in time: change with much finer steps, and rounding errors."""
        least = max(_FINER * accuracy, _FINEST)
        found = self._found("motion", **given, times=times, accuracy=least, max_steps=_MOST_STEPS)
        finer, steps = found["amplitudes"].T, found["n_steps"]
        off = np.full(len(amplitudes), np.inf)
        n = min(len(off), len(finer))
        off[:n] = np.abs(2 * finer[:n] - amplitudes[:n]).max(axis=1, initial=0.0)
        sizes = np.maximum.accumulate(np.abs(amplitudes).max(axis=1, initial=0.0))
        eps = float(np.finfo(float).eps)
        # The first steps may be equal.
        return np.asarray(off + (least + eps * np.sqrt(max(steps, 1))) * sizes)
