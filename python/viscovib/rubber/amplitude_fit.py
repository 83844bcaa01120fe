"""Amplitude dependence: stiffness that decreases with amplitude, progressive static curves.

A filled rubber is modelled by a kernel in parallel with Jenkins elements: springs k that slip at k
x_s. With u = x_s/X < 1 and cos t = 1 - 2 u their first harmonic is K' = (k/pi) (t - sin(2 t)/2) and
K'' = (k/pi) sin(t)^2, and k if X <= x_s (Caughey, J. Appl. Mech. 27, 1960). Several elements form
an Iwan model (Iwan, J. Appl. Mech. 33, 1966). The part of the kernel does not depend on the
amplitude, that of a Jenkins element does not depend on the frequency.
"""

import math
import warnings
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Flag, Whole
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.relaxation import Kernel
from viscovib.rubber.data import ModulusData
from viscovib.rubber.kernel_fit import fit_kernel
from viscovib.rubber.measured import Measured, covariance, descend
from viscovib.rubber.models import PARTS, Model, start_shapes

_ELEMENTS, _DEGREE, _ODD = Whole("elements", 1, 6), Whole("degree", 1, 9), Flag("odd")
#: Bounds of the largest deflection of a law (m).
_SIZES = (1e-12, 1e12)
#: Relative difference below which two amplitudes are equal.
_SAME = 1e-3
#: Number of slip deflections in the grid of starts, and of repeated fits of the best start.
_STARTS, _POLISHED = 16, 12
#: Exponents and number of times of the kernel in the grid of starts; number of starts continued.
_ALPHAS, _TIMES, _BEST = (0.08, 0.2, 0.35, 0.5, 0.65, 0.8, 0.93), 12, 3
#: Smallest part of a start relative to the largest stiffness.
_LEAST = 1e-6
#: A slip is neither above nor below an amplitude within this distance (logarithm).
_NEARBY = 0.02
#: Squared relative residual that is a rounding error.
_EXACT = 1e-28


def jenkins_stiffness(amplitude: npt.ArrayLike, *, stiffness: float, slip: float) -> ComplexArray:
    """Return the first harmonic of force divided by deflection of a Jenkins element.

    Parameters
    ----------
    amplitude : array_like
        X > 0 (m), any shape.
    stiffness : float
        k (N/m), > 0.
    slip : float
        Deflection at which it slips, x_s (m), > 0.

    Returns
    -------
    ndarray of complex, as amplitude
        K' + i K'' (N/m).

    Examples
    --------
    >>> vv.jenkins_stiffness([0.5e-3, 2e-3], stiffness=1e5, slip=1e-3).round(0)
    array([100000.    +0.j,  50000.+31831.j])
    """
    x = _native.real_array("amplitude", amplitude)
    k, s = _native.number("stiffness", stiffness), _native.number("slip", slip)
    if x.size and x.min() <= 0:
        raise InputError(f"amplitude = {x.min():g}: must be greater than 0")
    for name, value in (("stiffness", k), ("slip", s)):
        if value <= 0:
            raise InputError(f"{name} = {value:g}: must be greater than 0")
    return _jenkins(x, k, s)[()]


def _jenkins(x: FloatArray, k: float, s: float) -> ComplexArray:
    angle = np.arccos(1 - 2 * (np.minimum(s, x) / x))
    parts = angle - np.sin(2 * angle) / 2 + 1j * np.sin(angle) ** 2
    return np.asarray(k / math.pi * parts)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AmplitudeFit(Value):
    """A kernel in parallel with Jenkins elements, fitted by `fit_amplitude`.

    Attributes
    ----------
    kernel : Kernel
    modulus : float
        Instantaneous stiffness of the kernel's part (N/m).
    stiffness, slip : ndarray, shape (n,)
        k (N/m) and x_s (m) of the elements, ascending; they slip at forces k x_s.
    residual : (float, float)
        Relative rms residuals of K' and K''.
    interval : dict
        95 % intervals, linearized over logarithms: "stiffness_1", "slip_1", ...; 0 to inf for
        unconstrained parameters.
    unconstrained : tuple of str
        Parameters that the data do not determine: elements that slip below the smallest or above
        the largest amplitude, and two elements without an amplitude between their slips.

    Examples
    --------
    >>> slip = vv.jenkins_stiffness([1e-4, 1e-3], stiffness=1e5, slip=5e-4)
    >>> bool(abs(slip[0].imag) < 1e-6 and slip[1].real < 1e5)
    True
    """

    kernel: Kernel
    modulus: float
    stiffness: FloatArray
    slip: FloatArray
    residual: tuple[float, float]
    interval: dict[str, tuple[float, float]]
    unconstrained: tuple[str, ...] = ()

    def predict(self, frequencies: npt.ArrayLike, amplitude: npt.ArrayLike) -> ComplexArray:
        """Return K' + i K'' (N/m) at frequencies (rad/s) and amplitudes (m) of one shape."""
        nu = _native.real_array("frequencies", frequencies)
        x = _native.real_array("amplitude", amplitude)
        try:
            np.broadcast_shapes(nu.shape, x.shape)
        except ValueError:
            raise InputError(
                f"frequencies, amplitude: have shapes {nu.shape} and {x.shape}, must be of one"
            ) from None
        total = self.modulus * (1 - self.kernel.transform(nu)) + np.zeros(x.shape)
        for k, s in zip(self.stiffness.tolist(), self.slip.tolist(), strict=True):
            total = total + jenkins_stiffness(x, stiffness=k, slip=s)
        return np.asarray(total)


