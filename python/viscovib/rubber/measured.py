"""Targets of a fit, and the solution of least-squares problems."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Number
from viscovib.errors import InputError
from viscovib.rubber.data import CreepData, ModulusData, RelaxationData
from viscovib.rubber.models import Model

#: Relative singular value below which the data do not determine a direction; smallest share of the
#: other rows in the fit of a row.
LEAST_FELT, _OWN = 1e-9, 1e-6
#: Largest number of times without interpolation; accuracy of interpolation (natural logarithm).
_FEWEST, _DIGITS = 100, 32.0
#: Weights of the residuals of storage and of loss.
SHARE = Number("storage_weight", lowest=0, highest=1e100)
LOSS_SHARE = Number("loss_weight", lowest=0, highest=1e100)


@dataclass(frozen=True)
class Measured:
    """Targets of a fit, with predictions of a model."""

    data: ModulusData | RelaxationData | CreepData
    #: Logarithms of frequencies, or of inverse times.
    log_rates: FloatArray
    #: Measured numbers (storage, then loss), and weights of the relative residuals.
    target: FloatArray
    shares: FloatArray

    @classmethod
    def of(
        cls, data: ModulusData | RelaxationData | CreepData, shares: tuple[float, float]
    ) -> "Measured":
        """Create targets from data, with the weights of storage and loss."""
        if isinstance(data, ModulusData):
            n = np.asarray(data.frequencies).size
            target = np.concatenate([np.asarray(data.storage), np.asarray(data.loss)])
            weights = np.repeat(np.array(shares), n)
            if shares[1] and (target[n:] <= 0).any():
                i = int(np.argmin(target[n:]))
                raise InputError(
                    f"loss[{i}] = {target[n + i]:g}: must be greater than 0, or loss_weight 0"
                )
            return cls(data, np.log(np.asarray(data.frequencies)), target, weights)
        values = data.modulus if isinstance(data, RelaxationData) else data.compliance
        target = np.asarray(values)
        return cls(data, -np.log(np.asarray(data.times)), target, np.ones(target.size))

    @property
    def along(self) -> ComplexArray:
        """Logarithms of i w."""
        return np.asarray(self.log_rates + 0.5j * np.pi, dtype=np.complex128)

    @property
    def count(self) -> int:
        """Number of targets with a weight."""
        return int((self.shares > 0).sum())

    @property
    def largest(self) -> float:
        """The largest modulus."""
        if isinstance(self.data, CreepData):
            return float(1 / self.target.min())
        return float(self.target[: self.log_rates.size].max())

    def predicted(self, model: Model, theta: FloatArray) -> FloatArray:
        """Prediction of a model."""
        if isinstance(self.data, ModulusData):
            value, _ = model.modulus_at(self.along, theta)
            return np.concatenate([value.real, value.imag])
        times = np.asarray(self.data.times)
        if isinstance(self.data, RelaxationData):
            return model.relaxation(times, self.data.ramp, theta)
        return np.asarray(self._creep(model, theta, slopes=False)[0])

    def _creep(self, model: Model, theta: FloatArray, *, slopes: bool) -> FloatArray:
        """Creep and its derivatives at the times of the data, interpolated if they are many."""
        times, between = self._nodes
        found = model.creep(times, theta, slopes=slopes)
        return found if between is None else found @ between

    @cached_property
    def _nodes(self) -> tuple[FloatArray, FloatArray | None]:
        """Times at which creep is computed, and the interpolation matrix, (nodes, n).

        Creep is analytic for a positive real part of t. So interpolation over ln t at this number
        of Chebyshev nodes is accurate to rounding error.
        """
        at = -self.log_rates
        low, high = float(at.min()), float(at.max())
        if at.size < _FEWEST:
            return np.exp(at), None
        wide = math.pi / max(high - low, 1e-300)
        count = math.ceil(_DIGITS / math.log(wide + math.sqrt(1 + wide**2))) + 2
        if 2 * count > at.size:
            return np.exp(at), None
        angle = (np.arange(count) + 0.5) * np.pi / count
        x = (2 * at - (low + high)) / (high - low)
        # Chebyshev polynomials, orthogonal at the nodes.
        orders = np.arange(count)[:, np.newaxis]
        by_order = np.cos(orders * np.arccos(np.clip(x, -1, 1)))
        by_order[0] /= 2
        between = 2 / count * np.cos(orders * angle).T @ by_order
        return np.exp((low + high) / 2 + (high - low) / 2 * np.cos(angle)), between

    def predicted_of(self, model: Model, thetas: FloatArray) -> FloatArray:
        """Predictions for many sets of unknowns (m, size), shape (m, n)."""
        if isinstance(self.data, ModulusData):
            values = model.moduli(self.along, thetas)
            return np.hstack([values.real, values.imag])
        return np.array([self.predicted(model, theta) for theta in thetas])

    def slopes(self, model: Model, theta: FloatArray) -> FloatArray:
        """Derivatives of `predicted`, shape (n, size)."""
        if isinstance(self.data, ModulusData):
            _, slopes = model.modulus_at(self.along, theta)
            return np.concatenate([slopes.real, slopes.imag], axis=1).T
        if isinstance(self.data, CreepData):
            return self._creep(model, theta, slopes=True)[1:].T
        found = np.empty((self.target.size, theta.size))
        for j in range(theta.size):
            h = 1e-5 * max(1.0, abs(theta[j]))
            step = np.zeros(theta.size)
            step[j] = h
            found[:, j] = self.predicted(model, theta + step) - self.predicted(model, theta - step)
            found[:, j] /= 2 * h
        return found

    def scale(self, model: Model, theta: FloatArray, weights: str) -> FloatArray:
        """Weights divided by the reference of the relative residuals."""
        size = self.predicted(model, theta) if weights == "model" else self.target
        return np.where(self.shares > 0, self.shares / np.maximum(np.abs(size), 1e-300), 0.0)


def covariance(slopes: FloatArray, residual: FloatArray) -> FloatArray:
    """Covariance of least-squares unknowns for different scatter of the rows, shape (k, k).

    P diag(r^2/(1 - h)^2) P' with the pseudo-inverse P of the derivatives and the leverage h of each
    row (HC3 of MacKinnon and White, J. Econometrics 29, 1985). A common variance of all rows would
    require correct weights, but the noise of a loss is often relative to the whole modulus, not to
    the loss. Undetermined directions have a large variance.
    """
    if not slopes.size or not np.isfinite(slopes).all():
        raise InputError("data: the derivatives at the best fit are not finite")
    u, s, v = np.linalg.svd(slopes, full_matrices=False)
    if slopes.shape[0] <= slopes.shape[1] or s[0] == 0:
        return np.full((slopes.shape[1],) * 2, np.inf)
    own = np.minimum((u**2).sum(axis=1), 1 - _OWN)
    inverse = (v.T / np.maximum(s, LEAST_FELT * s[0])) @ u.T
    return np.asarray((inverse * (residual / (1 - own)) ** 2) @ inverse.T)


def descend(
    residual: Callable[[FloatArray], FloatArray],
    slopes: Callable[[FloatArray], FloatArray],
    start: FloatArray,
    *,
    rough: bool = False,
) -> FloatArray:
    """Levenberg-Marquardt method (SciPy, MINPACK), to rounding error or ``rough``."""
    from scipy.optimize import least_squares

    with np.errstate(all="ignore"):
        try:
            found = least_squares(
                lambda x: _finite(residual(x), 1e6),
                start,
                jac=lambda x: _finite(slopes(x), 0.0),
                method="lm",
                xtol=1e-6 if rough else 1e-13,
                ftol=1e-8 if rough else 1e-14,
                gtol=1e-15,
                max_nfev=200,
            )
        except (ValueError, np.linalg.LinAlgError, InputError):
            return start
    return np.asarray(found.x)


def _finite(values: FloatArray, instead: float) -> FloatArray:
    """Replace non-finite values by a number."""
    if np.isfinite(values).all():
        return values
    return np.nan_to_num(values, nan=instead, posinf=instead, neginf=-instead)
