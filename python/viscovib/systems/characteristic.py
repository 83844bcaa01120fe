"""Free motion with memory: roots of the characteristic equation det D(s) = 0."""

from __future__ import annotations

import cmath
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from viscovib._native import ComplexArray, FloatArray
from viscovib.common.values import Value
from viscovib.errors import ConvergenceWarning, InputError, caller
from viscovib.kernels.relaxation import Kernel, RzhanitsynKernel
from viscovib.kernels.sum_kernel import SumKernel
from viscovib.kernels.tabulated import TabulatedKernel
from viscovib.kernels.time_temperature import ThermalKernel
from viscovib.systems.layers import exponentials_of

# Memory is brought in by steps of 1/24 or less: a step that moves a root by more than 8 % may have
# landed on another root, and is taken in four.
_STEP, _LEAST_STEP, _FAR = 1 / 24, 1e-7, 0.08
# Paths from 0 to 1 along which memory is brought in, t + bend t (1 - t): where two roots meet on
# the real one, the others lead round that place.
_BENDS = (0.0, 0.4j, -0.4j)
# Steps of Newton's method; the last one of a root, as a part of it: a double one is known to the
# root of rounding. Indistinguishably close to the axis.
_NEWTON, _LAST, _ON_AXIS = 60, 1e-6, 2e-15
#: Damping ratio up to which roots are counted left of the imaginary axis, and points there.
_MOST_DAMPED, _POINTS = 0.999, 20_000
#: States up to which all roots of sums of exponentials are eigenvalues of one matrix.
_MOST_STATES = 400
#: Search for missing roots: points per decade, angles, decades beyond the natural frequencies.
_A_DECADE, _ANGLES, _BEYOND = 4, 7, 2


@dataclass(frozen=True, eq=False, repr=False)
class CharacteristicRoots(Value):
    """Roots s of free linear motion, a sum of exp(s t).

    Attributes
    ----------
    oscillatory : complex ndarray, shape (n,)
        Roots s with positive imaginary part (1/s), by increasing frequency, a double root twice.
        Their conjugates are roots too.
    real : ndarray, shape (m,)
        Real roots, largest first: without memory all; for Koltunov-Rzhanitsyn kernels those to the
        right of the branch cut at -beta, for other kernels the positive ones.
    n_unstable : int
        Number of roots with positive real part, including conjugates, by the argument principle.
    complete : bool
        True if all roots in ``region`` are listed, by the argument principle on its boundary.
    region : str
        The part of the complex plane to which ``complete`` refers.

    Examples
    --------
    >>> import viscovib as vv
    >>> rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    >>> mount = vv.Mount(
    ...     mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, kernel=rubber
    ... )
    >>> roots = mount.characteristic_roots()
    >>> roots.complete
    True
    """

    oscillatory: ComplexArray
    real: FloatArray
    n_unstable: int
    complete: bool
    region: str = ""

    @property
    def growth_rate(self) -> float:
        """Largest real part of the roots (1/s); free motion grows if it is positive."""
        return float(max([*self.oscillatory.real, *self.real], default=-np.inf))

    @property
    def logarithmic_decrement(self) -> FloatArray:
        """-2 pi Re s/Im s of the oscillatory roots."""
        result: FloatArray = -2 * np.pi * self.oscillatory.real / self.oscillatory.imag
        return result


#: Linear springs, each with its stiffness and its kernel.
SpringsLike = Sequence[tuple[FloatArray, Kernel | None]]


def characteristic_roots(
    mass: FloatArray,
    damping: FloatArray,
    springs: SpringsLike,
    memory_scale: float = 1.0,
    dampers: Sequence[FloatArray | None] = (),
) -> CharacteristicRoots:
    """Roots of det[s^2 M + s C + sum_j (K_j + s C_j) (1 - R_j(s))] = 0.

    R_j(s) are the kernels' transforms, C_j the ``dampers`` of the springs, None: none.
    """
    system = _System(mass, damping, springs, memory_scale, dampers)
    # Where a transform grows beyond the range of numbers nothing is found.
    with np.errstate(over="ignore", invalid="ignore"):
        oscillatory = system.oscillatory()
        real = system.real()
        n_unstable, missing = system.count(oscillatory)
        if missing > 0:
            oscillatory = system.searched(oscillatory, missing)
            n_unstable, missing = system.count(oscillatory)
    found = 2 * int((oscillatory.real > 0).sum()) + int((real > 0).sum())
    if missing:
        warnings.warn(
            f"the argument principle gives {missing:+d} oscillatory roots with a damping ratio "
            f"below {_MOST_DAMPED} to those listed",
            ConvergenceWarning,
            stacklevel=caller(),
        )
    complete = found == n_unstable and missing == 0
    return CharacteristicRoots(oscillatory, real, n_unstable, complete, system.region)


