"""Branches of steady motions: one function for oscillators and the pendulum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Unpack, overload

import numpy.typing as npt

from viscovib._native import check_instance
from viscovib.analyses.backbones import Backbone, BackbonePoint, oscillator_backbone
from viscovib.analyses.driven_branch import DrivenBranch, trace_pendulum
from viscovib.analyses.following import trace_mount
from viscovib.analyses.pendulum_backbone import pendulum_backbone
from viscovib.analyses.starts import StartLike
from viscovib.common.curve_options import CurveKeywords
from viscovib.common.parameters import (
    OSCILLATOR,
    PENDULUM,
    PROGRESS,
    Taken,
    with_curve,
    with_curve_options,
)
from viscovib.common.progress import counted_pieces
from viscovib.results.branch import Branch
from viscovib.results.curves import BranchPoint
from viscovib.systems.load import LoadLike
from viscovib.systems.mount import Mount
from viscovib.systems.oscillators import Steady
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.whole import usual_tolerance


class _CurveOptions(CurveKeywords, total=False):
    """Options of every curve."""

    harmonics: int | str
    rtol: float | None
    progress: bool


class _TraceOptions(_CurveOptions, total=False):
    """Additional options of every branch."""

    at: npt.ArrayLike
    leave: BranchPoint | None
    opposite: bool
    symmetric: bool | None
    stability: bool


@overload
def trace_response(
    system: Steady,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    nu: float | None = None,
    load_range: tuple[float, float] | None = None,
    vary: str | None = None,
    vary_range: tuple[float, float] | None = None,
    start: StartLike | None = None,
    coordinates: Sequence[str] | None = None,
    **curve: Unpack[_TraceOptions],
) -> Branch: ...
@overload
def trace_response(
    system: Pendulum,
    *,
    nu: tuple[float, float] | None = None,
    p1: tuple[float, float] | None = None,
    p2: tuple[float, float] | None = None,
    p3: tuple[float, float] | None = None,
    f0: tuple[float, float] | None = None,
    m01: tuple[float, float] | None = None,
    m02: tuple[float, float] | None = None,
    duration: float | None = None,
    subharmonic: int = 1,
    max_denominator: int = 12,
    **curve: Unpack[_TraceOptions],
) -> DrivenBranch: ...
@with_curve_options
def trace_response(
    system: Steady | Pendulum,
    nu_range: tuple[float, float] | None = None,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    nu: float | tuple[float, float] | None = None,
    load_range: tuple[float, float] | None = None,
    vary: str | None = None,
    vary_range: tuple[float, float] | None = None,
    p1: tuple[float, float] | None = None,
    p2: tuple[float, float] | None = None,
    p3: tuple[float, float] | None = None,
    f0: tuple[float, float] | None = None,
    m01: tuple[float, float] | None = None,
    m02: tuple[float, float] | None = None,
    at: npt.ArrayLike = (),
    start: StartLike | None = None,
    leave: BranchPoint | None = None,
    opposite: bool = False,
    symmetric: bool | None = None,
    harmonics: int | str = "auto",
    rtol: float | None = None,
    stability: bool = True,
    duration: float | None = None,
    subharmonic: int = 1,
    max_denominator: int = 12,
    coordinates: Sequence[str] | None = None,
    progress: bool = False,
    **curve: Unpack[CurveKeywords],
) -> Branch | DrivenBranch:
    """Follow a branch of steady motions through its folds.

    An oscillator is a mount, a polynomial system or a structure. One of the ranges selects the
    parameter that varies and its start and end value, upwards or downwards.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
    nu_range : (float, float)
        For an oscillator: frequencies (rad/s) of the load.
    load, base
        For an oscillator: as for `forced_response`.
    nu : float or (float, float)
        For an oscillator with ``load_range`` or ``vary_range``: the fixed frequency. For a
        pendulum: range of the base frequency with constant frequency ratios.
    load_range : (float, float)
        For an oscillator: factors of the load.
    vary, vary_range : str, (float, float)
        For an oscillator: a parameter of the system and its range. Mount: "mass", "inertia",
        "offset", "stiffness_x", "stiffness_phi", "cubic_scale", "memory_scale". `PolynomialSystem`:
        an entry, "stiffness[x1,x2]" (for one coordinate "stiffness"), also of mass or damping,
        together with its mirror image if it has the same value; a coefficient of the forces,
        "forces[x1,x1^2*x2]" ("forces[x^3]"); one of its parameters; a factor, "mass_scale",
        "damping_scale", "stiffness_scale", "forces_scale" (including all springs), "memory_scale"
        (all kernels). The prefix "springs[0]." restricts it to these springs. `Structure`:
        "elements[0].stiffness", "elements[0].k3" (k3 a parameter of its law), "elements[0].limit",
        ".gap" and other numbers of `Jenkins`, `BoucWen`, `Dahl`, `Gap` and `Stop`, or
        "memory_scale"; modal damping is constant. `Body`: "mass", "inertia_scale", "center[x]",
        "mounts[front].stiffness[z]" (its local z), "mounts[front].damping[z]",
        "mounts[front].position[x]", a factor of all three, "mounts[front].stiffness_scale",
        "mounts[front].k3" (k3 a parameter of its laws), and the names of a `PolynomialSystem`.
    p1, p2, p3, f0, m01, m02 : (float, float)
        For a pendulum: range of a frequency or amplitude of its loads.
    at : array_like
        Parameter values in the range. The branch gets a point at each crossing of these values.
    start : tuple, mapping or Trajectory
        For an oscillator: a nearby motion to start from, for example on a closed branch (an isola)
        or with a longer period than the load: ``(result, i)``, the i-th motion of a response or
        branch; ``{k: X_k}`` with a number for each coordinate; or a `Trajectory`, whose last
        period, 2 pi divided by the start frequency, is used. The branch starts at the parameter
        value of this motion if the range contains it, else at the start of the range. The motion
        keeps the symmetry of load and forces unless the start breaks it.
    leave : BranchPoint
        Follow the branch that crosses at this point. The first branch must have the same harmonics,
        loads and ``subharmonic``.
    opposite : bool
        With ``leave``: follow the opposite direction.
    symmetric : bool
        Use only motions with the symmetry of system and loads (for an oscillator: half-wave
        symmetry) if it exists. This is faster, but symmetry-breaking points are not found. None is
        True for an oscillator and False for a pendulum. For period doublings of an oscillator pass
        the load as harmonic 2 with half its frequency.
    harmonics : int or "auto"
        Highest harmonic, with several base frequencies in total. "auto": as many as bring
        ``truncation`` below ``tolerance``. For an oscillator at each point, up to 63, or 199 if
        forces are not polynomials (such a point of one coordinate takes about 6 ms with odd
        harmonics, 20 ms with all); with ``leave`` those of the first branch. For a pendulum 15, 6
        or 4 at first; the branch is followed again with more until the outermost harmonics are
        small enough; with ``leave`` those of the first branch.
    tolerance : float
        A second name of ``rtol``.
    rtol, atol : float
        The last correction, and for an oscillator the effect of neglected harmonics, are at most
        rtol times the size of the motion plus atol: rtol 1e-14 to 0.1 (default 1e-10, and 1e-6 if
        a force law has corners), atol in the unit of the coordinates (default 0), as for
        `forced_response`. For a pendulum rtol alone
        selects the harmonics.
    **curve
    stability : bool
        Compute Floquet multipliers; with memory the exponents of Hill's determinant, with a count
        of the growing ones by the argument principle. With many coordinates this takes longer than
        the branch itself (0.1 s per point with 20 coordinates). Beyond 240 unknowns it is not
        computed.
    duration : float
        For quasi-periodic motions of a pendulum: compute growth rates averaged over this time, 1 to
        1e6.
    subharmonic, max_denominator
        For a pendulum: as for `forced_response`.
    coordinates : sequence of str
        For a structure: coordinates of the result; by default all up to 64, else those with
        elements and loads. ``result.at(...)`` returns other coordinates.
    progress : bool
        Show the number of points if the computation takes longer than half a second.

    Returns
    -------
    Branch or DrivenBranch
        DrivenBranch for a pendulum.

    Raises
    ------
    InputError
        With the argument, its value and the allowed values; also for an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If the error by neglected harmonics or rounding exceeds ``tolerance``.

    Notes
    -----
    Newton's method for the harmonic balance equations with exact derivatives; pseudo-arclength
    continuation (Keller 1977) with the step size controlled by the angle between tangents. Folds
    are located to the rounding error of the parameter. At branch points the determinant of the
    bordered derivatives changes sign. With ``subharmonic=2`` period doublings of a pendulum, such
    as the parametric resonance under f0 alone, are branch points.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.trace_response(duffing, (0.3, 3), load=0.3).folds.size
    2
    """
    check_instance("system", system, *_STEADY)
    # The progress bar is the same for all systems.
    given = with_curve(locals() | {"progress": False}, "trace_response", usual_tolerance(system))
    with counted_pieces(PROGRESS.check(progress)):
        if system._has_own_loads:
            return trace_pendulum(**_TRACE_PENDULUM.of(given))
        return trace_mount(**_TRACE_MOUNT.of(given))


@overload
def backbone(
    system: Steady,
    mode: int,
    amplitude_range: tuple[float, float],
    *,
    dof: str | None = None,
    coordinates: Sequence[str] | None = None,
    **curve: Unpack[_CurveOptions],
) -> Backbone: ...
@overload
def backbone(
    system: Pendulum,
    mode: int,
    amplitude_range: tuple[float, float] | None = None,
    *,
    energy_range: tuple[float, float] | None = None,
    dof: str | None = None,
    leave: BackbonePoint | None = None,
    opposite: bool = False,
    symmetric: bool = False,
    stability: bool | None = None,
    subharmonic: int = 1,
    **curve: Unpack[_CurveOptions],
) -> Backbone: ...
@with_curve_options
def backbone(
    system: Steady | Pendulum,
    mode: int,
    amplitude_range: tuple[float, float] | None = None,
    *,
    energy_range: tuple[float, float] | None = None,
    dof: str | None = None,
    leave: BackbonePoint | None = None,
    opposite: bool = False,
    symmetric: bool = False,
    harmonics: int | str = "auto",
    rtol: float | None = None,
    stability: bool | None = None,
    subharmonic: int = 1,
    coordinates: Sequence[str] | None = None,
    progress: bool = False,
    **curve: Unpack[CurveKeywords],
) -> Backbone:
    """Follow the free motions that start from a linear mode: frequency against amplitude.

    Damping, loads and memory are omitted. Springs have their full (instantaneous) stiffness.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
        For a pendulum with printed equations only the mode of z, because its swinging motions do
        not conserve energy.
    mode : int
        Index of the linear mode, from 0 by increasing frequency; for a pendulum as in
        `Pendulum.natural_frequencies`.
    amplitude_range : (float, float)
        First harmonic of a coordinate at the (small) start and at the end of the curve.
    energy_range : (float, float)
        For a pendulum, alternatively: energies (`Pendulum.energy`).
    dof : str, optional
        The coordinate of ``amplitude_range``; by default the one with the largest motion in the
        mode, for an oscillator weighted by the square root of its inertia.
    leave : BackbonePoint
        For a pendulum: follow the branch that crosses at this point. The first branch must have the
        same mode, harmonics and ``subharmonic``.
    opposite : bool
        With ``leave``: follow the opposite direction.
    symmetric : bool
        For a pendulum: use only motions that are mirrored in phi and psi after half a period (for
        the mode of z: without swinging). This is faster, but symmetry-breaking points are not
        found.
    harmonics : int or "auto"
        Highest harmonic of the mode's frequency. "auto": 9 at first; the curve is followed again
        with more until `Backbone.truncation` is below ``tolerance`` everywhere, up to 63; with
        ``leave`` those of the first branch.
    tolerance : float
        A second name of ``rtol``.
    rtol, atol : float
        The last correction is at most rtol times the size of the motion plus atol, and the effect
        of neglected harmonics is at most rtol times the size: rtol 1e-14 to 0.1 (default 1e-10),
        atol in the unit of the coordinates (default 0).
    **curve
    stability : bool
        For a pendulum: compute Floquet multipliers.
    subharmonic : int
        For a pendulum: period of the motions in periods of the mode, 1 to 20: 2 finds the swinging
        motions that the motion in z excites.
    coordinates : sequence of str
        For a structure: coordinates of the result, as for `trace_response`.
    progress : bool
        As for `trace_response`.

    Returns
    -------
    Backbone

    Raises
    ------
    InputError
        With the argument, its value and the allowed values; also for an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If `Backbone.truncation` exceeds ``tolerance``.

    Notes
    -----
    Without damping the equations are invariant under time reversal. Motions with zero initial
    velocity are even in time, which determines their phase. Harmonic balance for a_k and nu with
    pseudo-arclength continuation. With internal resonances the curve may turn back in amplitude or
    energy. At branch points the determinant of the bordered derivatives changes sign.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, forces="x^3")
    >>> round(vv.backbone(duffing, 0, (0.01, 1)).nu[-1], 3)  # of one harmonic alone: sqrt(7/4)
    np.float64(1.328)
    """
    check_instance("system", system, *_STEADY)
    # The progress bar is the same for all systems.
    given = with_curve(locals() | {"progress": False}, "backbone")
    with counted_pieces(PROGRESS.check(progress)):
        if system._has_own_loads:
            return pendulum_backbone(**_PENDULUM_BACKBONE.of(given))
        return oscillator_backbone(**_OSCILLATOR_BACKBONE.of(given))


_STEADY = (Mount, PolynomialSystem, Structure, Pendulum)
_TRACE_MOUNT = Taken(trace_response, trace_mount, OSCILLATOR)
_TRACE_PENDULUM = Taken(trace_response, trace_pendulum, PENDULUM)
_OSCILLATOR_BACKBONE = Taken(backbone, oscillator_backbone, OSCILLATOR)
_PENDULUM_BACKBONE = Taken(backbone, pendulum_backbone, PENDULUM)
