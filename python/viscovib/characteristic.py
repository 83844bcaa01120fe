"""Free motion with memory: roots of the characteristic equation det D(s) = 0."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from viscovib._native import ComplexArray, FloatArray
from viscovib.kernels import Kernel, RzhanitsynKernel

if TYPE_CHECKING:
    from viscovib.mount import Mount

_HOMOTOPY = 24
_NEWTON = 60


@dataclass(frozen=True, eq=False)
class CharacteristicRoots:
    """Free linear motion is a sum of exp(s t).

    Attributes
    ----------
    oscillatory : complex ndarray, shape (n,)
        Roots s with positive imaginary part (1/s), by rising frequency; their conjugates are
        roots too.
    real : ndarray, shape (m,)
        Real roots, largest first: of Koltunov-Rzhanitsyn kernels those right of the cut at
        -beta, of other kernels the positive ones.
    n_unstable : int
        Roots with positive real part, conjugates counted, by the argument principle.
    complete : bool
        Whether the roots listed account for all unstable ones.
    """

    oscillatory: ComplexArray
    real: FloatArray
    n_unstable: int
    complete: bool

    @property
    def growth_rate(self) -> float:
        """Largest real part of the roots listed (1/s): free motion grows if it is positive."""
        return float(max([*self.oscillatory.real, *self.real], default=-np.inf))

    @property
    def logarithmic_decrement(self) -> FloatArray:
        """-2 pi Re s/Im s of the oscillatory roots."""
        result: FloatArray = -2 * np.pi * self.oscillatory.real / self.oscillatory.imag
        return result


def characteristic_roots(mount: "Mount") -> CharacteristicRoots:
    """Roots of det[s^2 M + s C + sum_j K_j (1 - R_j(s))] = 0, R_j(s) the kernels' transforms."""
    system = _System(mount)
    oscillatory = system.oscillatory()
    real = system.real()
    n_unstable = system.count_unstable()
    found = 2 * int((oscillatory.real > 0).sum()) + int((real > 0).sum())
    return CharacteristicRoots(oscillatory, real, n_unstable, found == n_unstable)


class _System:
    """The characteristic matrix D(s)."""

    def __init__(self, mount: "Mount") -> None:
        c_x, c_phi, arm = mount.stiffness_x, mount.stiffness_phi, mount.offset
        self.mount = mount
        self.mass = np.diag([mount.mass, mount.inertia])
        self.damping = np.asarray(mount.damping, dtype=float)
        self.springs = (
            np.array([[c_x, -c_x * arm], [-c_x * arm, c_x * arm**2]]),
            np.array([[0.0, 0.0], [0.0, c_phi]]),
        )
        in_phi = mount.kernel if mount.kernel_phi is None else mount.kernel_phi
        self.kernels = (mount.kernel, in_phi if isinstance(in_phi, Kernel) else None)

    def matrix(self, s: Any, memory: float = 1.0) -> npt.NDArray[Any]:
        """D(s), shape s.shape + (2, 2)."""
        at = np.asarray(s)[..., np.newaxis, np.newaxis]
        total: npt.NDArray[Any] = at**2 * self.mass + at * self.damping
        for spring, kernel in zip(self.springs, self.kernels, strict=True):
            kept: Any = 1.0
            if kernel is not None:
                scale = memory * self.mount.memory_scale
                kept = 1.0 - scale * np.asarray(kernel.laplace(s))[..., np.newaxis, np.newaxis]
            total = total + kept * spring
        return total

    def _determinant(self, s: complex, memory: float) -> complex:
        m = self.matrix(s, memory)
        return complex(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0])

    def oscillatory(self) -> ComplexArray:
        """From the roots without memory, memory brought in step by step."""
        zero, one = np.zeros((2, 2)), np.eye(2)
        stiffness = self.springs[0] + self.springs[1]
        inverse = np.linalg.inv(self.mass)
        companion = np.block([[zero, one], [-inverse @ stiffness, -inverse @ self.damping]])
        starts = np.linalg.eigvals(companion)
        roots: list[complex] = []
        for start in starts[starts.imag > 1e-12 * np.abs(starts)]:
            s = complex(start)
            for memory in np.linspace(0, 1, _HOMOTOPY + 1):
                s = self._polish(s, float(memory))
            if s.imag > 1e-9 * abs(s) and not any(abs(s - r) < 1e-9 * abs(s) for r in roots):
                roots.append(s)
        return np.array(sorted(roots, key=lambda s: s.imag), dtype=complex)

    def _polish(self, s: complex, memory: float) -> complex:
        """Newton's method, the derivative by a difference of the analytic function."""
        for _ in range(_NEWTON):
            h = 1e-6 * abs(s)
            slope = (self._determinant(s + h, memory) - self._determinant(s - h, memory)) / (2 * h)
            step = self._determinant(s, memory) / slope
            s -= step
            if abs(step) <= 4e-16 * abs(s):
                break
        return s

    def real(self) -> FloatArray:
        """Zeros of the eigenvalues of D along the real axis, which is symmetric there."""
        if not any(self.kernels) or self.mount.memory_scale == 0:
            return np.empty(0)
        cuts = [
            kernel.beta if isinstance(kernel, RzhanitsynKernel) else 0.0
            for kernel in self.kernels
            if kernel is not None
        ]
        cut = min(cuts)
        largest = float(self.mount.natural_frequencies().max())
        right = np.geomspace(1e-12, 1e3, 1200) * largest
        left = -cut * (1 - np.geomspace(1e-10, 1, 600, endpoint=False)) if cut > 0 else right[:0]
        grid = np.unique(np.concatenate([left, right]))
        scale = 1 / np.sqrt(np.diag(self.mass))

        def eigenvalue(s: float, j: int) -> float:
            m = np.real(self.matrix(s)) * np.outer(scale, scale)
            return float(np.linalg.eigvalsh((m + m.T) / 2)[j])

        table = np.real(self.matrix(grid)) * np.outer(scale, scale)
        values = np.linalg.eigvalsh((table + table.transpose(0, 2, 1)) / 2)
        roots = []
        for j in range(2):
            for i in np.flatnonzero(values[1:, j] * values[:-1, j] < 0):
                roots.append(
                    float(brentq(eigenvalue, grid[i], grid[i + 1], (j,), xtol=1e-300, rtol=1e-14))
                )
        return np.array(sorted(roots, reverse=True))

    def count_unstable(self) -> int:
        """Roots right of the imaginary axis by the turns of det D(i omega): Nyquist."""
        low, high = self.mount.natural_frequencies()
        # A quarter of a small circle first: a kernel may be singular at 0.
        circle = 1e-14 * low * np.exp(0.5j * np.pi * np.linspace(0, 1, 64))
        d = self.matrix(
            np.concatenate([circle, 1j * np.geomspace(1e-14 * low, 1e8 * high, 60_000)])
        )
        turned = np.unwrap(np.angle(d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0]))
        # At infinity det D is s^4 det M, which turns by 2 pi from the real axis to the imaginary.
        return round(float(2 - (turned[-1] - turned[0]) / np.pi))