def fit_amplitude(data: ModulusData, *, kind: str = "rabotnov", elements: int = 1) -> AmplitudeFit:
    """Fit a kernel in parallel with Jenkins elements to a stiffness at several amplitudes.

    Parameters
    ----------
    data : ModulusData
        With two or more amplitudes, one set each.
    kind : {"rabotnov", "rzhanitsyn", "abel"}
        Kind of the kernel.
    elements : int
        1 to 6 Jenkins elements; several form an Iwan model.

    Returns
    -------
    AmplitudeFit
        Use its numbers in `Jenkins` or `Iwan` elements of a `Structure`. The part of the kernel
        equals the result of `fit_kernel` for large amplitudes.

    Warns
    -----
    ConvergenceWarning
        If the amplitudes do not determine an element, see `AmplitudeFit.unconstrained`.

    Examples
    --------
    >>> nu, x = np.tile(np.geomspace(1, 1e3, 12), 4), np.repeat([1e-4, 3e-4, 1e-3, 3e-3], 12)
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> k = 2e5 * (1 - rubber.transform(nu)) + vv.jenkins_stiffness(x, stiffness=1e5, slip=2e-4)
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=k.real, loss=k.imag, amplitude=x, quantity="K"
    ... )
    >>> fit = vv.fit_amplitude(data)
    >>> float(fit.stiffness[0].round(3)), float(fit.slip[0].round(9)), round(fit.modulus, 3)
    (100000.0, 0.0002, 200000.0)
    """
    _native.check_instance("data", data, ModulusData)
    _native.choice("kind", kind, PARTS)
    count = _ELEMENTS.check(elements)
    if data.amplitude is None:
        raise InputError("data: has no amplitudes, must have them")
    x = np.asarray(data.amplitude)
    levels = np.unique(np.round(np.log(x) / _SAME)) * _SAME
    if levels.size < 2:
        raise InputError(f"data: has only one amplitude, {x[0]:g} m, must have two or more")
    nu = np.asarray(data.frequencies)
    measured = Measured.of(ModulusData(
        frequencies=nu, storage=data.storage, loss=data.loss, set=data.set, quantity=data.quantity
    ), (1.0, 1.0))  # fmt: skip
    model = Model((kind,), unit=math.exp(-float(np.mean(measured.log_rates))))
    if 2 * nu.size < model.size + 2 * count:
        raise InputError(
            f"data: {2 * nu.size} numbers do not determine {model.size + 2 * count} parameters"
        )
    first = np.log(x) >= levels[-1] - _SAME
    start = _kernel_start(data, first, kind, model)
    drop = np.asarray(data.storage)[np.log(x) <= levels[0] + _SAME].max()
    guess = max(float(drop - np.asarray(data.storage)[first].max()), 0.05 * float(drop)) / count
    grid = np.linspace(levels[0], levels[-1], count + 5)[1:-1]
    slips = list(islice(combinations(grid, count), _STARTS))
    starts = [np.concatenate([start, np.full(count, math.log(guess)), one]) for one in slips]
    starts += _grid_starts(measured, x, model, slips)

    def said(t: FloatArray) -> FloatArray:
        value, _ = model.modulus_at(measured.along, t[: model.size])
        for k, s in zip(t[model.size : model.size + count], t[model.size + count :], strict=True):
            value = value + _jenkins(x, math.exp(min(k, 300)), math.exp(min(max(s, -300), 300)))
        return np.concatenate([value.real, value.imag])

    size = np.tile(np.abs(data.modulus), 2)

    def residual(t: FloatArray) -> FloatArray:
        return np.asarray((said(t) - measured.target) / size)

    def slopes(t: FloatArray) -> FloatArray:
        found = np.empty((measured.target.size, t.size))
        for j in range(t.size):
            step = np.zeros(t.size)
            step[j] = 1e-6 * max(1.0, abs(t[j]))
            found[:, j] = (residual(t + step) - residual(t - step)) / (2 * step[j])
        return found

    ends = [descend(residual, slopes, one, rough=True) for one in starts]
    theta = min(ends, key=lambda end: float(residual(end) @ residual(end)))
    for _ in range(_POLISHED):
        before = float(residual(theta) @ residual(theta))
        theta = descend(residual, slopes, theta)
        after = float(residual(theta) @ residual(theta))
        if after > 0.999 * before or after < _EXACT * measured.target.size:
            break
    return _amplitude_result(model, theta, count, residual(theta), slopes(theta), levels)


