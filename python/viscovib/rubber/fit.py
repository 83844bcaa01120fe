"""Fitted kernels: results, uncertainty, and the data that determine each parameter."""

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Whole
from viscovib.common.results import Axes, Dataset, Result, as_dataset
from viscovib.common.values import Value
from viscovib.kernels.relaxation import Kernel
from viscovib.kernels.time_temperature import ShiftLaw, ThermalKernel
from viscovib.rubber.data import ModulusData, RelaxationData
from viscovib.rubber.measured import Measured

#: Number of samples, and their seeds.
_COUNT, _SEED = Whole("n", 1, 10**6), Whole("seed", 0, 2**31)


@dataclass(frozen=True, eq=False, repr=False)
class Optimum(Value):
    """A local optimum of the fit: the sum of squares (weights by the data), parameters.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> best = vv.fit_kernel(data).optima[0]
    >>> round(best.parameters["alpha"], 2), best.cost < 0.02
    (0.5, True)
    """

    cost: float
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Sample:
    """A kernel drawn from the likelihood of the data, the argument of the function of `propagate`.

    Attributes
    ----------
    kernel : Kernel
    modulus : float
        Its instantaneous modulus (Pa, N/m).

    Examples
    --------
    >>> sample = vv.Sample(kernel=vv.AbelKernel(amplitude=0.1, alpha=0.3), modulus=2e6)
    >>> sample.modulus
    2000000.0
    """

    kernel: Kernel
    modulus: float


@dataclass(frozen=True, eq=False, repr=False)
class Profile(Value):
    """Growth of the sum of squares for fixed values of a parameter near its best value.

    Attributes
    ----------
    name : str
    values : ndarray, shape (n,)
        Ascending values of the parameter.
    rise : ndarray, shape (n,)
        Growth of the sum of squares divided by the variance of a residual: 3.84 bounds 95 %.
    interval : (float, float)
        Range in which the rise is below the bound; 0 or inf (for alpha 0 or 1) if it never exceeds
        it.
    level : float

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> profile = vv.fit_kernel(data).profile("alpha")
    >>> bool(profile.interval[0] < 0.5 < profile.interval[1]), bool(profile.rise.min() == 0)
    (True, True)
    """

    name: str
    values: FloatArray
    rise: FloatArray
    interval: tuple[float, float]
    level: float

    def plot(self, ax: "Axes | None" = None) -> Axes:
        """Draw the rise over the values, with the interval."""
        # Import by name, because that module imports this one.
        return import_module("viscovib.plots.rubber").plot_profile(self, ax)  # type: ignore[no-any-return]


