"""Coordinates with a huge number on the diagonal of K or M, which become exact supports."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.errors import InputError, StabilityWarning, caller
from viscovib.systems.elements import ElementTerms
from viscovib.systems.structure_matrices import is_sparse

#: A row is a support if its diagonal entry is larger than this multiple of all other rows. Its
#: motion is below the rounding error, and eigensolvers lose the small eigenvalues.
_HUGE = 1e20
#: Stiffness of a support, in units of the largest stiffness of the other coordinates.
_SUPPORT = 1e30
#: Largest number of names in a message.
_SHOWN = 10


def penalty_supports(
    names: Sequence[str],
    mass: Any,
    matrices: Sequence[Any],
    elements: Sequence[ElementTerms],
) -> FloatArray:
    """Return the indices of coordinates with a huge mass or stiffness; ``matrices``: parts of K."""
    found: set[int] = set()
    diagonal, off = np.zeros((2, len(names)))
    for matrix in matrices:
        own = np.abs(matrix.diagonal())
        diagonal += own
        off += np.asarray(abs(matrix).sum(axis=1)).ravel() - own
    for element in elements:
        e, k = np.abs(element.direction), abs(element.powers.get(1, 0.0))
        diagonal += k * e**2
        off += k * e * (e.sum() - e)
    own = np.abs(mass.diagonal())
    of_mass = own, np.asarray(abs(mass).sum(axis=1)).ravel() - own
    for what, (large, nearby) in (("stiffness", (diagonal, off)), ("mass", of_mass)):
        places = _beyond_a_gap(large)
        coupled = [i for i in places if nearby[i] > large[i] / _HUGE]
        if coupled:
            raise InputError(
                f"{what}: {_shown(names, coupled)} are coupled by entries more than {_HUGE:g} "
                "times those of all other coordinates, and rounding loses the other entries; "
                "replace the rigid connection by one coordinate"
            )
        found.update(places)
    return np.array(sorted(found), dtype=int)


def _beyond_a_gap(large: FloatArray) -> list[int]:
    """Indices of the entries that are huge compared with all other entries."""
    order = np.argsort(large)
    sizes = large[order]
    gaps = np.flatnonzero((sizes[1:] > _HUGE * sizes[:-1]) & (sizes[:-1] > 0))
    return [int(i) for i in order[gaps[0] + 1 :]] if gaps.size else []


def fixed(matrix: Any, places: FloatArray) -> Any:
    """A matrix with zero rows and columns at these indices."""
    if is_sparse(matrix):
        from scipy.sparse import csc_array, diags_array

        keep = np.ones(matrix.shape[0])
        keep[places] = 0.0
        result = csc_array(diags_array(keep) @ matrix @ diags_array(keep))
        result.eliminate_zeros()
        return result
    result = matrix.copy()
    result[places] = 0.0
    result[:, places] = 0.0
    result.setflags(write=matrix.flags.writeable)
    return result


def held_stiffness(matrix: Any, parts: Sequence[Any], places: FloatArray) -> Any:
    """K with these coordinates fixed: each is uncoupled and has a very large stiffness."""
    result = fixed(matrix, places)
    largest = max([abs(part).max() for part in (result, *parts)], default=0.0) or 1.0
    if is_sparse(result):
        from scipy.sparse import csc_array, diags_array

        added = np.zeros(result.shape[0])
        added[places] = _SUPPORT * largest
        return csc_array(result + diags_array(added))
    result = result.copy()
    result[places, places] = _SUPPORT * largest
    result.setflags(write=False)
    return result


def fixed_elements(
    elements: Sequence[ElementTerms], places: FloatArray
) -> tuple[ElementTerms, ...]:
    """Elements without fixed coordinates; linear elements on fixed coordinates only are dropped."""
    found = []
    for element in elements:
        e = element.direction.copy()
        e[places] = 0.0
        if e.any():
            found.append(element._replace(direction=e))
        elif element.law is not None or set(element.powers) - {1}:
            bent = {power: k for power, k in element.powers.items() if power != 1}
            found.append(element._replace(powers=bent, damping=0.0))
    return tuple(found)


def supports_text(names: Sequence[str]) -> str:
    """Line of a plan about the supports."""
    return (
        f"skips: {_shown(names, range(len(names)))} (fixed by a huge mass or stiffness: supports)"
    )


def warn_of_supports(names: Sequence[str]) -> None:
    """Warn of coordinates that are replaced by supports."""
    warnings.warn(
        f"{_shown(names, range(len(names)))}: the mass or stiffness is more than {_HUGE:g} times "
        "that of all other coordinates; the structure has supports there, loads on them have no "
        "effect (remove these rows and columns; for an enforced motion use base=)",
        StabilityWarning,
        stacklevel=caller(),
    )


def _shown(names: Sequence[str], places: Any) -> str:
    some = [names[i] for i in list(places)[:_SHOWN]]
    unlisted = len(list(places)) - len(some)
    return ", ".join(some) + (f" and {unlisted} more" if unlisted else "")
