"""Which of the numbers that runs with memory keep are of the state, as the core writes them.

Others are of time (phases of loads, clocks) or of the method: largest values so far, marks. What
grows with a disturbance is the state alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

#: What all such runs begin with: whether steps roll, the time, corners, doublings.
_COMMON = 4
#: Modes go by blocks of so many, as `mode_block` of the core.
_BLOCK = 8


def of_mount(size: int, n_dof: int, n_phases: int) -> npt.NDArray[np.bool_]:
    """Of runs whose state are all coordinates.

    They keep coordinates, velocities, the rests of both, twice what judges steps, forces, the
    past, and phases in two parts.
    """
    belongs = np.ones(size, dtype=bool)
    belongs[:_COMMON] = False
    judged = _COMMON + 4 * n_dof
    belongs[judged : judged + 2 * n_dof] = False
    belongs[size - 2 * n_phases :] = False
    return belongs


def of_structure(
    size: int, n_seen: int, modal: Mapping[str, Any]
) -> tuple[npt.NDArray[np.bool_], slice]:
    """Of runs whose state are modes, and where deflections of elements are and their rates.

    They keep the largest sum of modes, modes, velocities and the rests of both; the same of what
    has no real modes, in real and imaginary parts; deflections, their rates and twice what judges
    them; forces and the past; phases in two parts; and three numbers each of what follows at once.
    """
    n = -(-modal["squares"].size // _BLOCK) * _BLOCK
    at_once = int(modal["n_at_once"])
    poles = modal["poles"]
    n_poles = poles.size - at_once if at_once or poles.size > 1 or poles[0] != 0 else 0
    # Those of loads that push nothing are left out.
    waves = (modal[name] for name in ("waves", "sine", "cosine"))
    n_phases = int(np.logical_or.reduce([(wave != 0).any(axis=0) for wave in waves]).sum())
    belongs = np.ones(size, dtype=bool)
    belongs[: _COMMON + 1] = False
    seen = _COMMON + 1 + 4 * (n + n_poles)
    judged = seen + 2 * n_seen
    belongs[judged : judged + 2 * n_seen] = False
    end = size - 3 * at_once
    belongs[end - 2 * n_phases : end] = False
    return belongs, slice(seen, judged)