class KernelFit(Result, ABC):
    """A kernel fitted to measurements by `fit_kernel`.

    Attributes
    ----------
    kind : str
    quantity : {"E", "G", "K"}
    modulus : float
        Instantaneous modulus M_0 (Pa, N/m).
    kernel : Kernel
        For a material with a shift law a `ThermalKernel`: ``fit.kernel.at(40)``.
    parameters : dict
        Parameters of the kernel at the reference temperature, and ``modulus``; NaN for parameters
        that the data do not determine.
    interval : dict
        95 % interval of each parameter.
    unconstrained : tuple of str
        Parameters that the data do not determine.
    residual : (float, float)
        Relative rms residuals of storage and loss; for data over time (rms, NaN).
    weights : {"model", "data"}
        Reference of the relative residuals in the final fit.
    optima : tuple of Optimum
        Results of all starts, the best first.

    Examples
    --------
    >>> nu = np.geomspace(1e-2, 1e4, 40)
    >>> noise = 1 + 0.01 * np.random.default_rng(1).standard_normal((2, 40))
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(
    ...     frequencies=nu, storage=stiff.real * noise[0], loss=stiff.imag * noise[1]
    ... )
    >>> fit = vv.fit_kernel(data)
    >>> fit.kind, fit.quantity, fit.weights, fit.unconstrained
    ('rabotnov', 'E', 'model', ())
    >>> low, high = fit.interval["alpha"]
    >>> bool(low < 0.5 < high), bool(abs(fit.predict(0.0) / (2e6 / 3) - 1) < 0.01)
    (True, True)
    """

    kind: str  # type: ignore[misc]
    weights: str
    shift: ShiftLaw | None
    measured: Measured
    optima: tuple[Optimum, ...]

    @property
    def quantity(self) -> str:
        """The measured quantity."""
        return self.measured.data.quantity

    @property
    @abstractmethod
    def modulus(self) -> float:
        """Instantaneous modulus."""

    @property
    @abstractmethod
    def bare_kernel(self) -> Kernel:
        """The kernel at the reference temperature, without a shift law."""

    @property
    @abstractmethod
    def parameters(self) -> dict[str, float]:
        """Parameters, NaN for undetermined ones."""

    @property
    @abstractmethod
    def interval(self) -> dict[str, tuple[float, float]]:
        """95 % intervals."""

    @property
    @abstractmethod
    def unconstrained(self) -> tuple[str, ...]:
        """Parameters that the data do not determine."""

    @abstractmethod
    def samples(self, n: int, *, seed: int = 0) -> Iterator[Sample]:
        """Return n kernels drawn from the likelihood of the data."""

    @abstractmethod
    def _sampled(self, n: int, seed: int) -> tuple[Iterator[Sample], float]:
        """Samples, and the number of effective samples."""

    @abstractmethod
    def _predicted(self) -> FloatArray:
        """Prediction of the fit for the measured numbers."""

    @abstractmethod
    def _saved(self) -> dict[str, Any]:
        """Content of a file in addition to the kernel."""

    @cached_property
    def kernel(self) -> Kernel:
        """The kernel, with a temperature if a shift law is known."""
        return self._thermal(self.bare_kernel)

    def _thermal(self, kernel: Kernel) -> Kernel:
        return kernel if self.shift is None else ThermalKernel(kernel=kernel, shift=self.shift)

    @property
    def residual(self) -> tuple[float, float]:
        """Relative rms residuals (storage, loss)."""
        relative = self._predicted() / self.measured.target - 1
        n = self.measured.log_rates.size
        first = float(np.sqrt(np.mean(relative[:n] ** 2)))
        of_loss = relative[n:]
        return first, float(np.sqrt(np.mean(of_loss**2))) if of_loss.size else math.nan

    def predict(self, frequencies: npt.ArrayLike) -> ComplexArray:
        """Return M' + i M'' (Pa, N/m) at circular frequencies (rad/s), any shape."""
        return np.asarray(self.modulus * (1 - self.bare_kernel.transform(frequencies)))[()]

    def _headline(self) -> str:
        storage, loss = self.residual
        both = (
            ""
            if math.isnan(loss)
            else (f" of {self.quantity}', {100 * loss:.2g} % of {self.quantity}''")
        )
        residuals = f"residuals {100 * storage:.2g} %{both}"
        return f"{self.kind}, {residuals}, weights by the {self.weights}"

    def _scope(self) -> list[str]:
        """Return one line per parameter."""
        lines, found = [], self.parameters
        for name, (low, high) in self.interval.items():
            value = "not constrained" if name in self.unconstrained else f"{found[name]:.6g}"
            lines.append(f"{name}: {value}  [{low:.6g}, {high:.6g}]")
        return lines

    def _predicted_error(self) -> FloatArray:
        """Half width of the 95 % band of the prediction; NaN if unknown."""
        return np.full(self.measured.target.size, np.nan)

    def plot(self, ax: "Axes | Sequence[Axes] | None" = None, *, x: str = "rad/s") -> Any:
        """Draw data and fit with its 95 % band (of the parameters), and the residuals below.

        A single axis shows no residuals. ``x``: "rad/s" or "hz". Returns a list of axes.
        """
        # Import by name, because that module imports this one.
        return import_module("viscovib.plots.rubber").plot_fit(self, ax, x=x)

    def _columns(self) -> dict[str, FloatArray]:
        """Measured and fitted values over frequencies or times."""
        n, target, fitted = self.measured.log_rates.size, self.measured.target, self._predicted()
        data = self.measured.data
        if isinstance(data, ModulusData):
            return {
                "frequency": np.asarray(data.frequencies),
                "storage": target[:n],
                "fitted_storage": fitted[:n],
                "loss": target[n:],
                "fitted_loss": fitted[n:],
            }
        name = "modulus" if isinstance(data, RelaxationData) else "compliance"
        return {"time": np.asarray(data.times), name: target, f"fitted_{name}": fitted}

    def to_dataset(self) -> Dataset:
        """Return data and fit over frequencies or times, and parameters with their intervals."""
        columns, found, bounds = self._columns(), self.parameters, self.interval
        values: dict[str, Any] = {name: ("row", column) for name, column in columns.items()}
        values["value"] = ("parameter", [found[name] for name in bounds])
        values["low"] = ("parameter", [low for low, _ in bounds.values()])
        values["high"] = ("parameter", [high for _, high in bounds.values()])
        attrs = {"kind": self.kind, "quantity": self.quantity, "weights": self.weights}
        return as_dataset(values, coords={"parameter": list(bounds)}, attrs=attrs)

    def to_json(self, path: str | os.PathLike[str]) -> None:
        """Write the fit and its data, for `read_fit` and for scenes (``kind = 'fitted'``)."""
        # Import by name: the modules depend on each other.
        import_module("viscovib.rubber.files").write_fit(self, path)
