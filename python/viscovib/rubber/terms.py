"""Prony terms for finite-element programs."""

import os
from dataclasses import dataclass

import numpy as np

from viscovib import _native
from viscovib._native import ComplexArray, FloatArray
from viscovib.common.files import whole_file
from viscovib.common.parameters import Number
from viscovib.common.values import Value
from viscovib.errors import InputError
from viscovib.kernels.relaxation import Kernel, PronyKernel
from viscovib.rubber.data import QUANTITIES
from viscovib.rubber.fit import KernelFit
from viscovib.rubber.prony_spectrum import dynamic_design, grid_of_times, nonnegative

_TOLERANCE = Number("tolerance", 1e-8, 0.5)
_T_MIN, _T_MAX = Number("t_min", 1e-100, 1e100), Number("t_max", 1e-100, 1e100)
_MODULUS = Number("modulus", lowest=1e-200, highest=1e200)
#: Terms per decade, and frequencies per decade for the measured error.
_DENSITIES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0)
_MEASURED = 24
_LS_DYNA_MOST = 18
_PROGRAMS = ("abaqus", "ansys", "ls-dyna")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PronyTerms(Value):
    """A modulus as M_e + sum_j M_j exp(-t/tau_j), with its error.

    Attributes
    ----------
    relaxed : float
        M_e (Pa).
    moduli, times : ndarray, shape (n,)
        M_j (Pa) and tau_j (s), ascending.
    t_min, t_max : float
        Range of times in which the terms represent the kernel (s); frequencies are their inverses.
    error : float
        Largest relative error |M_terms - M|/|M| at frequencies 1/t_max to 1/t_min (rad/s).
    quantity : {"E", "G", "K"}
        Kind of M: Young's modulus, the shear modulus, or a stiffness.

    Examples
    --------
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> terms = vv.prony_terms(rubber, modulus=2e6, t_min=1e-3, t_max=10, tolerance=0.05)
    >>> bool(abs(terms.modulus - terms.relaxed - terms.moduli.sum()) < 1e-6)
    True
    >>> terms.text("ansys").splitlines()[4]
    'TB,PRONY,1,1,...,SHEAR'
    """

    relaxed: float
    moduli: FloatArray
    times: FloatArray
    t_min: float
    t_max: float
    error: float
    quantity: str = "E"

    @property
    def modulus(self) -> float:
        """M_0 of these terms (Pa), after the faster relaxation of the kernel."""
        return self.relaxed + float(self.moduli.sum())

    @property
    def kernel(self) -> PronyKernel:
        """The terms as a kernel, with the instantaneous ``modulus``."""
        return PronyKernel(weights=self.moduli / self.times / self.modulus, rates=1 / self.times)

    def text(self, program: str, *, poisson: float = 0.49, density: float = 1000.0) -> str:
        """Return input for "abaqus", "ansys" or "ls-dyna" (units Pa, s, kg/m^3).

        Terms are shear terms; the bulk modulus is elastic. Young's modulus with ``poisson`` close
        to 0.5 relaxes as the shear modulus does; its instantaneous value is 2 (1 + ``poisson``)
        times as large. A stiffness (N/m) is not a modulus and is refused.
        """
        _native.choice("program", program, _PROGRAMS)
        if self.quantity == "K":
            raise InputError(
                "program: these terms are those of a stiffness (N/m), a material needs those "
                "of E or G"
            )
        nu = Number("poisson", 0, 0.4999).check(poisson)
        rho = Number("density", above=0).check(density)
        if program == "ls-dyna":
            return self._ls_dyna(nu, rho)
        write = self._abaqus if program == "abaqus" else self._ansys
        return write(self._error_line(self.error), nu, rho)

    def write(
        self,
        path: str | os.PathLike[str],
        program: str,
        *,
        poisson: float = 0.49,
        density: float = 1000.0,
    ) -> None:
        """Write `text` to a file."""
        text = self.text(program, poisson=poisson, density=density)
        with whole_file(path) as file:
            file.write(text)

    def _error_line(self, error: float) -> str:
        return (
            f"{self.times.size} Prony terms by viscovib: error of the modulus {error:.2g} "
            f"from {1 / self.t_max / (2 * np.pi):.3g} to {1 / self.t_min / (2 * np.pi):.3g} Hz"
        )

    def _young(self, nu: float) -> float:
        return self.modulus * (2 * (1 + nu) if self.quantity == "G" else 1.0)

    def _abaqus(self, error_line: str, nu: float, rho: float) -> str:
        lines = [
            f"** {error_line}",
            "*MATERIAL, NAME=RUBBER",
            "*DENSITY",
            f"{rho:.9g}",
            "*ELASTIC, MODULI=INSTANTANEOUS",
            f"{self._young(nu):.9e}, {nu:.6g}",
            "*VISCOELASTIC, TIME=PRONY",
        ]
        shares = self.moduli / self.modulus
        rows = zip(shares, self.times, strict=True)
        return "\n".join([*lines, *(f"{g:.9e}, 0.0, {tau:.9e}" for g, tau in rows)]) + "\n"

    def _ansys(self, error_line: str, nu: float, rho: float) -> str:
        lines = [
            f"! {error_line}",
            f"MP,EX,1,{self._young(nu):.9e}",
            f"MP,PRXY,1,{nu:.6g}",
            f"MP,DENS,1,{rho:.9g}",
            f"TB,PRONY,1,1,{self.times.size},SHEAR",
        ]
        pairs = np.column_stack([self.moduli / self.modulus, self.times]).ravel()
        for first in range(0, pairs.size, 6):
            values = ",".join(f"{value:.9e}" for value in pairs[first : first + 6])
            lines.append(f"TBDATA,{first + 1},{values}")
        return "\n".join(lines) + "\n"

    def _ls_dyna(self, nu: float, rho: float) -> str:
        """Fields of ten characters, whose rounding is part of the stated error."""
        if self.times.size > _LS_DYNA_MOST - 1:
            raise InputError(
                f"terms: {self.times.size}, must be at most {_LS_DYNA_MOST - 1} for "
                "*MAT_GENERAL_VISCOELASTIC: raise tolerance, or narrow t_min to t_max"
            )
        shear = self._young(nu) / (2 * (1 + nu))
        bulk = self._young(nu) / (3 * (1 - 2 * nu))
        g = np.concatenate([[self.relaxed], self.moduli]) * shear / self.modulus
        decay = np.concatenate([[0.0], 1 / self.times])
        rows = [(_field(a), _field(b)) for a, b in zip(g.tolist(), decay.tolist(), strict=True)]
        kept = np.array([[float(a), float(b)] for a, b in rows])
        s = 1j * np.geomspace(1 / self.t_max, 1 / self.t_min, 20 * self.times.size)[:, np.newaxis]
        meant = (g * s / (s + decay)).sum(axis=1)
        rounded = np.abs((kept[:, 0] * s / (s + kept[:, 1])).sum(axis=1) / meant - 1).max()
        lines = [
            f"$ {self._error_line(self.error + float(rounded))}",
            "*MAT_GENERAL_VISCOELASTIC",
            f"{1:>10d}{_field(rho)}{_field(bulk)}{0:>10d}{0:>10d}{0:>10d}{0:>10d}{0:>10d}",
            f"{0:>10d}" * 6,
        ]
        lines += [a + b for a, b in rows]
        return "\n".join([*lines, "*END", ""])


