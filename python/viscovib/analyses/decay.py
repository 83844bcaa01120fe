"""Free decay: frequencies and logarithmic decrements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.analyses.signals import tell_aliases
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.results.trajectory import Trajectory


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
    if t.size < 8 * wanted:
        raise InputError(
            f"trajectory: {t.size} states after start = {begin:g}, must be at least {8 * wanted}"
        )
    steps = np.diff(t)
    if np.ptp(steps) > 1e-6 * steps.mean():
        raise InputError("trajectory: must be kept at equal steps")
    sizes = np.abs(q).max(axis=0)
    moving = sizes > 0
    if not moving.any():
        raise InputError("trajectory: is at rest, nothing decays")
    for i in np.flatnonzero(moving):
        v = trajectory.state[keep][:, 2 * i + 1]
        tell_aliases(trajectory.dof_names[i], q[:, i], v, float(steps.mean()))
    poles = _poles(q[:, moving] / sizes[moving], 4 * wanted)
    basis = np.exp(np.outer(np.arange(t.size), np.log(poles)))
    shares, *_ = np.linalg.lstsq(basis, q.astype(complex), rcond=None)
    residual = float((np.abs(q - (basis @ shares).real).max(axis=0)[moving] / sizes[moving]).max())
    roots = np.log(poles) / steps.mean()
    swings = np.flatnonzero(roots.imag > 1e-9 * np.abs(roots))
    weight = np.abs(shares[swings] / np.where(moving, sizes, 1.0)).max(axis=1, initial=0.0)
    order = swings[np.argsort(-weight)][:wanted]
    if order.size < wanted:
        raise InputError(f"count = {wanted}: only {order.size} oscillations are in this motion")
    amplitudes = 2 * shares[order] * np.exp(-roots[order] * t[0])[:, np.newaxis]
    return FreeDecay(roots[order], amplitudes, residual)


def _poles(q: FloatArray, most: int) -> ComplexArray:
    """Factors a step of the exponentials in the columns of q, at most ``most``."""
    n = q.shape[0]
    # A few hundred rows of the pencil hold all there is; longer ones cost a cube.
    length = min(n // 2, 200)
    rows = n - length
    hankel = np.concatenate(
        [np.lib.stride_tricks.sliding_window_view(column, length + 1)[:rows] for column in q.T]
    )
    _, values, right = np.linalg.svd(hankel, full_matrices=False)
    rank = min(most, int((values > 1e-14 * values[0]).sum()))
    signal = right[:rank].T
    poles = np.linalg.eigvals(np.linalg.lstsq(signal[:-1], signal[1:], rcond=None)[0])
    return np.asarray(poles[np.abs(poles) > 0])
