"""Curves of steady motions: one name and one signature for oscillators and the pendulum."""

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


class _CurveOptions(CurveKeywords, total=False):
    """What every curve may be given."""

    harmonics: int | str
    rtol: float | None
    progress: bool


class _TraceOptions(_CurveOptions, total=False):
    """What every branch may be given besides."""

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

    An oscillator is a mount or a polynomial system. One of the ranges says what varies, from where
    and to where, up or down.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
    nu_range : (float, float)
        Of an oscillator: frequencies (rad/s) of the load.
    load, base
        Of an oscillator: as for `forced_response`.
    nu : float or (float, float)
        Of an oscillator with ``load_range`` or ``vary_range``: the frequency that stays. Of a
        pendulum: from and to for the base frequency of loads whose ratios of frequencies stay.
    load_range : (float, float)
        Of an oscillator: factors of the load.
    vary, vary_range : str, (float, float)
        Of an oscillator: a parameter of the system and its values. Of a mount "mass", "inertia",
        "offset", "stiffness_x", "stiffness_phi", "cubic_scale" or "memory_scale". Of a
        `PolynomialSystem` an entry, "stiffness[x1,x2]" (for one coordinate "stiffness"), also of
        mass or damping, with its mirror image if that has the same value; a coefficient of the
        forces, "forces[x1,x1^2*x2]" ("forces[x^3]"); or a factor of the whole, "mass_scale",
        "damping_scale", "stiffness_scale", "forces_scale" (those of all springs too),
        "memory_scale" (of all kernels). "springs[0]." before it means those springs alone.
        Of a `Structure` "elements[0].stiffness",
        "elements[0].k3" (k3 a parameter of its law), "elements[0].limit", ".gap" and other numbers
        of `Jenkins`, `BoucWen`, `Dahl`, `Gap` and `Stop`, or "memory_scale"; modal damping stays.
        Of a `Body` "mass", "inertia_scale", "center[x]", "mounts[front].stiffness[z]" (its local
        z), "mounts[front].damping[z]", "mounts[front].position[x]", a factor of all three,
        "mounts[front].stiffness_scale", or "mounts[front].k3" (k3 a parameter of its laws); and
        what a `PolynomialSystem` has.
    p1, p2, p3, f0, m01, m02 : (float, float)
        Of a pendulum: one of its own frequencies or amplitudes of loads.
    at : array_like
        Values of what varies, in its range, at each of which a point shall lie, as often as the
        branch gets there.
    start : tuple, mapping or Trajectory
        Of an oscillator: a motion nearby to begin at, such as on a closed branch that no sweep
        meets (an isola) or of a period longer than the load's: ``(result, i)``, the i-th motion of
        a response or branch; ``{k: X_k}`` with a number of each coordinate; or a `Trajectory`,
        whose last period, 2 pi over the frequency at which the branch begins, is taken. The branch
        begins at the value of that motion if the range holds it, else at the beginning of the
        range. Harmonics keep the symmetry of load and forces unless the motion breaks it.
    leave : BranchPoint
        Follow the branch that crosses another one here, which was traced with the same harmonics,
        loads and ``subharmonic``.
    opposite : bool
        With ``leave``: the other way.
    symmetric : bool
        Keep to motions that share the symmetry of system and loads (of an oscillator that about
        half a period), where there is one: faster, but blind to branch points where it breaks. None
        stands for True of an oscillator, False of a pendulum. For period doublings of an oscillator
        give the load as order 2 and half its frequency.
    harmonics : int or "auto"
        Highest order kept, with several base frequencies in all. "auto": as many as bring the
        ``truncation`` of the motions below ``tolerance``. Of an oscillator those that each point
        needs, up to 63, or 199 if forces are no polynomials (of one coordinate such a point takes
        some 6 ms with odd orders only, 20 ms with all); to ``leave`` a branch, give it what that
        was traced with. Of a pendulum 15,
        6 or 4 at first; the branch is followed again with more until the outermost orders, where
        they are the largest, are small enough or there is no more room; with ``leave`` those of the
        branch that is left.
    tolerance : float
        Another name of ``rtol``.
    rtol, atol : float
        The last correction, and of an oscillator what leaving out orders may change, are within
        rtol times the size of the motion and atol besides, whatever its size: rtol 1e-14 to 0.1
        (1e-10 if neither it nor ``tolerance`` is given), atol in the unit of the coordinates (0 if
        not given), as for `forced_response`. Of a pendulum rtol alone chooses the orders.
    **curve
    stability : bool
        Compute Floquet multipliers; with memory, exponents from Hill's determinant, those that grow
        counted by the argument principle; with many coordinates that takes longer than the branch
        itself (0.1 s a point with 20), and beyond 240 unknowns it is not tried.
    duration : float
        Of a pendulum, for quasi-periodic motions: compute rates of growth, averaged over this time,
        1 to 1e6.
    subharmonic, max_denominator
        Of a pendulum: as for `forced_response`.
    coordinates : sequence of str
        Of a structure: which of its coordinates the result holds; default all up to 64, else those
        that elements and loads touch. ``result.at(...)`` shows others.
    progress : bool
        Show how many points are done, if that takes longer than half a second.

    Returns
    -------
    Branch or DrivenBranch
        The latter of a pendulum.

    Raises
    ------
    InputError
        Naming the argument, its value and what is allowed; also an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If the orders kept leave an estimated error above ``tolerance``, or rounding does.

    Notes
    -----
    Newton's method on the equations of harmonic balance with exact derivatives;
    pseudo-arclength continuation (Keller 1977), steps by the angle between tangents; folds located
    to rounding of the parameter. Branch points are where the determinant of the bordered
    derivatives changes its sign. With ``subharmonic=2`` period doublings of a pendulum, such as the
    parametric resonance of one that swings under f0 alone, are branch points.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.trace_response(duffing, (0.3, 3), load=0.3).folds.size
    2
    """
    # The bar is the same whatever the system.
    given = with_curve(locals() | {"progress": False}, "trace_response")
    with counted_pieces(PROGRESS.check(progress)):
        if isinstance(system, Pendulum):
            return trace_pendulum(**_TRACE_PENDULUM.of(given))
        if not isinstance(system, _STEADY):
            check_instance("system", system, *_STEADY)
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
    """Follow the free motions that grow from a linear mode: frequency against amplitude.

    Damping, loads and memory are left out: springs act as at once, with their full stiffness.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
        Of a pendulum with printed equations the mode of z only: their swings keep no energy, and
        are not periodic.
    mode : int
        The linear mode, counted from 0 by rising frequency; of a pendulum as in
        `Pendulum.natural_frequencies`.
    amplitude_range : (float, float)
        First harmonic of a coordinate from which (small) and to which the curve is followed.
    energy_range : (float, float)
        Of a pendulum, instead: energies (`Pendulum.energy`).
    dof : str, optional
        The coordinate of ``amplitude_range``; default the one that moves most in the mode, of an
        oscillator weighed by the root of its inertia.
    leave : BackbonePoint
        Of a pendulum: follow the family that crosses another one here, which was traced with the
        same modes, harmonics and ``subharmonic``.
    opposite : bool
        With ``leave``: the other way.
    symmetric : bool
        Of a pendulum: keep to motions that are mirrored in phi and psi half a period later (of the
        mode of z: that do not swing): faster, but blind to branch points where the symmetry breaks.
    harmonics : int or "auto"
        Highest order kept of the mode's frequency. "auto": 9 at first; the curve is followed again
        with more until `Backbone.truncation` is below ``tolerance`` all along it, up to 63; to
        ``leave`` a curve, as many as that has at first.
    tolerance : float
        Another name of ``rtol``.
    rtol, atol : float
        The last correction is within rtol times the size of the motion and atol besides, whatever
        its size, and what leaving out orders may change within rtol times it: rtol 1e-14 to 0.1
        (1e-10 if neither it nor ``tolerance`` is given), atol in the unit of the coordinates (0 if
        not given).
    **curve
    stability : bool
        Of a pendulum: compute Floquet multipliers, unless this is False.
    subharmonic : int
        Of a pendulum: period of the motions in periods of the mode, 1 to 20: 2 finds the swings
        that the motion in z feeds.
    coordinates : sequence of str
        Of a structure: which of its coordinates the result holds, as for `trace_response`.
    progress : bool
        As for `trace_response`.

    Returns
    -------
    Backbone

    Raises
    ------
    InputError
        Naming the argument, its value and what is allowed; also an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If the orders kept do not bring `Backbone.truncation` below ``tolerance``.

    Notes
    -----
    Without losses the equations keep their form when time runs backwards; motions that begin at
    rest are even in time, which settles their phase. Harmonic balance for a_k and nu, followed by
    pseudo-arclength continuation. Where modes interact the curve may turn back in amplitude or
    energy. Branch points are where the determinant of the bordered derivatives changes its sign.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, forces="x^3")
    >>> round(vv.backbone(duffing, 0, (0.01, 1)).nu[-1], 3)  # of one harmonic alone: sqrt(7/4)
    np.float64(1.328)
    """
    # The bar is the same whatever the system.
    given = with_curve(locals() | {"progress": False}, "backbone")
    with counted_pieces(PROGRESS.check(progress)):
        if isinstance(system, Pendulum):
            return pendulum_backbone(**_PENDULUM_BACKBONE.of(given))
        if not isinstance(system, _STEADY):
            check_instance("system", system, *_STEADY)
        return oscillator_backbone(**_OSCILLATOR_BACKBONE.of(given))


_STEADY = (Mount, PolynomialSystem, Structure, Pendulum)
_TRACE_MOUNT = Taken(trace_response, trace_mount, OSCILLATOR)
_TRACE_PENDULUM = Taken(trace_response, trace_pendulum, PENDULUM)
_OSCILLATOR_BACKBONE = Taken(backbone, oscillator_backbone, OSCILLATOR)
_PENDULUM_BACKBONE = Taken(backbone, pendulum_backbone, PENDULUM)
