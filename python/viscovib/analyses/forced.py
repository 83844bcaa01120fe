"""Steady motions under given loads: one name and one signature for oscillators and the pendulum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

import numpy.typing as npt

from viscovib._native import check_instance
from viscovib.analyses.driven import DrivenResponse, pendulum_response
from viscovib.analyses.starts import StartLike
from viscovib.analyses.steady import mount_plan, mount_response
from viscovib.common.parameters import OSCILLATOR, PENDULUM, Taken, with_rtol
from viscovib.common.plan import Plan
from viscovib.results.response import Response
from viscovib.systems.load import LoadLike
from viscovib.systems.mount import Mount
from viscovib.systems.oscillators import Steady
from viscovib.systems.pendulum import Pendulum
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure


@overload
def forced_response(
    system: Steady,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    rtol: float | None = None,
    atol: float = 0.0,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
    start: StartLike | None = None,
    coordinates: Sequence[str] | None = None,
    progress: bool = False,
) -> Response: ...
@overload
def forced_response(
    system: Pendulum,
    nu: npt.ArrayLike | None = None,
    *,
    p1: npt.ArrayLike | None = None,
    p2: npt.ArrayLike | None = None,
    p3: npt.ArrayLike | None = None,
    f0: npt.ArrayLike | None = None,
    m01: npt.ArrayLike | None = None,
    m02: npt.ArrayLike | None = None,
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    rtol: float | None = None,
    stability: bool = False,
    duration: float | None = None,
    subharmonic: int = 1,
    max_denominator: int = 12,
) -> DrivenResponse: ...
def forced_response(
    system: Steady | Pendulum,
    nu: npt.ArrayLike | None = None,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    p1: npt.ArrayLike | None = None,
    p2: npt.ArrayLike | None = None,
    p3: npt.ArrayLike | None = None,
    f0: npt.ArrayLike | None = None,
    m01: npt.ArrayLike | None = None,
    m02: npt.ArrayLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    rtol: float | None = None,
    atol: float = 0.0,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
    duration: float | None = None,
    subharmonic: int = 1,
    max_denominator: int = 12,
    start: StartLike | None = None,
    coordinates: Sequence[str] | None = None,
    progress: bool = False,
) -> Response | DrivenResponse:
    """Steady response of a system to its loads, by harmonic balance.

    An oscillator (a mount or a polynomial system) is given a periodic load, or motion of its base,
    and its frequencies. A pendulum has its loads in itself. With one load, or loads whose
    frequencies are ratios of small numbers, its motions are periodic; else quasi-periodic, with all
    combinations of two or three base frequencies.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
        Loads of a pendulum of amplitude or frequency 0 are no oscillations: the former do not act,
        the latter are constant.
    nu : array_like, shape (n,)
        Circular frequencies of the load (rad/s), each > 0, in any order; an oscillator needs them.
        Of a pendulum: base frequencies, all loads keeping their ratios to it.
    load : complex, array_like or mapping
        Of an oscillator: force on the first coordinate (x, N): P sin(nu t); or a vector over the
        coordinates (of a mount: force on x, moment on phi); or forces by the names of coordinates,
        {"x3": P}; or a Fourier series {order: any of these}, f(t) = Im sum_k P_k exp(i k nu t),
        whose mean is the imaginary part of P_0. `fourier_coefficients` makes one from samples.
    base : complex or mapping
        Of an oscillator: displacement of the supports (of a mount: in x, m), likewise, along the
        ``base_direction`` of the system. Of a `PolynomialSystem` or a `Body` also a vector over its
        coordinates (of a body x, y, z, rx, ry, rz), or amplitudes by their names: each its own. The
        response stays absolute. Viscous damping acts on the motion relative to the base. A mass
        matrix that couples coordinates to the supports (block M_fs, as of consistent finite
        elements) needs the load -M_fs a too, a being the acceleration of the supports.
    p1, p2, p3, f0, m01, m02 : array_like, shape (n,)
        Of a pendulum, instead of ``nu``: values of one of them in place of its own. Without any a
        single motion is computed.
    method : {"successive", "newton", "linear"}
        Of an oscillator. "linear": nonlinear terms left out; "successive": successive
        approximations from the linear response, which converge where the nonlinear force is small
        against the dynamic stiffness; "newton": Newton's method, which also passes resonances.
        There each frequency starts from the one before in the order given, as in a slow sweep:
        where several motions exist, upwards and downwards may give different ones. Where the branch
        ends, or at the first frequency, the load is raised from nothing: along the curve of the
        growing load, through its folds, to where the load is first the whole one.
        `trace_response` gives all of a branch. A pendulum is solved by Newton's method.
    harmonics : int or "auto"
        Highest order kept (1 to 399); with several base frequencies highest |k1| + |k2| + ... .
        "auto": as many as bring the ``truncation`` of the result below ``tolerance``, or as there
        is room for: those that each motion needs, which is also fastest; with successive
        approximations the same for all, or for all of a part of a long list. Orders that
        symmetry rules out are dropped: even ones and the mean, where the load has none.
    tolerance : float
        Another name of ``rtol``.
    rtol, atol : float
        Errors of the iteration and of the orders left out are wanted within rtol times the size of
        the motion and atol besides: rtol 1e-14 to 0.1 (1e-10 if neither it nor ``tolerance`` is
        given), atol in the unit of each coordinate (0 if not given; not of a pendulum). The size
        of a motion is its largest sqrt(M_ii) (abs(Re X) + abs(Im X)) of all coordinates i and
        orders, M being the mass matrix, so that metres and radians weigh by inertia; atol counts
        as that of the lightest coordinate, and so every coordinate keeps it. Of a structure, or a
        polynomial system of many coordinates, atol is of the displacements across its elements,
        which the equations left are for.
    max_iterations : int
        Of an oscillator: iterations a frequency, 1 to 100000.
    relaxation : float or "auto"
        Of an oscillator: fraction of each correction that is taken, in (0, 1]; "auto": start with 1
        and halve, up to four times, where the iteration does not converge.
    stability : bool
        Also say whether each motion is stable: by Floquet multipliers, with memory by Hill's
        determinant (see `Branch`), of quasi-periodic motions by rates of growth. An oscillator
        needs ``method="newton"``.
    duration : float
        Of a pendulum: time over which the rates of a quasi-periodic motion are averaged, 1 to 1e6
        (default 3000). Rates whose differences are small against 1/duration share their errors;
        where the errors hide the sign of a rate, stability is unknown.
    subharmonic : int
        Of a pendulum: period of the motion in periods of the loads, 1 to 20: 2 finds what period
        doubling leads to.
    max_denominator : int
        Of a pendulum: loads share a base frequency of which they are multiples up to this, 1 to 99;
        those of ``nu`` or a subharmonic share one if this is so for each pair.
    start : tuple, mapping or Trajectory
        Of an oscillator, with ``method="newton"``: a motion near the first one wanted, as for
        `trace_response`. A frequency at which Newton's method does not reach a motion from it has
        no solution; the next one is tried from it again.
    coordinates : sequence of str
        Of a structure: which of its coordinates the result holds; default all up to 64, else those
        that elements and loads touch.
    progress : bool
        Of an oscillator: show a progress bar.

    Returns
    -------
    Response or DrivenResponse
        The latter of a pendulum.

    Raises
    ------
    InputError
        Naming the argument, its value and what is allowed; also an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If some motions were not found; they hold NaN. If the orders kept do not bring the
        ``truncation`` below ``tolerance``.
    StabilityWarning
        If the stability of motions found is unknown.

    Notes
    -----
    Source: seed paper 001, (14)-(19), corrected (see the theory pages). Fixed point
    D(k nu) X_k = P_k - N_k(X) with the harmonics N_k of the nonlinear force from alias-free samples
    of a period. Of a pendulum: Newton's method with exact derivatives on -w_k^2 X_k = A_k, the
    harmonics of the accelerations from samples on the torus of the loads' phases; each row starts
    from those before, else the loads are raised from nothing. A motion raised from rest keeps the
    symmetry of system and loads, if there is one. Another motion may be found by `trace_response`.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> vv.forced_response(duffing, [0.8, 1.2], load=0.2, method="newton").converged.all()
    np.True_
    """
    given = with_rtol(locals())
    if isinstance(system, Pendulum):
        return pendulum_response(**_PENDULUM_RESPONSE.of(given))
    if not isinstance(system, _STEADY):
        check_instance("system", system, *_STEADY)
    return mount_response(**_MOUNT_RESPONSE.of(given))


def plan_response(
    system: Steady,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "successive",
    harmonics: int | str = "auto",
    tolerance: float = 1e-10,
    rtol: float | None = None,
    atol: float = 0.0,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
) -> Plan:
    """Say what `forced_response` of an oscillator would compute and skip, and why.

    Parameters
    ----------
    system : Mount or PolynomialSystem
    nu, load, base, method, harmonics, tolerance, rtol, atol, max_iterations, relaxation, stability
        As for `forced_response`.

    Returns
    -------
    Plan

    Examples
    --------
    >>> import viscovib as vv
    >>> mount = vv.Mount(
    ...     mass=1,
    ...     inertia=0.1,
    ...     offset=0.5,
    ...     stiffness_x=10,
    ...     stiffness_phi=2,
    ...     damping=[[0.2, -0.1], [-0.1, 0.09]],
    ... )
    >>> skipped = vv.plan_response(mount, [1.0, 2.0], load=0.1)["skips"]
    """
    given = with_rtol(locals())
    del given["rtol"]
    return mount_plan(**given)


_STEADY = (Mount, PolynomialSystem, Structure, Pendulum)
_MOUNT_RESPONSE = Taken(forced_response, mount_response, OSCILLATOR)
_PENDULUM_RESPONSE = Taken(forced_response, pendulum_response, PENDULUM)
