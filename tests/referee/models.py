"""Independent systems: forces, ordinary differential equations with Prony memory, Python source."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import gamma

from referee.case import even, few, number, numbers
from referee.integration import solve_ivp

Array = Any


@dataclass(frozen=True)
class Memory:
    """A kernel: its Laplace transform, and weights and rates if it is a sum of exponentials."""

    source: str
    laplace: Callable[[Array], Array]
    weights: Array = None
    rates: Array = None


def prony(weights: Sequence[float], rates: Sequence[float]) -> Memory:
    """Return sum_j w_j exp(-r_j t)."""
    w, r = np.array(weights, float), np.array(rates, float)
    return Memory(
        f"vv.PronyKernel(weights={numbers(w)}, rates={numbers(r)})",
        lambda s: (w / (np.asarray(s)[..., None] + r)).sum(-1),
        w,
        r,
    )


def rzhanitsyn(amplitude: float, alpha: float, beta: float) -> Memory:
    """Return A exp(-beta t) t^(alpha-1)."""
    return Memory(
        f"vv.RzhanitsynKernel(amplitude={amplitude!r}, alpha={alpha!r}, beta={beta!r})",
        lambda s: amplitude * gamma(alpha) * (np.asarray(s, complex) + beta) ** -alpha,
    )


def spread(memory: Memory, amplitude: float, alpha: float, beta: float, omega: float) -> Memory:
    """Return the kernel A exp(-beta t) t^(alpha-1) as a sum of exponentials near a frequency.

    t^(alpha-1) Gamma(1-alpha) is the integral of exp(-x t) x^-alpha over x > 0. The trapezoidal rule
    in log x with step 0.95 has an error of about 1e-4. Rates above 40 omega are one term.
    """
    apart = 0.95
    y = np.arange(np.log(omega) - 11 / (1 - alpha), np.log(40 * omega), apart)
    beyond = y[-1] + apart * np.arange(1, 400)
    scale = amplitude * apart / gamma(1 - alpha)
    fast = 80 * omega
    rest = (scale * np.exp((1 - alpha) * beyond) / (beta + np.exp(beyond))).sum()
    weights = np.append(scale * np.exp((1 - alpha) * y), rest * fast)
    return replace(memory, weights=weights, rates=np.append(beta + np.exp(y), fast))


def rabotnov(amplitude: float, alpha: float, beta: float) -> Memory:
    """Return the kernel with the transform A / (s^alpha + beta)."""
    return Memory(
        f"vv.RabotnovKernel(amplitude={amplitude!r}, alpha={alpha!r}, beta={beta!r})",
        lambda s: amplitude / (np.asarray(s, complex) ** alpha + beta),
    )


def some_prony(rng: np.random.Generator, most: float = 0.3) -> Memory:
    """Return one or two exponentials with an integral of at most ``most``."""
    n = int(rng.integers(1, 3))
    rates = [few(rng, 0.02, 3, 3) for _ in range(n)]
    weights = [float(f"{r * rng.uniform(0.02, most) / n:.3g}") for r in rates]
    return prony(weights, rates)


def some_memory(rng: np.random.Generator) -> Memory:
    """Return any kernel with a transform in closed form and an integral below 1."""
    kind = rng.integers(3)
    if kind == 0:
        return some_prony(rng)
    alpha, beta = even(rng, 0.1, 0.95, 3), few(rng, 0.02, 1, 3)
    part = rng.uniform(0.02, 0.5)
    if kind == 1:
        return rzhanitsyn(float(f"{part * beta**alpha / gamma(alpha):.3g}"), alpha, beta)
    return rabotnov(float(f"{part * beta:.3g}"), alpha, beta)


@dataclass(frozen=True)
class Group:
    """Springs that share a kernel: forces and their derivatives at displacements (..., n)."""

    force: Callable[[Array], Array]
    slope: Callable[[Array], Array]
    memory: Memory | None


@dataclass(frozen=True)
class Model:
    """M u'' + C u' + sum_g (1 - R_g*) g(u) = load."""

    source: str
    mass: Array
    damping: Array
    groups: tuple[Group, ...]
    names: tuple[str, ...]
    #: Direction of each coordinate in a base motion.
    base: Array = None

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.names)

    @property
    def stiffness(self) -> Array:
        """Stiffness at rest without memory."""
        return sum(g.slope(np.zeros(self.n)) for g in self.groups)

    @property
    def frequencies(self) -> Array:
        """Natural frequencies without memory, ascending."""
        squares = np.linalg.eigvals(np.linalg.solve(self.mass, self.stiffness))
        return np.sort(np.sqrt(np.abs(squares.real)))

    def dynamic_stiffness(self, nu: float, inertia: bool = True) -> Array:
        """D(nu) at rest."""
        total = 1j * nu * self.damping - (nu**2 * self.mass if inertia else 0)
        for g in self.groups:
            kept = 1.0 if g.memory is None else 1 - g.memory.laplace(1j * nu)
            total = total + kept * g.slope(np.zeros(self.n))
        return total

    def remembered(self) -> tuple[tuple[int, Array, Array], ...]:
        """Index, weight and rate of each exponential; the index is that of its group."""
        return tuple(
            (i, w, r)
            for i, g in enumerate(self.groups)
            if g.memory is not None
            for w, r in zip(g.memory.weights, g.memory.rates, strict=True)
        )

    def equations(self, load: Callable[[float], Array] | None) -> Callable[[float, Array], Array]:
        """Right side of the ordinary equations: u, u', then one vector per exponential.

        h' = -r h + g(u), and the force is g(u) - sum w h.
        """
        n, inverse = self.n, np.linalg.inv(self.mass)
        terms = self.remembered()

        def right(t: float, y: Array) -> Array:
            u, v = y[:n], y[n : 2 * n]
            forces = [g.force(u) for g in self.groups]
            total = -(self.damping @ v) - sum(forces)
            out = np.empty_like(y)
            for j, (i, w, r) in enumerate(terms):
                at = slice((2 + j) * n, (3 + j) * n)
                total = total + w * y[at]
                out[at] = forces[i] - r * y[at]
            if load is not None:
                total = total + load(t)
            out[:n], out[n : 2 * n] = v, inverse @ total
            return out

        return right

    def start(self, state: Array, held: Array | None = None) -> Array:
        """State of the ordinary equations from (u1, u1', ...), after a constant past ``held``."""
        n, terms = self.n, self.remembered()
        y = np.zeros((2 + len(terms)) * n)
        y[:n], y[n : 2 * n] = np.asarray(state)[::2], np.asarray(state)[1::2]
        if held is not None:
            for j, (i, _, r) in enumerate(terms):
                y[(2 + j) * n : (3 + j) * n] = self.groups[i].force(np.asarray(held, float)) / r
        return y

    def motion(
        self,
        y: Array,
        times: Array,
        load: Callable[[float], Array] | None,
        breaks: Sequence[float] = (),
        begin: float = 0.0,
        rtol: float = 1e-12,
        events: Any = None,
    ) -> Array:
        """States (u1, u1', ...) at times, integrated by SciPy between breaks."""
        return integrate(self.equations(load), y, times, breaks, begin, rtol)[
            :, interleaved(self.n)
        ]

    def linearised(self, u: Array) -> Array:
        """Matrices of the linearized ordinary equations at displacements (m, n)."""
        n, terms = self.n, self.remembered()
        size = (2 + len(terms)) * n
        out = np.zeros((u.shape[0], size, size))
        inverse = np.linalg.inv(self.mass)
        slopes = [g.slope(u) for g in self.groups]
        out[:, :n, n : 2 * n] = np.eye(n)
        out[:, n : 2 * n, :n] = -inverse @ sum(slopes)
        out[:, n : 2 * n, n : 2 * n] = -inverse @ self.damping
        for j, (i, w, r) in enumerate(terms):
            at = slice((2 + j) * n, (3 + j) * n)
            out[:, n : 2 * n, at] = w * inverse
            out[:, at, :n] = slopes[i]
            out[:, at, at] = -r * np.eye(n)
        return out


