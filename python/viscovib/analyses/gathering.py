"""Selection of the motions of an ensemble that are computed together or one by one."""

from __future__ import annotations

from collections.abc import Mapping
from threading import Lock
from typing import Any

import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.events import Event
from viscovib.analyses.members import SCALES, Members, PendulumMembers, PolynomialMembers
from viscovib.analyses.memoryless import TAYLOR
from viscovib.analyses.singles import SingleMembers
from viscovib.errors import InputError
from viscovib.systems.load import LoadLike, at_frequency
from viscovib.systems.many_numbers import (
    ManySystems,
    joined,
    systems_of_parameters,
)
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.varying import varied
from viscovib.systems.whole import whole_system, whole_with_parameters

#: Largest number of coordinates in the vector unit, without and with perturbations.
_MOST, _MOST_DISTURBED = 6, 3


def members_of(
    system: Any,
    initial: npt.ArrayLike,
    parameters: Mapping[str, npt.ArrayLike] | None,
    load: LoadLike | None,
    nu: float | None,
    method: str,
    surface: Event | None,
    lyapunov: bool,
) -> Members:
    """Check a system and its varied parameters."""
    given = {} if parameters is None else _native.mapping("parameters", parameters)
    _native.check_instance("system", system, Pendulum, PolynomialSystem, Structure, Mount)
    if surface is None and system._has_own_loads:
        for name, value in (("load", load), ("nu", nu)):
            if value is not None:
                raise InputError(f"{name}: a Pendulum has its loads in itself, must be None")
        return PendulumMembers(system, initial, given, method)
    if "nu" not in given:
        load = at_frequency(load, nu)
    if type(system) is PolynomialSystem:
        for name in given:
            if name in SCALES[1:]:
                _check_scale(system, name)
    few = None if surface is not None else side_by_side(system, given, lyapunov)
    if few is None:
        if _is_series(method):
            raise InputError(
                f"method = {method!r}: is for motions that are computed together, these are "
                "computed one after the other: give a method of simulate"
            )
        return SingleMembers(system, initial, given, load, nu, method, surface)
    made: list[Members] = []
    lock = Lock()
    numbers = any(name not in ("nu", *SCALES) for name in given)

    def alone() -> Members:
        # Several threads may call this.
        with lock:
            if not made:
                # Runs with thin layers need partial steps, which Taylor's method does not have.
                own = "auto" if _is_series(method) else method
                one: Any = system if numbers else few
                made.append(SingleMembers(one, initial, given, load, nu, own, None))
        return made[0]

    def with_parameters(values: Mapping[str, FloatArray]) -> ManySystems:
        if type(system) is PolynomialSystem:
            return systems_of_parameters(system, values)

        rows = zip(*(x.tolist() for x in values.values()), strict=True)
        return joined(
            [whole_with_parameters(system, dict(zip(values, row, strict=True))) for row in rows]
        )

    return PolynomialMembers(few, initial, given, load, nu, method, alone, with_parameters)


def _is_series(method: object) -> bool:
    """True for Taylor's method."""
    return isinstance(method, str) and method in TAYLOR


def _check_scale(system: PolynomialSystem, name: str) -> None:
    """Refuse a factor of a missing part before any run."""
    try:
        varied(system, name, 1.0, 1.0)
    except InputError as error:
        raise InputError(str(error).replace(f"vary = {name!r}", f"parameters: {name!r}")) from None


def side_by_side(
    system: Any, given: Mapping[str, object], disturbed: bool
) -> PolynomialSystem | None:
    """The system whose motions are computed together; None: they are computed one by one."""
    most = _MOST_DISTURBED if disturbed else _MOST
    if isinstance(system, Mount | Pendulum) or len(system.dof_names) > most:
        return None
    varied = [name for name in given if name not in ("nu", *SCALES)]
    if system._all_kernels or not all(name in system._parameter_names for name in varied):
        return None
    if system._is_condensed:
        if varied and any(name in SCALES[1:] for name in given):
            return None
        if system._reduced is not None or system._has_kinks:
            return None
        return whole_system(system)
    kinked = any(law.branches for law in system._all_laws)
    return None if kinked or system._turns else system