def _kernel_start(
    data: ModulusData, rows: npt.NDArray[np.bool_], kind: str, model: Model
) -> FloatArray:
    """Unknowns of the kernel from the rows with the largest amplitude."""
    from viscovib.rubber.parametric_fit import ParametricFit

    order = np.argsort(np.asarray(data.frequencies)[rows])
    part = ModulusData(
        frequencies=np.asarray(data.frequencies)[rows][order],
        storage=np.asarray(data.storage)[rows][order],
        loss=np.asarray(data.loss)[rows][order],
    )
    with warnings.catch_warnings():
        # Warnings about the first guess are irrelevant.
        warnings.simplefilter("ignore")
        fit = fit_kernel(part, kind=kind, weights="data")
    assert isinstance(fit, ParametricFit)
    modulus, alpha, tau, p = fit.model.split(fit.theta)
    if kind == "abel":
        p = p * (fit.model.unit / model.unit) ** alpha
        tau = np.array([model.unit])
    return model.join(modulus, alpha, tau, p)


def _grid_starts(
    measured: Measured, x: FloatArray, model: Model, slips: list[tuple[float, ...]]
) -> list[FloatArray]:
    """Unknowns by least squares on a grid of exponents, times and slips, the best first.

    The others are linear: M_0 (1 - p H) + sum k_i J_i. Fits with a negative part are dropped.
    """
    part = model.parts[0]
    taus = np.array([model.unit])
    if part != "abel":
        ends = -measured.log_rates.max() - 1, -measured.log_rates.min() + 1
        taus = np.exp(np.linspace(*ends, _TIMES))
    shapes = start_shapes(part, _ALPHAS, taus, measured.along)
    size = np.abs(measured.target[: x.size] + 1j * measured.target[x.size :])
    found: list[tuple[float, FloatArray]] = []
    for places in slips:
        springs = [_jenkins(x, 1.0, math.exp(place)) for place in places]
        fixed = np.array([np.ones(x.size), *springs], dtype=complex)
        for (i, j), shape in zip(
            np.ndindex(shapes.shape[:2]), shapes.reshape(-1, x.size), strict=True
        ):
            rows = np.vstack([fixed, -shape]) / size
            rows = np.concatenate([rows.real, rows.imag], axis=1).T
            target = measured.target / np.tile(size, 2)
            parts, *_ = np.linalg.lstsq(rows, target, rcond=None)
            if parts.min() <= _LEAST * parts.max() or (model.bounded and parts[-1] >= parts[0]):
                continue
            alpha, tau, share = np.array([_ALPHAS[i]]), taus[[j]], parts[[-1]] / parts[0]
            theta = model.join(float(parts[0]), alpha, tau, share)
            residuals = target - rows @ parts
            found.append(
                (float(residuals @ residuals), np.concatenate([theta, np.log(parts[1:-1]), places]))
            )
    found.sort(key=lambda one: one[0])
    return [one for _, one in found[:_BEST]]


