"""Free decay: frequencies and logarithmic decrements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.signals import warn_of_aliases
from viscovib.common.values import Value
from viscovib.results.trajectory import Trajectory

#: Array size of a motion up to which the fit takes a few milliseconds.
_FEW = 500


@dataclass(frozen=True, eq=False, repr=False)
class FreeDecay(Value):
    """A free motion as a sum of decaying oscillations.

    Attributes
    ----------
    roots : complex ndarray, shape (n,)
        s with positive imaginary part (1/time) of the motions Re(a exp(s t)), the largest motion
        first.
    amplitudes : complex ndarray, shape (n, n_dof)
        a of each coordinate, at t = 0 of the trajectory.
    residual : float
        Largest residual of a coordinate, relative to its largest value.

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
    >>> run = vv.simulate(mount, 40, initial=[0.01, 0, 0, 0], dt=0.05)
    >>> found = vv.free_decay(run)
    >>> s = found.roots  # decay and frequency of each oscillation
    """

    roots: ComplexArray
    amplitudes: ComplexArray
    residual: float

    @property
    def frequency(self) -> FloatArray:
        """Circular frequencies, the imaginary parts of the roots."""
        return np.asarray(self.roots.imag)

    @property
    def logarithmic_decrement(self) -> FloatArray:
        """-2 pi Re s/Im s: logarithm of the ratio of one amplitude to the next."""
        result: FloatArray = -2 * np.pi * self.roots.real / self.roots.imag
        return result


def free_decay(trajectory: Trajectory, *, count: int = 2, start: float = 0.0) -> FreeDecay:
    """Fit decaying oscillations to the coordinates of a free motion.

    Parameters
    ----------
    trajectory : Trajectory
        With equidistant states (``save_every``), at least 8 ``count`` states after ``start``, more
        than two per period of the fastest oscillation.
    count : int
        Number of oscillations.
    start : float
        Leave out the part before this time: with memory the beginning contains a slow creep, which
        is not an oscillation.

    Warns
    -----
    ConvergenceWarning
        If the velocities show oscillations that are too fast for the states kept.

    Notes
    -----
    Matrix pencil (Hua and Sarkar, IEEE Trans. Acoust. 38, 1990) of all coordinates together, with
    ``2 count`` additional exponentials for non-oscillatory parts.

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
    >>> run = vv.simulate(mount, 40, initial=[0.01, 0, 0, 0], dt=0.05)
    >>> found = vv.free_decay(run)
    >>> s = found.roots  # decay and frequency of each oscillation
    """
    _native.check_instance("trajectory", trajectory, Trajectory)
    wanted = _native.integer("count", count, 1, 50)
    begin = _native.number("start", start)
    keep = trajectory.t >= begin
    t, q = trajectory.t[keep], trajectory.state[keep][:, ::2]
    values = {"t": t, "q": q, "count": wanted}
    found = _native.run_either(q.size > _FEW, "spectrum decay", **values)
    step = float(np.diff(t).mean())
    for i, name in enumerate(trajectory.dof_names):
        if q[:, i].any():
            warn_of_aliases(name, q[:, i], trajectory.state[keep][:, 2 * i + 1], step)
    return FreeDecay(found["roots"], found["amplitudes"], found["residual"])
