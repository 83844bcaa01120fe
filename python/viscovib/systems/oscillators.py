"""Systems for responses and branches."""

from typing import Any, TypeAlias

from viscovib import _native
from viscovib._native import oscillator_object
from viscovib.errors import InputError
from viscovib.systems.condensed import LoadedStructure
from viscovib.systems.load import (
    Job,
    LoadLike,
    base_by_order,
    in_components,
    oscillator_series,
)
from viscovib.systems.load_table import LoadTable
from viscovib.systems.mount import Mount
from viscovib.systems.own_supports import moves_apart
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.system import System

Oscillator: TypeAlias = Mount | PolynomialSystem
#: Systems for steady motions.
Steady: TypeAlias = Oscillator | Structure


def check_oscillator(system: Any, base: "LoadLike | LoadTable | None") -> None:
    """Refuse other systems, and a base motion for a system without a base direction."""
    _native.check_instance("system", system, Mount, PolynomialSystem)
    _check_base(system, base)


def check_steady(system: Any, base: "LoadLike | None") -> None:
    """`check_oscillator` for steady motions, which also accept structures."""
    _native.check_instance("system", system, Mount, PolynomialSystem, Structure)
    _check_base(system, base)


def refuse_turning(system: System, what: str) -> None:
    """Refuse a body with finite rotations where the mass matrix must be constant."""
    if system._turns:
        raise InputError(
            f"geometry = 'exact': {what} is not available for finite rotations: use geometry = "
            "'small'"
        )


def _check_base(system: Steady, base: "LoadLike | LoadTable | None") -> None:
    if isinstance(base, LoadTable):
        apart, along = base._columned, not base._columned
    elif moves_apart(system, base):
        return
    else:
        terms = [in_components(term) for term in base_by_order(base).values()]
        apart, along = any(terms), not all(terms)
    if apart and not isinstance(system, PolynomialSystem):
        raise InputError(
            "base: has a motion for each coordinate, must be along one direction here; a "
            "PolynomialSystem and a Body take several"
        )
    if apart and len(system.dof_names) == 1:
        raise InputError(
            "base: values must have shape (n,), and a motion must be a number: one coordinate "
            "moves along base_direction"
        )
    if along and system._base_direction is None:
        raise InputError(
            "base: this system has no base_direction, its base is fixed: give it one, or a motion "
            "for each coordinate"
        )


def oscillator_job(
    system: Any,
    load: LoadLike | None,
    base: LoadLike | None,
    flat: Any = None,
    *,
    whole: bool = False,
    stability: bool = False,
) -> tuple[Job, LoadedStructure | None]:
    """Return system and load for the core, and the structure if it is condensed.

    ``flat``: replaces the numbers of the system; ``whole``: do not condense a polynomial system;
    ``stability``: True if stability is computed.
    """
    condensed: Structure | PolynomialSystem | None = None
    if system._is_condensed:
        condensed = system
    elif isinstance(system, PolynomialSystem) and not whole and flat is None:
        # Base motions along several directions are not defined for condensed coordinates.
        several = any(in_components(term) for term in base_by_order(base).values())
        if not several and (system._space is None or base is None):
            condensed = system if system._condenses(stability) else None
    if condensed is not None:
        loaded = condensed._loaded(load, base)
        job = loaded.steady
        if flat is not None:
            job = Job(oscillator_object(flat, loaded.job[1:5]), job.given)
        return job, loaded
    own = system._handle if flat is None else oscillator_object(flat, system._kernels)
    orders, series, formulas = oscillator_series(system, load, base)
    return Job(own, {"orders": orders, "series": series, "formulas": formulas}), None
