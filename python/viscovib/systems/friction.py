"""Hysteresis elements of a structure: elements with internal states."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.systems.dampers import _positive, _take, _within
from viscovib.systems.laws import Law

#: Instruction codes of the core for numbers.
_ARGUMENT, _NUMBER = 2, 1
#: Largest number of parallel elements, and bounds of exponents.
_MOST, _EXPONENTS = 200, (1.0, 20.0)


def cycles(state: int, numbers: Sequence[float], d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forces of an element over cycles of deflections, shape (n, m), and the energy losses."""
    found = _native.run("law loops", state=state, numbers=np.array(numbers, dtype=float), d=d)
    return found["force"], found["lost"]


class Hysteresis:
    """An element whose force depends on its deflection and on the last reversals."""

    #: Code of the element in the core.
    _state: ClassVar[int]
    #: -1: the opposite path gives the opposite force; 0: not in general.
    _parity: ClassVar[int] = -1
    on: Any

    @property
    def _numbers(self) -> tuple[float, ...]:
        """Parameters in the order of the core."""
        raise NotImplementedError

    @property
    def _stiffness_at_rest(self) -> float:
        raise NotImplementedError

    @property
    def _law(self) -> Law:
        """The element in the form of the core: a deflection and its parameters."""
        numbers = self._numbers
        code = (_ARGUMENT, *[_NUMBER] * len(numbers))
        return Law(
            type(self).__name__, ("d",), code, (1.0, *numbers), self._parity, state=self._state
        )

    def loop(self, d: npt.ArrayLike) -> FloatArray:
        """Return the force over a cycle of deflections, linear between samples.

        Parameters
        ----------
        d : array_like, shape (..., n)
            Samples of one period. The next period begins with the first sample.

        Returns
        -------
        ndarray
            f, shape (..., n), of the periodic cycle.
        """
        return self._run(d)[0]

    def energy(self, d: npt.ArrayLike) -> FloatArray:
        """Return the energy loss (J) of a cycle of deflections as in `loop`, shape (...)."""
        return self._run(d)[1]

    def _run(self, d: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        samples = _native.real_array("d", d)
        if samples.ndim == 0 or samples.shape[-1] < 2:
            raise InputError(f"d: must have shape (..., n), n > 1, got {samples.shape}")
        rows = samples.reshape(-1, samples.shape[-1]).T
        force, lost = cycles(self._state, self._numbers, rows)
        if not (_native.all_finite(force) and _native.all_finite(lost)):
            raise InputError(
                f"d = {np.abs(samples).max():g}: force or energy is not finite, must be smaller"
            )
        return (
            np.asarray(np.reshape(force.T, samples.shape)),
            np.asarray(np.reshape(lost, samples.shape[:-1])),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Jenkins(Hysteresis):
    """Elastic dry friction on the deflection d = e . u: a spring in series with a slider.

    f' = k d' if abs(f) < F_s, else f = F_s or -F_s. Periodic motions (`forced_response`,
    `trace_response`) use exact derivatives of the periodic cycle. With almost no sliding the steady
    state may depend on the history. The result is the state that starts with an undeflected slider.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : float
        k, greater than 0 (N/m).
    limit : float
        F_s, the sliding force, greater than 0 (N).

    Examples
    --------
    The energy of a cycle is 4 F_s (a - F_s/k) for an amplitude a beyond F_s/k:

    >>> import numpy as np
    >>> import viscovib as vv
    >>> slider = vv.Jenkins(on="x1", stiffness=20, limit=1)
    >>> d = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 401)[:-1])
    >>> round(float(slider.energy(d)), 12)
    1.0
    """

    on: Any
    stiffness: float
    limit: float
    _state: ClassVar[int] = 1

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "stiffness", "limit")
        _positive(self, "stiffness", "limit")

    @property
    def _numbers(self) -> tuple[float, ...]:
        return self.stiffness, self.limit

    @property
    def _stiffness_at_rest(self) -> float:
        return self.stiffness


@dataclass(frozen=True, kw_only=True, eq=False)
class Iwan(Hysteresis):
    """Dry friction elements in parallel on one deflection: f = sum_j f_j, each a `Jenkins`.

    Their sliders yield one after the other, so the loop is round where that of a single element has
    corners (Iwan, J. Appl. Mech. 33, 1966).

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : array_like, shape (n,)
        k_j, each greater than 0 (N/m), at most 200.
    limit : array_like, shape (n,)
        F_j, each greater than 0 (N).

    Examples
    --------
    >>> import viscovib as vv
    >>> joint = vv.Iwan(on="x1", stiffness=[10, 10], limit=[1, 3])
    >>> joint.loop([0, 0.2, 0, -0.2]).tolist()
    [1.0, 3.0, -1.0, -3.0]
    """

    on: Any
    stiffness: npt.ArrayLike
    limit: npt.ArrayLike
    _state: ClassVar[int] = 1

    def __post_init__(self) -> None:
        own_fields(self)
        for name in ("stiffness", "limit"):
            values = _native.real_array(name, getattr(self, name))
            if values.ndim != 1 or not 0 < values.size <= _MOST:
                raise InputError(f"{name}: must have shape (n,), n = 1 to {_MOST}, "
                                 f"got {values.shape}")  # fmt: skip
            for i, value in enumerate(values.tolist()):
                if value <= 0:
                    raise InputError(f"{name}[{i}] = {value:g}: must be greater than 0")
            object.__setattr__(self, name, tuple(values.tolist()))
        if len(self.stiffness) != len(self.limit):  # type: ignore[arg-type]
            raise InputError(
                f"limit: must have one value for each stiffness, {len(self.stiffness)}, "  # type: ignore[arg-type]
                f"got {len(self.limit)}"  # type: ignore[arg-type]
            )

    @property
    def _numbers(self) -> tuple[float, ...]:
        pairs: Sequence[tuple[float, float]] = list(zip(self.stiffness, self.limit, strict=True))  # type: ignore[arg-type]
        return tuple(x for pair in pairs for x in pair)

    @property
    def _stiffness_at_rest(self) -> float:
        return float(sum(self.stiffness))  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoucWen(Hysteresis):
    """Bouc-Wen hysteresis: f = a k d + (1 - a) k z, z' = [1 - (g + b sign(z d')) |z|^n] d'.

    The stiffness at rest is k. For large deflections the stiffness is a k, with an offset of (1 -
    a) k z_max, z_max = (b + g)^(-1/n) (Wen, J. Eng. Mech. Div. ASCE 102, 1976).

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : float
        k, greater than 0 (N/m).
    ratio : float
        a, the elastic fraction, 0 to less than 1.
    beta, gamma : float
        b > 0 and g (m^-n). For -b < g <= b no loop generates energy. For g > b unloading is less
        steep than loading. For g <= -b the element hardens and its force has no limit; for n > 1
        it becomes infinite at a finite deflection.
    exponent : float
        n, 1 to 20: sharpness of the yield.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> joint = vv.BoucWen(on="x1", stiffness=10, ratio=0.1, beta=5, gamma=5)
    >>> d = np.sin(2 * np.pi * np.arange(200) / 200)
    >>> round(float(joint.loop(d).max()), 3), round(float(joint.energy(d)), 3)
    (1.9, 3.15)
    """

    on: Any
    stiffness: float
    beta: float
    gamma: float
    ratio: float = 0.0
    exponent: float = 1.0
    _state: ClassVar[int] = 2

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "stiffness", "beta", "ratio", "gamma", "exponent")
        _positive(self, "stiffness", "beta")
        if not 0 <= self.ratio < 1:
            raise InputError(f"ratio = {self.ratio:g}: must be in [0, 1)")
        _within(self, "exponent", *_EXPONENTS)

    @property
    def _numbers(self) -> tuple[float, ...]:
        k, a = self.stiffness, self.ratio
        return a * k, (1 - a) * k, 1.0, self.beta, self.gamma, self.exponent

    @property
    def _stiffness_at_rest(self) -> float:
        return self.stiffness


