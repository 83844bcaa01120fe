"""Mask of the state in the memory of runs, in the layout of the core.

The other numbers belong to time (phases of loads, clocks) or to the method (largest values, flags).
Only the state grows with a perturbation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

#: First entries of all memories: flag of rolling steps, time, kinks, doublings.
_COMMON = 4
#: Number of modes in a block, as `mode_block` of the core.
_BLOCK = 8


def of_mount(size: int, n_dof: int, n_phases: int) -> npt.NDArray[np.bool_]:
    """Mask for runs whose state contains all coordinates.

    The memory contains coordinates, velocities, their rounding errors, two arrays for the check of
    steps, forces, the past, and phases in two parts.
    """
    belongs = np.ones(size, dtype=bool)
    belongs[:_COMMON] = False
    assessed = _COMMON + 4 * n_dof
    belongs[assessed : assessed + 2 * n_dof] = False
    belongs[size - 2 * n_phases :] = False
    return belongs


def of_structure(
    size: int, n_seen: int, modal: Mapping[str, Any]
) -> tuple[npt.NDArray[np.bool_], slice]:
    """Mask for runs whose state contains modes, and slice of the deflections with their rates.

    The memory contains the largest sum of modes; modes, velocities and their rounding errors; the
    same for complex modes, in real and imaginary parts; deflections, their rates and two arrays for
    their check; forces and the past; phases in two parts; three numbers for each massless mode.
    """
    n = -(-modal["squares"].size // _BLOCK) * _BLOCK
    at_once = int(modal["n_at_once"])
    poles = modal["poles"]
    n_poles = poles.size - at_once if at_once or poles.size > 1 or poles[0] != 0 else 0
    # Loads without forces have no phases.
    waves = (modal[name] for name in ("waves", "sine", "cosine"))
    n_phases = int(np.logical_or.reduce([(wave != 0).any(axis=0) for wave in waves]).sum())
    belongs = np.ones(size, dtype=bool)
    belongs[: _COMMON + 1] = False
    seen = _COMMON + 1 + 4 * (n + n_poles)
    assessed = seen + 2 * n_seen
    belongs[assessed : assessed + 2 * n_seen] = False
    end = size - 3 * at_once
    belongs[end - 2 * n_phases : end] = False
    return belongs, slice(seen, assessed)
