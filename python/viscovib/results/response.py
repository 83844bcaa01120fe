"""Steady forced responses: amplitudes of each harmonic over a frequency range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.column_notes import NOTES
from viscovib.common.counts import things
from viscovib.common.motion_stability import codes_of
from viscovib.common.periodic_motions import PeriodicMotions
from viscovib.common.plan import Plan, wanted_places
from viscovib.common.results import Dataset, Number, Panel, Result, as_dataset, named, span
from viscovib.common.tables import Table
from viscovib.errors import InputError
from viscovib.results.dissipation import Parts
from viscovib.results.extrapolation import check_orders, extrapolated
from viscovib.results.sampling import (
    add_requested,
    lost_energy,
    rounding_errors,
    sampling_errors,
    sampling_text,
)
from viscovib.systems.load import Job

#: Largest number of multiplications for the search of peaks between all frequencies.
MAX_SEARCH = 3e9
#: Largest number of halvings of a frequency interval with several modes of a linear response.
_HALVINGS = 24
#: Largest relative variation in a short interval about a maximum, and smallest interval.
_FLAT, _SHORTEST = 1e-6, 1e-15
#: A few ulps of a frequency; relative size of a component that counts as rounding error.
_ULPS, _NOTHING = 1e-15, 1e-13
#: Values at 1/4 and 3/4 of a parabola from its ends and its middle.
_PARABOLA = np.array([[3, 6, -1], [-1, 6, 3]]) / 8


class Peak(NamedTuple):
    """Largest amplitude in a frequency range.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> response = vv.forced_response(mount, np.linspace(0.5, 12, 100), load=0.1)
    >>> nu, amplitude, enclosed = response.peak("x")
    >>> enclosed
    True
    """

    nu: float
    amplitude: float
    #: True for a maximum inside the range. False if the largest amplitude lies at the end of the
    #: range, next to a point without a solution, or at a jump to a second branch.
    enclosed: bool


@dataclass(frozen=True, eq=False, repr=False)
class Response(PeriodicMotions, Result):
    """Steady response u(t) = Im sum_k X_k exp(i k nu t).

    Attributes
    ----------
    nu : ndarray, shape (n,)
        Circular frequencies of the load (rad/s).
    harmonics : ndarray of int, shape (m,)
        Harmonics k that are kept at any frequency.
    coefficients : ndarray, complex, shape (n, n_dof, m)
        X_k (m, rad); NaN without a solution, 0 for harmonics that are not kept at this frequency.
    outcome : ndarray of str, shape (n,)
        "converged", "stalled", "diverged", "singular" (undamped resonance) or "overflow" (the
        solution exceeds the range of floating-point numbers).
    iterations : ndarray of int, shape (n,)
        Number of iterations.
    rate : ndarray, shape (n,)
        Ratio of the last corrections.
    highest : ndarray of int, shape (n,)
        Highest harmonic of each frequency; 0 without a solution.
    truncation : ndarray, shape (n,)
        Estimated relative error by neglected harmonics, in the norm of ``tolerance``; 0 for a
        linear response. It is the largest change of any harmonic by the residual of the neglected
        harmonics. If rounding keeps the corrections of Newton's method above the tolerance, it is
        at least the rounding error. For successive approximations with non-polynomial forces it
        includes the error of the samples.
    method : str
        The method that was used; "auto" if ``methods`` contains two different methods.
    methods : ndarray of str, shape (n,)
        The method that computed each motion: "linear", "successive" or "newton". Without a
        solution, the last method that was tried.
    stable : ndarray of bool, shape (n,), or None
        Stability of each motion; None: not requested. If it is unknown for some motions, the array
        contains objects: True, False and None.
    multipliers, exponents : complex ndarray, shape (n, m), or None
        As in `Branch`; NaN if unknown.
    slowest : ndarray of bool, shape (n,), or None
        As in `Branch`: True if the first multiplier is certainly the largest.
    power : ndarray, shape (n,), or None
        For `extrapolated` motions: the measured power p of the convergence K^-p; NaN for a motion
        that was not extrapolated. None for other responses.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> response = vv.forced_response(mount, np.linspace(0.5, 12, 100), load=0.1)
    >>> peak = response.peak("x")
    >>> solved = response.converged  # elsewhere its numbers are NaN
    """

    nu: FloatArray
    harmonics: npt.NDArray[np.int32]
    coefficients: ComplexArray
    outcome: npt.NDArray[np.str_]
    iterations: npt.NDArray[np.int32]
    rate: FloatArray
    highest: npt.NDArray[np.int32]
    truncation: FloatArray
    method: str
    dof_names: tuple[str, ...]
    dof_units: tuple[str, ...]
    #: The run, which can be repeated.
    _work: Any = field(repr=False)
    #: Creates the plan.
    _planned: Callable[[], Plan] = field(repr=False)
    #: System and load for the core, and the relative tolerance.
    _job: Job = field(repr=False)
    _tolerance: float = field(repr=False)
    #: Allowed relative error of each motion, including the absolute tolerance.
    _allowed: FloatArray = field(repr=False)
    stable: npt.NDArray[Any] | None = None
    multipliers: ComplexArray | None = None
    exponents: ComplexArray | None = None
    slowest: npt.NDArray[np.bool_] | None = None
    power: FloatArray | None = None
    #: The method of each motion, if they differ.
    _methods: npt.NDArray[np.str_] | None = field(default=None, repr=False)
    #: Data for the energy loss of the motions.
    _parts: Parts | None = field(default=None, repr=False)
    #: Additional columns requested by a scene.
    _extra_columns: tuple[str, ...] = field(default=(), repr=False)

    kind = "response"
    _form = "response"

    @property
    def _along(self) -> tuple[FloatArray, str, bool]:
        """The varied parameter: values, label, and True if it is a circular frequency (rad/s)."""
        return self.nu, r"circular frequency of the load $\nu$ (rad/s)", True

    @property
    def converged(self) -> npt.NDArray[np.bool_]:
        """True where a solution was found, shape (n,)."""
        return np.asarray(self.outcome == "converged")

    @property
    def methods(self) -> npt.NDArray[np.str_]:
        """The method that computed each motion, shape (n,)."""
        return np.full(self.nu.size, self.method) if self._methods is None else self._methods

    @cached_property
    def plan(self) -> Plan:
        """What was computed, and what was skipped and why; created on first access."""
        return self._planned()

    @cached_property
    def corrections(self) -> FloatArray:
        """Relative size of each correction, shape (n, iterations); NaN after the last one.

        The first access repeats the computation, because the first run does not store corrections.
        Newton's method stores none: shape (n, 0).
        """
        return np.asarray(self._work.corrections(int(self.iterations.max(initial=0))))

    @cached_property
    def iterates(self) -> ComplexArray:
        """Successive iterates X_k, shape (1 + iterations, n, n_dof, m); NaN after the last one.

        The first iterate is the linear response, the last one is the result. The first access
        repeats the computation with the harmonics of the result. Frequencies that another method
        solved show the iteration that does not converge. A linear response has only one iterate.

        Examples
        --------
        >>> import viscovib as vv
        >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
        >>> response = vv.forced_response(duffing, [0.5], load=0.1)
        >>> first = abs(response.iterates[:3, 0, 0, 0])
        >>> print(*first.round(5))
        0.13304 0.13083 0.13094
        """
        if self.method == "linear":
            return self.coefficients[np.newaxis]
        if self.dof_names != self._computed_names:
            raise InputError("iterates: are available for mounts and polynomial systems only")
        longest = int(self.iterations[self.methods == "successive"].max(initial=1))
        found: ComplexArray = self._work.iterates(longest, int(self.harmonics[-1]))
        # Relative to the base; the base motion is the same in each.
        solved = np.nan_to_num(self.coefficients)
        assert self._parts is not None
        moved = solved - self._parts.relative(self.harmonics, solved, np.ones(self.nu.size))
        return found[..., : self.harmonics.size] + moved

    @property
    def _computed_names(self) -> tuple[str, ...]:
        """Coordinates that the core computes."""
        return self.dof_names if self._job.n_dof == len(self.dof_names) else ()

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        return self.nu, self.harmonics, self.coefficients

    def amplitude(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """Return abs(X_k) of one coordinate, shape (n,)."""
        return np.abs(self.coefficient(dof, harmonic))

    def peak(
        self, dof: int | str, harmonic: int = 1, *, band: tuple[float, float] | None = None
    ) -> Peak:
        """Return the largest amplitude in a range of nu (default: all), located between the points.

        If the derivatives of two neighbouring motions indicate a maximum, or if the motions do not
        belong to one branch, the branch is followed through all maxima between them. So the
        amplitude is accurate to the tolerance on coarse grids too. ``enclosed`` is False if the
        largest amplitude lies at the end of the range, at a jump to a second branch, or if the
        component is 0 within the rounding error of the other components. For a linear response the
        amplitude is inf if a resonance is undamped or narrower than the rounding error of its
        frequency.
        """
        inside = self.converged
        if band is not None:
            low, high = band_of(band)
            inside = inside & (self.nu >= low) & (self.nu <= high)
        if not inside.any():
            raise InputError(f"band = {band}: contains no frequency with a solution")
        amplitude = self.amplitude(dof, harmonic)
        places = np.flatnonzero(inside)
        _, first = np.unique(self.nu[places], return_index=True)
        places = places[first]
        summit = None
        if places.size > 1 and not only_rounding(amplitude[places], self.coefficients[places]):
            j = int(np.flatnonzero(self.harmonics == harmonic)[0])
            summit = self._summit(places, self._dof(dof), j)
        i = int(np.where(inside, amplitude, -1.0).argmax())
        if summit is None or summit[1] < amplitude[i]:
            return Peak(float(self.nu[i]), float(amplitude[i]), enclosed=False)
        return Peak(*summit, enclosed=True)

    def _summit(self, places: npt.NDArray[np.intp], d: int, j: int) -> tuple[float, float] | None:
        """Largest maximum between motions at ascending frequencies, or None."""
        if self.method == "linear":
            return _linear_summit(self, places, d, j)
        highest = int(self.highest[places].max())
        kept = np.flatnonzero(self.harmonics <= highest)
        if j >= kept.size:
            return None
        unknowns = 2 * kept.size * len(self.dof_names)
        return find_peak(
            self._job, self.harmonics[kept], self.nu[places],
            self.coefficients[places][:, :, kept], (d, j), self._tolerance,
            at_nu=self.nu[places[0]], keep_idle=False,
            wide=places.size * unknowns**3 < MAX_SEARCH,
        )  # fmt: skip

    def _linear_sizes(self, d: int, j: int, nu: FloatArray) -> FloatArray:
        """Amplitudes of a linear response at any frequencies."""
        return np.abs(self._linear_component(d, j, nu))

    def _linear_component(self, d: int, j: int, nu: FloatArray) -> ComplexArray:
        return np.asarray(self._linear_motions(nu)[:, d, j])

    def _linear_motions(self, nu: FloatArray) -> ComplexArray:
        """X_k of the coordinates that the core computes, shape (n, n_dof, m)."""
        if self._work.request.direct is not None:
            return np.asarray(self._work.request.direct(nu)["coefficients"].T)
        return np.asarray(self._job.run("response solve", nu=nu, method="linear")["coefficients"].T)

    @cached_property
    def sampling(self) -> FloatArray:
        """Estimated relative error of each motion by sampling of its forces, shape (n,).

        Forces that are not polynomials are sampled over a period, with more samples until the
        harmonics are accurate to 1e-7, or they are integrated between switches. The estimate
        evaluates the residual with four times the samples and converts it into a change of the
        motion. Twice this change, in the norm of ``tolerance``, is returned. It is 0 for polynomial
        forces and linear motions, and NaN if it is unknown or no motion was found. Neglected
        harmonics are a separate error, ``truncation``. The first access takes as long as one Newton
        step per motion.

        Examples
        --------
        >>> import viscovib as vv
        >>> friction = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.1*tanh(x_dot/0.1)")
        >>> r = vv.forced_response(friction, [0.8], load=0.3, method="newton", harmonics=15)
        >>> bool(r.sampling[0] < 1e-9 < r.truncation[0])
        True
        """
        finest: Response | None = self.__dict__.get("_finest")
        if finest is not None:
            return finest.sampling
        if self.method == "linear":
            return np.where(self.converged, 0.0, np.nan)
        job = self._job.along(at_nu=self.nu[0])
        return sampling_errors(self, job, self.nu, self._relative(np.ones(self.nu.size)))

    @cached_property
    def error(self) -> FloatArray:
        """Estimated relative error of each motion as a solution of its equations, shape (n,).

        It contains the remaining correction and the rounding error: the unit roundoff times the
        condition of the equations, which in resonance is 1 divided by the damping. It is given in
        the norm of ``tolerance``; NaN if it is unknown or no motion was found. Neglected harmonics
        (``truncation``) and samples (``sampling``) are separate errors. The first access takes as
        long as one Newton step per motion.

        Examples
        --------
        >>> import viscovib as vv
        >>> light = vv.PolynomialSystem(mass=1, stiffness=1, damping=1e-9)
        >>> r = vv.forced_response(light, [0.5, 1 + 1e-9], load=1e-9, method="linear")
        >>> bool(r.error[0] < 1e-14 < 1e-8 < r.error[1])
        True
        """
        finest: Response | None = self.__dict__.get("_finest")
        if finest is not None:
            return finest.error
        motions = self._relative(np.ones(self.nu.size))
        return rounding_errors(self, self._job, motions, linear=self.method == "linear")

    def _relative(self, factors: FloatArray) -> ComplexArray:
        """Motions relative to the base, of the coordinates that the core computes."""
        assert self._parts is not None
        return self._parts.relative(self.harmonics, self.coefficients, factors)

    def dissipation(self) -> FloatArray:
        """Return the energy loss of each motion per period (J), shape (n, 1 + n_groups).

        For a `PolynomialSystem` the columns are the loss by ``damping`` together with its own
        springs and forces (laws of rates, kernels), then by each of its ``springs``: pi sum_k k
        Im(F_k conj(U_k)) with the harmonics of force and relative motion. Their sum is the work of
        load and base per period. The result is exact for the harmonics kept. Laws with kinks or
        jumps use 16384 samples and are accurate to about 1e-6. NaN where no motion was found.

        Examples
        --------
        >>> import numpy as np
        >>> import viscovib as vv
        >>> pendulum = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.1*x_dot*abs(x_dot)")
        >>> r = vv.forced_response(pendulum, [1.0], load=0.2, method="newton", harmonics=15)
        >>> bool(abs(r.dissipation().sum() + np.pi * 0.2 * r.coefficient("x", 1).imag[0]) < 1e-6)
        True
        """
        assert self._parts is not None
        linear = self.method == "linear"
        return self._parts.dissipated(
            self.nu, self.harmonics, self._whole(), np.ones(self.nu.size), linear=linear
        )

    def _energy_loss(self) -> FloatArray:
        """Energy loss of each motion per period by all forces (J), shape (n,)."""
        ones = np.ones(self.nu.size)
        linear = self.method == "linear"
        return lost_energy(self, self._job, ones, self._relative(ones), linear=linear)

    def _whole(self) -> ComplexArray:
        """X_k of all coordinates."""
        return self.coefficients

    def extrapolated(self, middle: Response, coarse: Response) -> Response:
        """Return these motions extrapolated to infinitely many harmonics.

        If a force jumps, as with dry friction, harmonics converge slowly, X(K) = X + C K^-p. The
        power p follows from three responses with different numbers of harmonics (Richardson, Phil.
        Trans. A 226, 1927) and is stored in ``power``. ``truncation`` is then the estimated error
        of the extrapolated motion. A motion stays unchanged if no power up to 2 fits, if it would
        change by more than twice its error estimate, or if extrapolation does not improve it.

        Extrapolation does not improve forces with kinks, such as gaps.

        Parameters
        ----------
        middle, coarse : Response
            Responses of the same system, load and frequencies. The highest harmonics should differ
            by factors of about 2, and the lowest number must resolve the jumps.

        Examples
        --------
        Den Hartog's friction oscillator without stops, of the amplitude 2.711415:

        >>> import warnings
        >>> import viscovib as vv
        >>> friction = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.2*sign(x_dot)")
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("ignore", vv.ConvergenceWarning)
        ...     fine, middle, coarse = (
        ...         vv.forced_response(friction, [0.8], load=1, method="newton", harmonics=k)
        ...         for k in (99, 49, 25)
        ...     )
        >>> best = fine.extrapolated(middle, coarse)
        >>> round(float(fine.peak_to_peak("x")[0]) / 2, 5)
        2.71097
        >>> round(float(best.peak_to_peak("x")[0]) / 2, 5), round(float(best.power[0]), 2)
        (2.71142, 1.0)
        """
        three = (coarse, middle, self)
        for name, one in (("middle", middle), ("coarse", coarse)):
            if type(one) is not type(self):
                raise InputError(f"{name}: must be a Response, got {type(one).__name__}")
            if one.dof_names != self.dof_names or not np.array_equal(one.nu, self.nu):
                raise InputError(f"{name}: must be of the same frequencies and coordinates")
        check_orders([int(one.harmonics.max(initial=0)) for one in three])
        coefficients, truncation = self.coefficients.copy(), self.truncation.copy()
        power = np.full(self.nu.size, np.nan)
        for i in np.flatnonzero(self.converged & middle.converged & coarse.converged):
            row = [(one.harmonics, one.coefficients[i], int(one.highest[i])) for one in three]
            found = extrapolated(row, float(truncation[i]))
            if found is not None:
                coefficients[i], truncation[i], power[i] = found
        result = replace(self, coefficients=coefficients, truncation=truncation, power=power)
        # It does not solve the truncated equations; its errors are those of this response.
        result.__dict__["_finest"] = self
        return result

    @property
    def complete(self) -> bool:  # type: ignore[override]
        """True if all frequencies are solved with enough harmonics."""
        return bool(self.converged.all()) and not self._short

    @property
    def _short(self) -> int:
        """Number of motions with too few harmonics."""
        return int((self.truncation > self._allowed).sum())

    def _headline(self) -> str:
        short = f", {self._short} of them with too few harmonics" if self._short else ""
        total = things(self.nu.size, "frequency", "frequencies")
        return f"{self.converged.sum()} of {total} solved{short}"

    def _scope(self) -> list[str]:
        worst = np.nanmax(self.truncation, initial=0.0)
        return [
            f"nu: {span(self.nu, 'rad/s')}; {named(self.dof_names, self.dof_units)}",
            f"method {self.method}, harmonics up to {self.highest.max(initial=0)}, estimated "
            f"error by neglected harmonics {worst:.1e}{sampling_text(self)}",
        ]

    def _details(self) -> list[str]:
        lines = []
        for name, unit in zip(self.dof_names, self.dof_units, strict=True):
            if 1 not in self.harmonics or not self.converged.any():
                break
            peak = self.peak(name)
            lines.append(f"largest |{name}_1| = {peak.amplitude:.6g} {unit} at nu = {peak.nu:.6g}")
            if not peak.enclosed:
                lines[-1] += " (the largest of the motions found, not a peak)"
        return lines

    def numbers(self) -> dict[str, Number]:
        """Return peaks ``peak_x``, their frequencies ``nu_peak_x`` and the unsolved part."""
        return peaks(self) | {"unsolved": Number(1 - self.converged.mean())}

    def panels(self) -> list[Panel]:
        """Return the amplitudes of the lowest harmonic over nu."""
        order = lowest_order(self.harmonics)
        return [
            Panel(self.nu, self.amplitude(name, order), r"$\nu$ (rad/s)", name, unit, order, True)
            for name, unit in zip(self.dof_names, self.dof_units, strict=True)
        ]

    def _pieces(self) -> tuple[int, str, str]:
        n = self.nu.size
        return n, f"{things(n, 'point')} of {things(self.harmonics.size, 'harmonic')}", "point"

    def to_dataset(self) -> Dataset:
        """Return all data as an xarray Dataset with units."""
        dims = ("nu", "dof", "harmonic")
        return as_dataset(
            {
                "coefficients": (dims, self.coefficients, {"long_name": "X_k, m or rad"}),
                "amplitude": (dims, np.abs(self.coefficients), {"long_name": "|X_k|, m or rad"}),
                "outcome": ("nu", self.outcome),
                "method": ("nu", self.methods),
                "iterations": ("nu", self.iterations),
                "rate": ("nu", self.rate),
                "highest": ("nu", self.highest, {"long_name": "highest harmonic"}),
                "truncation": ("nu", self.truncation),
                "sampling": ("nu", self.sampling),
                "error": ("nu", self.error, {"long_name": "relative, of each motion"}),
            },
            coords={
                "nu": ("nu", self.nu, {"units": "rad/s", "long_name": "circular frequency"}),
                "dof": ("dof", list(self.dof_names)),
                "unit": ("dof", list(self.dof_units)),
                "harmonic": ("harmonic", self.harmonics),
            },
            attrs={"method": self.method, "plan": str(self.plan)},
        ).assign(self._compared())

    def _compared(self) -> dict[str, Any]:
        """Stability for a Dataset; stable: 1, 0, or -1 if unknown."""
        if self.stable is None:
            return {}
        return {
            "stable": ("nu", codes_of(self.stable)),
            "multipliers": (("nu", "multiplier"), self.multipliers),
            "exponents": (("nu", "multiplier"), self.exponents),
            "slowest": ("nu", self.slowest),
        }

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        names = {d: self.dof_names[d] for d in wanted_places(coordinates, self.dof_names)}
        about = "".join(
            f"{name}_k_re, {name}_k_im: X_k of {name} ({self.dof_units[d]}); "
            for d, name in names.items()
        )
        table = Table(
            [
                NOTES["response"],
                f"{about}{NOTES['unsolved']}",
            ],
            {
                "nu": self.nu,
                "outcome": self.outcome,
                "method": self.methods,
                "iterations": self.iterations,
                "rate": self.rate,
                "highest": self.highest,
                "truncation": self.truncation,
                "error": self.error,
            },
        )
        add_requested(table, self)
        if self.stable is not None:
            table.notes.append("stable: 1: stable, 0: not, -1: unknown")
            table.columns["stable"] = codes_of(self.stable)
        table.add_harmonics(names, map(str, self.harmonics), self.coefficients)
        return table


def find_peak(
    job: Job, orders: Any, p: FloatArray, motions: ComplexArray, place: tuple[int, int],
    tolerance: float, **more: Any,
) -> tuple[float, float] | None:  # fmt: skip
    """Largest maximum of a harmonic along a branch near motions at ``p``, or None.

    ``motions``: absolute, shape (n, n_dof, m); ``place``: indices of coordinate and harmonic.
    """
    found = job.run_long(
        "response peak", kept=orders, p=p, samples=motions.T, dof=place[0] + 1,
        place=place[1] + 1, tolerance=tolerance, **more,
    )  # fmt: skip
    return (found["at"], found["size"]) if found["enclosed"] else None


def lowest_order(harmonics: npt.NDArray[Any]) -> int:
    """Return the lowest harmonic other than the mean."""
    if harmonics.ndim > 1:
        raise InputError("quasi-periodic motions have no single harmonic to draw")
    orders = harmonics[harmonics > 0]
    if not orders.size:
        raise InputError("response: contains a mean only, which has no amplitude curve")
    return int(orders[0])


def peaks(value: Any, at: str = "rad/s") -> dict[str, Number]:
    """Return the largest amplitudes of the lowest harmonic and their locations."""
    found: dict[str, Number] = {}
    orders = value.harmonics[value.harmonics > 0] if value.harmonics.ndim == 1 else np.empty(0)
    for name, unit in zip(value.dof_names, value.dof_units, strict=True):
        place, size = np.nan, np.nan
        if orders.size and np.isfinite(value.amplitude(name, int(orders[0]))).any():
            place, size = value.peak(name, int(orders[0]))[:2]
        found |= {f"peak_{name}": Number(size, unit), f"nu_peak_{name}": Number(place, at)}
    return found


def only_rounding(amplitude: FloatArray, motions: ComplexArray) -> bool:
    """Return True if a component is everywhere below the rounding error of the largest component.

    Motions have the shape (n, n_dof, m).
    """
    largest = np.nanmax(np.abs(motions), axis=(1, 2))
    return bool((amplitude <= _NOTHING * largest).all())


def band_of(band: object) -> tuple[float, float]:
    """Return the ends of a range."""
    try:
        low, high = map(float, band)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        raise InputError(f"band = {_native.shown(band)}: must be two numbers") from None
    return low, high


def _between_modes(sizes: Callable[[FloatArray], FloatArray], nu: FloatArray) -> FloatArray:
    """Return the frequencies and intermediate ones, so that no interval contains two modes.

    Near one mode 1/size^2 is a parabola, (nu - w)^2 + decay^2, for any width of the resonance.
    Near an antiresonance size^2 is a parabola. An interval without such a parabola is halved.
    """
    found, low, high = [nu], nu[:-1], nu[1:]
    for _ in range(_HALVINGS):
        at = low + (high - low) * np.linspace(0, 1, 5)[:, np.newaxis]
        squares = sizes(at.ravel()).reshape(at.shape) ** 2
        rough = np.ones(low.size, dtype=bool)
        with np.errstate(all="ignore"):
            for form in (squares, 1 / squares):
                fitted = _PARABOLA @ form[::2]
                rough &= (np.abs(fitted - form[1::2]) > 0.1 * form[1::2]).any(axis=0)
        # A change with the last digits of the frequency is a rounding error of other components.
        nearby = sizes((at[:, rough] * (1 + _ULPS)).ravel()).reshape(5, -1) ** 2
        rough[rough] = (np.abs(nearby - squares[:, rough]) > 0.1 * nearby).sum(axis=0) < 3
        if not rough.any():
            break
        middle = at[2, rough]
        found.append(middle)
        low, high = np.r_[low[rough], middle], np.r_[middle, high[rough]]
    return np.unique(np.concatenate(found))


def _scatters(response: Response, d: int, j: int, nu: FloatArray) -> npt.NDArray[np.bool_]:
    """Return where rounding errors of other components change a component of a linear response.

    Its ratio to the largest component then scatters between frequencies a few ulps apart. The
    rounding error may be divided by the damping, look like a resonance, or cause maxima. Near a
    resonance of any width all components change in the same way.
    """
    near = nu * (1 + _ULPS * np.arange(-4, 5)[:, np.newaxis])
    motions = response._linear_motions(near.ravel()).reshape(*near.shape, -1)
    at = np.abs(motions[0]).argmax(axis=-1)[np.newaxis, :, np.newaxis]
    with np.errstate(invalid="ignore", divide="ignore"):
        part = response._linear_component(d, j, near.ravel()).reshape(near.shape)
        part = part / np.take_along_axis(motions, at, -1)[..., 0]
    size = np.abs(part).mean(axis=0)
    apart = np.abs(part - part.mean(axis=0)).max(axis=0)
    return np.asarray((size <= _NOTHING) | (apart > 0.1 * _FLAT * size))


def _linear_summit(
    response: Response, places: npt.NDArray[np.intp], d: int, j: int
) -> tuple[float, float] | None:
    """Return the maximum of a linear response by shrinking intervals of frequencies."""
    sizes = partial(response._linear_sizes, d, j)
    nu = _between_modes(sizes, response.nu[places])
    # The slopes at both ends of each interval show whether it contains a maximum. If rounding
    # hides them, a frequency with a larger value than its neighbours shows it.
    h, at = 1e-6 * np.diff(nu), sizes(nu)
    from_left = sizes(nu[:-1] + h) > at[:-1]
    from_right = sizes(nu[1:] - h) > at[1:]
    held = np.flatnonzero(from_left & from_right)
    tops = 1 + np.flatnonzero((at[1:-1] >= at[:-2]) & (at[1:-1] >= at[2:]))
    if not held.size + tops.size:
        return None
    low, high = np.r_[nu[held], nu[tops - 1]], np.r_[nu[held + 1], nu[tops + 1]]
    for _ in range(60):
        inner = np.linspace(low, high, 9)
        around = np.nan_to_num(sizes(inner.ravel()).reshape(inner.shape), nan=np.inf)
        top = around.argmax(axis=0)
        # Constant over the interval. A narrow resonance is not constant in such a short interval.
        flat = around.min(axis=0) >= (1 - _FLAT) * around.max(axis=0)
        low = np.take_along_axis(inner, np.maximum(top - 1, 0)[np.newaxis], 0)[0]
        high = np.take_along_axis(inner, np.minimum(top + 1, 8)[np.newaxis], 0)[0]
        if (high - low <= np.where(flat, 1e-9, _SHORTEST) * high).all():
            break
    middle = 0.5 * (low + high)
    found = np.nan_to_num(sizes(middle), nan=np.inf)
    rounded = _scatters(response, d, j, middle)
    found[~flat & ~rounded] = np.inf
    best = int(found.argmax())
    if rounded[best] or not found[best] > 0:
        return None
    return float(middle[best]), float(found[best])