@dataclass(frozen=True, kw_only=True, eq=False)
class Dahl(Hysteresis):
    """Dahl friction: f' = s (1 - f/F_c)^i d' for increasing d, with the initial stiffness s.

    For decreasing d it is f' = s (1 + f/F_c)^i d'. The force approaches its limit F_c without
    reaching it, unless i < 1 (Dahl, The Aerospace Corporation, TOR-0158, 1968).

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : float
        s, greater than 0 (N/m).
    limit : float
        F_c, greater than 0 (N).
    exponent : float
        i, 0 to 20; 0 is a `Jenkins` element.

    Examples
    --------
    >>> import viscovib as vv
    >>> brake = vv.Dahl(on="x1", stiffness=10, limit=1)
    >>> brake.loop([0, 1, 0, -1]).round(6).tolist()
    [0.999909, 1.0, -0.999909, -1.0]
    """

    on: Any
    stiffness: float
    limit: float
    exponent: float = 1.0
    _state: ClassVar[int] = 3

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "stiffness", "limit")
        _positive(self, "stiffness", "limit")
        _take(self, "exponent")
        _within(self, "exponent", 0.0, _EXPONENTS[1])

    @property
    def _numbers(self) -> tuple[float, ...]:
        return self.stiffness, self.limit, self.exponent

    @property
    def _stiffness_at_rest(self) -> float:
        return self.stiffness