def interleaved(n: int) -> Array:
    """Indices of (u1, u1', u2, ...) in (u, u', ...)."""
    return np.arange(2 * n).reshape(2, n).T.ravel()


#: Number of times up to which steps end at each time.
_FEW_TIMES = 40


def integrate(
    right: Callable[[float, Array], Array],
    y: Array,
    times: Array,
    breaks: Sequence[float] = (),
    begin: float = 0.0,
    rtol: float = 1e-12,
) -> Array:
    """States at ascending times by DOP853, restarted at each break.

    The interpolation of DOP853 has order 7 and errors of up to 1e-10. So steps end at the times, or
    the step size is limited to the median spacing of the times between two breaks.
    """
    times = np.asarray(times, float)
    out = np.full((times.size, y.size), np.nan)
    out[times == begin] = y
    ends = set(times[times > begin]) if times.size <= _FEW_TIMES else {float(times[-1])}
    ends = sorted({b for b in breaks if begin < b < times[-1]} | ends)
    for end in ends:
        inside = (times > begin) & (times <= end)
        at = np.unique(np.append(times[inside], end))
        many = times.size > _FEW_TIMES and at.size > 1
        longest = float(np.median(np.diff(at, prepend=begin))) if many else np.inf
        size = max(1e-300, float(np.abs(y).max()))
        found = solve_ivp(
            # A load may jump at the ends of the piece: it is evaluated inside the piece.
            lambda t, x, a=begin, b=end: right(min(max(t, a + 1e-13 * (b - a)), b - 1e-13 * (b - a)), x),
            (begin, end), y, method="DOP853", t_eval=at, rtol=max(rtol, 2.3e-14),
            atol=1e-3 * rtol * max(size, 1e-3), max_step=longest,
        )  # fmt: skip
        if not found.success:
            break
        out[inside] = found.y.T[np.isin(at, times[inside])]
        y, begin = found.y[:, -1], end
    return out


