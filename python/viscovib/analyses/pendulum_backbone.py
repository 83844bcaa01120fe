"""Backbone curves of the pendulum: its free motions without losses."""

from dataclasses import replace
from typing import Any

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.analyses.backbones import Backbone, BackbonePoint, warn_of_few
from viscovib.analyses.driven import check_size
from viscovib.analyses.torus import IntArray
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
from viscovib.results.curves import MAX_SPECIAL, OUTCOMES
from viscovib.systems.pendulum import Pendulum


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
    pend = system
    j = _native.integer("mode", mode, 0, 2)
    if pend.equations == "printed" and j > 0:
        raise InputError(
            f"mode = {j}: the printed equations keep no energy in swings, must be 0 with them"
        )
    free = replace(pend, c1=0.0, c2=0.0, c3=0.0, f0=0.0, m01=0.0, m02=0.0)
    multiple = SUBHARMONIC.check(subharmonic)
    if leave is not None:
        _check_departure(leave)
    auto = _native.is_auto(harmonics)
    most = MAX_HARMONICS // multiple
    wanted_order: Any = harmonics
    if auto:
        most = min(MOST_FREE, most)
        wanted_order = min(FIRST_FREE, most)
        if leave is not None:
            wanted_order = _highest_left(leave, multiple)
            most = max(most, wanted_order)
    order = _native.integer("harmonics", wanted_order, 1, MAX_HARMONICS // multiple)
    if not auto:
        most = order
    first, highest = order, multiple * order
    shape = free.mode_shapes()[:, j]
    names = Pendulum.dof_names
    place = int(np.abs(shape).argmax())
    if dof is not None:
        place = names.index(_native.choice("dof", dof, names))
        if energy_range is not None:
            raise InputError("dof: goes with amplitude_range only")
    if shape[place] == 0:
        raise InputError(f"dof = {dof!r}: stands still in mode {j}")
    varies = "amplitude" if energy_range is None else "energy"
    start, finish = _ends(amplitude_range, energy_range)
    curve = CurveOptions.checked(options)
    wanted, points = curve.tolerance, curve.max_points
    n, n_most = 3 * (highest + 1), 3 * (multiple * most + 1)
    check_size("max_points", points, n_most)
    given = checked((SYMMETRIC, OPPOSITE), locals())
    judged = stability is None or STABILITY.check(stability)
    kept = _kept(pend, j, highest, multiple, given["symmetric"])
    pattern = _kept(pend, j, 2 * multiple - 1, multiple, given["symmetric"])
    unit = float(free.natural_frequencies()[j]) / multiple
    begin, begin_nu, begin_p, along = np.zeros((3, highest + 1)), unit, 0.0, np.zeros(n + 2)
    begin[:, multiple] = shape / shape[place]
    if leave is not None:
        begin, along = _departure(leave, n, given["opposite"])
        lost = np.where(kept.T == 1, 0.0, np.abs(leave.across)).max()
        if lost > 1e-6 * np.abs(leave.across).max():
            raise InputError(
                "leave: leads to motions that do not share the symmetry, must have symmetric=False"
            )
        begin_nu, begin_p = leave.nu, leave.parameter
    cancel = np.zeros(1, dtype=np.intc)
    (
        count, ended, order, nu, energy, truncation, x, multipliers, growing, n_folds, folds,
        n_branch, branch_p, branch_nu, branch_x, across, before,
    ) = _native.call_interruptibly(
        core.pendulum_backbone, cancel, free._flat, pattern, unit,
        place + 1 if varies == "amplitude" else 0, multiple, order, most,
        curve.packed(start, finish), points, int(judged), int(leave is not None), begin.ravel(),
        begin_nu, begin_p, along, n_most, MAX_SPECIAL, cancel,
    )  # fmt: skip
    if not count:
        raise InputError(
            f"{varies}_range: no solution was found at its beginning {start:g}: begin lower"
        )
    n = 3 * (multiple * order + 1)
    warn_of_few(truncation[:count], wanted, order)
    if judged:
        warn_of_unknown(growing[:count] < 0)
    return Backbone(
        nu=nu[:count].copy(),
        harmonics=np.arange(multiple * order + 1, dtype=np.intc),
        coefficients=_coefficients(x[:n, :count]),
        truncation=truncation[:count].copy(),
        mode=j,
        outcome=OUTCOMES[ended],
        dof_names=names,
        dof_units=Pendulum.dof_units,
        varies=varies,
        energy=energy[:count].copy(),
        folds=folds[:n_folds].copy(),
        branch_points=tuple(
            BackbonePoint(
                float(branch_p[i]),
                float(branch_nu[i]),
                _coefficients(branch_x[:n, i : i + 1])[0],
                int(before[i]) - 1,
                _coefficients(across[:n, i : i + 1])[0],
                across[: n + 2, i].copy(),
            )
            for i in range(n_branch)
        ),
        multipliers=multipliers[:, :count].T.copy() if judged else None,
        stable=growing[:count] == 0 if judged else None,
        growing=growing[:count].copy() if judged else None,
        plan=Plan(
            f"computes: free motions of mode {j} from {varies} {start:g} to {finish:g}, "
            f"{_kept_text(auto, first, int(kept.sum()))}\n"
            "skips: damping and loads (free motions of the system without losses)\n"
            "skips: sines (motions that begin at rest are even in time)\n"
            + ("computes: Floquet multipliers" if judged else "skips: stability (not asked for)")
        ),
        _tolerance=wanted,
    )


def _kept_text(auto: bool, first: int, n_cosines: int) -> str:
    """Return what the plan says of the orders."""
    if auto:
        return f"as many harmonics as the tolerance needs, {first} at first"
    return f"{n_cosines} cosines"


def _ends(amplitude: object, energy: object) -> tuple[float, float]:
    """Where the curve begins and ends."""
    if (amplitude is None) == (energy is None):
        raise InputError("amplitude_range or energy_range: must be given, and only one of them")
    name = "amplitude_range" if energy is None else "energy_range"
    ends = Interval(name, above=0).check(amplitude if energy is None else energy)
    return float(ends[0]), float(ends[1])


def _kept(pend: Pendulum, mode: int, highest: int, multiple: int, symmetric: bool) -> IntArray:
    """1 where an order of a coordinate is an unknown, shape (n_orders, 3)."""
    kept = np.ones((highest + 1, 3), dtype=np.intc, order="F")
    if mode == 0 and (symmetric or pend.equations == "printed"):
        kept[:, 1:] = 0
    elif symmetric:
        orders = np.arange(highest + 1)
        kept[:, 0] = orders % (2 * multiple) == 0
        kept[:, 1:] = (orders % (2 * multiple) == multiple)[:, np.newaxis]
    return kept


def _coefficients(cosines: FloatArray) -> ComplexArray:
    """X_k from cosines, shape (3 n_orders, n) to (n, 3, n_orders)."""
    whole = np.ascontiguousarray(cosines.T).reshape(cosines.shape[1], 3, -1)
    return np.asarray(1j * whole, dtype=np.complex128)


def _check_departure(leave: object) -> None:
    if not isinstance(leave, BackbonePoint):
        raise InputError(f"leave = {leave!r}: must be one of a backbone's branch_points")


def _highest_left(leave: BackbonePoint, multiple: int) -> int:
    """Return the order that the curve was followed with, of the mode's frequency."""
    highest, rest = divmod((leave._direction.size - 2) // 3 - 1, multiple)
    if rest:
        raise InputError(
            f"subharmonic = {multiple}: must be that of the curve that ``leave`` lies on"
        )
    return highest


def _departure(leave: BackbonePoint, n: int, opposite: bool) -> tuple[FloatArray, FloatArray]:
    """Cosines and direction."""
    if leave._direction.size != n + 2:
        raise InputError(
            f"leave: has {(leave._direction.size - 2) // 3} cosines a coordinate, must have as "
            f"many as asked for now ({n // 3}): use the same harmonics and subharmonic"
        )
    if not leave._direction.any():
        raise InputError("leave: the direction of the other family was not found")
    return leave.coefficients.imag.copy(), (-1 if opposite else 1) * leave._direction
