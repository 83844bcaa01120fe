"""Steady motions under given loads: one function for oscillators and the pendulum."""

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
from viscovib.systems.whole import usual_tolerance


@overload
def forced_response(
    system: Steady,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "auto",
    harmonics: int | str = "auto",
    tolerance: float | None = None,
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
    tolerance: float | None = None,
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
    method: str = "auto",
    harmonics: int | str = "auto",
    tolerance: float | None = None,
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
    """Compute the steady response of a system to its loads by harmonic balance.

    An oscillator (a mount, a polynomial system or a structure) needs a periodic load, or a base
    motion, and frequencies. The loads of a pendulum are part of the system. With one load, or loads
    with rational frequency ratios, its motions are periodic. Otherwise they are quasi-periodic,
    with all combinations of two or three base frequencies.

    Parameters
    ----------
    system : Mount, PolynomialSystem, Structure or Pendulum
        Loads of a pendulum with amplitude 0 have no effect; loads with frequency 0 are constant.
    nu : array_like, shape (n,)
        Circular frequencies of the load (rad/s), each > 0, in any order. Required for an
        oscillator. For a pendulum: base frequencies with constant ratios of all loads.
    load : complex, array_like or mapping
        For an oscillator: force on the first coordinate (x, N), P sin(nu t); or a vector over the
        coordinates (for a mount: force on x, moment on phi); or forces by the names of coordinates,
        {"x3": P}; or a Fourier series {harmonic: any of these}, f(t) = Im sum_k P_k exp(i k nu t),
        whose mean is the imaginary part of P_0. `fourier_coefficients` computes it from samples.
        P may be a formula in nu, such as "0.002*nu^2" for an unbalance of 0.002 kg m.
    base : complex or mapping
        For an oscillator: displacement of the supports (for a mount: in x, m) in the same form,
        along the ``base_direction`` of the system. For a `PolynomialSystem` or a `Body` also a
        vector over its coordinates (for a body x, y, z, rx, ry, rz), or amplitudes by name. The
        response is absolute. Viscous damping acts on the motion relative to the base. A mass matrix
        that couples coordinates to the supports (block M_fs of consistent finite elements) also
        needs the load -M_fs a with the acceleration a of the supports. For a `Structure` with
        ``supports`` also a motion of each by name, {"left": 1e-3, "right": {1: 1e-3j, 2: 2e-4}}.
        Only linear springs and dampers may act on such supports.
    p1, p2, p3, f0, m01, m02 : array_like, shape (n,)
        For a pendulum, instead of ``nu``: values of one of its parameters. Without them a single
        motion is computed.
    method : {"auto", "successive", "newton", "linear"}
        For an oscillator. "linear": without nonlinear terms. "successive": successive
        approximations from the linear response; they converge if the nonlinear force is small
        compared with the dynamic stiffness. "newton": Newton's method, also through resonances.
        Each frequency starts from the previous one in the given order, as in a slow sweep. If
        several motions exist, sweeps up and down may return different motions. At the first
        frequency, and where the branch ends, the branch is followed in the load from 0 to the full
        load, through its folds. "auto" (default): successive approximations where they converge,
        Newton's method elsewhere, from the neighbouring motions; ``methods`` of the result contains
        the method of each frequency. Hysteresis, finite rotations, ``stability`` and ``start`` use
        Newton's method everywhere. If several motions exist, "auto" and "newton" may return
        different motions. `trace_response` returns the whole branch. A pendulum always uses
        Newton's method.
    harmonics : int or "auto"
        Highest harmonic (1 to 399); with several base frequencies the highest |k1| + |k2| + ... .
        "auto": as many as each motion needs to bring its ``truncation`` below ``tolerance``, within
        the maximum number; with successive approximations the same number for all frequencies of a
        part of the list. Harmonics that are 0 by symmetry are dropped: even ones and the mean, if
        the load does not contain them.
    tolerance : float
        Alias of ``rtol``. Default: 1e-10, and 1e-6 if a force law has corners (abs, min,
        max, sign, hysteresis), because its harmonics decrease slowly.
    rtol, atol : float
        The errors of the iteration and of neglected harmonics are at most rtol times the size of
        the motion plus atol: rtol 1e-14 to 0.1, atol in the unit of each coordinate
        (default 0; not for a pendulum). The size of a motion is its largest sqrt(M_ii) (abs(Re X) +
        abs(Im X)) of all coordinates i and harmonics, with the mass matrix M, so metres and radians
        are weighted by inertia. atol refers to the coordinate with the smallest inertia, so every
        coordinate satisfies it. For a structure, or a polynomial system of many coordinates, atol
        refers to the deflections of the elements.
    max_iterations : int
        For an oscillator: largest number of iterations per frequency, 1 to 100000.
    relaxation : float or "auto"
        For an oscillator: fraction of each correction that is applied, in (0, 1]; "auto": start
        with 1 and halve it up to four times if the iteration does not converge.
    stability : bool
        Also compute the stability of each motion: by Floquet multipliers, with memory by Hill's
        determinant (see `Branch`), for quasi-periodic motions by growth rates. An oscillator needs
        ``method="newton"`` or "auto".
    duration : float
        For a pendulum: averaging time of the growth rates of a quasi-periodic motion, 1 to 1e6
        (default 3000). Rates that differ by less than about 1/duration share their errors. If the
        error exceeds the rate, stability is unknown.
    subharmonic : int
        For a pendulum: period of the motion in periods of the loads, 1 to 20. 2 finds motions after
        a period doubling.
    max_denominator : int
        For a pendulum: loads with frequency ratios of integers up to this number share a base
        frequency, 1 to 99; for ``nu`` or a subharmonic this applies to each pair.
    start : tuple, mapping or Trajectory
        For an oscillator with ``method="newton"`` or "auto": a motion near the first one, as for
        `trace_response`. A frequency at which Newton's method does not converge from it has no
        solution; the next frequency starts from it again.
    coordinates : sequence of str
        For a structure: coordinates of the result; by default all up to 64, else those with
        elements and loads.
    progress : bool
        For an oscillator: show a progress bar.

    Returns
    -------
    Response or DrivenResponse
        DrivenResponse for a pendulum.

    Raises
    ------
    InputError
        With the argument, its value and the allowed values; also for an argument that this kind of
        system does not have.

    Warns
    -----
    ConvergenceWarning
        If some motions were not found (they are NaN), or if ``truncation`` exceeds ``tolerance``.
    StabilityWarning
        If the stability of some motions is unknown.

    Notes
    -----
    Source: the paper on the mount, (14)-(19), corrected. Fixed point D(k nu) X_k =
    P_k - N_k(X) with the harmonics N_k of the nonlinear force from samples of a period without
    aliasing. For a pendulum: Newton's method with exact derivatives for -w_k^2 X_k = A_k, the
    harmonics of the accelerations from samples on the torus of the loads' phases. Each row starts
    from the previous rows, or the loads are increased from 0. A motion computed from rest has the
    symmetry of system and loads. `trace_response` finds other motions.

    Examples
    --------
    >>> import viscovib as vv
    >>> duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    >>> response = vv.forced_response(duffing, [0.2, 1.2], load=0.2)
    >>> print(*response.methods)
    successive newton
    """
    check_instance("system", system, *_STEADY)
    given = with_rtol(locals(), usual_tolerance(system))
    if system._has_own_loads:
        return pendulum_response(**_PENDULUM_RESPONSE.of(given))
    return mount_response(**_MOUNT_RESPONSE.of(given))


def plan_response(
    system: Steady,
    nu: npt.ArrayLike,
    *,
    load: LoadLike | None = None,
    base: LoadLike | None = None,
    method: str = "auto",
    harmonics: int | str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float = 0.0,
    max_iterations: int = 200,
    relaxation: float | str = 1.0,
    stability: bool = False,
) -> Plan:
    """Return the plan of `forced_response` for an oscillator, without computing it.

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
    check_instance("system", system, *_STEADY)
    given = with_rtol(locals(), usual_tolerance(system))
    del given["rtol"]
    return mount_plan(**given)


_STEADY = (Mount, PolynomialSystem, Structure, Pendulum)
_MOUNT_RESPONSE = Taken(forced_response, mount_response, OSCILLATOR)
_PENDULUM_RESPONSE = Taken(forced_response, pendulum_response, PENDULUM)