def _amplitude_result(
    model: Model,
    theta: FloatArray,
    count: int,
    residuals: FloatArray,
    slopes: FloatArray,
    levels: FloatArray,
) -> AmplitudeFit:
    from scipy.special import stdtrit

    order = np.argsort(theta[model.size + count :])
    k = theta[model.size : model.size + count][order]
    s = theta[model.size + count :][order]
    free = max(residuals.size - theta.size, 1)
    errors = np.sqrt(np.maximum(np.diag(covariance(slopes, residuals)), 0))
    reach = float(stdtrit(free, 0.975))
    interval = {}
    for name, values, spread in (
        ("stiffness", k, errors[model.size : model.size + count][order]),
        ("slip", s, errors[model.size + count :][order]),
    ):
        for i in range(count):
            ends = np.exp(np.clip(values[i] + np.array([-1, 1]) * reach * spread[i], -700, 700))
            interval[f"{name}_{i + 1}"] = (float(ends[0]), float(ends[1]))
    loose = _unconstrained(s, levels)
    if loose:
        interval |= dict.fromkeys(loose, (0.0, math.inf))
        warnings.warn(
            f"the amplitudes do not determine {', '.join(loose)}: the slip of an element must "
            "lie between the smallest and the largest amplitude, and an amplitude between the "
            "slips of two elements",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    half = residuals.size // 2
    return AmplitudeFit(
        kernel=model.kernel(theta[: model.size]),
        modulus=model.split(theta[: model.size])[0],
        stiffness=np.exp(k),
        slip=np.exp(s),
        residual=(
            float(np.sqrt(np.mean(residuals[:half] ** 2))),
            float(np.sqrt(np.mean(residuals[half:] ** 2))),
        ),
        interval=interval,
        unconstrained=loose,
    )


def _unconstrained(slips: FloatArray, levels: FloatArray) -> tuple[str, ...]:
    """Names of undetermined parameters, from logarithms of slips and of amplitudes."""
    loose = (slips < levels[0] + _NEARBY) | (slips > levels[-1] - _NEARBY)
    for i in range(slips.size - 1):
        between = (levels > slips[i] + _NEARBY) & (levels < slips[i + 1] - _NEARBY)
        if not between.any():
            loose[i : i + 2] = True
    places = (np.flatnonzero(loose) + 1).tolist()
    return tuple(f"{name}_{i}" for i in places for name in ("stiffness", "slip"))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ProgressiveLaw(Value):
    """A static curve as a polynomial, fitted by `fit_progressive`.

    Attributes
    ----------
    stiffness : float
        Linear part k (N/m).
    law : str
        The nonlinear part as a text for springs, "k3*d^3"; its numbers are ``parameters``.
    parameters : dict of str to float
    residual : float
        Root mean square divided by the largest force.

    Examples
    --------
    >>> d = np.linspace(-5e-3, 5e-3, 21)
    >>> found = vv.fit_progressive(d, 1e5 * d + 4e9 * d**3)
    >>> spring = vv.Spring(
    ...     on="x", stiffness=found.stiffness, law=found.law, parameters=found.parameters
    ... )
    """

    stiffness: float
    law: str
    parameters: dict[str, float]
    residual: float


def fit_progressive(
    deflection: npt.ArrayLike, force: npt.ArrayLike, *, degree: int = 3, odd: bool = True
) -> ProgressiveLaw:
    """Fit k d + k2 d^2 + ... to a static curve. Its slope must stay positive.

    Parameters
    ----------
    deflection : array_like, shape (n,)
        d (m).
    force : array_like, shape (n,)
        N.
    degree : int
        1 to 9.
    odd : bool
        Odd powers only: a symmetric law.

    Raises
    ------
    InputError
        If the fitted curve decreases within the deflections, because such a static law is unstable.

    Examples
    --------
    >>> d = np.linspace(0, 5e-3, 11)
    >>> found = vv.fit_progressive(d, 1e5 * d + 4e9 * d**3)
    >>> found.law, round(found.stiffness, 3), round(found.parameters["k3"], 0)
    ('k3*d^3', 100000.0, 4000000000.0)
    """
    d = _native.real_array("deflection", deflection, ndim=1)
    f = _native.real_array("force", force, ndim=1)
    top, only = _DEGREE.check(degree), _ODD.check(odd)
    powers = [p for p in range(1, top + 1) if p % 2 or not only]
    if d.size != f.size or d.size < len(powers) or not np.any(d):
        raise InputError(
            f"deflection and force have {d.size} and {f.size} numbers: must match, be at least "
            f"{len(powers)} and not all 0"
        )
    size = float(np.abs(d).max())
    if not _SIZES[0] <= size <= _SIZES[1]:
        raise InputError(f"deflection: the largest is {size:g} m, must be 1e-12 to 1e12 m")
    rows = (d / size)[:, np.newaxis] ** np.array(powers)
    found, *_ = np.linalg.lstsq(rows, f, rcond=None)
    fine = np.linspace(min(d.min(), 0.0), max(d.max(), 0.0), 400) / size
    slope = sum(c * p * fine ** (p - 1) for c, p in zip(found, powers, strict=True))
    if np.min(slope) <= 0:
        at = size * float(fine[int(np.argmin(slope))])
        raise InputError(
            f"degree = {top}: the fitted force decreases at a deflection of {at:g} m, must "
            "increase everywhere: use another degree"
        )
    scaled = {p: float(c / size**p) for c, p in zip(found, powers, strict=True)}
    largest = max(float(np.abs(f).max()), 1e-300)
    residuals = (rows @ found - f) / largest
    return ProgressiveLaw(
        stiffness=scaled[1],
        law=" + ".join(f"k{p}*d^{p}" for p in powers[1:]) or "0*d",
        parameters={f"k{p}": scaled[p] for p in powers[1:]},
        residual=float(np.sqrt(np.mean(residuals**2))),
    )
