"""Contact elements of a structure: springs behind a gap, and stops."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from viscovib import _native
from viscovib.common.values import own_fields
from viscovib.errors import InputError
from viscovib.systems.dampers import _positive, _take, _within
from viscovib.systems.laws import Law, compile_law

#: Instruction codes of the core for numbers, and its code of a stop with restitution.
_ARGUMENT, _NUMBER, _STOP = 2, 1, 100
#: Largest exponent.
_MOST = 20


class Contact:
    """An element whose law is 0 inside a gap."""

    on: Any
    gap: float
    stiffness: float | None
    restitution: float | None
    exponent: float
    #: True for stops on both sides.
    _both: ClassVar[bool] = False

    def __post_init__(self) -> None:
        own_fields(self)
        _take(self, "gap", "exponent")
        _within(self, "exponent", 1, _MOST)
        if (self.stiffness is None) == (self.restitution is None):
            raise InputError("stiffness, restitution: give exactly one of them")
        if self.stiffness is not None:
            _take(self, "stiffness")
            _positive(self, "stiffness")
            return
        if self.exponent != 1:
            raise InputError(f"exponent = {self.exponent:g}: must be 1 with a restitution")
        value = _native.number("restitution", self.restitution)
        if not 0 <= value <= 1:
            raise InputError(f"restitution = {value:g}: must be in [0, 1]")
        object.__setattr__(self, "restitution", value)

    def _rigid(self) -> Law:
        """A rigid stop for the core: deflection, gap, restitution, 1 for stops on both sides."""
        assert self.restitution is not None
        numbers = (1.0, self.gap, self.restitution, float(self._both))
        code = (_ARGUMENT, _NUMBER, _NUMBER, _NUMBER)
        return Law("restitution", ("d",), code, numbers, -int(self._both), state=_STOP)

    def _elastic(self) -> float:
        """The stiffness; an error for a rigid stop."""
        if self.stiffness is None:
            raise InputError("stiffness: is None, a rigid stop has no force of its deflection")
        return self.stiffness

    def _read(self, text: str) -> Law:
        numbers = {"k": self._elastic(), "gap": self.gap, "n": self.exponent}
        return compile_law("law", text, ("d", "v"), numbers, 1)

    @property
    def _law(self) -> Law:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap(Contact):
    """A one-sided spring behind a gap: f = k max(d - gap, 0)^n of the deflection d = e . u.

    It equals a `Spring` with this law.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`; contact if d > gap.
    stiffness : float
        k, greater than 0 (N/m^n).
    restitution : float
        Instead of the stiffness, for motions in time: a rigid stop that returns the fraction e of
        the velocity, 0 to 1. Infinitely many impacts (e < 1) end in contact.
    gap : float
        Positive or negative (m); a negative gap is a preload, f = k (-gap)^n at rest, which plans
        state.
    exponent : float
        n, 1 to 20: a progressive stop for n > 1 (Hertz's contact: 1.5).

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.Gap(on="x1", stiffness=100, gap=0.5).force([0, 1]).tolist()
    [0.0, 50.0]
    """

    on: Any
    gap: float
    stiffness: float | None = None
    restitution: float | None = None
    exponent: float = 1.0

    @property
    def _law(self) -> Law:
        if self.restitution is not None:
            return self._rigid()
        return self._read("k*max(d - gap, 0)^n")

    def force(self, d: Any) -> Any:
        """Return f at deflections of any shape."""
        return self._elastic() * (_native.real_array("d", d) - self.gap).clip(0) ** self.exponent


@dataclass(frozen=True, kw_only=True, eq=False)
class Stop(Contact):
    """Two-sided stops: f = k (d - gap)^n if d > gap, -k (-d - gap)^n if d < -gap, else 0.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as for `Spring`.
    stiffness : float
        k of the contacts, greater than 0 (N/m^n).
    restitution : float
        Instead of the stiffness, for motions in time, as for `Gap`.
    gap : float
        At least 0 (m), on either side.
    exponent : float
        n, 1 to 20, as for `Gap`.

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.Stop(on="x1", stiffness=100, gap=0.5).force([-1, 0, 1]).tolist()
    [-50.0, 0.0, 50.0]
    """

    on: Any
    gap: float
    stiffness: float | None = None
    restitution: float | None = None
    exponent: float = 1.0
    _both: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap < 0:
            raise InputError(f"gap = {self.gap:g}: must be at least 0 (of stops on both sides)")

    @property
    def _law(self) -> Law:
        if self.restitution is not None:
            return self._rigid()
        return self._read("k*stop(d, gap, n)")

    def force(self, d: Any) -> Any:
        """Return f at deflections of any shape."""
        x = _native.real_array("d", d)
        beyond = x - x.clip(-self.gap, self.gap)
        return self._elastic() * np.sign(beyond) * np.abs(beyond) ** self.exponent
