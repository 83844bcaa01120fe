"""Measurements of rubber: moduli over frequency, relaxation, creep, dynamic stiffness.

All numbers are in SI units, and frequencies are circular (rad/s). Readers convert the units of a
file. E is Young's modulus, G the shear modulus, K a stiffness. A conversion between them needs a
Poisson ratio.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.parameters import Number
from viscovib.common.results import Axes
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.kernels.time_temperature import KELVIN

#: Measured quantities: E or G (Pa), K (N/m or N m/rad).
QUANTITIES = ("E", "G", "K")
#: Upper bound of measured numbers and their inverses.
_FAR = 1e40
_POISSON = Number("poisson", -1, 0.5)
_RAMP = Number("ramp", lowest=0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModulusData(Value):
    """Storage and loss over frequency, in one or several sets.

    Parameters
    ----------
    frequencies : array_like, shape (n,)
        Circular frequencies (rad/s), > 0, different within a set.
    storage, loss : array_like, shape (n,)
        M' > 0 and M'' >= 0: moduli (Pa), or dynamic stiffness (N/m).
    temperature : array_like, shape (n,) or float, optional
        Degrees Celsius.
    set : array_like, shape (n,), optional
        Number of the set of each row. By default a new set begins where the frequencies turn back.
    amplitude : array_like, shape (n,) or float, optional
        Amplitudes of the deflection (m).
    quantity : {"E", "G", "K"}
        Young's modulus, shear modulus, or a stiffness.

    Raises
    ------
    InputError
        For values that no material or measurement can have, with their row.

    Examples
    --------
    >>> nu = np.geomspace(1, 1e3, 30)
    >>> stiff = 2e6 * (1 - vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3).transform(nu))
    >>> data = vv.ModulusData(frequencies=nu, storage=stiff.real, loss=stiff.imag)
    >>> data
    ModulusData(30 rows of E, 1 to 1000 rad/s, storage 9.59e+05 to 1.91e+06)
    """

    frequencies: npt.ArrayLike
    storage: npt.ArrayLike
    loss: npt.ArrayLike
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    amplitude: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        n = _columns(self, ("frequencies", "storage", "loss"), ("temperature", "set", "amplitude"))
        for name in ("frequencies", "storage"):
            _first_wrong(name, getattr(self, name), getattr(self, name) <= 0, "be greater than 0")
        for name in ("frequencies", "storage", "loss"):
            _in_range(name, getattr(self, name))
        _first_wrong("loss", self.loss, np.asarray(self.loss) < 0, "not be negative")
        if self.amplitude is not None:
            sizes = np.asarray(self.amplitude)
            _first_wrong("amplitude", sizes, sizes <= 0, "be greater than 0")
        if self.set is None:
            labels = _turns(np.asarray(self.frequencies))
            labels.setflags(write=False)
            object.__setattr__(self, "set", labels)
        _check_order(self, "frequencies", "rad/s")
        assert n == np.asarray(self.set).size

    def __repr__(self) -> str:
        nu, storage = np.asarray(self.frequencies), np.asarray(self.storage)
        return (
            f"ModulusData({_rows(self)} of {self.quantity}, {nu.min():.4g} to {nu.max():.4g} "
            f"rad/s{_warmth(self)}, storage {storage.min():.3g} to {storage.max():.3g})"
        )

    @property
    def modulus(self) -> ComplexArray:
        """M' + i M'', shape (n,)."""
        return np.asarray(self.storage) + 1j * np.asarray(self.loss)

    @property
    def loss_factor(self) -> FloatArray:
        """tan(delta) = M''/M', shape (n,)."""
        return np.asarray(np.asarray(self.loss) / np.asarray(self.storage))

    def sets(self) -> "list[ModulusData]":
        """Return each set separately, with ascending frequencies; from cold to warm, if known."""
        return _sets(self, "frequencies")

    def to_shear(self, *, poisson: float) -> "ModulusData":
        """Return G = E/(2 (1 + poisson)) with a real constant Poisson ratio."""
        return self._converted("E", "G", 0.5 / (1 + _POISSON.check(poisson)))

    def to_young(self, *, poisson: float) -> "ModulusData":
        """Return E = 2 (1 + poisson) G with a real constant Poisson ratio."""
        return self._converted("G", "E", 2 * (1 + _POISSON.check(poisson)))

    def _converted(self, before: str, after: str, factor: float) -> "ModulusData":
        if self.quantity != before:
            raise InputError(f"quantity = {self.quantity!r}: must be {before!r} to become {after}")
        return replace(
            self,
            storage=np.asarray(self.storage) * factor,
            loss=np.asarray(self.loss) * factor,
            quantity=after,
        )

    def kramers_kronig(self) -> Any:
        """Check the consistency of storage and loss: see `kramers_kronig`."""
        # Import by name: the modules depend on each other.
        return import_module("viscovib.rubber.kramers_kronig_pair").kramers_kronig(self)

    def plot(
        self, ax: "Axes | Sequence[Axes] | None" = None, *, x: str = "rad/s"
    ) -> Sequence[Axes]:
        """Draw storage and loss over frequency: see `plot_modulus`."""
        # Import by name: that module imports this one.
        return import_module("viscovib.plots.rubber").plot_modulus(self, ax, x=x)  # type: ignore[no-any-return]


