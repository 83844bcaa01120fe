"""User-defined hysteresis elements of the build option ``elements``."""

from dataclasses import make_dataclass
from functools import cache
from keyword import iskeyword
from typing import Any

import numpy as np

from viscovib import _native
from viscovib.errors import InputError
from viscovib.systems.friction import Hysteresis


class _UserElement(Hysteresis):
    """A user-defined element of the core; Python adds only names."""

    _names: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in self._names:
            object.__setattr__(self, name, _native.number(name, getattr(self, name)))
        _native.run(
            "law check_user_element", state=self._state, numbers=np.array(self._numbers, float)
        )
        if not np.isfinite(self._stiffness_at_rest):
            raise InputError(f"{type(self).__name__}: its stiffness at rest is not finite")

    def __reduce__(self) -> tuple[Any, ...]:
        values = {name: getattr(self, name) for name in ("on", *self._names)}
        return _made, (type(self).__name__, values)

    @property
    def _numbers(self) -> tuple[float, ...]:
        return tuple(getattr(self, name) for name in self._names)

    @property
    def _stiffness_at_rest(self) -> float:
        found = _native.run(
            "law stiffness_at_rest", state=self._state, numbers=np.array(self._numbers, float)
        )
        return float(found["stiffness"])


@cache
def _classes() -> dict[str, type[Hysteresis]]:
    found: dict[str, type[Hysteresis]] = {}
    built = _native.run("law user_elements")
    rows = zip(built["states"], built["odd"], built["names"].splitlines(), strict=True)
    for state, odd, text in rows:
        name, *names = text.split()
        bad = [one for one in names if not one.isidentifier() or iskeyword(one) or one[0] == "_"]
        if bad or len({"on", *names}) <= len(names):
            raise InputError(
                f"{name}_parameters = {' '.join(names)!r}: must be names that Python can take, "
                "each once, none of them 'on'"
            )
        found[name] = make_dataclass(
            name,
            [("on", Any), *((one, float) for one in names)],
            bases=(_UserElement,),
            namespace={
                "_state": int(state),
                "_parity": -1 if odd else 0,
                "_names": tuple(names),
                "__doc__": f"An element of yours: {name}(on, {', '.join(names)}).",
                "__module__": __name__,
            },
            frozen=True,
            kw_only=True,
            eq=False,
        )
    return found


def _made(name: str, values: dict[str, Any]) -> Hysteresis:
    element = _classes().get(name)
    if element is None:
        raise InputError(f"the element {name} is not built into this viscovib")
    return element(**values)


def user_elements() -> dict[str, type[Hysteresis]]:
    """Return the user-defined hysteresis elements of this build, by name.

    Each is a class like `Jenkins`, with the parameters of its Fortran file. Structures, branches,
    motions in time, ensembles and ``vary=`` accept it.

    Returns
    -------
    dict
        Classes by the names of their files; empty in a build without user elements.

    Examples
    --------
    >>> import viscovib as vv
    >>> sorted(vv.user_elements()) in ([], ["ratchet"])
    True
    """
    return dict(_classes())
