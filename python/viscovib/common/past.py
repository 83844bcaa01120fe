"""A given motion before t = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib.common.values import short_repr
from viscovib.errors import InputError

#: Largest initial displacement, as in the core.
_LARGEST_START = 1e30


def check_start(state: npt.NDArray[np.float64]) -> None:
    """Refuse initial displacements and velocities (alternating) beyond the range of motions."""
    largest = float(np.maximum.reduce(np.abs(state[::2]), initial=0.0))
    if largest > _LARGEST_START:
        raise InputError(
            f"initial: has a displacement of {largest!r}, must be at most {_LARGEST_START:g}: "
            "choose other units"
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Past:
    """Displacements before t = 0, for springs with memory.

    They are linear between the times. Before the first time the first displacements are constant.

    Parameters
    ----------
    times : array_like, shape (n,)
        Strictly ascending (s), the last 0, n >= 2.
    displacements : array_like, shape (n, n_dof)
        Displacements of each coordinate, relative to the base.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> mount = vv.Mount(
    ...     mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    ... )
    >>> past = vv.Past(times=[-5, -1, 0], displacements=[[0, 0], [0.1, 0], [0.1, 0]])
    >>> run = vv.simulate(mount, 2, held=past, initial=[0.1, 0, 0, 0])
    """

    times: npt.ArrayLike
    displacements: npt.ArrayLike

    __repr__ = short_repr

    def __post_init__(self) -> None:
        for name, ndim in (("times", 1), ("displacements", 2)):
            array = _native.real_array(name, getattr(self, name), ndim=ndim).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        times, displacements = np.asarray(self.times), np.asarray(self.displacements)
        if times.size < 2 or (np.diff(times) <= 0).any():
            raise InputError("times: must be two or more and strictly ascending")
        if times[-1] != 0:
            raise InputError(f"times: the last is {times[-1]:g}, must be 0")
        if displacements.shape[0] != times.size:
            raise InputError(
                f"displacements: must have shape ({times.size}, n_dof), got {displacements.shape}"
            )
