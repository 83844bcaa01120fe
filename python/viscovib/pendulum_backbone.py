"""Backbone curves of the pendulum: its free motions without losses."""

import warnings
from dataclasses import replace

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray, core
from viscovib.backbone import Backbone, BackbonePoint
from viscovib.curves import MAX_SPECIAL, OUTCOMES
from viscovib.driven import check_size
from viscovib.errors import ConvergenceWarning, InputError
from viscovib.parameters import (
    MAX_POINTS,
    MAX_STEP,
    OPPOSITE,
    STABILITY,
    SYMMETRIC,
    TOLERANCE,
    Interval,
    checked,
)
from viscovib.pendulum import Pendulum
from viscovib.plan import Plan
from viscovib.stability import warn_of_unknown
from viscovib.torus import IntArray, check_pendulum, tail

#: Orders left out count as many from this relative size on.
_COARSE = 1e-4


def pendulum_backbone(
    pend: Pendulum,
    mode: int,
    amplitude_range: tuple[float, float] | None = None,
    *,
    energy_range: tuple[float, float] | None = None,
    dof: str | None = None,
    harmonics: int = 15,
    tolerance: float = 1e-10,
    max_points: int = 2000,
    max_step: float = 0.1,
    stability: bool = True,
    symmetric: bool = False,
    subharmonic: int = 1,
    leave: BackbonePoint | None = None,
    opposite: bool = False,
) -> Backbone:
    """Follow the free motions of the pendulum that grow from a linear mode.

    Damping and loads are left out.

    Parameters
    ----------
    pend : Pendulum
        With printed equations the mode of z only: their swings keep no energy, and are not
        periodic.
    mode : int
        The linear mode, counted from 0 as in `Pendulum.natural_frequencies`.
    amplitude_range : (float, float)
        First harmonic of a coordinate from which (small) and to which the curve is followed.
    energy_range : (float, float)
        Instead: energies (`Pendulum.energy`).
    dof : str, optional
        The coordinate of ``amplitude_range``; default the one that moves most in the mode.
    harmonics : int
        Highest order kept of the mode's frequency.
    tolerance : float
        Relative size of the last correction, 1e-14 to 0.1.
    max_points : int
        Points at most, 2 to 100000.
    max_step : float
        Largest step as a part of the present point, 1e-4 to 1.
    stability : bool
        Compute Floquet multipliers.
    symmetric : bool
        Keep to motions that are mirrored in phi and psi half a period later (of the mode of z:
        that do not swing): faster, but blind to branch points where the symmetry breaks.
    subharmonic : int
        Period of the motions in periods of the mode, 1 to 20: 2 finds the swings that the motion in
        z feeds.
    leave : BackbonePoint
        Follow the family that crosses another one here, which was traced with the same modes,
        harmonics and ``subharmonic``; ``opposite``: the other way.

    Returns
    -------
    Backbone

    Warns
    -----
    ConvergenceWarning
        If orders are too few somewhere (`Backbone.truncation` above 1e-4).

    Notes
    -----
    Motions that begin at rest are even in time; harmonic balance in their cosines, the frequency an
    unknown, followed by pseudo-arclength continuation through folds of amplitude or energy, as
    where modes resonate. Branch points are where the determinant of the bordered derivatives
    changes its sign.
    """
    check_pendulum(pend)
    j = _native.integer("mode", mode, 0, 2)
    if pend.equations == "printed" and j > 0:
        raise InputError(
            f"mode = {j}: the printed equations keep no energy in swings, must be 0 with them"
        )
    free = replace(pend, c1=0.0, c2=0.0, c3=0.0, f0=0.0, m01=0.0, m02=0.0)
    multiple = _native.integer("subharmonic", subharmonic, 1, 20)
    highest = multiple * _native.integer("harmonics", harmonics, 1, 199 // multiple)
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
    wanted = TOLERANCE.check(tolerance)
    points = MAX_POINTS.check(max_points)
    step = MAX_STEP.check(max_step)
    n = 3 * (highest + 1)
    check_size("max_points", points, n)
    given = checked((STABILITY, SYMMETRIC, OPPOSITE), locals())
    kept = _kept(pend, j, highest, multiple, given["symmetric"])
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
        count, ended, nu, energy, x, multipliers, growing, n_folds, folds, n_branch, branch_p,
        branch_nu, branch_x, across, before,
    ) = _native.call_interruptibly(
        core.pendulum_backbone, cancel, free._flat, kept, unit,
        place + 1 if varies == "amplitude" else 0, multiple, start, finish, wanted, points, step,
        int(given["stability"]), int(leave is not None), begin.ravel(), begin_nu, begin_p, along,
        MAX_SPECIAL, cancel,
    )  # fmt: skip
    if not count:
        raise InputError(
            f"{varies}_range: no solution was found at its beginning {start:g}: begin lower"
        )
    coefficients = _coefficients(x[:, :count])
    left_out = tail(coefficients, np.arange(highest + 1, dtype=np.int32)[:, np.newaxis])
    if left_out.max() > _COARSE:
        warnings.warn(
            f"harmonics = {highest // multiple}: leave an estimated relative error of "
            f"{left_out.max():.1e}",
            ConvergenceWarning,
            stacklevel=3,
        )
    if stability:
        warn_of_unknown(growing[:count] < 0)
    return Backbone(
        nu=nu[:count].copy(),
        harmonics=np.arange(highest + 1, dtype=np.intc),
        coefficients=coefficients,
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
                _coefficients(branch_x[:, i : i + 1])[0],
                int(before[i]) - 1,
                _coefficients(across[:n, i : i + 1])[0],
                across[:, i].copy(),
            )
            for i in range(n_branch)
        ),
        multipliers=multipliers[:, :count].T.copy() if stability else None,
        stable=growing[:count] == 0 if stability else None,
        growing=growing[:count].copy() if stability else None,
        plan=Plan(
            f"computes: free motions of mode {j} from {varies} {start:g} to {finish:g}, "
            f"{int(kept.sum())} cosines\n"
            "skips: damping and loads (free motions of the system without losses)\n"
            "skips: sines (motions that begin at rest are even in time)\n"
            + ("computes: Floquet multipliers" if stability else "skips: stability (not asked for)")
        ),
    )


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


def _departure(leave: object, n: int, opposite: bool) -> tuple[FloatArray, FloatArray]:
    """Cosines and direction."""
    if not isinstance(leave, BackbonePoint):
        raise InputError(f"leave = {leave!r}: must be one of a backbone's branch_points")
    if leave._direction.size != n + 2:
        raise InputError(
            f"leave: has {(leave._direction.size - 2) // 3} cosines a coordinate, must have as "
            f"many as asked for now ({n // 3}): use the same harmonics and subharmonic"
        )
    if not leave._direction.any():
        raise InputError("leave: the direction of the other family was not found")
    return leave.coefficients.imag.copy(), (-1 if opposite else 1) * leave._direction
