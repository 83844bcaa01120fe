"""Elements of a structure that touch and leave: springs behind a gap, and stops."""

from dataclasses import dataclass, replace
from typing import Any

from viscovib import _native
from viscovib.errors import InputError
from viscovib.systems.laws import Law, read_law


class Contact:
    """An element with a law of its deflection that is 0 inside a gap."""

    on: Any
    stiffness: float
    gap: float

    def __post_init__(self) -> None:
        for name in ("stiffness", "gap"):
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        if self.stiffness <= 0:
            raise InputError(f"stiffness = {self.stiffness:g}: must be greater than 0")

    def _read(self, text: str) -> Law:
        law = read_law("law", text, ("d",), {"k": self.stiffness, "gap": self.gap}, ("v",))
        assert isinstance(law, Law)
        return law

    @property
    def _law(self) -> Law:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, eq=False)
class Gap(Contact):
    """A spring that only pushes, behind a gap: f = k max(d - gap, 0) of the deflection d = e . u.

    As the law of a `Spring` of this text, with a name.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as of `Spring`; it touches where d > gap.
    stiffness : float
        k, greater than 0 (N/m).
    gap : float
        Of any sign (m); a negative gap is a preload, f = -k gap at rest, of which plans tell.

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.Gap(on="x1", stiffness=100, gap=0.5).force([0, 1]).tolist()
    [0.0, 50.0]
    """

    on: Any
    stiffness: float
    gap: float

    @property
    def _law(self) -> Law:
        return self._read("k*max(d - gap, 0)")

    def force(self, d: Any) -> Any:
        """Return f at deflections of any shape."""
        return self.stiffness * (_native.real_array("d", d) - self.gap).clip(0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stop(Contact):
    """Stops on both sides: f = k (d - gap) where d > gap, k (d + gap) where d < -gap, else 0.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as of `Spring`.
    stiffness : float
        k of the contacts, greater than 0 (N/m).
    gap : float
        At least 0 (m), on either side.

    Examples
    --------
    >>> import viscovib as vv
    >>> vv.Stop(on="x1", stiffness=100, gap=0.5).force([-1, 0, 1]).tolist()
    [-50.0, 0.0, 50.0]
    """

    on: Any
    stiffness: float
    gap: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gap < 0:
            raise InputError(f"gap = {self.gap:g}: must be at least 0 (of stops on both sides)")

    @property
    def _law(self) -> Law:
        # Odd, which its text does not show.
        return replace(self._read("k*(max(d - gap, 0) - max(-d - gap, 0))"), parity=-1)

    def force(self, d: Any) -> Any:
        """Return f at deflections of any shape."""
        x = _native.real_array("d", d)
        return self.stiffness * (x - x.clip(-self.gap, self.gap))
