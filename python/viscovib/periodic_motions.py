"""What is told of periodic motions u = Im sum_k X_k exp(i k nu t), however they were found."""

from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.errors import InputError

#: Samples a period for each order, at least and for the highest.
_FEWEST, _PER_ORDER = 64, 8
#: Samples so close to a summit differ from it by rounding.
_CLOSE = 1e-9
#: Times of a waveform that are computed at once.
_AT_A_TIME = 4096


class PeriodicMotions:
    """A row of periodic motions: harmonics of each coordinate, and what follows from them.

    Of a motion without a solution every number is NaN. ``dof`` is a name of `dof_names`.
    """

    dof_names: tuple[str, ...]

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
        """X_k of one coordinate, shape (n,)."""
        _, orders, coefficients = self._motions()
        where = np.flatnonzero(orders == harmonic) if np.isscalar(harmonic) else np.empty(0)
        if not where.size:
            kept = ", ".join(map(str, orders))
            raise InputError(
                f"harmonic = {_native.shown(harmonic)}: must be one of those kept ({kept})"
            )
        return coefficients[:, self._dof(dof), where[0]]

    def phase(self, dof: int | str, harmonic: int = 1) -> FloatArray:
        """Phase of X_k (rad), in (-pi, pi], shape (n,)."""
        return np.angle(self.coefficient(dof, harmonic))

    def velocity(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """Harmonic of the velocity, i k nu X_k, shape (n,)."""
        # Told first if the harmonic is none.
        own = self.coefficient(dof, harmonic)
        return np.asarray(1j * harmonic * self._motions()[0] * own)

    def acceleration(self, dof: int | str, harmonic: int = 1) -> ComplexArray:
        """Harmonic of the acceleration, -(k nu)^2 X_k, shape (n,)."""
        own = self.coefficient(dof, harmonic)
        return np.asarray(-((harmonic * self._motions()[0]) ** 2) * own)

    def waveform(self, i: int, n: int = 256) -> tuple[FloatArray, FloatArray]:
        """One period of the i-th motion: n times, shape (n,), and u, shape (n, n_dof)."""
        nu, orders, coefficients = self._motions()
        point = _native.integer("i", i, -nu.size, nu.size - 1)
        count = _native.integer("n", n, 1, 10_000_000)
        t = 2 * np.pi / nu[point] * np.arange(count) / count
        found = np.empty((count, coefficients.shape[1]))
        # Some at a time: all waves at all times may be more than memory holds.
        for start in range(0, count, _AT_A_TIME):
            part = slice(start, start + _AT_A_TIME)
            waves = np.exp(1j * np.outer(t[part], orders * nu[point]))
            found[part] = (waves @ coefficients[point].T).imag
        return t, found

    def rms(self, dof: int | str) -> FloatArray:
        """Root mean square over a period, the mean included, shape (n,): by Parseval's theorem."""
        _, orders, coefficients = self._motions()
        own = coefficients[:, self._dof(dof)]
        squares = np.where(orders == 0, own.imag**2, 0.5 * np.abs(own) ** 2)
        return np.asarray(np.sqrt(squares.sum(axis=1)))

    def peak_to_peak(self, dof: int | str) -> FloatArray:
        """Largest value less smallest in a period, to rounding, shape (n,)."""
        _, orders, coefficients = self._motions()
        own = coefficients[:, self._dof(dof)]
        n = max(_FEWEST, _PER_ORDER * int(orders.max(initial=1)))
        phases = 2 * np.pi * np.arange(n) / n
        values = (own @ np.exp(1j * np.outer(orders, phases))).imag
        solved = np.isfinite(values).all(axis=1)
        result = np.full(own.shape[0], np.nan)
        if solved.any():
            highest = _summit(own[solved], orders, phases[values[solved].argmax(axis=1)], phases[1])
            lowest = _summit(-own[solved], orders, phases[values[solved].argmin(axis=1)], phases[1])
            result[solved] = highest + lowest
        return result


def _summit(
    own: ComplexArray, orders: npt.NDArray[Any], middle: FloatArray, width: float
) -> FloatArray:
    """Return the largest values near phases ``middle``, by ever closer samples around the best."""
    places = np.linspace(-1, 1, 9)
    while True:
        phases = middle[:, np.newaxis] + width * places
        waves = np.exp(1j * phases[:, :, np.newaxis] * orders)
        values = np.einsum("nk,npk->np", own, waves).imag
        best = values.argmax(axis=1)
        rows = np.arange(len(middle))
        if width < _CLOSE:
            return np.asarray(values[rows, best])
        middle, width = phases[rows, best], 0.25 * width