class _System:
    """The characteristic matrix D(s)."""

    def __init__(
        self,
        mass: FloatArray,
        damping: FloatArray,
        springs: SpringsLike,
        memory_scale: float,
        dampers: Sequence[FloatArray | None],
    ) -> None:
        self.mass, self.damping = mass, damping
        self.dampers: Sequence[FloatArray | None] = dampers or [None] * len(springs)
        # Without memory these damp as others do.
        self.all_damping = damping + sum(c for c in self.dampers if c is not None)
        self.springs, self.memory_scale = springs, memory_scale
        self.stiffness = np.sum([spring for spring, _ in springs], axis=0)
        self.scale = 1 / np.sqrt(np.diag(self.mass))
        # Frequencies to scale by, positive also where rest is unstable.
        squares = np.linalg.eigvals(np.linalg.solve(self.mass, self.stiffness))
        present = np.sqrt(np.abs(squares))
        present = present[present > 1e-7 * present.max()]
        self.slowest = float(present.min()) if present.size else 1.0
        rates = np.abs(np.linalg.eigvals(np.linalg.solve(self.mass, self.all_damping)))
        self.fastest = float(max(present.max(initial=0.0), rates.max())) or 1.0

    @property
    def n(self) -> int:
        return int(self.mass.shape[0])

    def matrix(self, s: Any, memory: complex = 1.0) -> npt.NDArray[Any]:
        """D(s), shape s.shape + (n, n)."""
        at = np.asarray(s)[..., np.newaxis, np.newaxis]
        total: npt.NDArray[Any] = at**2 * self.mass + at * self.damping
        for (spring, kernel), damper in zip(self.springs, self.dampers, strict=True):
            kept: Any = 1.0
            if kernel is not None:
                scale = memory * self.memory_scale
                kept = 1.0 - scale * np.asarray(kernel.laplace(s))[..., np.newaxis, np.newaxis]
            total = total + kept * (spring if damper is None else spring + at * damper)
        return total

    def _determinant(self, s: Any, memory: complex, size: Any) -> Any:
        m = self.matrix(s, memory)
        if self.n == 2:
            return m[..., 0, 0] * m[..., 1, 1] - m[..., 0, 1] * m[..., 1, 0]
        # Scaled, so that the product over many coordinates stays in range.
        scale = np.outer(self.scale, self.scale) / np.asarray(size)[..., np.newaxis, np.newaxis]
        return np.linalg.det(m * scale)

    @property
    def remembers(self) -> bool:
        return self.memory_scale != 0 and any(kernel is not None for _, kernel in self.springs)

    def without_memory(self) -> ComplexArray:
        """Eigenvalues of the damped linear system, those on an axis put there."""
        zero, one = np.zeros_like(self.mass), np.eye(self.n)
        inverse = np.linalg.inv(self.mass)
        companion = np.block(
            [[zero, one], [-inverse @ self.stiffness, -inverse @ self.all_damping]]
        )
        roots = np.linalg.eigvals(companion).astype(complex)
        roots[np.abs(roots) < 1e-7 * self.fastest] = 0.0
        roots.real[np.abs(roots.real) < 1e-13 * np.abs(roots)] = 0.0
        return roots

    @property
    def is_tabulated(self) -> bool:
        """Whether a kernel is a table, which has roots without number far left."""
        return any(kernel is not None and _is_table(kernel) for _, kernel in self.springs)

    @property
    def region(self) -> str:
        """Where roots are counted."""
        if not self.remembers:
            return "the whole plane"
        if self.is_tabulated:
            return "Re s > 0"
        return f"Re s > 0, and Im s != 0 with a damping ratio below {_MOST_DAMPED}"

    def oscillatory(self) -> ComplexArray:
        """All roots of sums of exponentials; else from the roots without memory."""
        if not self.remembers:
            starts = self.without_memory()
            starts = starts[starts.imag > 1e-12 * np.abs(starts)]
            return starts[np.argsort(starts.imag)]
        states = self._states()
        roots = self._continued() if states is None else self._eigenvalues(states)
        return _listed(roots)

    def _states(self) -> FloatArray | None:
        """The matrix of (u, u', y_q), y_q' = u - b_q y_q for each exponential; None: not of these.

        (K + s C)(1 - w/(s + b)) = K + s C - w C - w (K - b C)/(s + b).
        """
        n, terms = self.n, []
        stiffness = self.stiffness.copy()
        for (spring, kernel), damper in zip(self.springs, self.dampers, strict=True):
            found = None if kernel is None else exponentials_of(kernel)
            if kernel is not None and found is None:
                return None
            for w, b in zip(*(found or ((), ())), strict=True):
                pull = spring if damper is None else spring - b * damper
                stiffness -= 0 if damper is None else self.memory_scale * w * damper
                terms.append((self.memory_scale * w * pull, b))
        size = (2 + len(terms)) * n
        if size > _MOST_STATES:
            return None
        matrix = np.zeros((size, size))
        inverse = np.linalg.inv(self.mass)
        matrix[:n, n : 2 * n] = np.eye(n)
        matrix[n : 2 * n, :n] = -inverse @ stiffness
        matrix[n : 2 * n, n : 2 * n] = -inverse @ self.all_damping
        for q, (pull, b) in enumerate(terms, 2):
            own = slice(q * n, (q + 1) * n)
            matrix[n : 2 * n, own] = inverse @ pull
            matrix[own, :n] = np.eye(n)
            matrix[own, own] = -b * np.eye(n)
        return matrix

    def _eigenvalues(self, matrix: FloatArray) -> list[complex]:
        """Oscillatory eigenvalues, polished by Newton's method."""
        found = np.linalg.eigvals(matrix)
        roots: list[complex] = []
        for start in found[found.imag > 1e-9 * np.abs(found)]:
            self._add(complex(start), roots)
        return roots

    def _add(self, start: complex, roots: list[complex]) -> None:
        """Add the root near a start, if Newton's method finds a new one."""
        s = self._polish(start, 1.0)
        if not cmath.isfinite(s):
            return
        s = complex(s.real, abs(s.imag))
        if any(abs(s - r) < 1e-9 * abs(s) for r in roots):
            roots += self._twin(s, roots)
        elif s.imag > 1e-9 * abs(s) and self._is_root(s):
            roots.append(s)

    def searched(self, known: ComplexArray, missing: int) -> ComplexArray:
        """The roots known and those that Newton's method finds from places all over the region."""
        roots = list(known)
        wanted = len(roots) + missing
        low, high = self.slowest / 10**_BEYOND, self.fastest * 10**_BEYOND
        n = math.ceil(_A_DECADE * math.log10(high / low))
        sizes = np.geomspace(low, high, n + 1)
        # Near the natural frequencies first.
        sizes = sizes[np.argsort(np.abs(np.log(sizes / math.sqrt(self.slowest * self.fastest))))]
        for size in sizes:
            for angle in np.linspace(0.5 * np.pi, math.pi - math.acos(_MOST_DAMPED), _ANGLES):
                if len(roots) >= wanted:
                    return _listed(roots)
                self._add(complex(size * cmath.exp(1j * angle)), roots)
        return _listed(roots)

    def _continued(self) -> list[complex]:
        """Memory is brought in step by step."""
        starts = self.without_memory()
        starts = starts[starts.imag > 1e-12 * np.abs(starts)]
        roots: list[complex] = []
        for start in starts:
            for bend in _BENDS:
                s = self._with_memory(complex(start), bend)
                if not cmath.isfinite(s):
                    continue
                s = complex(s.real, abs(s.imag))
                new = not any(abs(s - r) < 1e-9 * abs(s) for r in roots)
                if new and s.imag > 1e-9 * abs(s) and self._is_root(s):
                    roots.append(s)
                    break
            else:
                roots += self._twin(s, roots)
        return roots

    def _is_root(self, s: complex) -> bool:
        """Whether det D is small there relative to its values nearby.

        Far left the transforms of kernels that end are so large that the rest of D is lost in
        rounding, of which Newton's method finds zeros too.
        """
        h, size = 1e-4 * abs(s), abs(s) ** 2
        try:
            at, *beside = (abs(self._determinant(s + d, 1.0, size)) for d in (0, h, -h))
        except InputError:
            return False
        return bool(at <= 1e-3 * max(beside))

    def _twin(self, s: complex, roots: list[complex]) -> list[complex]:
        """A second root near a known root, or that root if it is a double one."""
        if not cmath.isfinite(s) or not any(abs(s - r) < 1e-9 * abs(s) for r in roots):
            return []
        twin = self._polish(s + 1e-3 * abs(s) * (1 + 1j), 1.0, roots)
        if not cmath.isfinite(twin):
            return []
        if abs(twin - s) < _LAST * abs(s):
            return [s]
        return [twin] if abs(twin - s) < _FAR * abs(s) and twin.imag > 1e-9 * abs(s) else []

    def _with_memory(self, s: complex, bend: complex) -> complex:
        """The root that s, one without memory, becomes with all of it."""
        s, t, step = self._polish(s, 0.0), 0.0, _STEP
        while t < 1 and cmath.isfinite(s):
            wanted = min(t + step, 1.0)
            moved = self._polish(s, wanted + bend * wanted * (1 - wanted))
            # The size of a complex NaN may be an OverflowError.
            near = cmath.isfinite(moved) and abs(moved - s) <= _FAR * abs(s)
            if step > _LEAST_STEP and not near:
                step /= 4
                continue
            s, t, step = moved, wanted, min(2 * step, _STEP)
        return s

    def _polish(self, s: complex, memory: complex, known: Sequence[complex] = ()) -> complex:
        """Newton's method, the derivative by a difference of the analytic function.

        Those known are divided out. NaN where it does not settle, or leaves the range of numbers,
        the kernels' too: such a root is not listed, and the count of the argument principle tells
        that it is not.
        """
        nothing = complex(math.nan, math.nan)
        size, furthest = abs(s) ** 2, 1e9 * self.fastest
        step = s
        for _ in range(_NEWTON):
            h = 1e-6 * abs(s)
            try:
                at = np.array([s + h, s - h, s])
                values = self._determinant(at, memory, np.full(3, size))
                above, below, value = (
                    v / math.prod(place - r for r in known)
                    for v, place in zip(values, (s + h, s - h, s), strict=True)
                )
            except (InputError, ZeroDivisionError):
                return nothing
            if above == below:
                # A double root; but where all are 0, what is huge hides the rest.
                return s if value == 0 and above != 0 else nothing
            step = complex(value / ((above - below) / (2 * h)))
            s -= step
            if not max(abs(s.real), abs(s.imag)) < furthest:
                return nothing
            if abs(step) <= 4e-16 * abs(s):
                break
        return s if abs(step) <= _LAST * abs(s) else nothing

    def real(self) -> FloatArray:
        """Zeros of the eigenvalues of D along the real axis, where it is symmetric as a rule."""
        from scipy.optimize import brentq, minimize_scalar

        if not self.remembers:
            roots = self.without_memory()
            return np.sort(roots.real[roots.imag == 0])[::-1]
        cut = min(
            kernel.beta if isinstance(kernel, RzhanitsynKernel) else 0.0
            for _, kernel in self.springs
            if kernel is not None
        )
        right = np.geomspace(1e-12, 1e3, 1200) * self.fastest
        left = -cut * (1 - np.geomspace(1e-10, 1, 600, endpoint=False)) if cut > 0 else right[:0]
        grid = np.unique(np.concatenate([left, right]))
        scale = np.outer(self.scale, self.scale)
        symmetric = all(np.array_equal(m, m.T) for m in (self.all_damping, self.stiffness))

        def eigenvalue(s: float | FloatArray, j: int | slice) -> Any:
            m = np.real(self.matrix(s)) * scale
            if symmetric:
                return np.linalg.eigvalsh(m)[..., j]
            sign, size = np.linalg.slogdet(m)
            return (sign * np.exp(np.clip(size, -600, 600)))[..., np.newaxis][..., j]

        values = eigenvalue(grid, slice(None))
        found = []
        for j in range(values.shape[1]):
            signs, sizes = np.sign(values[:, j]), np.abs(values[:, j])
            places = np.flatnonzero(signs[1:] * signs[:-1] < 0)
            between = [(float(grid[i]), float(grid[i + 1])) for i in places]
            # Of two roots side by side the lowest value between has another sign.
            dips = (sizes[1:-1] < sizes[:-2]) & (sizes[1:-1] < sizes[2:])
            dips &= (signs[1:-1] == signs[:-2]) & (signs[1:-1] == signs[2:])
            for i in np.flatnonzero(dips) + 1:
                low, high = float(grid[i - 1]), float(grid[i + 1])
                least = minimize_scalar(
                    lambda s, side, j: side * eigenvalue(float(s), j),
                    bounds=(low, high), args=(signs[i], j), method="bounded",
                    options={"xatol": 1e-12 * abs(grid[i])},
                )  # fmt: skip
                if least.fun < 0:
                    between += [(low, float(least.x)), (float(least.x), high)]
            for ends in between:
                root = brentq(eigenvalue, *ends, (j,), xtol=1e-300, rtol=1e-14, maxiter=2000)
                found.append(float(root))
        return np.array(sorted(found, reverse=True))

    def count(self, known: ComplexArray) -> tuple[int, int]:
        """Roots right of the imaginary axis, and how many oscillatory ones left of it are unknown.

        By the turns of det D along the imaginary axis (Nyquist) and along a ray on the left.
        Pairs of oscillatory roots that are known are divided out: light modes side by side turn
        the determinant by more than pi between two frequencies, however close these are.
        """
        if not self.remembers:
            return int((self.without_memory().real > 0).sum()), 0
        near, far = 1e-14 * self.slowest, 1e8 * self.fastest
        # A quarter of a small circle first: a kernel may be singular at 0.
        circle = near * np.exp(0.5j * np.pi * np.linspace(0, 1, 64))
        along = 1j * np.geomspace(near, far, 60_000)
        turned = self._turned(np.concatenate([circle, along]), known)
        others = round(float(self.n - known.size - (turned[-1] - turned[0]) / np.pi))
        n_unstable = others + 2 * int((known.real > 0).sum())
        if self.is_tabulated:
            return n_unstable, 0
        # At infinity det D is s^2n det M; each known pair turns as s^2.
        end = math.pi - math.acos(_MOST_DAMPED)
        angles = np.linspace(0.5 * np.pi, end, 64)
        # A real root may be at rounding of 0: the arc is well outside.
        first = int(np.searchsorted(along.imag, 1e-9 * self.slowest))
        ray = np.geomspace(along[first].imag, far, _POINTS) * cmath.exp(1j * end)
        arc = self._turned(along[first].imag * np.exp(1j * angles), known)
        left = self._turned(ray, known)
        up = turned[-1] - turned[circle.size + first]
        outer = 2 * (self.n - known.size) * (end - 0.5 * np.pi)
        total = up + outer - (left[-1] - left[0]) - (arc[-1] - arc[0])
        return n_unstable, round(float(total / (2 * np.pi)))

    def _turned(self, s: ComplexArray, known: ComplexArray) -> FloatArray:
        """Angle of det D along a path, known pairs divided out."""
        parts = np.array_split(s, max(1, self.n**2 // 16))
        sizes = (np.abs(part) ** 2 + self.slowest**2 for part in parts)
        determinants = [
            self._determinant(part, 1.0, size) for part, size in zip(parts, sizes, strict=True)
        ]
        angle = np.angle(np.concatenate(determinants))
        for root in known:
            angle = angle - np.angle(s - root) - np.angle(s - root.conj())
        return np.asarray(np.unwrap(angle))


def _is_table(kernel: Kernel) -> bool:
    if isinstance(kernel, SumKernel):
        return any(_is_table(part) for part in kernel.parts)
    within = kernel.kernel if isinstance(kernel, ThermalKernel) else kernel
    return isinstance(within, TabulatedKernel)


def _listed(roots: Sequence[complex]) -> ComplexArray:
    """By rising frequency, those on the imaginary axis put there."""
    listed = np.array(sorted(roots, key=lambda s: s.imag), dtype=complex)
    listed.real[np.abs(listed.real) < _ON_AXIS * np.abs(listed)] = 0.0
    return listed
