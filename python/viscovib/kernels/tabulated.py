"""A relaxation kernel from measured values."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.kernels.relaxation import Kernel, _vectors


@dataclass(frozen=True, kw_only=True, eq=False)
class TabulatedKernel(Kernel):
    """A measured kernel R(t_i), with an exact transform of its interpolant.

    Parameters
    ----------
    times : array_like, shape (n,)
        t_i >= 0 (s), strictly increasing, n >= 2.
    values : array_like, shape (n,)
        R(t_i) (1/s).
    interpolation : {"linear", "exponential"}
        "linear": straight lines, constant before the first point, 0 after the last. "exponential":
        log-linear (all values > 0), extrapolated with the first and last rates; refused if the
        extrapolation overflows.

    Warns
    -----
    StabilityWarning
        If values are negative or increase with time, which no relaxing material does, or if the
        first points increase towards t = 0 like a power of t, so that more than 1 % of the integral
        lies before the first time. Then add earlier times, or use a kernel with this singularity,
        such as `RzhanitsynKernel`.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> t = np.geomspace(1e-3, 50, 40)
    >>> kernel = vv.TabulatedKernel(times=t, values=0.1 * np.exp(-t))
    >>> cosine = kernel.cosine(2.0)
    """

    times: npt.ArrayLike
    values: npt.ArrayLike
    interpolation: str = "linear"
    _kind: ClassVar[int] = 5
    # The fit to a table is not repeated: its first error is the best.
    _meets: ClassVar[bool] = False
    _codes: ClassVar[tuple[str, ...]] = ("linear", "exponential")

    def __post_init__(self) -> None:
        _vectors(self, "times", "values")
        _native.choice("interpolation", self.interpolation, self._codes)
        self._check()
        self._warn_of_what_no_material_does()

    @cached_property
    def _data(self) -> FloatArray:
        code = float(self._codes.index(self.interpolation))
        return np.concatenate([[code], np.asarray(self.times), np.asarray(self.values)])

    @cached_property
    def _seconds(self) -> float:
        return 1e-7 * self._data.size

    @property
    def _relaxing(self) -> float:
        return 2e-6

    def _scaled(self, unit: float) -> FloatArray:
        times, values = np.split(self._data[1:], 2)
        return np.concatenate([self._data[:1], times / unit, values * unit])

    def _warn_of_what_no_material_does(self) -> None:
        times, values = np.asarray(self.times), np.asarray(self.values)
        if (values < 0).any():
            i = int(values.argmin())
            meaning = "the spring would stiffen under a held deflection"
            text = f"R({times[i]:g}) = {values[i]:g} < 0: {meaning}, which no relaxation does"
        elif (np.diff(values) > 0).any():
            i = int((np.diff(values) > 0).argmax())
            meaning = "relaxation would speed up with time"
            text = f"R increases between t = {times[i]:g} and {times[i + 1]:g}: {meaning}"
        else:
            text = _native.run("kernel integral", self._handle)["doubt"]
        if not text:
            return
        warnings.warn(text, StabilityWarning, stacklevel=caller())

    def _complete_exponentials(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[FloatArray, FloatArray]:
        """Least squares with weights >= 0 on a grid of rates, then also over the rates."""
        from scipy.optimize import least_squares, nnls

        times = np.geomspace(first, last, 400)
        values = self(times)
        scale = np.where(values != 0, np.abs(values), np.abs(values).max() or 1.0)
        n = math.ceil(1.5 * math.log(last / first)) + 6
        rates = np.geomspace(0.1 / last, 10 / first, n)
        target = values / scale
        weights, _ = nnls(np.exp(-np.outer(times, rates)) / scale[:, None], target, maxiter=100 * n)
        used = weights > 1e-12 * weights.max()
        if not used.any():
            raise InputError("values: no sum of decaying exponentials comes near this table")

        def misfit(logarithms: FloatArray) -> FloatArray:
            w, r = np.exp(logarithms.reshape(2, -1))
            return np.asarray((np.exp(-np.outer(times, r)) @ w) / scale - target)

        start = np.log(np.concatenate([weights[used], rates[used]]))
        best = least_squares(misfit, start, xtol=tolerance, ftol=tolerance, max_nfev=100)
        weights, rates = np.exp(best.x.reshape(2, -1))
        return weights, rates
