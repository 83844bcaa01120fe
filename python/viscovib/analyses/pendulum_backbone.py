"""Backbone curves of the pendulum: free motions without damping."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.backbones import Backbone, BackbonePoint, imaginary, warn_of_doubts
from viscovib.analyses.driven import check_size
from viscovib.analyses.torus import IntArray
from viscovib.common.counts import things
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


@dataclass(frozen=True)
class _Orders:
    """Harmonic orders of a motion with the period of ``multiple`` periods of the mode."""

    multiple: int
    #: Highest harmonics of the mode's frequency: at first, and at most.
    first: int
    most: int
    auto: bool

    @classmethod
    def checked(
        cls, harmonics: int | str, subharmonic: int, leave: BackbonePoint | None
    ) -> "_Orders":
        """Check the requested harmonics, or choose a first number."""
        multiple = SUBHARMONIC.check(subharmonic)
        if leave is not None:
            _check_departure(leave)
        auto = _native.is_auto(harmonics)
        room = most = MAX_HARMONICS // multiple
        wanted: Any = harmonics
        if auto:
            most = min(MOST_FREE, most)
            wanted = min(FIRST_FREE, most)
            if leave is not None:
                wanted = _highest_left(leave, multiple)
                most = max(most, wanted)
        first = _native.integer("harmonics", wanted, 1, room)
        return cls(multiple, first, most if auto else first, auto)

    @property
    def highest(self) -> int:
        """First value of the highest harmonic of the motion's own frequency."""
        return self.multiple * self.first


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
    if system.equations == "printed" and j > 0:
        raise InputError(
            f"mode = {j}: the printed equations keep no energy in swings, must be 0 with them"
        )
    free = replace(system, c1=0.0, c2=0.0, c3=0.0, f0=0.0, m01=0.0, m02=0.0)
    orders = _Orders.checked(harmonics, subharmonic, leave)
    shape = free.mode_shapes()[:, j]
    place = _place(shape, dof, j, by_energy=energy_range is not None)
    varies = "amplitude" if energy_range is None else "energy"
    start, finish = _ends(amplitude_range, energy_range)
    curve = CurveOptions.checked(options)
    multiple, highest = orders.multiple, orders.highest
    n_most = 3 * (multiple * orders.most + 1)
    check_size("max_points", curve.max_points, n_most)
    given = checked((SYMMETRIC, OPPOSITE), locals())
    assessed = stability is None or STABILITY.check(stability)
    kept = _kept(system, j, highest, multiple, given["symmetric"])
    pattern = _kept(system, j, 2 * multiple - 1, multiple, given["symmetric"])
    unit = float(free.natural_frequencies()[j]) / multiple
    begin = np.zeros((3, highest + 1))
    begin[:, multiple] = shape / shape[place]
    departure: dict[str, Any] = {}
    if leave is not None:
        begin, along = _departure(leave, kept, given["opposite"])
        departure = {"begin_nu": leave.nu, "begin_p": leave.parameter, "along": along}
    found = _native.apart(
        lambda: _native.run(
            "backbone pendulum", free._handle, pattern=pattern, unit=unit,
            dof=place + 1 if varies == "amplitude" else 0, order=multiple,
            harmonics=orders.first, most=orders.most, stability=assessed, begin=begin.ravel(),
            **curve.along(start, finish), **departure,
        )
    )  # fmt: skip
    if not found["nu"].size:
        raise InputError(
            f"{varies}_range: no solution was found at the start {start:g}: start at a smaller "
            "value"
        )
    plan = Plan(
        f"computes: free motions of mode {j} from {varies} {start:g} to {finish:g}, "
        f"{_kept_text(orders.auto, orders.first, int(kept.sum()))}\nskips: damping and loads "
        "(free motions of the system without losses)\nskips: sines (motions that start at "
        "rest are even in time)\n"
        + ("computes: Floquet multipliers" if assessed else "skips: stability (not requested)")
    )
    tolerances = curve.tolerance, curve.values["atol"]
    return _backbone(found, j, varies, multiple, tolerances, assessed, plan)


def _backbone(
    found: dict[str, Any],
    mode: int,
    varies: str,
    multiple: int,
    tolerances: tuple[float, float],
    assessed: bool,
    plan: Plan,
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
        plan=plan,
        _tolerance=tolerances[0],
        _off=found["off"],
        _allowed=allowed,
    )  # fmt: skip


def _place(shape: FloatArray, dof: str | None, mode: int, *, by_energy: bool) -> int:
    """Index of the coordinate of the amplitude."""
    if dof is None:
        return int(np.abs(shape).argmax())
    place = Pendulum.dof_names.index(_native.choice("dof", dof, Pendulum.dof_names))
    if by_energy:
        raise InputError("dof: is allowed with amplitude_range only")
    if shape[place] == 0:
        raise InputError(f"dof = {dof!r}: does not move in mode {mode}")
    return place


def _kept_text(auto: bool, first: int, n_cosines: int) -> str:
    """Return the text of the plan about the harmonics."""
    if auto:
        return f"harmonics chosen to meet the tolerance, {first} at first"
    return things(n_cosines, "cosine")


def _ends(amplitude: object, energy: object) -> tuple[float, float]:
    """Start and end of the curve."""
    if (amplitude is None) == (energy is None):
        raise InputError("amplitude_range or energy_range: give exactly one of them")
    name = "amplitude_range" if energy is None else "energy_range"
    ends = Interval(name, above=0).check(amplitude if energy is None else energy)
    return float(ends[0]), float(ends[1])


def _kept(pend: Pendulum, mode: int, highest: int, multiple: int, symmetric: bool) -> IntArray:
    """1 where a harmonic of a coordinate is an unknown, shape (n_orders, 3)."""
    kept = np.ones((highest + 1, 3), dtype=np.intc, order="F")
    if mode == 0 and (symmetric or pend.equations == "printed"):
        kept[:, 1:] = 0
    elif symmetric:
        orders = np.arange(highest + 1)
        kept[:, 0] = orders % (2 * multiple) == 0
        kept[:, 1:] = (orders % (2 * multiple) == multiple)[:, np.newaxis]
    return kept


def _check_departure(leave: object) -> None:
    if not isinstance(leave, BackbonePoint):
        raise InputError(f"leave = {leave!r}: must be one of a backbone's branch_points")


def _highest_left(leave: BackbonePoint, multiple: int) -> int:
    """Return the highest harmonic of the mode's frequency of the first curve."""
    highest, rest = divmod((leave._direction.size - 2) // 3 - 1, multiple)
    if rest:
        raise InputError(f"subharmonic = {multiple}: must be that of the curve of ``leave``")
    return highest


def _departure(
    leave: BackbonePoint, kept: IntArray, opposite: bool
) -> tuple[FloatArray, FloatArray]:
    """Cosines and direction of the second branch; ``kept``: its unknowns."""
    n = kept.size
    if leave._direction.size != n + 2:
        raise InputError(
            f"leave: has {(leave._direction.size - 2) // 3} cosines per coordinate, must have as "
            f"many as this backbone ({n // 3}): use the same harmonics and subharmonic"
        )
    if not leave._direction.any():
        raise InputError("leave: the direction of the bifurcating branch was not found")
    outside = np.where(kept.T == 1, 0.0, np.abs(leave.across)).max()
    if outside > 1e-6 * np.abs(leave.across).max():
        raise InputError(
            "leave: the bifurcating motions do not have this symmetry: give symmetric=False"
        )
    return leave.coefficients.imag.copy(), (-1 if opposite else 1) * leave._direction
