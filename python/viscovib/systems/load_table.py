"""Loads in time from tables, and shocks by formula."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields, short_repr
from viscovib.errors import InputError

_Array = TypeVar("_Array", bound=npt.NDArray[Any])
#: Two times of a base closer than this, relative to the last, are a jump.
_JUMP = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LoadTable:
    """A load given at times; 0 before the first and after the last time.

    As ``base`` of `simulate` it is a displacement of the base, constant before the first and after
    the last time.

    Parameters
    ----------
    times : array_like, shape (n,)
        Strictly ascending (s), n >= 2.
    values : array_like, shape (n,) or (n, n_dof)
        Force on the first coordinate, or on each (N, N m). For a base: shape (n,), its displacement
        (m), or a column for each coordinate (for a body x, y, z, rx, ry, rz).
    on : str, int, mapping or array_like, optional
        For a `Structure` with values of shape (n,): direction of the load, as ``on`` of a `Spring`.
    unit : {"m/s^2", "g"}
        Only for accelerations: the unit of the values.
    interpolation : {"linear", "cubic"}
        Straight lines, or a spline that is twice continuously differentiable. Steps in time end on
        every corner and end, so the order of the integrator is kept.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> mount = vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2)
    >>> shock = vv.LoadTable(times=[0, 0.1, 0.2], values=[[0, 0], [5, 0], [0, 0]])
    >>> run = vv.simulate(mount, 2, force=shock)
    """

    times: npt.ArrayLike
    values: npt.ArrayLike
    interpolation: str = "linear"
    on: Any = None
    unit: str = "m/s^2"
    _kinds: ClassVar[tuple[str, ...]] = ("linear", "cubic")

    __repr__ = short_repr

    def __post_init__(self) -> None:
        own_fields(self, "on")
        _native.choice("interpolation", self.interpolation, self._kinds)
        _native.choice("unit", self.unit, ("m/s^2", "g"))
        for name in ("times", "values"):
            array = _native.real_array(name, getattr(self, name)).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        times, values = np.asarray(self.times), np.asarray(self.values)
        if times.ndim != 1 or times.size < 2:
            raise InputError(f"times: must have shape (n,) with n >= 2, got {times.shape}")
        wrong = np.flatnonzero(np.diff(times) <= 0)
        if wrong.size:
            i = int(wrong[0])
            raise InputError(
                f"times[{i + 1}] = {times[i + 1]:g} after {times[i]:g}: must be strictly ascending"
            )
        if values.ndim not in (1, 2) or values.shape[0] != times.size:
            raise InputError(
                f"values: must have shape ({times.size},) or ({times.size}, n_dof), "
                f"got {values.shape}"
            )

        if self.on is not None and values.ndim == 2:
            raise InputError("on: must not be given with values for every coordinate")

    @staticmethod
    def half_sine(
        peak: npt.ArrayLike, duration: float, *, start: float = 0.0, on: Any = None
    ) -> HalfSine:
        """Return ``HalfSine(amplitude=peak, ...)``.

        Examples
        --------
        >>> import viscovib as vv
        >>> shock = vv.LoadTable.half_sine(50.0, 0.011)
        """
        return HalfSine(amplitude=peak, duration=duration, start=start, on=on)

    @staticmethod
    def sawtooth(
        peak: npt.ArrayLike, duration: float, *, start: float = 0.0, on: Any = None
    ) -> Sawtooth:
        """Return ``Sawtooth(amplitude=peak, ...)``.

        Examples
        --------
        >>> import viscovib as vv
        >>> shock = vv.LoadTable.sawtooth(50.0, 0.011)
        """
        return Sawtooth(amplitude=peak, duration=duration, start=start, on=on)

    def __call__(self, t: npt.ArrayLike) -> FloatArray:
        """Load at times t, shape t.shape + values.shape[1:]."""
        at = _native.real_array("t", t)
        times, values = np.asarray(self.times), np.asarray(self.values)
        found = table_at(times, self._polynomials(values.reshape(times.size, -1)), at.ravel())
        return found.reshape(at.shape + values.shape[1:])

    def _pieces(self, n_dof: int) -> FloatArray:
        """Polynomials between the times for the core (`piecewise`), shape (n_dof, n_powers, n)."""
        return self._polynomials(self._columns(n_dof))

    def _polynomials(self, values: FloatArray) -> FloatArray:
        """The polynomials of columns, shape (n, n_columns)."""
        from scipy.interpolate import CubicSpline

        n_dof = values.shape[1]
        times = np.asarray(self.times)
        pieces = np.zeros((n_dof, 4, times.size), order="F")
        if self.interpolation == "cubic":
            pieces[:, :, :-1] = np.moveaxis(CubicSpline(times, values).c, 2, 0)
        else:
            pieces[:, 2, :-1] = (np.diff(values, axis=0) / np.diff(times)[:, np.newaxis]).T
            pieces[:, 3, :-1] = values[:-1].T
        return pieces

    def _breaks(self, n_dof: int) -> FloatArray:
        """Times at which the spline is not smooth, and both ends."""
        times, values = np.asarray(self.times), np.asarray(self.values)
        one = values.ndim == 1
        pieces = self._polynomials(values[:, np.newaxis] if one else self._columns(n_dof))
        return np.asarray(_native.run("motion corners", breaks=times, pieces=pieces)["times"])

    def _refuse_g(self, name: str) -> None:
        if self.unit == "g":
            raise InputError(f"{name}: is an acceleration in g: give it as base_acceleration")

    @property
    def _columned(self) -> bool:
        """True if the table has a column for each coordinate."""
        return np.asarray(self.values).ndim == 2

    def _base_pieces(self, n_columns: int = 0, n_dof: int = 1) -> FloatArray:
        """Polynomials of base displacements, shape (n_powers, q, n); the last value stays constant.

        0 columns: one displacement, q = 1; else one for each of the first coordinates, q = n_dof.
        """
        self._refuse_g("base")
        times, values = np.asarray(self.times), np.asarray(self.values)
        wanted = (times.size, n_columns) if n_columns else (times.size,)
        if values.shape != wanted:
            raise InputError(f"base: values must have shape {wanted}, got {values.shape}")
        columns = np.zeros((times.size, n_dof if n_columns else 1))
        columns[:, : max(n_columns, 1)] = values.reshape(times.size, -1)
        short = np.diff(times) < _JUMP * np.abs(times).max()
        jumps = short[:, np.newaxis] & (np.diff(columns, axis=0) != 0)
        if jumps.any():
            i, j = np.argwhere(jumps)[0]
            raise InputError(
                f"base: moves from {columns[i, j]:g} to {columns[i + 1, j]:g} within "
                f"{np.diff(times)[i]:g} at t = {times[i]:g}, must not jump: take a longer ramp"
            )
        pieces = self._polynomials(columns)
        pieces[:, -1, -1] = columns[-1]
        return np.asfortranarray(np.moveaxis(pieces, 0, 1))

    def _columns(self, n_dof: int) -> FloatArray:
        values = np.asarray(self.values)
        if self.on is not None:
            raise InputError("on: is for the load of a Structure")
        self._refuse_g("force")
        if values.ndim == 1:
            columns = np.zeros((values.size, n_dof))
            columns[:, 0] = values
            return columns
        if values.shape[1] != n_dof:
            raise InputError(
                f"values: must have {n_dof} columns for this system, got {values.shape[1]}"
            )
        return values


class PiecewiseTable(LoadTable):
    """A load by polynomials between its times."""

    @classmethod
    def of(cls, times: FloatArray, pieces: FloatArray, on: Any = None) -> PiecewiseTable:
        """Return a load by polynomials of each coordinate, or of the direction ``on``."""
        values = pieces[0, -1] if on is not None else pieces[:, -1].T
        table = cls(times=times, values=values, interpolation="cubic", on=on)
        object.__setattr__(table, "_own", np.asfortranarray(pieces))
        return table

    def _polynomials(self, values: FloatArray) -> FloatArray:
        own: FloatArray = self._own  # type: ignore[attr-defined]
        if self.on is None or values.shape[1] == 1:
            return own
        return np.asfortranarray(np.multiply.outer(np.asarray(self.on), own[0]))

    def _columns(self, n_dof: int) -> FloatArray:
        values = np.asarray(self.values)
        return values if self.on is None else np.multiply.outer(values, np.asarray(self.on))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FormulaLoad(LoadTable):
    """A load by a formula, as polynomials of the core."""

    times: FloatArray = field(init=False)
    values: FloatArray = field(init=False)
    interpolation: str = field(init=False, default="cubic")
    start: float = 0.0
    _shape: ClassVar[str]

    def __repr__(self) -> str:
        given = [(one.name, one.default) for one in dataclasses.fields(self) if one.init]
        words = [
            f"{name}={getattr(self, name)!r}"
            for name, default in given
            if getattr(self, name) is not default
        ]
        return f"{type(self).__name__}({', '.join(words)})"

    def _expand(self, *terms: tuple[FloatArray, dict[str, Any]]) -> None:
        """Set the table to a sum of loads, each a vector times the formula of some numbers."""
        own: Any = 0.0
        for size, numbers in terms:
            found = _native.run(
                "motion shock", shape=self._shape, start=self._number("start"), **numbers
            )
            with np.errstate(over="ignore"):
                own = own + np.multiply.outer(size, found["pieces"])
        if not np.isfinite(own).all():
            raise InputError("the load is not finite, must be smaller or longer")
        object.__setattr__(self, "times", found["times"])
        object.__setattr__(self, "values", np.moveaxis(own[..., -1, :], -1, 0).copy())
        own[..., -1] = 0.0
        object.__setattr__(self, "_own", own.reshape(-1, *own.shape[-2:]))
        super().__post_init__()

    def _number(self, name: str) -> float:
        return _native.number(name, getattr(self, name))

    def _size(self, name: str, convert: Callable[[str, object], _Array]) -> _Array:
        """A number, or a number of each coordinate."""
        own_fields(self, name)
        size = convert(name, getattr(self, name))
        if size.ndim > 1:
            raise InputError(f"{name}: must be a number or have shape (n_dof,), got {size.shape}")
        return size

    def _ends(self, name: str, what: str) -> FloatArray:
        """A first and a last value."""
        own_fields(self, name)
        ends = _native.real_array(name, getattr(self, name))
        if ends.shape != (2,):
            raise InputError(f"{name}: must be two {what}, got shape {ends.shape}")
        return ends

    def _breaks(self, n_dof: int) -> FloatArray:
        return np.asarray(self.times)

    def _polynomials(self, values: FloatArray) -> FloatArray:
        own: FloatArray = self._own  # type: ignore[attr-defined]
        pieces = np.zeros((values.shape[1], *own.shape[1:]), order="F")
        pieces[: len(own)] = own
        return pieces


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Shock(FormulaLoad):
    """A formula of height 1 times an amplitude."""

    amplitude: npt.ArrayLike

    def __post_init__(self) -> None:
        self._expand((self._size("amplitude", _native.real_array), self._numbers()))

    def _numbers(self) -> dict[str, Any]:
        """Numbers of the shape, as the core calls them."""
        return {"duration": self._number("duration")}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class HalfSine(Shock):
    """A half-sine shock amplitude sin(pi (t - start)/duration).

    Parameters
    ----------
    amplitude : float or array_like, shape (n_dof,)
        Peak: a force on the first coordinate, or on each (N, N m), or an acceleration of the base.
    duration : float
        Length (s).
    start : float
        Begin (s).
    on, unit : optional
        As for `LoadTable`.

    Examples
    --------
    >>> import viscovib as vv
    >>> shock = vv.HalfSine(amplitude=50.0, duration=0.011)
    >>> round(float(shock(0.0055)), 9)
    50.0
    """

    duration: float
    _shape: ClassVar[str] = "half_sine"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Haversine(Shock):
    """A haversine shock amplitude sin^2(pi (t - start)/duration).

    Parameters
    ----------
    amplitude, duration, start, on, unit
        As for `HalfSine`.

    Examples
    --------
    >>> import viscovib as vv
    >>> shock = vv.Haversine(amplitude=2.0, duration=1.0)
    >>> round(float(shock(0.25)), 9)
    1.0
    """

    duration: float
    _shape: ClassVar[str] = "haversine"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Sawtooth(Shock):
    """A terminal-peak sawtooth: a shock that grows linearly to its amplitude and ends there.

    Parameters
    ----------
    amplitude, duration, start, on, unit
        As for `HalfSine`.

    Examples
    --------
    >>> import viscovib as vv
    >>> shock = vv.Sawtooth(amplitude=50.0, duration=0.01)
    >>> float(shock(0.005))
    25.0
    """

    duration: float
    _shape: ClassVar[str] = "sawtooth"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Trapezoid(Shock):
    """A trapezoidal shock: it rises linearly, is constant, and falls linearly.

    Parameters
    ----------
    amplitude, duration, start, on, unit
        As for `HalfSine`; ``duration`` includes the flanks.
    rise, fall : float, optional
        Lengths of the flanks (s); a tenth of the duration, and the same as ``rise``. With 0 the
        load jumps.

    Examples
    --------
    >>> import viscovib as vv
    >>> shock = vv.Trapezoid(amplitude=10.0, duration=1.0, rise=0.2)
    >>> [round(float(shock(t)), 12) for t in (0.1, 0.5, 0.9)]
    [5.0, 10.0, 5.0]
    """

    duration: float
    rise: float | None = None
    fall: float | None = None
    _shape: ClassVar[str] = "trapezoid"

    def _numbers(self) -> dict[str, Any]:
        length = self._number("duration")
        rise = 0.1 * length if self.rise is None else self._number("rise")
        fall = rise if self.fall is None else self._number("fall")
        return {"duration": length, "rise": rise, "fall": fall}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Chirp(Shock):
    """A sine sweep amplitude sin(phase), whose frequency goes from one value to another.

    Parameters
    ----------
    amplitude, duration, start, on, unit
        As for `HalfSine`.
    hz : tuple of two floats
        First and last frequency (Hz, not rad/s).
    sweep : {"linear", "logarithmic"}
        How the frequency depends on time.

    Notes
    -----
    At least four steps in time are made in a cycle of the highest frequency.

    Examples
    --------
    >>> import viscovib as vv
    >>> sweep = vv.Chirp(amplitude=1.0, duration=2.0, hz=(1.0, 3.0))
    >>> round(float(sweep(0.5)), 9)  # phase 2 pi (1 + 0.5 t) t
    -0.707106781
    """

    duration: float
    hz: tuple[float, float]
    sweep: str = "linear"
    _shape: ClassVar[str] = "chirp"

    def _numbers(self) -> dict[str, Any]:
        sweep = _native.choice("sweep", self.sweep, ("linear", "logarithmic"))
        return {
            "duration": self._number("duration"), "hz": self._ends("hz", "frequencies"),
            "is_logarithmic": sweep == "logarithmic",
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RunUp(FormulaLoad):
    r"""The force of an unbalance whose speed changes linearly: run-up or coast-down of a machine.

    The shaft has the angle phi(t), with phi = ``phase`` at ``start``. Its speed phi' goes from the
    first to the last value of ``speed`` within ``duration``, and then keeps the last value for
    ``hold``. A real unbalance u = m e has the force -u d^2/dt^2 sin(phi), a complex one

    .. math:: F = \mathrm{Im}[u\,(\dot\varphi^2 - i\ddot\varphi)\,e^{i\varphi}]

    so that ``unbalance=(u, 1j*u)`` rotates from the second coordinate to the first. At constant
    speed nu this is the load u nu^2 of `forced_response`. The motion of the shaft is given: the
    vibration does not act on the speed.

    Parameters
    ----------
    unbalance : complex or array_like, shape (n_dof,)
        m e (kg m) on the first coordinate, or on each (kg m, kg m^2). For a `Body` it is
        ``body.unbalance(1.0, m_e, at, axis)``.
    speed : tuple of two floats
        First and last speed (rad/s, not Hz), not negative. A coast-down has the larger speed first.
    duration : float
        Time of the change of speed (s).
    hold : float
        Time at the last speed after it (s). The load is 0 before ``start`` and after ``hold``.
    phase : float
        Angle of the shaft at ``start`` (rad).
    start, on
        As for `HalfSine`.

    Raises
    ------
    InputError
        If a speed is negative, both are 0, or the largest speed has more than 20000 revolutions.

    Notes
    -----
    The load is a polynomial of degree 21 in each quarter of a revolution at the largest speed, and
    steps in time end on these quarters. Its error is below 1e-13 of the largest force.

    Source: R. Gasch, R. Nordmann, H. Pfuetzner, Rotordynamik, 2nd ed., Springer 2006 (passage
    through resonance); F. M. Lewis, Trans. ASME 54 (1932), 253-261.

    Examples
    --------
    >>> import viscovib as vv
    >>> load = vv.RunUp(unbalance=0.01, speed=(0.0, 100.0), duration=2.0)
    >>> round(float(load(1.0)), 9)  # phi = 25, phi' = 50, phi'' = 50
    -3.804395158
    """

    unit: str = field(init=False, default="m/s^2")
    unbalance: npt.ArrayLike
    speed: tuple[float, float]
    duration: float
    hold: float = 0.0
    phase: float = 0.0
    _shape: ClassVar[str] = "run_up"

    def _numbers(self) -> dict[str, Any]:
        """Numbers of the shape, as the core calls them."""
        numbers = {name: self._number(name) for name in ("duration", "hold", "phase")}
        return numbers | {"speed": self._ends("speed", "speeds")}

    def _turn(self) -> dict[str, Any]:
        """Angle and speed at t = 0 (`turn_start`), and the angular acceleration in time."""
        return _native.run(
            "motion shock", shape=self._shape, start=self._number("start"), **self._numbers()
        )

    def __post_init__(self) -> None:
        size = self._size("unbalance", _native.complex_array)
        numbers = self._numbers()
        terms = [(size.real, numbers)]
        if size.imag.any():
            terms.append((size.imag, numbers | {"phase": numbers["phase"] + 0.5 * np.pi}))
        self._expand(*terms)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Step(Shock):
    """A step: the load is constant from a time on.

    Parameters
    ----------
    amplitude, start, on, unit
        As for `HalfSine`.

    Examples
    --------
    >>> import viscovib as vv
    >>> step = vv.Step(amplitude=3.0, start=1.0)
    >>> step([0.5, 1.0, 100.0]).tolist()
    [0.0, 3.0, 3.0]
    """

    _shape: ClassVar[str] = "step"

    def _numbers(self) -> dict[str, Any]:
        return {}


def table_at(breaks: FloatArray, pieces: FloatArray, t: FloatArray) -> FloatArray:
    """Return the loads of polynomials (n, n_powers, m) at times, shape (n_times, n)."""
    found = _native.run("motion table at", breaks=breaks, pieces=pieces, times=t)
    return np.asarray(found["values"])


def added(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """The sum of two tables, each given by breaks and polynomials (n_dof, n_powers, n)."""
    found = _native.run(
        "motion sum of tables", breaks=one[0], pieces=one[1], other_breaks=other[0],
        other_pieces=other[1],
    )  # fmt: skip
    return found["breaks"], found["pieces"]