def escape(
    right: Callable[[float, Array], Array],
    y: Array,
    n: int,
    end: float,
    breaks: Sequence[float] = (),
) -> float | None:
    """Time when one of n coordinates, the first of a state, exceeds 1e5; None: never."""

    def far(t: float, x: Array) -> float:
        return float(np.abs(x[:n]).max()) - 1e5

    far.terminal = True  # type: ignore[attr-defined]
    begin = 0.0
    for until in sorted({b for b in breaks if 0 < b < end} | {end}):
        found = solve_ivp(
            lambda t, x, a=begin, b=until: right(min(max(t, a + 1e-13 * (b - a)), b - 1e-13 * (b - a)), x),
            (begin, until), y, method="DOP853", rtol=1e-11, atol=1e-12, events=far,
        )  # fmt: skip
        if found.t_events[0].size:
            return float(found.t_events[0][0])
        if not found.success:
            return float(found.t[-1])
        y, begin = found.y[:, -1], until
    return None


@dataclass(frozen=True)
class Term:
    """coefficient * prod u^powers in equation ``on``."""

    coefficient: float
    powers: tuple[int, ...]
    on: int


def polynomial_group(stiffness: Array, terms: Sequence[Term], memory: Memory | None) -> Group:
    """Return K u + f(u)."""
    matrix = np.asarray(stiffness, float)
    n = matrix.shape[0]

    rows = matrix.tolist()
    each = [(t.coefficient, t.on, [(d, p) for d, p in enumerate(t.powers) if p]) for t in terms]

    def force(u: Array) -> Array:
        if u.ndim == 1 and n < 4:
            # Scalar arithmetic is faster for a single state.
            x = u.tolist()
            plain = [sum(a * b for a, b in zip(row, x, strict=True)) for row in rows]
            for coefficient, on, factors in each:
                part = coefficient
                for d, p in factors:
                    part *= x[d] ** p
                plain[on] += part
            return np.array(plain)
        out = u @ matrix.T
        for t in terms:
            part = t.coefficient
            for d, p in enumerate(t.powers):
                if p:
                    part = part * u[..., d] ** p
            out[..., t.on] += part
        return out

    def slope(u: Array) -> Array:
        out = np.broadcast_to(matrix, (*u.shape[:-1], n, n)).copy()
        for t in terms:
            for by, q in enumerate(t.powers):
                if not q:
                    continue
                part = t.coefficient * q
                for d, p in enumerate(t.powers):
                    k = p - (d == by)
                    if k:
                        part = part * u[..., d] ** k
                out[..., t.on, by] += part
        return out

    return Group(force, slope, memory)


@dataclass
class Draft:
    """A polynomial system under construction."""

    mass: Array
    damping: Array
    stiffness: Array
    terms: list[Term]
    memory: Memory | None = None
    #: Further groups: stiffness, terms, kernel.
    more: list[tuple[Array, list[Term], Memory | None]] = field(default_factory=list)
    base: Array = None

    def model(self) -> Model:
        """Return the system and its Python source."""
        n = len(self.mass)
        names = ("x",) if n == 1 else tuple(f"x{d + 1}" for d in range(n))

        def part(stiffness: Array, terms: list[Term], memory: Memory | None) -> str:
            text = f"stiffness={numbers(stiffness)}"
            if terms:
                listed = ", ".join(
                    f"vv.Monomial(coefficient={t.coefficient!r}, powers={t.powers!r}, on={t.on})"
                    for t in terms
                )
                text += f",\n    forces=[{listed}]"
            return text + (f",\n    kernel={memory.source}" if memory else "")

        source = (
            f"vv.PolynomialSystem(\n    mass={numbers(self.mass)}, damping={numbers(self.damping)},\n"
            f"    {part(self.stiffness, self.terms, self.memory)}"
        )
        if self.more:
            source += f",\n    springs=[{', '.join(f'vv.Springs({part(*m)})' for m in self.more)}]"
        if self.base is not None:
            source += f",\n    base_direction={numbers(self.base)}"
        mass = np.asarray(self.mass, float)
        groups = [(self.stiffness, self.terms, self.memory), *self.more]
        return Model(
            f"{source},\n)",
            np.diag(mass) if mass.ndim == 1 else mass,
            np.asarray(self.damping, float),
            tuple(polynomial_group(*g) for g in groups),
            names,
            self.base,
        )


