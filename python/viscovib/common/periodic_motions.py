"""Common functions of periodic motions u = Im sum_k X_k exp(i k nu t)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError

#: Samples per period of the highest harmonic, number of maxima that are refined, Newton steps for
#: each, and motions per array.
_PER_ORDER, _SUMMITS, _NEWTON, _AT_ONCE = 64, 6, 5, 256
#: Smallest number of harmonics for the rate of decrease.
_FEWEST_TO_FALL = 8
#: Number of times of a waveform per array.
_AT_A_TIME = 4096


class PeriodicMotions:
    """A set of periodic motions: harmonics of each coordinate, and derived values.

    Every number of a motion without a solution is NaN. ``dof`` is a name of `dof_names`.

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
    >>> response = vv.forced_response(mount, [1.0, 2.0], load=0.1)
    >>> t, coordinates = response.waveform(0, 64)  # one period
    >>> size = response.peak_to_peak("x")
    """

    dof_names: tuple[str, ...]

    @property
    def _solved(self) -> ComplexArray:
        """Harmonics of the unknowns; for a structure, of the condensed coordinates."""
        return self._motions()[2]

    def _warn_of_reduction(self) -> None:
        """Warn of the error of a reduction of the system, if any."""

    def _motions(self) -> tuple[FloatArray, npt.NDArray[Any], ComplexArray]:
        """Return nu, shape (n,), the orders, shape (m,), and X_k, shape (n, n_dof, m)."""
        raise NotImplementedError

    def _dof(self, dof: int | str) -> int:
        if isinstance(dof, str) and dof in self.dof_names:
            return self.dof_names.index(dof)
        if isinstance(dof, (int, np.integer)) and 0 <= dof < len(self.dof_names):
            return int(dof)
        names = ", ".join(f"{name!r} ({i})" for i, name in enumerate(self.dof_names))
        raise InputError(f"dof = {_native.shown(dof)}: must be one of {names}")

    def coefficient(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """Return X_k of one coordinate, shape (n,)."""
        _, orders, coefficients = self._motions()
        is_number = isinstance(harmonic, (int, float, np.integer, np.floating))
        where = np.flatnonzero(orders == harmonic) if is_number else np.empty(0)
        if not where.size:
            kept = ", ".join(map(str, orders))
            raise InputError(
                f"harmonic = {_native.shown(harmonic)}: must be one of those kept ({kept})"
            )
        return coefficients[:, self._dof(dof), where[0]]

    def phase(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """Return the phase of X_k (rad), in (-pi, pi], shape (n,)."""
        return np.angle(self.coefficient(dof, harmonic))

    def velocity(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """Harmonic of the velocity, i k nu X_k, shape (n,)."""
        # An invalid harmonic is reported first.
        own = self.coefficient(dof, harmonic)
        return np.asarray(1j * harmonic * self._motions()[0] * own)

    def acceleration(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """Harmonic of the acceleration, -(k nu)^2 X_k, shape (n,)."""
        own = self.coefficient(dof, harmonic)
        return np.asarray(-((harmonic * self._motions()[0]) ** 2) * own)

    def waveform(self, i: int, n: int = 256) -> tuple[FloatArray, FloatArray]:
        """Return one period of the i-th motion: n times, shape (n,), and u, shape (n, n_dof)."""
        nu, orders, coefficients = self._motions()
        point = _native.integer("i", i, -nu.size, nu.size - 1)
        count = _native.integer("n", n, 1, 10_000_000)
        t = 2 * np.pi / nu[point] * np.arange(count) / count
        found = np.empty((count, coefficients.shape[1]))
        # In parts: all harmonics at all times may exceed the memory.
        for start in range(0, count, _AT_A_TIME):
            part = slice(start, start + _AT_A_TIME)
            waves = np.exp(1j * np.outer(t[part], orders * nu[point]))
            found[part] = (waves @ coefficients[point].T).imag
        return t, found

    def rms(self, dof: int | str) -> FloatArray:
        """Return the root mean square over a period, including the mean, shape (n,)."""
        _, orders, coefficients = self._motions()
        own = coefficients[:, self._dof(dof)]
        squares = np.where(orders == 0, own.imag**2, 0.5 * np.abs(own) ** 2)
        return np.asarray(np.sqrt(squares.sum(axis=1)))

    def peak_to_peak(self, dof: int | str) -> FloatArray:
        """Return the largest minus the smallest value in a period, shape (n,)."""
        _, orders, coefficients = self._motions()
        own = coefficients[:, self._dof(dof)]
        result = np.full(own.shape[0], np.nan)
        solved = np.flatnonzero(np.isfinite(own).all(axis=1))
        for rows in np.array_split(solved, -(-solved.size // _AT_ONCE) or 1):
            values = _samples(own[rows], orders)
            result[rows] = sum(
                _highest(sign * own[rows], orders, sign * values) for sign in (1, -1)
            )
        return result

    def fall_off(self) -> FloatArray:
        """Return the measured power p with which harmonics decrease as k^-p, shape (n,).

        It is computed from the last two octaves of the harmonics kept, of all coordinates in units
        of their size; NaN with fewer than 8 harmonics. A kink of the force gives 4, a jump 3,
        `v*abs(v)` 5. For a smooth law p grows with the number of harmonics.
        """
        nu, orders, coefficients = self._motions()
        if orders.ndim != 1:
            return np.full(nu.size, np.nan)
        return np.array([power_of_fall(own) for own in coefficients])


def power_of_fall(own: ComplexArray) -> float:
    """`PeriodicMotions.fall_off` for one motion X_k, shape (n_dof, m)."""
    if not np.isfinite(own).all():
        return float("nan")
    # Harmonics that are not kept are 0.
    kept = np.flatnonzero(own.any(axis=0))
    m = int(kept[-1]) + 1 if kept.size else 0
    if m < _FEWEST_TO_FALL:
        return float("nan")
    sizes = np.linalg.norm(own, axis=1, keepdims=True)
    unit = own[:, :m] / np.where(sizes > 0, sizes, 1.0)
    low, high = np.linalg.norm(unit[:, m // 4 : m // 2]), np.linalg.norm(unit[:, m // 2 :])
    return float(np.log2(low / high)) + 0.5 if high > 0 and low > 0 else float("nan")


def _samples(own: ComplexArray, orders: npt.NDArray[Any]) -> FloatArray:
    """Return values of Im sum_k X_k exp(i k phase) at evenly spaced phases of a period."""
    n = _PER_ORDER * int(max(orders.max(initial=1), 1))
    spectrum = np.zeros((own.shape[0], n // 2 + 1), dtype=complex)
    spectrum[:, orders] = -0.5j * n * own
    spectrum[:, 0] *= 2
    return np.fft.irfft(spectrum, n)


def _highest(own: ComplexArray, orders: npt.NDArray[Any], values: FloatArray) -> FloatArray:
    """Return the largest value in a period from samples.

    The highest sample may not belong to the highest maximum, so several are refined.
    """
    width = 2 * np.pi / values.shape[1]
    summits = (values >= np.roll(values, 1, axis=1)) & (values >= np.roll(values, -1, axis=1))
    best = np.argpartition(np.where(summits, -values, np.inf), _SUMMITS, axis=1)[:, :_SUMMITS]

    def derivative(phases: FloatArray, times: int) -> FloatArray:
        waves = np.exp(1j * phases[:, :, np.newaxis] * orders)
        terms = own * (1j * orders) ** times
        return np.asarray(np.einsum("nk,npk->np", terms, waves).imag)

    start = width * best
    phases = start
    for _ in range(_NEWTON):
        bend = derivative(phases, 2)
        flat = np.abs(bend) <= np.finfo(float).tiny
        step = derivative(phases, 1) / np.where(flat, np.inf, bend)
        phases = np.clip(phases - step, start - width, start + width)
    return np.asarray(np.maximum(derivative(phases, 0).max(axis=1), values.max(axis=1)))