def _field(value: float) -> str:
    """Return a number in ten characters: a blank and as many digits as fit."""
    for digits in range(9, 0, -1):
        text = f"{value:.{digits}g}".replace("e+0", "e+").replace("e-0", "e-")
        if len(text) < 10:
            break
    return f"{text:>10}"


def prony_terms(
    source: KernelFit | Kernel,
    *,
    t_min: float,
    t_max: float,
    tolerance: float = 0.01,
    modulus: float | None = None,
    quantity: str | None = None,
) -> PronyTerms:
    """Return the smallest number of Prony terms for a modulus over a range, for other programs.

    Parameters
    ----------
    source : KernelFit or Kernel
    t_min, t_max : float
        Times (s): the inverses of the highest and lowest circular frequencies of interest.
    tolerance : float
        Largest relative error of the complex modulus in this range.
    modulus : float, optional
        M_0 (Pa) for a kernel; a fit contains it.
    quantity : {"E", "G", "K"}, optional
        Kind of the modulus for a kernel, default "E"; a fit contains it.

    Returns
    -------
    PronyTerms
        With positive moduli; ``error`` is the actual error.

    Raises
    ------
    InputError
        If no density of terms up to 8 per decade meets the tolerance.

    Examples
    --------
    >>> rubber = vv.RabotnovKernel(amplitude=2, alpha=0.5, beta=3)
    >>> terms = vv.prony_terms(rubber, modulus=2e6, t_min=1e-4, t_max=1e2, tolerance=0.01)
    >>> terms.error < 0.01, 6 <= terms.times.size <= 16
    (True, True)
    >>> print(terms.text("abaqus").splitlines()[4])
    *ELASTIC, MODULI=INSTANTANEOUS
    """
    _native.check_instance("source", source, KernelFit, Kernel)
    first, last = _T_MIN.check(t_min), _T_MAX.check(t_max)
    if not first < last:
        raise InputError(f"t_min = {first:g}, t_max = {last:g}: must be t_min < t_max")
    wanted = _TOLERANCE.check(tolerance)
    if isinstance(source, KernelFit):
        if modulus is not None:
            raise InputError("modulus: a fit has its own, must not be given")
        if quantity is not None:
            raise InputError("quantity: a fit has its own, must not be given")
        kernel, whole, measured = source.kernel, source.modulus, source.quantity
    else:
        if modulus is None:
            raise InputError("modulus: must be given with a kernel")
        kernel, whole = source, _MODULUS.check(modulus)
        measured = "E" if quantity is None else _native.choice("quantity", quantity, QUANTITIES)
    n = int(np.ceil(_MEASURED * np.log10(last / first))) + 2
    nu = np.geomspace(1 / last, 1 / first, n)
    true = whole * (1 - kernel.transform(nu))
    if not true.real.min() > 0:
        raise InputError(
            f"t_max = {last:g}: the storage modulus is {true.real.min():.3g} within the range, "
            "must be positive: the integral of the kernel passes 1 there"
        )
    best = np.inf
    for density in _DENSITIES:
        for beyond in (0.3, 0.8, 1.5):
            tau = grid_of_times(first, last, density, beyond)
            found, error = _terms(nu, true, tau)
            best = min(best, error)
            if error <= wanted:
                on = found[1:] > 0
                return PronyTerms(
                    relaxed=float(found[0]),
                    moduli=found[1:][on],
                    times=tau[on],
                    t_min=first,
                    t_max=last,
                    error=error,
                    quantity=measured,
                )
    raise InputError(
        f"tolerance = {wanted:g}: the smallest error is {best:.2g}, must be at least that"
    )


def _terms(nu: FloatArray, true: ComplexArray, tau: FloatArray) -> tuple[FloatArray, float]:
    storage, loss = dynamic_design(nu, tau)
    size = np.abs(true)
    rows = np.vstack([storage, loss]) / np.concatenate([size, size])[:, np.newaxis]
    target = np.concatenate([true.real, true.imag]) / np.concatenate([size, size])
    found = nonnegative(rows, target)
    if found[0] <= 0:
        found[0] = 1e-9 * float(size.min())
    residuals = rows @ found - target
    return found, float(np.hypot(residuals[: nu.size], residuals[nu.size :]).max())