@dataclass(frozen=True, kw_only=True, eq=False)
class RelaxationData(Value):
    """A modulus over time after a step of strain, or after a ramp.

    Parameters
    ----------
    times : array_like, shape (n,)
        From the start of the step or ramp (s), > 0, different within a set.
    modulus : array_like, shape (n,)
        Stress divided by the final strain (Pa), or force divided by deflection (N/m), > 0.
    ramp : float
        Duration of the ramp (s), 0 for a step; times must not be before its end. A ramp that is
        treated as a step gives an instantaneous modulus that is far too large, with a small
        residual.
    temperature, set, quantity
        As in `ModulusData`.

    Examples
    --------
    >>> t = np.geomspace(0.1, 100, 20)
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> vv.RelaxationData(times=t, modulus=2e6 * rubber.relaxation(t))
    RelaxationData(20 rows of E, 0.1 to 100 s, 6.92e+05 to 1.26e+06)
    """

    times: npt.ArrayLike
    modulus: npt.ArrayLike
    ramp: float = 0.0
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        _check_times(self, "modulus")
        object.__setattr__(self, "ramp", _RAMP.check(self.ramp))
        first = float(np.min(np.asarray(self.times)))
        if first < self.ramp * (1 - 1e-12):
            raise InputError(
                f"times: {first:g} is before the end of the ramp, must be {self.ramp:g} or later"
            )

    def __repr__(self) -> str:
        return f"RelaxationData({_rows(self)} of {self.quantity}, {_times(self, self.modulus)})"

    def sets(self) -> "list[RelaxationData]":
        """Return each set separately, with ascending times."""
        return _sets(self, "times")


@dataclass(frozen=True, kw_only=True, eq=False)
class CreepData(Value):
    """A compliance over time after a step of stress.

    Parameters
    ----------
    times : array_like, shape (n,)
        From the step on (s), > 0, different within a set.
    compliance : array_like, shape (n,)
        Strain divided by stress (1/Pa), or deflection divided by force (m/N), > 0.
    temperature, set, quantity
        As in `ModulusData`; the quantity is the modulus of this compliance.

    Examples
    --------
    >>> vv.CreepData(times=[1, 10, 100], compliance=[1e-6, 1.2e-6, 1.5e-6])
    CreepData(3 rows of 1/E, 1 to 100 s, 1e-06 to 1.5e-06)
    """

    times: npt.ArrayLike
    compliance: npt.ArrayLike
    temperature: npt.ArrayLike | None = None
    set: npt.ArrayLike | None = None
    quantity: str = "E"

    def __post_init__(self) -> None:
        _native.choice("quantity", self.quantity, QUANTITIES)
        _check_times(self, "compliance")

    def __repr__(self) -> str:
        return f"CreepData({_rows(self)} of 1/{self.quantity}, {_times(self, self.compliance)})"

    def sets(self) -> "list[CreepData]":
        """Return each set separately, with ascending times."""
        return _sets(self, "times")