def chain(
    rng: np.random.Generator,
    n: int,
    damping: float,
    *,
    memory: Memory | None = None,
    cubic: tuple[float, float] = (0.05, 0.6),
    quadratic: bool = False,
    softening: bool = False,
) -> Draft:
    """Masses in a row, both ends fixed, proportional damping, a few nonlinear terms."""
    mass = [even(rng, 0.6, 2, 3) for _ in range(n)]
    springs = [even(rng, 0.5, 1.8, 3) for _ in range(n + 1)]
    matrix = np.zeros((n, n))
    for i in range(n):
        matrix[i, i] = springs[i] + springs[i + 1]
        if i:
            matrix[i, i - 1] = matrix[i - 1, i] = -springs[i]
    matrix = np.round(matrix, 6)
    terms = []
    for _ in range(int(rng.integers(1, 3))):
        d = int(rng.integers(n))
        sign = -1 if softening and rng.random() < 0.5 else 1
        powers = tuple(3 * int(k == d) for k in range(n))
        terms.append(Term(sign * even(rng, *cubic, 3), powers, d))
    if quadratic:
        d = int(rng.integers(n))
        terms.append(Term(even(rng, *cubic, 3), tuple(2 * int(k == d) for k in range(n)), d))
    return Draft(mass, np.round(damping * matrix, 12), matrix, terms, memory)


def mount(
    rng: np.random.Generator,
    *,
    damped: float,
    memory: Memory | None = None,
    geometry: str = "cubic",
    memory_phi: "Memory | bool | None" = None,
) -> Model:
    """A mount, with forces from the equations of its theory page."""
    m, inertia, arm = even(rng, 0.5, 2, 3), even(rng, 0.05, 0.3, 3), even(rng, 0.2, 0.8, 3)
    c_x, c_phi = even(rng, 5, 15, 3), even(rng, 1, 4, 3)
    at_rest = np.array([[c_x, -c_x * arm], [-c_x * arm, c_x * arm**2]])
    damping = np.round(damped * (at_rest + np.diag([0, c_phi])), 8)
    source = (
        f"vv.Mount(mass={m}, inertia={inertia}, offset={arm}, stiffness_x={c_x}, "
        f"stiffness_phi={c_phi},\n    damping={numbers(damping)}, geometry={geometry!r}"
    )
    if memory is not None:
        source += f",\n    kernel={memory.source}"
    in_phi = memory if memory_phi is None else memory_phi
    if isinstance(memory_phi, Memory):
        source += f",\n    kernel_phi={memory_phi.source}"
    elif memory_phi is False:
        source += ", kernel_phi=False"
        in_phi = None
    if geometry == "exact":
        raise ValueError("memory on the deflection is no group of forces of this kind")
    printed = geometry == "printed"
    a = -c_x * arm / 6 if printed else c_x * arm / 6
    b = -c_x * arm / 2 if printed else c_x * arm / 2
    c = -8 / 6 * c_x * arm**2 if printed else -2 / 3 * c_x * arm**2
    terms = [Term(a, (0, 3), 0), Term(b, (1, 2), 1), Term(c, (0, 3), 1)]
    return Model(
        f"{source})",
        np.diag([m, inertia]),
        damping,
        (
            polynomial_group(at_rest, terms, memory),
            polynomial_group(np.diag([0.0, c_phi]), [], in_phi if in_phi else None),
        ),
        ("x", "phi"),
        np.array([1.0, 0.0]),
    )


@functools.lru_cache
def _elongation(alpha: float, w2: float) -> float:
    """The real root of alpha z^3 + z = w2^2."""
    roots = np.roots([alpha, 0, 1, -(w2**2)]) if alpha else [w2**2]
    return float(next(r.real for r in roots if abs(np.imag(r)) < 1e-9 * (1 + abs(r))))


