"""Shock response spectra of records of an acceleration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native, units
from viscovib._native import FloatArray
from viscovib.common.counts import things
from viscovib.common.parameters import Number, Word
from viscovib.common.results import Dataset, Result, as_dataset, span
from viscovib.common.tables import Table
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory, spacing
from viscovib.systems.base_acceleration import warn_of_record
from viscovib.systems.load_table import FormulaLoad, LoadTable
from viscovib.systems.piecewise import values_at

KINDS = ("absolute_acceleration", "relative_displacement", "pseudo_velocity")
_KIND, _UNIT = Word("kind", KINDS), Word("unit", ("m/s^2", "g"))
_DAMPING, _DT = Number("damping", lowest=0), Number("dt", above=0)
#: Relative error of the straight lines between samples of a smooth shock, and samples at most.
_SAMPLED, _MOST = 1e-10, 2_000_000
#: Places in a piece at which its second derivative is computed, as fractions.
_INSIDE = np.linspace(0.0, 1.0, 9)
#: Steps of oscillators that take some milliseconds.
_FEW = 1_000_000


@dataclass(frozen=True, eq=False, repr=False)
class ShockResponseSpectrum(Result):
    """Extremes of the responses of oscillators to a shock, over their natural frequency.

    All values are magnitudes of 0 or more. "positive" is the largest value of the response itself:
    a positive acceleration of the base first gives a negative relative displacement.

    Attributes
    ----------
    quantity : str
        "absolute_acceleration", "relative_displacement" or "pseudo_velocity".
    frequencies : ndarray, shape (n,)
        Natural frequencies (Hz).
    damping : float
        Damping ratio.
    primary_positive, primary_negative : ndarray, shape (n,)
        Extremes while the record lasts.
    residual_positive, residual_negative : ndarray, shape (n,)
        Extremes of the free vibration after the record.
    unit : str
        Unit of these values.
    peak : float
        Largest absolute value of the record (m/s^2).
    duration : float
        Length of the record (s).

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> record = 50 * np.sin(np.pi * np.linspace(0, 1, 1001))
    >>> found = vv.shock_response_spectrum(record, [20.0, 80.0], dt=0.011 / 1000, damping=0.05)
    >>> print(found.maximax.round(1))
    [39.2 82.4]
    """

    quantity: str
    frequencies: FloatArray
    damping: float
    primary_positive: FloatArray
    primary_negative: FloatArray
    residual_positive: FloatArray
    residual_negative: FloatArray
    unit: str
    peak: float
    duration: float

    kind = "shock_response_spectrum"

    @property
    def primary(self) -> FloatArray:
        """Largest magnitude while the record lasts, shape (n,)."""
        return np.maximum(self.primary_positive, self.primary_negative)

    @property
    def residual(self) -> FloatArray:
        """Largest magnitude after the record, shape (n,)."""
        return np.maximum(self.residual_positive, self.residual_negative)

    @property
    def positive(self) -> FloatArray:
        """Largest value of the response, shape (n,)."""
        return np.maximum(self.primary_positive, self.residual_positive)

    @property
    def negative(self) -> FloatArray:
        """Magnitude of the smallest value of the response, shape (n,)."""
        return np.maximum(self.primary_negative, self.residual_negative)

    @property
    def maximax(self) -> FloatArray:
        """Largest magnitude of the response, shape (n,)."""
        return np.maximum(self.positive, self.negative)

    def _headline(self) -> str:
        i = int(self.maximax.argmax())
        places = things(self.frequencies.size, "frequency", "frequencies")
        return (
            f"{self.quantity.replace('_', ' ')} at {places}, "
            f"at most {self.maximax[i]:.6g} {self.unit} at {self.frequencies[i]:.6g} Hz"
        )

    def _scope(self) -> list[str]:
        peak = f"{self.peak:.6g} m/s^2 = {self.peak / units.g:.6g} g"
        return [
            f"frequencies: {span(self.frequencies, 'Hz')}; damping ratio {self.damping:.6g}",
            f"record: {self.duration:.6g} s, peak {peak}",
        ]

    def _table(self, coordinates: Sequence[str] | None) -> Table:
        notes = [
            f"kind {self.quantity}, damping ratio {self.damping:.16e}; frequency in Hz, magnitudes "
            f"in {self.unit}",
            f"record of {self.duration:.16e} s, peak {self.peak:.16e} m/s^2",
        ]
        return Table(notes, super()._table(coordinates).columns)

    def to_dataset(self) -> Dataset:
        """Return all extremes as an xarray Dataset over the frequency."""
        names = (
            "maximax", "positive", "negative", "primary", "residual", "primary_positive",
            "primary_negative", "residual_positive", "residual_negative",
        )  # fmt: skip
        return as_dataset(
            {name: ("frequency", getattr(self, name), {"units": self.unit}) for name in names},
            coords={"frequency": ("frequency", self.frequencies, {"units": "Hz"})},
            attrs={"quantity": self.quantity, "damping": self.damping},
        )


def shock_response_spectrum(
    record: npt.ArrayLike | LoadTable | Trajectory,
    frequencies: npt.ArrayLike,
    *,
    dt: float | None = None,
    coordinate: str | None = None,
    damping: float = 0.05,
    kind: str = "absolute_acceleration",
    unit: str | None = None,
) -> ShockResponseSpectrum:
    """Return the shock response spectrum of an acceleration of the base.

    Parameters
    ----------
    record : array_like, shape (n,), LoadTable or Trajectory
        Acceleration of the base, linear between its samples, from an oscillator at rest; 0 after
        the last sample. A `LoadTable` has its own times, which may be unequally spaced. A smooth
        one, such as a `HalfSine`, is sampled to 1e-10 of its peak. Of a `Trajectory` it is the
        absolute acceleration of a ``coordinate`` at the states kept.
    frequencies : array_like, shape (m,)
        Undamped natural frequencies of the oscillators (Hz, not rad/s), in any order.
    dt : float
        Time between samples (s); only with an array.
    coordinate : str
        For a `Trajectory` of several coordinates: the one that carries the oscillators.
    damping : float
        Damping ratio zeta = 1/(2 Q), at least 0 and less than 1.
    kind : {"absolute_acceleration", "relative_displacement", "pseudo_velocity"}
        Acceleration of the mass, in the unit of the record; displacement relative to the base (m);
        this times the circular frequency (m/s).
    unit : {"m/s^2", "g"}, optional
        Unit of the record; by default that of a `LoadTable`, and "m/s^2" for an array.

    Warns
    -----
    RangeWarning
        If the record begins and ends with the same offset, which makes the base drift, or if its
        peak exceeds 4000 m/s^2, because its unit may be wrong.

    Notes
    -----
    The oscillator x'' + 2 zeta w x' + w^2 x = -a(t) has a solution in closed form between two
    samples, and extremes between samples are located: the error is rounding error (ramp-invariant
    method, ISO 18431-4). A record that is sampled at less than ten times a frequency may itself not
    resolve the shock.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> shock = vv.Sawtooth(amplitude=15.0, duration=0.011, unit="g")
    >>> found = vv.shock_response_spectrum(shock, np.geomspace(5, 500, 50))
    >>> print(f"{found.maximax.max():.3f} {found.unit}")
    17.807 g

    See Also
    --------
    LoadTable, spectrum
    """
    quantity = _KIND.check(kind)
    if unit is None:
        unit = record.unit if isinstance(record, LoadTable) else "m/s^2"
    unit = _UNIT.check(unit)
    ratio = _DAMPING.check(damping)
    values, steps = _read(record, dt, coordinate)
    places = np.atleast_1d(_native.real_array("frequencies", frequencies))
    if places.ndim != 1 or not places.size:
        raise InputError(f"frequencies: must have shape (m,) with m >= 1, got {places.shape}")
    factor = units.g if unit == "g" else 1.0
    peak, duration = (
        factor * float(np.abs(values).max()),
        float(steps.sum() if steps.size > 1 else steps[0] * (values.size - 1)),
    )
    warn_of_record("record", values, unit, not isinstance(record, FormulaLoad))
    one, two, three, four = _native.run_either(
        values.size * places.size > _FEW, "spectrum shock", record=values, steps=steps, hz=places,
        damping=ratio, kind=KINDS.index(quantity) + 1, unit=unit,
    )["extremes"]  # fmt: skip
    if quantity != KINDS[0]:
        unit = "m" if quantity == KINDS[1] else "m/s"
    return ShockResponseSpectrum(
        quantity, places, ratio, one, two, three, four, unit, peak, duration
    )


def _read(
    record: npt.ArrayLike | LoadTable | Trajectory, dt: float | None, coordinate: str | None
) -> tuple[FloatArray, FloatArray]:
    """Return samples between which the record is linear, and the times between them: one or all."""
    if isinstance(record, Trajectory):
        names = record.dof_names
        name = names[0] if coordinate is None and len(names) == 1 else coordinate
        column = names.index(_native.choice("coordinate", name, names))
        if record.t.size < 2:
            raise InputError(f"record: {record.t.size} states kept, must be at least 2")
        record = LoadTable(times=record.t, values=record.acceleration[:, column])
    elif coordinate is not None:
        raise InputError("coordinate: only a Trajectory has coordinates, must not be given")
    if not isinstance(record, LoadTable):
        if dt is None:
            raise InputError("dt: must be given with an array: the time between samples")
        values = _native.real_array("record", record)
        if values.ndim != 1 or values.size < 2:
            raise InputError(f"record: must have shape (n,) with n >= 2, got {values.shape}")
        return values, np.array([_DT.check(dt)])
    if dt is not None:
        raise InputError(
            "dt: must not be given with a LoadTable or a Trajectory, which has its own times"
        )
    times, values = np.asarray(record.times), np.asarray(record.values)
    if values.ndim != 1:
        raise InputError(f"record: values must have shape ({times.size},), got {values.shape}")
    if record.interpolation != "linear":
        # Straight lines are off by the square of their length and the second derivative over 8.
        length = np.diff(times)
        at = times[:-1, np.newaxis] + length[:, np.newaxis] * _INSIDE
        pieces = record._polynomials(values[:, np.newaxis])
        second = values_at(times, pieces, at.ravel())[2].reshape(at.shape)
        bend = np.abs(second).max(axis=1) * length**2
        part = math.ceil(math.sqrt(bend.max() / (8 * _SAMPLED * (np.abs(values).max() or 1.0))))
        part = max(part, 1)
        part = min(part, max(_MOST // times.size, 1))
        inner = np.arange(part) / part
        times = np.append(times[:-1, np.newaxis] + length[:, np.newaxis] * inner, times[-1])
        values = record(times)
    step = spacing(times)
    return values, np.diff(times) if math.isnan(step) else np.array([step])
