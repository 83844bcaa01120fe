"""Backbone curves of the pendulum: free motions without damping."""

from typing import Any

import numpy as np

from viscovib import _native
from viscovib.analyses.backbones import Backbone, BackbonePoint, imaginary, warn_of_doubts
from viscovib.common.parameters import (
    FIRST_FREE,
    MAX_HARMONICS,
    MOST_FREE,
    OPPOSITE,
    STABILITY,
    SUBHARMONIC,
    SYMMETRIC,
    CurveOptions,
    Interval,
    checked,
)
from viscovib.common.plan import Plan
from viscovib.common.stability import warn_of_unknown
from viscovib.errors import InputError
from viscovib.results.curves import OUTCOMES, allowed_nearby
from viscovib.systems.pendulum import Pendulum

#: Largest array size of a result: 400 MB.
_MAX_NUMBERS = 50_000_000


def pendulum_backbone(
    system: Pendulum,
    mode: int,
    amplitude_range: tuple[float, float] | None,
    *,
    energy_range: tuple[float, float] | None,
    dof: str | None,
    harmonics: int | str,
    stability: bool | None,
    symmetric: bool,
    subharmonic: int,
    leave: BackbonePoint | None,
    opposite: bool,
    **options: Any,
) -> Backbone:
    """`backbone` of a pendulum."""
    j = _native.integer("mode", mode, 0, 2)
    multiple = SUBHARMONIC.check(subharmonic)
    if leave is not None:
        _check_departure(leave)
    room, auto = MAX_HARMONICS // multiple, _native.is_auto(harmonics)
    if auto:
        first = min(FIRST_FREE, room) if leave is None else _highest_left(leave, multiple)
        most = max(min(MOST_FREE, room), first)
    else:
        first = most = _native.integer("harmonics", harmonics, 1, room)
    place = 0
    if dof is not None:
        place = Pendulum.dof_names.index(_native.choice("dof", dof, Pendulum.dof_names)) + 1
        if energy_range is not None:
            raise InputError("dof: is allowed with amplitude_range only")
    varies = "amplitude" if energy_range is None else "energy"
    start, finish = _ends(amplitude_range, energy_range)
    curve = CurveOptions.checked(options)
    largest = _MAX_NUMBERS // (3 * (multiple * most + 1))
    if curve.max_points > largest:
        raise InputError(
            f"max_points: {curve.max_points} points, must be at most {largest} with so many "
            "harmonics"
        )
    given = checked((SYMMETRIC, OPPOSITE), locals())
    assessed = stability is None or STABILITY.check(stability)
    departure = {} if leave is None else _departure(leave, multiple * first, given["opposite"])
    found = _native.apart(
        lambda: _native.run(
            "backbone pendulum", system._handle, mode=j, dof=place, by_energy=varies == "energy",
            symmetric=given["symmetric"], order=multiple, harmonics=first, most=most,
            chosen=auto, stability=assessed, **curve.along(start, finish), **departure,
        )
    )  # fmt: skip
    tolerances = curve.tolerance, curve.values["atol"]
    return _backbone(found, j, varies, multiple, tolerances, assessed)


def _backbone(
    found: dict[str, Any],
    mode: int,
    varies: str,
    multiple: int,
    tolerances: tuple[float, float],
    assessed: bool,
) -> Backbone:
    """Create the result with names and units; ``tolerances``: relative and absolute."""
    coefficients, order = imaginary(found["cosines"].T), found["highest"]
    allowed = allowed_nearby(coefficients, *tolerances)
    warn_of_doubts(found["truncation"], found["off"], (tolerances[0], allowed), order)
    growing = found["growing"] if assessed else None
    if growing is not None:
        warn_of_unknown(growing < 0)
    motions = imaginary(found["branch_cosines"].T)
    directions = imaginary(found["across"][:-2].T).reshape(motions.shape)
    return Backbone(
        nu=found["nu"],
        harmonics=np.arange(multiple * order + 1),
        coefficients=coefficients,
        truncation=found["truncation"],
        error=found["error"],
        mode=mode,
        outcome=OUTCOMES[found["ended"]],
        dof_names=Pendulum.dof_names,
        dof_units=Pendulum.dof_units,
        varies=varies,
        energy=found["energy"],
        folds=found["folds"],
        fold_errors=found["fold_errors"],
        branch_points=tuple(
            BackbonePoint(
                float(p), float(found["branch_nu"][i]), motions[i],
                int(found["branch_before"][i]) - 1, directions[i], found["across"][:, i].copy(),
            )
            for i, p in enumerate(found["branch_p"])
        ),
        multipliers=found["multipliers"].T if assessed else None,
        stable=None if growing is None else growing == 0,
        growing=growing,
        plan=Plan(found["text"]),
        _tolerance=tolerances[0],
        _off=found["off"],
        _allowed=allowed,
    )  # fmt: skip


def _ends(amplitude: object, energy: object) -> tuple[float, float]:
    """Start and end of the curve."""
    if (amplitude is None) == (energy is None):
        raise InputError("amplitude_range or energy_range: give exactly one of them")
    name = "amplitude_range" if energy is None else "energy_range"
    ends = Interval(name, above=0).check(amplitude if energy is None else energy)
    return float(ends[0]), float(ends[1])


def _check_departure(leave: object) -> None:
    if not isinstance(leave, BackbonePoint):
        raise InputError(f"leave = {leave!r}: must be one of a backbone's branch_points")


def _highest_left(leave: BackbonePoint, multiple: int) -> int:
    """Return the highest harmonic of the mode's frequency of the first curve."""
    highest, rest = divmod((leave._direction.size - 2) // 3 - 1, multiple)
    if rest:
        raise InputError(f"subharmonic = {multiple}: must be that of the curve of ``leave``")
    return highest


def _departure(leave: BackbonePoint, highest: int, opposite: bool) -> dict[str, Any]:
    """Start and direction of the second branch, with cosines up to the ``highest`` order."""
    n = 3 * (highest + 1)
    if leave._direction.size != n + 2:
        raise InputError(
            f"leave: has {(leave._direction.size - 2) // 3} cosines per coordinate, must have as "
            f"many as this backbone ({n // 3}): use the same harmonics and subharmonic"
        )
    if not leave._direction.any():
        raise InputError("leave: the direction of the bifurcating branch was not found")
    return {
        "begin_nu": leave.nu, "begin_p": leave.parameter, "begin": leave.coefficients.imag.ravel(),
        "along": (-1 if opposite else 1) * leave._direction,
    }  # fmt: skip
