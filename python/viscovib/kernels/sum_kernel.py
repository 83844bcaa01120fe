"""Sums of kernels."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from viscovib import _native
from viscovib._native import FloatArray
from viscovib.kernels.relaxation import Kernel


@dataclass(frozen=True, kw_only=True)
class SumKernel(Kernel):
    """A sum of kernels R = R_1 + R_2 + ..., each with its own exact transforms.

    Two Rabotnov kernels are two fractional Zener elements in parallel: a spring with two
    spring-pots.

    Parameters
    ----------
    parts : sequence of Kernel
        One or more. Sums in the sequence are expanded.

    Examples
    --------
    >>> fast = vv.RabotnovKernel(amplitude=0.3, alpha=0.6, beta=1.5)
    >>> slow = vv.PronyKernel(weights=[0.01], rates=[0.05])
    >>> round(vv.SumKernel(parts=[fast, slow]).integral, 12)
    0.4
    """

    parts: Sequence[Kernel]
    _kind: ClassVar[int] = 6

    def __post_init__(self) -> None:
        flat: list[Kernel] = []
        for part in _native.several("parts", self.parts, Kernel):
            flat += part.parts if isinstance(part, SumKernel) else [part]
        object.__setattr__(self, "parts", tuple(flat))
        self._check()

    @cached_property
    def _data(self) -> FloatArray:
        return _joined([(part._kind, part._data) for part in self.parts])

    @cached_property
    def _seconds(self) -> float:
        return sum(part._seconds for part in self.parts)

    @property
    def _relaxing(self) -> float:
        return sum(part._relaxing for part in self.parts)

    def _scaled(self, unit: float) -> FloatArray:
        return _joined([(part._kind, part._scaled(unit)) for part in self.parts])

    def _complete_exponentials(
        self, tolerance: float, first: float, last: float, later: float
    ) -> tuple[FloatArray, FloatArray]:
        """Concatenate the sums of the parts, which are positive and keep the relative tolerance."""
        found = [part._complete_exponentials(tolerance, first, last, later) for part in self.parts]
        return np.concatenate([w for w, _ in found]), np.concatenate([r for _, r in found])


def _joined(parts: list[tuple[int, FloatArray]]) -> FloatArray:
    """Parts in the flat order of the core: kind, length, numbers."""
    pieces = [np.concatenate([[float(kind), float(data.size)], data]) for kind, data in parts]
    return np.concatenate(pieces)
