"""Mean squares of responses to random floor motions, including narrow resonances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError

#: Largest relative width of an interval for the check by three values.
_WIDE = 0.02
#: Largest error of an interval relative to the integral, and largest number of halvings.
_OPEN, _HALVINGS = 1e-10, 50
#: Nodes and weights of Gauss and Kronrod, 7 and 15 points on (0, 1) and its mirror image
#: (Piessens et al., QUADPACK, 1983): every other node is one of Gauss.
_NODES = np.array([
    0.991455371120812639206854697526329, 0.949107912342758524526189684047851,
    0.864864423359769072789712788640926, 0.741531185599394439863864773280788,
    0.586087235467691130294144691693160, 0.405845151377397166906606412076961,
    0.207784955007898467600689403773245, 0.0,
])  # fmt: skip
_KRONROD = np.array([
    0.022935322010529224963732008058970, 0.063092092629978553290700663189204,
    0.104790010322250183839876322541518, 0.140653259715525918745189590510238,
    0.169004726639267902826583426598550, 0.190350578064785409913256402421014,
    0.204432940075298892414161999234649, 0.209482141084727828012999174891714,
])  # fmt: skip
_GAUSS = np.array([
    0.129484966168869693270611432679082, 0.279705391489276667901467771423780,
    0.381830050505118944950369775488975, 0.417959183673469387755102040816327,
])  # fmt: skip
_X = np.concatenate([-_NODES, _NODES[-2::-1]])
_K = np.concatenate([_KRONROD, _KRONROD[-2::-1]])
_G = np.zeros(15)
_G[1::2] = np.concatenate([_GAUSS, _GAUSS[-2::-1]])


def mean_square(
    gain: Callable[[FloatArray], FloatArray], hz: FloatArray, density: FloatArray
) -> FloatArray:
    """Return the integral of gain times density, which is straight between the frequencies.

    The gain is also evaluated between the frequencies, because a resonance may be far narrower than
    their spacing. Intervals on which the trapezoidal rule and Simpson's rule agree are accepted.
    All others are halved until the rules of Gauss and Kronrod agree.
    """

    def answer(at: FloatArray) -> FloatArray:
        found = gain(at.ravel()) * np.interp(at.ravel(), hz, density)[:, np.newaxis]
        return found.reshape(*at.shape, -1)

    low, high = hz[:-1], hz[1:]
    width = (high - low)[:, np.newaxis]
    ends, middle = answer(hz), answer((low + high) / 2)
    coarse = (ends[:-1] + ends[1:]) / 2 * width
    fine = (ends[:-1] + 4 * middle + ends[1:]) / 6 * width
    scale = _OPEN * fine.sum(axis=0)
    done = (np.abs(fine - coarse) <= scale).all(axis=1) & (high - low <= _WIDE * high)
    total = fine[done].sum(axis=0)
    low, high = low[~done], high[~done]
    for _ in range(_HALVINGS):
        half, centre = (high - low) / 2, (high + low) / 2
        values = answer(centre[:, np.newaxis] + half[:, np.newaxis] * _X)
        kronrod, gauss = (np.einsum("i,j,ijk->ik", half, weights, values) for weights in (_K, _G))
        scale = _OPEN * (total + kronrod.sum(axis=0))
        done = (np.abs(kronrod - gauss) <= scale).all(axis=1)
        total = total + kronrod[done].sum(axis=0)
        if done.all() or not np.isfinite(kronrod).all():
            break
        low, high, centre = low[~done], high[~done], centre[~done]
        low, high = np.concatenate([low, centre]), np.concatenate([centre, high])
    else:
        raise InputError(
            f"hz: the body has a resonance without damping at {low[0]:.6g} Hz, where the mean "
            "square has no bound: must have damping there, or not reach it"
        )
    return total if np.isfinite(kronrod).all() else np.full_like(total, np.inf)
