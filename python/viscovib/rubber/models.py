"""Moduli with few parameters: storage and loss, relaxation and creep of kernels.

A model is M*(w) = M_0 (1 - sum_k p_k H_k(i w)), with parts p_k of the integral and H_k(0) = 1:

    rabotnov     H = 1/(1 + (s tau)^alpha)   A = p tau^-alpha, beta = tau^-alpha (fractional Zener)
    rzhanitsyn   H = (1 + s tau)^-alpha      A = p tau^-alpha/Gamma(alpha), beta = 1/tau
    abel         H = (s tau)^-alpha          A = p tau^-alpha/Gamma(alpha), tau a given time

Unknowns are the logarithms of M_0 and of each tau, the logit of each (alpha - 0.01)/0.99, and w,
p_k = (1 - 1e-6) exp(w_k)/(1 + sum exp(w)). So 0.01 < alpha < 1, p_k > 0 and sum p_k < 1 always
hold, and the relaxed modulus is positive. If an integral of 1 or more is allowed, and for abel
kernels, p_k = exp(w_k).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from viscovib._native import ComplexArray, FloatArray
from viscovib.kernels.relaxation import AbelKernel, Kernel, RabotnovKernel, RzhanitsynKernel
from viscovib.kernels.sum_kernel import SumKernel

PARTS = ("rzhanitsyn", "rabotnov", "abel")
#: Nodes and exponent of the graded rule over a ramp, and nodes of the contour of creep.
_RAMP_NODES, _GRADED, _CONTOUR = 24, 8, 32
#: Smallest alpha: below it the relaxation is logarithmic in time for all measurements.
LEAST_ALPHA = 0.01
#: Largest absolute value of logarithms.
_FARTHEST = 200.0
#: Largest integral, unless 1 and more are allowed.
MOST_INTEGRAL = 1 - 1e-6


@dataclass(frozen=True)
class Model:
    """Parts of a kernel; ``free``: the integral may be 1 or more; ``modulus``: a given M_0."""

    parts: tuple[str, ...]
    free: bool = False
    modulus: float | None = None
    #: Reference time of abel kernels (s).
    unit: float = 1.0

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Public names of the parameters."""
        each: list[str] = []
        for i, part in enumerate(self.parts):
            number = f"_{i + 1}" if len(self.parts) > 1 else ""
            own = ["amplitude", "alpha"] if part == "abel" else ["amplitude", "alpha", "beta"]
            each += [one + number for one in own]
        return (*(() if self.modulus else ("modulus",)), *each)

    @cached_property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.names)

    @cached_property
    def _places(self) -> tuple[list[int], list[int], list[int]]:
        """Indices of the logits of alpha, of ln tau (-1: given), and of w."""
        at = 0 if self.modulus else 1
        alphas, taus = [], []
        for part in self.parts:
            alphas.append(at)
            taus.append(-1 if part == "abel" else at + 1)
            at += 1 if part == "abel" else 2
        return alphas, taus, list(range(at, at + len(self.parts)))

    def split(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        """M_0, alphas, taus, parts of the integral."""
        alphas, taus, ws = self._places
        # Use floats: they are faster than arrays of so few numbers.
        x = [min(max(value, -_FARTHEST), _FARTHEST) for value in theta.tolist()]
        modulus = self.modulus or math.exp(x[0])
        own = 1 - LEAST_ALPHA
        alpha = np.array([LEAST_ALPHA + own / (1 + math.exp(-x[i])) for i in alphas])
        tau = np.array([self.unit if i < 0 else math.exp(x[i]) for i in taus])
        return modulus, alpha, tau, np.array(self._integrals([x[i] for i in ws]))

    @cached_property
    def bounded(self) -> bool:
        """True if the integral stays below 1."""
        return not self.free and "abel" not in self.parts

    def _integrals(self, w: list[float]) -> list[float]:
        if not self.bounded:
            return [math.exp(value) for value in w]
        top = max(0.0, *w)
        powers = [math.exp(value - top) for value in w]
        scale = MOST_INTEGRAL / (math.exp(-top) + sum(powers))
        return [scale * power for power in powers]

    def splits(self, thetas: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """`split` for many sets of unknowns, shape (m, size)."""
        alphas, taus, ws = self._places
        bounded = np.clip(thetas, -_FARTHEST, _FARTHEST)
        modulus = np.full(len(thetas), self.modulus) if self.modulus else np.exp(bounded[:, 0])
        alpha = LEAST_ALPHA + (1 - LEAST_ALPHA) / (1 + np.exp(-bounded[:, alphas]))
        given = np.full(len(thetas), math.log(self.unit))
        tau = np.exp(np.column_stack([given if i < 0 else bounded[:, i] for i in taus]))
        w = bounded[:, ws]
        if not self.bounded:
            return modulus, alpha, tau, np.exp(w)
        top = np.maximum(w.max(axis=1, keepdims=True), 0.0)
        powers = np.exp(w - top)
        p = MOST_INTEGRAL * powers / (np.exp(-top) + powers.sum(axis=1, keepdims=True))
        return modulus, alpha, tau, p

    def log_priors(self, thetas: FloatArray) -> FloatArray:
        """Logarithms of Jeffreys's density 1/sqrt(x (1 - x)) of alphas and parts of the integral.

        For many sets of unknowns, shape (m, size).
        """
        _, alpha, _, p = self.splits(thetas)
        margin = 1 - p.sum(axis=1, keepdims=True) / MOST_INTEGRAL if self.bounded else p[:, :0]
        factors = np.hstack([alpha - LEAST_ALPHA, 1 - alpha, p, margin])
        return np.asarray(np.log(np.maximum(factors, 1e-300)).sum(axis=1) / 2)

    def join(self, modulus: float, alpha: FloatArray, tau: FloatArray, p: FloatArray) -> FloatArray:
        """Unknowns from the quantities of `split`, moved inside their range."""
        alphas, taus, ws = self._places
        theta = np.zeros(self.size)
        if not self.modulus:
            theta[0] = math.log(modulus)
        alpha = np.clip(alpha, LEAST_ALPHA + 1e-3, 1 - 1e-3)
        theta[alphas] = np.log((alpha - LEAST_ALPHA) / (1 - alpha))
        for i, at in enumerate(taus):
            if at >= 0:
                theta[at] = math.log(tau[i])
        p = np.maximum(p, 1e-6)
        if self.bounded:
            p = p * min(1.0, 0.999 / p.sum())
            theta[ws] = np.log(p / (MOST_INTEGRAL - p.sum()))
        else:
            theta[ws] = np.log(p)
        return theta

    def kernel(self, theta: FloatArray) -> Kernel:
        """The kernel, in seconds."""
        _, alpha, tau, p = self.split(theta)
        made: list[Kernel] = []
        for part, a, t, share in zip(
            self.parts, alpha.tolist(), tau.tolist(), p.tolist(), strict=True
        ):
            slow = t**-a
            if part == "rabotnov":
                made.append(RabotnovKernel(amplitude=share * slow, alpha=a, beta=slow))
            elif part == "rzhanitsyn":
                amplitude = share * slow / math.gamma(a)
                made.append(RzhanitsynKernel(amplitude=amplitude, alpha=a, beta=1 / t))
            else:
                made.append(AbelKernel(amplitude=share * slow / math.gamma(a), alpha=a))
        return made[0] if len(made) == 1 else SumKernel(parts=made)

    def parameters(self, theta: FloatArray) -> FloatArray:
        """Values of `names`."""
        modulus, alpha, tau, p = self.split(theta)
        found = [] if self.modulus else [modulus]
        for part, a, t, share in zip(
            self.parts, alpha.tolist(), tau.tolist(), p.tolist(), strict=True
        ):
            slow = t**-a
            if part == "rabotnov":
                found += [share * slow, a, slow]
            else:
                found += [share * slow / math.gamma(a), a]
                found += [1 / t] if part == "rzhanitsyn" else []
        return np.array(found)

    def turned(self, theta: FloatArray) -> FloatArray:
        """Unbounded parameters: logarithms, and logits of alphas."""
        values = self.parameters(theta)
        return np.array(
            [
                _logit(v) if name.startswith("alpha") else math.log(max(v, 1e-300))
                for name, v in zip(self.names, values.tolist(), strict=True)
            ]
        )

    def back(self, name: str, value: float) -> float:
        """Inverse of `turned` for one parameter."""
        with np.errstate(over="ignore"):
            if name.startswith("alpha"):
                return float(LEAST_ALPHA + (1 - LEAST_ALPHA) / (1 + np.exp(-value)))
            return float(np.exp(value))

    def turned_slopes(self, theta: FloatArray) -> FloatArray:
        """Derivatives of `turned` by the unknowns, shape (size, size)."""
        from scipy.special import digamma

        _, alpha, tau, p = self.split(theta)
        alphas, taus, ws = self._places
        slopes = np.zeros((self.size, self.size))
        if not self.modulus:
            slopes[0, 0] = 1.0
        row = 0 if self.modulus else 1
        for k, part in enumerate(self.parts):
            a, log_tau = float(alpha[k]), math.log(tau[k])
            by_logit = (a - LEAST_ALPHA) * (1 - a) / (1 - LEAST_ALPHA)
            # ln(p tau^-alpha), for power laws divided by Gamma(alpha).
            own = -log_tau if part == "rabotnov" else -log_tau - float(digamma(a))
            slopes[row, alphas[k]] = own * by_logit
            if self.bounded:
                slopes[row, ws] = -p / MOST_INTEGRAL
            slopes[row, ws[k]] += 1.0
            slopes[row + 1, alphas[k]] = 1.0
            if part != "abel":
                slopes[row, taus[k]] = -a
                slopes[row + 2, taus[k]] = -a if part == "rabotnov" else -1.0
            if part == "rabotnov":
                slopes[row + 2, alphas[k]] = -log_tau * by_logit
            row += 2 if part == "abel" else 3
        # Derivatives beyond the bounds are 0.
        slopes[:, np.abs(theta) > _FARTHEST] = 0.0
        return slopes

    def modulus_at(
        self, log_s: ComplexArray, theta: FloatArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """M and its derivatives by the unknowns at s = exp(log_s): shapes (n,) and (size, n)."""
        modulus, alpha, tau, p = self.split(theta)
        alphas, taus, ws = self._places
        slopes = np.zeros((self.size, log_s.size), dtype=complex)
        shapes = np.empty((len(self.parts), log_s.size), dtype=complex)
        for k, part in enumerate(self.parts):
            a = alpha[k]
            log_z = log_s + math.log(tau[k])
            if part == "rabotnov":
                power = np.exp(a * log_z)
                h = 1 / (1 + power)
                common = -power * h * h
                by_alpha, by_tau = common * log_z, a * common
            elif part == "rzhanitsyn":
                z = np.exp(log_z)
                log_one = np.log(1 + z)
                h = np.exp(-a * log_one)
                by_alpha, by_tau = -log_one * h, -a * z / (1 + z) * h
            else:
                h = np.exp(-a * log_z)
                by_alpha, by_tau = -log_z * h, -a * h
            shapes[k] = h
            scale = -modulus * p[k]
            slopes[alphas[k]] = scale * (a - LEAST_ALPHA) * (1 - a) / (1 - LEAST_ALPHA) * by_alpha
            if taus[k] >= 0:
                slopes[taus[k]] = scale * by_tau
        total = p @ shapes
        for k, at in enumerate(ws):
            margin = total / MOST_INTEGRAL if self.bounded else 0
            slopes[at] = -modulus * p[k] * (shapes[k] - margin)
        value = modulus * (1 - total)
        if not self.modulus:
            slopes[0] = value
        return np.asarray(value), np.asarray(slopes)

    def moduli(self, log_s: ComplexArray, thetas: FloatArray) -> ComplexArray:
        """M for many sets of unknowns (m, size), s = exp(log_s), shape (m, n); see `modulus_at`."""
        modulus, alpha, tau, p = self.splits(thetas)
        total = np.zeros((len(thetas), log_s.size), dtype=complex)
        for k, part in enumerate(self.parts):
            a, log_z = alpha[:, k, np.newaxis], log_s + np.log(tau[:, k, np.newaxis])
            if part == "rabotnov":
                h = 1 / (1 + np.exp(a * log_z))
            elif part == "rzhanitsyn":
                h = np.exp(-a * np.log(1 + np.exp(log_z)))
            else:
                h = np.exp(-a * log_z)
            total += p[:, k, np.newaxis] * h
        return np.asarray(modulus[:, np.newaxis] * (1 - total))

    def relaxation(self, times: FloatArray, ramp: float, theta: FloatArray) -> FloatArray:
        """M(t) after a ramp: M_0 times the mean relaxation over the ages of its parts."""
        kernel, modulus = self.kernel(theta), self.split(theta)[0]
        return modulus * ramped(kernel, times, ramp)

    def compliance(self, times: FloatArray, theta: FloatArray) -> FloatArray:
        """Creep after a step: the inverse transform of 1/(s M(s))."""
        return np.asarray(self.creep(times, theta, slopes=False)[0])

    def creep(self, times: FloatArray, theta: FloatArray, *, slopes: bool) -> FloatArray:
        """Creep and, with ``slopes``, its derivatives by the unknowns, (1 + size, n) or (1, n)."""

        def transform(log_s: ComplexArray) -> ComplexArray:
            value, by = self.modulus_at(log_s, theta)
            creep = 1 / (np.exp(log_s) * value)
            return np.vstack([creep, -by * (creep / value)]) if slopes else creep[np.newaxis]

        return inverse_laplace(transform, times)


def _logit(alpha: float) -> float:
    return math.log(max(alpha - LEAST_ALPHA, 1e-300) / max(1 - alpha, 1e-300))


def ramped(kernel: Kernel, times: FloatArray, ramp: float) -> FloatArray:
    """Relaxation after a ramp of strain: its mean over [t - ramp, t], t >= ramp."""
    if ramp == 0:
        return kernel.relaxation(times)
    x, w = np.polynomial.legendre.leggauss(_RAMP_NODES)
    u = (1 + x) / 2
    # Graded towards the youngest part, whose relaxation starts like a power of its age.
    ages = np.maximum(times - ramp, 0)[:, np.newaxis] + ramp * u**_GRADED
    weights = w / 2 * _GRADED * u ** (_GRADED - 1)
    return np.asarray(kernel.relaxation(ages) @ weights)


def inverse_laplace(
    transform: Callable[[ComplexArray], ComplexArray], times: FloatArray
) -> FloatArray:
    """Values in time on a modified Talbot contour (Weideman, SIAM J. Numer. Anal. 44, 2006).

    ``transform``: k functions at logarithms of s (m,), shape (k, m). Result: shape (k, n).
    """
    zeta, weights = _contour()
    log_s = np.log(zeta)[np.newaxis, :] - np.log(times)[:, np.newaxis]
    values = transform(log_s.ravel()).reshape(-1, *log_s.shape)
    return np.asarray((values @ weights).imag / times)


@cache
def _contour() -> tuple[ComplexArray, ComplexArray]:
    """Points on the contour times t, and their weights."""
    theta = (2 * np.arange(1, _CONTOUR // 2 + 1) - 1) * np.pi / _CONTOUR
    angle = 0.6407 * theta
    zeta = _CONTOUR * (0.5017 * theta / np.tan(angle) - 0.6122 + 0.2645j * theta)
    slope = _CONTOUR * (0.5017 / np.tan(angle) - 0.5017 * angle / np.sin(angle) ** 2 + 0.2645j)
    return zeta, np.asarray(2 / _CONTOUR * np.exp(zeta) * slope)


def start_shapes(
    part: str, alphas: Sequence[float], taus: FloatArray, log_s: ComplexArray
) -> ComplexArray:
    """H on a grid, shape (alphas, taus, n)."""
    log_z = log_s + np.log(taus)[:, np.newaxis]
    a = np.asarray(alphas)[:, np.newaxis, np.newaxis]
    if part == "rabotnov":
        return np.asarray(1 / (1 + np.exp(a * log_z)))
    if part == "rzhanitsyn":
        return np.asarray(np.exp(-a * np.log(1 + np.exp(log_z))))
    return np.asarray(np.exp(-a * log_z))