def _columns(data: Any, needed: Sequence[str], optional: Sequence[str]) -> int:
    """Check the columns, which must have the same length, and make them read-only."""
    n = -1
    for name in [*needed, *optional]:
        given = getattr(data, name)
        if given is None and name in optional:
            continue
        array = _native.real_array(name, given)
        if name in optional and array.ndim == 0:
            array = np.full(max(n, 0), float(array))
        array = array.copy()
        if array.ndim != 1 or array.size == 0:
            raise InputError(f"{name}: must have shape (n,) with n > 0, got {array.shape}")
        if n < 0:
            n = array.size
        elif array.size != n:
            raise InputError(f"{name} has {array.size} numbers: must match {needed[0]}, {n}")
        if name == "temperature":
            _first_wrong(name, array, array <= -KELVIN, f"be above -{KELVIN} degrees Celsius")
        array.setflags(write=False)
        object.__setattr__(data, name, array)
    return n


def _check_times(data: Any, values: str) -> None:
    _columns(data, ("times", values), ("temperature", "set"))
    for name in ("times", values):
        _first_wrong(name, getattr(data, name), getattr(data, name) <= 0, "be greater than 0")
        _in_range(name, getattr(data, name))
    if data.set is None:
        labels = _turns(data.times)
        labels.setflags(write=False)
        object.__setattr__(data, "set", labels)
    _check_order(data, "times", "s")


def _first_wrong(name: str, values: Any, wrong: npt.NDArray[np.bool_], allowed: str) -> None:
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise InputError(f"{name}[{i}] = {values[i]:g}: must {allowed}")


def _in_range(name: str, values: Any) -> None:
    """Refuse numbers whose ratios would overflow; such numbers have no sensible unit."""
    far = (values > _FAR) | ((values < 1 / _FAR) & (values > 0))
    _first_wrong(name, values, far, f"be {1 / _FAR:g} to {_FAR:g}")


def _turns(x: FloatArray) -> FloatArray:
    """Numbers of sets: a new set starts where the values turn back."""
    step = np.sign(np.diff(x))
    labels = np.zeros(x.size)
    number, way = 0, 0.0
    for i in range(1, x.size):
        if way not in (0.0, step[i - 1]) and step[i - 1] != 0:
            number, way = number + 1, 0.0
        elif step[i - 1] != 0:
            way = step[i - 1]
        labels[i] = number
    return labels


def _check_order(data: Any, name: str, unit: str) -> None:
    """Refuse repeated values in a set, and sets that are not monotonic."""
    values, labels = np.asarray(getattr(data, name)), np.asarray(data.set)
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        step = np.diff(values[rows])
        wrong = np.flatnonzero(step == 0)
        if wrong.size:
            i = rows[wrong[0] + 1]
            raise InputError(
                f"{name}[{i}] = {values[i]:g} {unit} is given twice in set {label:g}: must be once"
            )
        turns = np.flatnonzero(np.sign(step[1:]) != np.sign(step[:-1]))
        if turns.size:
            i = rows[turns[0] + 2]
            raise InputError(
                f"{name}[{i}] = {values[i]:g} {unit} turns back in set {label:g}: a set must "
                "ascend or descend"
            )


def _sets(data: Any, name: str) -> list[Any]:
    labels = np.asarray(data.set)
    columns = [
        one for one in data.__dataclass_fields__ if isinstance(getattr(data, one), np.ndarray)
    ]
    found = []
    for label in np.unique(labels):
        rows = np.flatnonzero(labels == label)
        rows = rows[np.argsort(np.asarray(getattr(data, name))[rows])]
        found.append(replace(data, **{one: getattr(data, one)[rows] for one in columns}))
    if data.temperature is not None:
        found.sort(key=lambda one: float(np.mean(one.temperature)))
    return found


def _rows(data: Any) -> str:
    sets = np.unique(np.asarray(data.set)).size
    return f"{np.asarray(data.set).size} rows" + (f" in {sets} sets" if sets > 1 else "")


def _warmth(data: Any) -> str:
    if data.temperature is None:
        return ""
    return f", {np.min(data.temperature):.4g} to {np.max(data.temperature):.4g} deg C"


def _times(data: Any, values: Any) -> str:
    t = np.asarray(data.times)
    return (
        f"{t.min():.4g} to {t.max():.4g} s{_warmth(data)}, "
        f"{np.min(values):.3g} to {np.max(values):.3g}"
    )
