"""Periodic motions in time by shooting; steps end where laws switch."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.analyses.accuracy import Accuracy
from viscovib.analyses.period_map import PeriodMap
from viscovib.analyses.runs import starting_state
from viscovib.analyses.whole_structure import check_outside
from viscovib.errors import ConvergenceWarning, caller
from viscovib.results.steady_motion import SteadyMotion
from viscovib.systems.load import LoadLike
from viscovib.systems.polynomial_system import PolynomialSystem
from viscovib.systems.structure import Structure
from viscovib.systems.system import turned

MOST_PERIODS = 64
#: Outcomes of a search, by their number in the core.
SEARCHES = ("converged", "stalled", "diverged", "singular", "overflow", "stopped")
#: Stability, by its number in the core.
STABLE = {1: True, 0: False, -1: None}


def steady_motion(
    system: PolynomialSystem | Structure,
    nu: float,
    *,
    load: LoadLike | None = None,
    initial: npt.ArrayLike | SteadyMotion | None = None,
    n_periods: int = 1,
    method: str = "auto",
    tolerance: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
) -> SteadyMotion:
    """Find a periodic motion in time by shooting. Steps end where laws switch.

    Newton's method finds the state that repeats after a number of load periods. There is no
    expansion in harmonics, so a gap, an impact or dry friction that sticks is as accurate as a
    smooth law. The derivatives across switches give the Floquet multipliers.

    Parameters
    ----------
    system : PolynomialSystem or Structure
        With at most 512 coordinates (time grows with the cube of their number); with memory, if its
        kernels are sums of exponentials; without hysteresis elements (`Jenkins`, `Iwan`, `BoucWen`,
        `Dahl`: see `forced_response`).
    nu : float
        Circular frequency of the load (rad/s).
    load
        As for `simulate`.
    initial : array_like, shape (2 n_dof,), or SteadyMotion
        Initial guess of the state at t = 0: each coordinate with its velocity. If several periodic
        motions exist, stable or not, a nearby one is found. None: the state of the motion from rest
        after 30 periods, or later if this fails.
    n_periods : int
        Number of load periods after which the motion repeats, 1 to 64: 2 after a period doubling. A
        nearby motion with a shorter period may be found: see `repeats_after`.
    method : {"auto", "gauss8", "gauss16"}
        As for `simulate`; "auto" is "gauss8". "gauss16" for at most 6 coordinates without memory.
    tolerance : float
        Absolute error of the state at t = 0, velocities divided by ``nu``, 1e-13 to 1
        (default: 1e-10 times the largest entry): the step size is halved until the state no longer
        changes.
    rtol, atol : float
        Instead of ``tolerance``: atol + rtol times the largest entry.

    Returns
    -------
    SteadyMotion

    Warns
    -----
    ConvergenceWarning
        If no motion was found, or if the tolerance is not reached.

    Notes
    -----
    With the map P of a state over the period Newton's steps are (1 - P')^-1 (P(y) - y). P' is the
    derivative of the collocation times the jump of perturbations at each switch (Aizerman and
    Gantmakher 1958; see `SteadyMotion.multipliers`). At a grazing contact the map has a square
    root: Newton's method converges slowly near it, and a different motion may lie beyond it.

    Examples
    --------
    >>> import numpy as np
    >>> import viscovib as vv
    >>> friction = vv.PolynomialSystem(mass=1, stiffness=1, forces="0.7*sign(x_dot)")
    >>> motion = vv.steady_motion(friction, 0.4, load=1.0)
    >>> motion.stable, bool(np.abs(motion.multipliers[-1]) < 1e-9)  # it sticks on the way
    (True, True)
    """
    system = turned(system, nu)
    periods = _native.integer("n_periods", n_periods, 1, MOST_PERIODS)
    wanted = Accuracy.checked(tolerance, rtol, atol, 1e-10)
    assert wanted is not None
    mapping = PeriodMap.checked(system, load, nu, periods, method)
    found = search(system, mapping, initial, wanted)
    motion = _motion(system, mapping, found)
    if found["doubt"]:
        about = f"steady_motion: {motion.outcome}{found['doubt']}"
        warnings.warn(about, ConvergenceWarning, stacklevel=caller())
    return motion


def search(
    system: Any,
    mapping: PeriodMap,
    initial: npt.ArrayLike | SteadyMotion | None,
    wanted: Accuracy,
) -> dict[str, Any]:
    """Find a periodic motion from a nearby state or from rest."""
    begin = begin_of(system, mapping, initial)
    return _native.apart(
        lambda: _native.run(
            "motion steady", mapping.system_in_core, **mapping.given, **begin,
            absolute=wanted.absolute, relative=wanted.relative,
        )
    )  # fmt: skip


def begin_of(
    system: Any,
    mapping: PeriodMap,
    initial: npt.ArrayLike | SteadyMotion | None,
) -> dict[str, FloatArray]:
    """Return the initial state for tasks; hidden states are 0 unless known."""
    if initial is None:
        return {}
    remembered = np.zeros(mapping.hidden)
    if isinstance(initial, SteadyMotion):
        if initial.remembered.size == remembered.size:
            remembered = initial.remembered
        initial = initial.state[0]
    state = starting_state(initial, mapping.n_dof, system.dof_names)
    if system._is_condensed:
        check_outside(system, state)
    return {"begin": np.concatenate([state, remembered])}


def _motion(
    system: PolynomialSystem | Structure, mapping: PeriodMap, found: dict[str, Any]
) -> SteadyMotion:
    """Create the result with names."""
    return SteadyMotion(
        nu=mapping.nu,
        n_periods=mapping.n_periods,
        repeats_after=found["repeats_after"],
        t=found["t"],
        state=found["states"].T,
        remembered=found["begin"][2 * mapping.n_dof :],
        multipliers=found["multipliers"],
        stable=STABLE[found["stable"]],
        error=found["error"],
        multiplier_error=found["multiplier_error"],
        outcome=SEARCHES[found["outcome"]],
        iterations=found["iterations"],
        switches=found["n_passed"],
        step=mapping.period / found["n_steps"],
        method=mapping.method,
        system=system,
        _map=mapping,
    )
