"""Fits of few parameters: covariances, intervals, profiles."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.parameters import Number
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel
from viscovib.kernels.time_temperature import ShiftLaw
from viscovib.rubber.data import ModulusData
from viscovib.rubber.fit import _COUNT, _SEED, KernelFit, Optimum, Profile, Sample
from viscovib.rubber.likelihood import likely
from viscovib.rubber.measured import LEAST_FELT, Measured, covariance, descend
from viscovib.rubber.models import LEAST_ALPHA, Model

_LEVEL = Number("level", 0.01, 0.9999)
#: A parameter is not constrained if the ends of its 95 % interval have this ratio or, for alpha, if
#: the interval has this width.
_LOOSE, _WIDE = 20.0, 0.5
#: Largest number of points on each side of a profile, growth of steps, largest log distance,
#: and weight that fixes a parameter.
_SIDE, _LONGER, _FAR, _HOLD = 60, 1.5, 40.0, 1e3


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ParametricFit(KernelFit):
    """A fit with few parameters; see `KernelFit`.

    It is linearized at the best parameters, over their logarithms (the logit of alpha), so
    intervals stay admissible (Seber and Wild, Nonlinear Regression, 1989, ch. 5). The covariance
    uses the residuals themselves (HC3 of MacKinnon and White, J. Econometrics 29, 1985), so storage
    and loss may have different scatter. Errors must be independent: a common error, such as an
    error of calibration, is not part of the intervals.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> fit = vv.fit_kernel(data)
    >>> fit.names, fit.correlation.shape, sorted(fit.zener[0])
    (('modulus', 'amplitude', 'alpha', 'beta'), (4, 4), ['alpha', 'loss', 'relaxed', 'tau'])
    """

    model: Model
    measured: Measured
    theta: FloatArray
    weights: str
    shift: ShiftLaw | None
    kind: str  # type: ignore[misc]
    optima: tuple[Optimum, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of matrices."""
        return self.model.names

    @property
    def modulus(self) -> float:
        """Instantaneous modulus."""
        return self.model.split(self.theta)[0]

    @cached_property
    def bare_kernel(self) -> Kernel:
        """The kernel at the reference temperature, without a shift law."""
        return self.model.kernel(self.theta)

    @cached_property
    def _problem(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Scales, residuals and their derivatives by the unknowns."""
        factor = self.measured.scale(self.model, self.theta, self.weights)
        residual = (self._predicted() - self.measured.target) * factor
        slopes = self.measured.slopes(self.model, self.theta) * factor[:, np.newaxis]
        return factor, residual, slopes

    @cached_property
    def _variance(self) -> float:
        _, residual, slopes = self._problem
        free = self.measured.count - slopes.shape[1]
        return float(residual @ residual) / free if free > 0 else math.inf

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the fitted unknowns, shape (k, k)."""
        _, residual, slopes = self._problem
        rows = self.measured.shares > 0
        return covariance(slopes[rows], residual[rows])

    @cached_property
    def turned_covariance(self) -> FloatArray:
        """Covariance of the logarithms of parameters (logit for alpha), in order of ``names``."""
        turn = self.model.turned_slopes(self.theta)
        # Infinite for undetermined parameters; times 0 this is NaN, which means unknown.
        with np.errstate(invalid="ignore"):
            return np.asarray(turn @ self.covariance @ turn.T)

    @cached_property
    def _errors(self) -> FloatArray:
        own = np.diag(self.turned_covariance)
        return np.sqrt(np.where(np.isnan(own), np.inf, np.maximum(own, 0.0)))

    @cached_property
    def _alike(self) -> FloatArray:
        """Ratio of the variances for equal scatter of all rows to the actual variances."""
        turn = self.model.turned_slopes(self.theta)
        with np.errstate(invalid="ignore"):
            plain = self._variance * np.diag(turn @ _inverse(self._problem[2]) @ turn.T)
        own = self._errors**2
        known = np.isfinite(plain) & np.isfinite(own) & (own > 0)
        return np.where(known, plain / np.where(known, own, 1.0), 1.0)

    @property
    def correlation(self) -> FloatArray:
        """Correlations of the parameters, in the order of ``names``, shape (k, k)."""
        size = np.where(self._errors > 0, self._errors, 1.0)
        return np.asarray(self.turned_covariance / np.outer(size, size))

    @cached_property
    def interval(self) -> dict[str, tuple[float, float]]:
        """95 % interval of each parameter."""
        return self.intervals(0.95)

    def intervals(self, level: float) -> dict[str, tuple[float, float]]:
        """Return the interval of each parameter at a different level."""
        from scipy.special import stdtrit

        wanted = _LEVEL.check(level)
        if self.at_bound:
            return {name: self.profile(name, level=wanted).interval for name in self.names}
        free = max(self.measured.count - len(self.names), 1)
        reach = float(stdtrit(free, 0.5 + wanted / 2))
        middle = self.model.turned(self.theta)
        found = {}
        for name, at, error in zip(self.names, middle.tolist(), self._errors.tolist(), strict=True):
            ends = (at - reach * error, at + reach * error)
            found[name] = (self.model.back(name, ends[0]), self.model.back(name, ends[1]))
        return found

    @cached_property
    def at_bound(self) -> bool:
        """True if the fit lies at a bound of the admissible range, such as an integral near 1.

        It is then not a local minimum, and intervals are those of `profile`.
        """
        _, alpha, _, p = self.model.split(self.theta)
        ends = alpha.min() < LEAST_ALPHA + 1e-3 or alpha.max() > 1 - 1e-3
        return bool(ends or p.min() < 1e-4 or (self.model.bounded and p.sum() > 1 - 1e-3))

    @cached_property
    def unconstrained(self) -> tuple[str, ...]:
        """Parameters that the data do not determine."""
        loose = []
        for name, (low, high) in self.interval.items():
            if name.startswith("alpha"):
                known = high - low <= _WIDE
            else:
                known = low > 0 and high < low * _LOOSE
            if not known:
                loose.append(name)
        return tuple(loose)

    @cached_property
    def parameters(self) -> dict[str, float]:
        """Parameters, NaN for undetermined ones."""
        values = dict(zip(self.names, self.model.parameters(self.theta).tolist(), strict=True))
        return {k: math.nan if k in self.unconstrained else v for k, v in values.items()}

    @property
    def zener(self) -> tuple[dict[str, float], ...]:
        """Return each rabotnov part as a fractional Zener element.

        ``loss``: M_0 p, the relaxing part of the modulus; ``tau`` (s) and ``alpha`` of (i w
        tau)^alpha. A single part also has ``relaxed``, the relaxed modulus.
        """
        modulus, alpha, tau, p = self.model.split(self.theta)
        rows = zip(self.model.parts, alpha.tolist(), tau.tolist(), p.tolist(), strict=True)
        found = [
            {"loss": modulus * share, "tau": t, "alpha": a}
            for part, a, t, share in rows
            if part == "rabotnov"
        ]
        if len(self.model.parts) == 1 and found:
            found[0]["relaxed"] = modulus * (1 - float(p[0]))
        return tuple(found)

    def profile(self, name: str, *, level: float = 0.95) -> Profile:
        """Fix a parameter at values near its best value and fit the remaining parameters.

        Unlike ``interval`` this does not assume a parabolic sum of squares. The rise is given in
        variances of the parameter from ``covariance``.
        """
        from scipy.special import fdtri

        _native.choice("name", name, self.names)
        wanted = _LEVEL.check(level)
        free = max(self.measured.count - len(self.names), 1)
        bound = float(fdtri(1, free, wanted))
        place = self.names.index(name)
        middle = float(self.model.turned(self.theta)[place])
        step = max(0.4 * min(float(self._errors[place]), 1.0), 1e-8)
        best = float(self._problem[1] @ self._problem[1])
        share = float(self._alike[place]) / self._variance if self._variance > 0 else math.inf
        values, rises, ends = [middle], [0.0], []
        for way in (-1, 1):
            theta, at, rise = self.theta, middle, 0.0
            end = 0.0 if way < 0 else (1.0 if name.startswith("alpha") else math.inf)
            for i in range(1, _SIDE + 1):
                away = step * (_LONGER**i - 1) / (_LONGER - 1)
                if away > _FAR:
                    break
                before, at = (at, rise), middle + way * away
                theta, cost = self._held(place, at, theta)
                if self.at_bound:
                    # At the bounds derivatives vanish: also start from inside.
                    inner = self.model.join(*self.model.split(theta))
                    theta, cost = min((theta, cost), self._held(place, at, inner), key=_second)
                rise = max(cost - best, 0.0) * share if self._variance > 0 else math.inf
                values.append(at)
                rises.append(rise)
                if rise > bound:
                    lower, upper = math.sqrt(before[1]), math.sqrt(min(rise, 1e300))
                    part = (math.sqrt(bound) - lower) / (upper - lower)
                    end = self.model.back(name, before[0] + part * (at - before[0]))
                    break
            ends.append(end)
        order = np.argsort(values)
        return Profile(
            name=name,
            values=np.array([self.model.back(name, values[i]) for i in order]),
            rise=np.array(rises)[order],
            interval=(ends[0], ends[1]),
            level=wanted,
        )

    def _held(self, place: int, at: float, start: FloatArray) -> tuple[FloatArray, float]:
        """Fit with a fixed parameter: its distance is one more residual with a large weight."""
        model, measured = self.model, self.measured
        factor = self._problem[0]
        weight = (
            _HOLD * math.sqrt(max(self._variance, 1e-24)) / max(float(self._errors[place]), 1e-12)
        )

        def residual(x: FloatArray) -> FloatArray:
            off = weight * (model.turned(x)[place] - at)
            return np.append((measured.predicted(model, x) - measured.target) * factor, off)

        def slopes(x: FloatArray) -> FloatArray:
            rows = measured.slopes(model, x) * factor[:, np.newaxis]
            return np.vstack([rows, weight * model.turned_slopes(x)[place]])

        found = descend(residual, slopes, start)
        residuals = residual(found)[:-1]
        return found, float(residuals @ residuals)

    def constraints(self) -> tuple[FloatArray, FloatArray]:
        """Return the range of the data that determines each parameter.

        Returns
        -------
        edges : ndarray, shape (m + 1,)
            Decades of circular frequency (rad/s), or of time (s).
        growth : ndarray, shape (m, k)
            Factor by which the standard error of each parameter, in the order of ``names``, would
            grow without the data of each decade.
        """
        _, _, slopes = self._problem
        over_time = not isinstance(self.measured.data, ModulusData)
        place = self.measured.log_rates / math.log(10) * (-1 if over_time else 1)
        place = np.tile(place, self.measured.target.size // place.size)
        edges = np.arange(math.floor(place.min()), math.floor(place.max()) + 2)
        turn = self.model.turned_slopes(self.theta)
        whole = np.sqrt(np.diag(turn @ _inverse(slopes) @ turn.T))
        growth = []
        for low in edges[:-1]:
            kept = slopes[(place < low) | (place >= low + 1)]
            growth.append(np.sqrt(np.diag(turn @ _inverse(kept) @ turn.T)) / whole)
        return 10.0**edges, np.array(growth)

    def samples(self, n: int, *, seed: int = 0) -> Iterator[Sample]:
        """Return n kernels drawn from the likelihood of the data.

        If it is nearly normal over the unknowns, this distribution is resampled. Otherwise, for
        example with a parameter at its bound or an interval over decades, an ensemble of Markov
        chains is used, which takes some seconds for 1000 kernels.
        """
        yield from self._sampled(_COUNT.check(n), _SEED.check(seed))[0]

    def _sampled(self, n: int, seed: int) -> tuple[Iterator[Sample], float]:
        drawn, effective = self._drawn(n, seed)
        return (
            Sample(self._thermal(self.model.kernel(theta)), self.model.split(theta)[0])
            for theta in drawn
        ), effective

    def _drawn(self, n: int, seed: int) -> tuple[FloatArray, float]:
        """Unknowns of samples, and the effective number of samples."""
        if not np.isfinite(self.covariance).all():
            raise InputError(
                f"data: {self.measured.count} numbers for {self.theta.size} parameters do not "
                "determine the scatter: must be more"
            )
        return likely(self, n, np.random.default_rng(seed))

    def _predicted(self) -> FloatArray:
        return self.measured.predicted(self.model, self.theta)

    def _predicted_error(self) -> FloatArray:
        from scipy.special import stdtrit

        slopes = self.measured.slopes(self.model, self.theta)
        free = max(self.measured.count - len(self.names), 1)
        with np.errstate(invalid="ignore"):
            squares = np.einsum("ij,jk,ik->i", slopes, self.covariance, slopes)
        return np.asarray(stdtrit(free, 0.975) * np.sqrt(np.maximum(squares, 0)))

    def _saved(self) -> dict[str, Any]:
        return {
            "parts": list(self.model.parts),
            "allow_creep": self.model.free,
            "given_modulus": self.model.modulus,
            "unit": self.model.unit,
            "unknowns": self.theta.tolist(),
        }


def _second(pair: tuple[FloatArray, float]) -> float:
    return pair[1]


def _inverse(slopes: FloatArray) -> FloatArray:
    """(J' J)^-1, with large values for undetermined directions."""
    if not slopes.size or not np.isfinite(slopes).all():
        raise InputError("data: the derivatives at the best fit are not finite")
    _, s, v = np.linalg.svd(slopes, full_matrices=False)
    if s.size < slopes.shape[1] or s[0] == 0:
        return np.full((slopes.shape[1],) * 2, np.inf)
    return np.asarray((v.T / np.maximum(s, LEAST_FELT * s[0]) ** 2) @ v)
