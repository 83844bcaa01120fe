"""Kernels of scenes from files of fits (``kind = 'fitted'``)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from viscovib._native import FloatArray
from viscovib.kernels.relaxation import (
    AbelKernel,
    Kernel,
    PronyKernel,
    RabotnovKernel,
    RzhanitsynKernel,
)
from viscovib.kernels.sum_kernel import SumKernel
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.kernels.time_temperature import WLF, Arrhenius, ShiftLaw, ThermalKernel
from viscovib.rubber.shift_fit import ShiftTable


def fitted_kernel(group: Mapping[str, Any]) -> Kernel:
    """Return the kernel of a group of the canonical scene, with its shift law if it has one."""
    numbers = np.atleast_1d(np.asarray(group["numbers"], dtype=float))
    kernel = _of_numbers(round(numbers[0]), numbers[1:])
    if group["shift_law"] == "none":
        return kernel
    shift = np.atleast_1d(np.asarray(group["shift_numbers"], dtype=float))
    law: ShiftLaw
    if group["shift_law"] == "wlf":
        law = WLF(reference=shift[0], c1=shift[1], c2=shift[2])
    elif group["shift_law"] == "arrhenius":
        law = Arrhenius(reference=shift[0], activation_energy=shift[1])
    else:
        law = ShiftTable(**dict(zip(("temperatures", "decades"), np.split(shift, 2), strict=True)))
    return ThermalKernel(kernel=kernel, shift=law, temperature=group["temperature"])


def _of_numbers(kind: int, p: FloatArray) -> Kernel:
    """A kernel from the flat order of the core, which has checked the numbers."""
    if kind in (RzhanitsynKernel._kind, RabotnovKernel._kind):
        made = RzhanitsynKernel if kind == RzhanitsynKernel._kind else RabotnovKernel
        return made(amplitude=p[0], alpha=p[1], beta=p[2])
    if kind == AbelKernel._kind:
        return AbelKernel(amplitude=p[0], alpha=p[1])
    if kind == PronyKernel._kind:
        weights, rates = np.split(p, 2)
        return PronyKernel(weights=weights, rates=rates)
    if kind == TabulatedKernel._kind:
        times, values = np.split(p[1:], 2)
        word = TabulatedKernel._codes[round(p[0])]
        return TabulatedKernel(times=times, values=values, interpolation=word)
    parts, first = [], 0
    while first < p.size:
        length = round(p[first + 1])
        parts.append(_of_numbers(round(p[first]), p[first + 2 : first + 2 + length]))
        first += 2 + length
    return SumKernel(parts=parts)