@dataclass(frozen=True)
class Swinging:
    """The pendulum, from the equations of its theory page."""

    e: float
    w2: float
    w3: float
    alpha: float = 0.0
    c1: float = 0.0
    c2: float = 0.0
    c3: float = 0.0
    f0: float = 0.0
    m01: float = 0.0
    m02: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    p3: float = 0.0

    @classmethod
    def of(cls, body: Any) -> "Swinging":
        """Return the model of a pendulum of the package."""
        if body.equations != "exact":
            raise ValueError(f"equations are {body.equations}, not exact")
        return cls(**{name: getattr(body, name) for name in cls.__dataclass_fields__})

    @property
    def source(self) -> str:
        """Python source."""
        given = {k: v for k, v in vars(self).items() if v or k in ("e", "w2", "w3")}
        return f"vv.Pendulum({', '.join(f'{k}={number(v)}' for k, v in given.items())})"

    @property
    def z_r(self) -> float:
        """Static elongation."""
        return _elongation(self.alpha, self.w2)

    def right(self, t: float, y: Array) -> Array:
        """d/dt of (z, z', phi, phi', psi, psi'); any shape after the first axis, also complex."""
        if y.ndim == 1 and y.dtype == float:
            # Scalar arithmetic is ten times faster for a single state.
            return np.array(self._slopes(t, y.tolist(), math.sin, math.cos))
        return np.array(self._slopes(t, y, np.sin, np.cos))

    def _slopes(self, t: Any, y: Any, sine: Any, cosine: Any) -> list[Any]:
        z, zd, f, fd, s, sd = y
        sin, cos = sine(f - s), cosine(f - s)
        arm, zr, al, r = 1 + z, self.z_r, self.alpha, self.w3**2 / self.w2**2
        a1 = (
            self.f0 * cosine(self.p1 * t)
            - self.c1 * zd
            - z
            - al * z**3
            - 3 * zr * al * z**2
            - 3 * zr**2 * al * z
            - 2 * self.w2**2 * sine(f / 2) ** 2
            + arm * fd**2
            + self.e * cos * sd**2
        )
        a2 = (
            self.m01 * cosine(self.p2 * t)
            - self.w2**2 * arm * sine(f)
            - self.c2 * fd
            - 2 * arm * zd * fd
            - self.e * arm * sin * sd**2
        )
        a3 = (
            self.m02 * cosine(self.p3 * t)
            - self.w3**2 * sine(s)
            - self.c3 * sd
            - 2 * r * cos * zd * fd
            + r * arm * sin * fd**2
        )
        sdd = (a3 - r * (sin * a1 + cos * a2 / arm)) / (1 - self.e * r)
        zdd = a1 - self.e * sin * sdd
        fdd = (a2 / arm - self.e * cos * sdd) / arm
        return [zd, zdd, fd, fdd, sd, sdd]

    def jacobian(self, t: Array, y: Array) -> Array:
        """Derivatives of the right side by complex step, at states (m, 6): (m, 6, 6)."""
        h = 1e-150
        columns = []
        for j in range(6):
            x = y.T.astype(complex)
            x[j] += 1j * h
            columns.append(self.right(t, x).imag / h)
        return np.stack(columns, axis=-1).transpose(1, 0, 2)

    def energy(self, y: Array) -> Array:
        """Energy of states (..., 6)."""
        z, zd, f, fd, s, sd = np.moveaxis(np.asarray(y), -1, 0)
        sin, cos = np.sin(f - s), np.cos(f - s)
        arm, zr, al, r = 1 + z, self.z_r, self.alpha, self.w3**2 / self.w2**2
        return (
            (zd**2 + arm**2 * fd**2 + self.e / r * sd**2) / 2
            + self.e * sd * (sin * zd + arm * cos * fd)
            + z**2 * (1 + 3 * zr**2 * al) / 2 + zr * al * z**3 + al * z**4 / 4
            + 2 * self.w2**2 * arm * np.sin(f / 2) ** 2 + 2 * self.e * self.w2**2 * np.sin(s / 2) ** 2
        )  # fmt: skip

    def motion(self, state: Array, times: Array, rtol: float = 1e-12) -> Array:
        """States at times, by SciPy."""
        return integrate(self.right, np.asarray(state, float), times, rtol=rtol)


def pendulum(
    rng: np.random.Generator, damping: tuple[float, float] | None = (5e-3, 0.05), **more: float
) -> Swinging:
    """Draw a pendulum."""
    w2 = even(rng, 0.25, 0.6, 3)
    w3 = even(rng, 0.6, 1.2, 3)
    e = float(f"{rng.uniform(0.03, 0.5) * min(1.0, w2**2 / w3**2):.3g}")
    lost = {} if damping is None else {k: few(rng, *damping, 3) for k in ("c1", "c2", "c3")}
    return Swinging(e=e, w2=w2, w3=w3, alpha=even(rng, 0, 1, 3), **(lost | more))
