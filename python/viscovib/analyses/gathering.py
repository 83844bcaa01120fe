"""Which motions of an ensemble go side by side, and which one after another."""

from __future__ import annotations

from collections.abc import Mapping
from threading import Lock
from typing import Any

import numpy.typing as npt

from viscovib import _native
from viscovib.analyses.events import Event
from viscovib.analyses.members import SCALES, Members, PendulumMembers, PolynomialMembers
from viscovib.analyses.memoryless import TAYLOR
from viscovib.analyses.singles import SingleMembers
from viscovib.errors import InputError
from viscovib.systems.load import LoadLike
from viscovib.systems.mount import Mount
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import switches, whole_system

#: Coordinates of a polynomial system in the vector unit at most, and with disturbances.
_MOST, _MOST_DISTURBED = 6, 3


def members_of(
    system: object,
    initial: npt.ArrayLike,
    parameters: Mapping[str, npt.ArrayLike] | None,
    load: LoadLike | None,
    nu: float | None,
    method: str,
    surface: Event | None,
    lyapunov: object,
) -> Members:
    """Check a system and what varies."""
    given = {} if parameters is None else _native.mapping("parameters", parameters)
    if not isinstance(system, Pendulum | PolynomialSystem | Structure | Mount):
        raise InputError(
            f"system = {_native.shown(system)}: must be a Pendulum, a PolynomialSystem, a "
            "Structure or a Mount"
        )
    if surface is None and isinstance(system, Pendulum):
        for name, value in (("load", load), ("nu", nu)):
            if value is not None:
                raise InputError(f"{name}: a Pendulum has its loads in itself, must be None")
        return PendulumMembers(system, initial, given, method)
    few = None if surface is not None else side_by_side(system, given, bool(lyapunov))
    if few is None:
        if method == TAYLOR:
            raise InputError(
                f"method = {TAYLOR!r}: is for motions that go side by side, these go one after "
                "another: give one that simulate takes"
            )
        return SingleMembers(system, initial, given, load, nu, method, surface)
    made: list[Members] = []
    lock = Lock()

    def alone() -> Members:
        # Pieces of an ensemble are made by several threads.
        with lock:
            if not made:
                # Those that meet thin layers go in parts of steps, by a method that has such.
                own = "auto" if method == TAYLOR else method
                made.append(SingleMembers(few, initial, given, load, nu, own, None))
        return made[0]

    return PolynomialMembers(few, initial, given, load, nu, method, alone)


def side_by_side(
    system: Any, given: Mapping[str, object], disturbed: bool
) -> PolynomialSystem | None:
    """The system in few coordinates whose motions go side by side; None: they do not."""
    most = _MOST_DISTURBED if disturbed else _MOST
    if isinstance(system, Mount | Pendulum) or len(system.dof_names) > most:
        return None
    kernels = system._all_kernels if isinstance(system, Structure) else system._active_kernels
    if kernels or any(name not in ("nu", *SCALES) for name in given):
        return None
    if isinstance(system, Structure):
        if system._reduced is not None or switches(system):
            return None
        return whole_system(system)
    kinked = any(law.branches for group in system.groups for _, law in group.laws)
    assert isinstance(system, PolynomialSystem)
    return None if kinked or system._turns else system
