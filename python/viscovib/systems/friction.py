"""Elements of a structure that have states of their own: elastic dry friction."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.errors import InputError
from viscovib.systems.laws import Law

#: Instructions of the core that hold numbers, and what it calls a Jenkins element.
_ARGUMENT, _NUMBER, _JENKINS = 2, 1, 1
#: Cycles from rest until a loop repeats.
_CYCLES = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Jenkins:
    """Elastic dry friction on the deflection d = e . u: a spring in series with a slider.

    f' = k d' where abs(f) < F_s, else f = F_s or -F_s. Periodic motions (`forced_response`,
    `trace_response`) take it, with exact derivatives through the cycle, which is run from a slider
    that has not moved until it repeats. Where a motion hardly slides the steady state may depend on
    the past; this is the one after that start. Stability is told as unknown, motions in time are
    refused.

    Parameters
    ----------
    on : str, int, tuple of two str, mapping or array_like
        The direction e, as of `Spring`.
    stiffness : float
        k, greater than 0 (N/m).
    limit : float
        F_s, the force at which it slides, greater than 0 (N).

    Examples
    --------
    The energy of a cycle is 4 F_s (a - F_s/k) for an amplitude a beyond F_s/k:

    >>> import numpy as np
    >>> import viscovib as vv
    >>> slider = vv.Jenkins(on="x1", stiffness=20, limit=1)
    >>> d = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 401)[:-1])
    >>> round(float(slider.energy(d)), 12)
    1.0
    """

    on: Any
    stiffness: float
    limit: float

    def __post_init__(self) -> None:
        for name in ("stiffness", "limit"):
            value = _native.number(name, getattr(self, name))
            if value <= 0:
                raise InputError(f"{name} = {value:g}: must be greater than 0")
            object.__setattr__(self, name, value)

    @property
    def _law(self) -> Law:
        """The element as the core takes it: a deflection, stiffness and limit."""
        code, number = (_ARGUMENT, _NUMBER, _NUMBER), (1.0, self.stiffness, self.limit)
        return Law("Jenkins", ("d",), code, number, -1, state=_JENKINS)

    def loop(self, d: npt.ArrayLike) -> FloatArray:
        """Return the force over a cycle of deflections, straight between samples.

        Parameters
        ----------
        d : array_like, shape (..., n)
            Samples of one period, the next of which begins with the first again.

        Returns
        -------
        ndarray
            f, shape (..., n), in the cycle that repeats.
        """
        return self._run(d)[0]

    def energy(self, d: npt.ArrayLike) -> FloatArray:
        """Return the energy lost in a cycle of deflections (J), shape (...); as of `loop`."""
        return self._run(d)[1]

    def _run(self, d: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        samples = _native.real_array("d", d)
        if samples.ndim == 0 or samples.shape[-1] < 2:
            raise InputError(f"d: must have shape (..., n), n > 1, got {samples.shape}")
        k, limit = self.stiffness, self.limit
        last = samples[..., -1]
        f = np.clip(k * last, -limit, limit)
        force, lost = np.empty_like(samples), np.zeros(samples.shape[:-1])
        for _ in range(_CYCLES):
            lost = np.zeros(samples.shape[:-1])
            for i in range(samples.shape[-1]):
                wanted = f + k * (samples[..., i] - last)
                f, last = np.clip(wanted, -limit, limit), samples[..., i]
                lost = lost + limit * np.abs(wanted - f) / k
                force[..., i] = f
        return force, np.asarray(lost)
