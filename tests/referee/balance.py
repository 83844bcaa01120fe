"""Independent harmonic balance and Floquet multipliers in plain NumPy."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from referee.case import Claim
from referee.models import Array, Model


class Balance:
    """Harmonics 0 to ``highest`` of a model: u = sum_k s_k sin(k theta) + c_k cos(k theta).

    Unknowns are c_0, s_1, c_1, s_2, ... of each coordinate, shape (2 highest + 1, n).
    """

    def __init__(self, model: Model, highest: int) -> None:
        self.model, self.highest = model, highest
        count = max(64, 8 * (highest + 1))
        theta = 2 * np.pi * np.arange(count) / count
        rows = [np.ones(count)]
        for k in range(1, highest + 1):
            rows += [np.sin(k * theta), np.cos(k * theta)]
        self.waves = np.array(rows).T
        weights = np.full(2 * highest + 1, 2 / count)
        weights[0] = 1 / count
        self.project = self.waves.T * weights[:, None]

    def real(self, coefficients: Array, orders: Array) -> Array:
        """Unknowns from X_k, shape (n, m), at the given harmonics."""
        a = np.zeros((2 * self.highest + 1, self.model.n))
        for j, k in enumerate(orders):
            if k > self.highest:
                continue
            if k == 0:
                a[0] = coefficients[:, j].imag
            else:
                a[2 * k - 1], a[2 * k] = coefficients[:, j].real, coefficients[:, j].imag
        return a

    def complex(self, a: Array) -> Array:
        """X_k, shape (n, highest + 1)."""
        out = np.zeros((a.shape[1], self.highest + 1), complex)
        out[:, 0] = 1j * a[0]
        out[:, 1:] = (a[1::2] + 1j * a[2::2]).T
        return out

    def _turn(self, factors: Array) -> Array:
        """Real matrix of the multiplication of X_k by factors[k]."""
        m = np.zeros((2 * self.highest + 1,) * 2)
        m[0, 0] = factors[0].real
        for k in range(1, self.highest + 1):
            x, y = factors[k].real, factors[k].imag
            i = 2 * k - 1
            m[i, i], m[i, i + 1], m[i + 1, i], m[i + 1, i + 1] = x, -y, y, x
        return m

    def operators(self, nu: float) -> tuple[Array, Array, list[Array]]:
        """Matrices of u'' and u', and the memory matrix of each group."""
        k = np.arange(self.highest + 1)
        kept = []
        for g in self.model.groups:
            if g.memory is None:
                kept.append(np.eye(2 * self.highest + 1))
            else:
                kept.append(self._turn(1 - g.memory.laplace(1j * k * nu + (k == 0) * 1e-300)))
        return self._turn(-((k * nu) ** 2) + 0j), self._turn(1j * k * nu), kept

    def residual(
        self, a: Array, nu: float, load: Array | Callable[[float], Array], slopes: bool = True
    ) -> tuple[Array, Array]:
        """Residual, and its derivatives with respect to the unknowns (flattened row by row)."""
        second, first, kept = self.operators(nu)
        load = load(nu) if callable(load) else load
        m = self.model
        u = self.waves @ a
        r = second @ a @ m.mass.T + first @ a @ m.damping.T - load
        size = a.size
        jac = np.einsum("ij,ab->iajb", second, m.mass) + np.einsum("ij,ab->iajb", first, m.damping)
        for g, keep in zip(m.groups, kept, strict=True):
            onto = keep @ self.project
            r = r + onto @ g.force(u)
            if slopes:
                jac += np.einsum("it,tab,tj->iajb", onto, g.slope(u), self.waves, optimize=True)
        return r, jac.reshape(size, size)

    def solve(self, a: Array, nu: float, load: Array, steps: int = 25) -> Array | None:
        """Newton's method; None if it does not converge."""
        for _ in range(steps):
            r, jac = self.residual(a, nu, load)
            try:
                change = np.linalg.solve(jac, r.ravel()).reshape(a.shape)
            except np.linalg.LinAlgError:
                return None
            a = a - change
            if not np.isfinite(a).all():
                return None
            if np.abs(change).max() <= 1e-13 * np.abs(a).max() + 1e-300:
                return a
        return a if np.abs(change).max() <= 1e-9 * np.abs(a).max() else None

    def raised(self, nu: float, load: Array, steps: int = 1500) -> Array | None:
        """Motion at the full load, by continuation in the load from rest in short steps."""
        size = load.size
        z, tangent, length = np.zeros(size + 1), np.eye(size + 1)[-1], 0.02
        unit = 0.0
        for _ in range(steps):
            unit = max(unit, float(np.abs(z[:-1]).max()))
            weights = np.r_[np.full(size, 1 / max(unit, 1e-3) ** 2), 1.0]
            before, old = z, tangent
            for attempt in range(8):
                h = length / 2**attempt
                z = before + h * old / np.sqrt(weights @ old**2)
                for _turn in range(5):
                    r, jac = self.residual(z[:-1].reshape(load.shape), nu, z[-1] * load)
                    m = np.r_[np.c_[jac, -load.ravel()], [weights * old]]
                    z = z - np.linalg.solve(m, np.r_[r.ravel(), 0.0])
                tangent = np.linalg.solve(m, np.eye(size + 1)[-1])
                turned = (
                    weights @ (tangent * old) / np.sqrt((weights @ tangent**2) * (weights @ old**2))
                )
                if np.abs(r).max() < 1e-9 * (1 + np.abs(load).max()) and turned > 0.98:
                    break
            else:
                return None
            length = min(0.1, h * (1.5 if turned > 0.998 else 1.0))
            if z[-1] >= 1:
                part = (1 - before[-1]) / (z[-1] - before[-1])
                a = (before + part * (z - before))[:-1].reshape(load.shape)
                return self.solve(a, nu, load)
        return None

    def fold(
        self, a: Array, nu: float, load: Array | Callable[[float], Array]
    ) -> tuple[float, Array] | None:
        """Fold near a motion: the frequency at which d nu = 0 along the curve, and the motion.

        ``load``: rows, or a function of the frequency.
        """
        # Newton's method for F = 0, F_a v = 0, l.v = 1 with second derivatives by differences.
        r, jac = self.residual(a, nu, load)
        v = np.linalg.svd(jac)[2][-1]
        x, place = a.ravel().copy(), int(np.abs(v).argmax())
        v = v / v[place]
        size = x.size
        scale = np.abs(x).max()
        for _ in range(12):
            at = x.reshape(a.shape)
            r, jac = self.residual(at, nu, load)
            h = 1e-5 * scale / np.abs(v).max()
            up = self.residual(at + h * v.reshape(a.shape), nu, load)[1]
            down = self.residual(at - h * v.reshape(a.shape), nu, load)[1]
            bent = (up - down) / (2 * h)
            d = 1e-6 * nu
            r_up, j_up = self.residual(at, nu + d, load)
            r_down, j_down = self.residual(at, nu - d, load)
            by_nu, jac_nu = (r_up - r_down).ravel() / (2 * d), (j_up - j_down) / (2 * d)
            m = np.zeros((2 * size + 1, 2 * size + 1))
            m[:size, :size], m[:size, -1] = jac, by_nu
            m[size : 2 * size, :size], m[size : 2 * size, size : 2 * size] = bent, jac
            m[size : 2 * size, -1] = jac_nu @ v
            m[-1, size + place] = 1
            right = np.concatenate([r.ravel(), jac @ v, [v[place] - 1]])
            try:
                change = np.linalg.solve(m, right)
            except np.linalg.LinAlgError:
                return None
            x, v, nu = x - change[:size], v - change[size:-1], nu - change[-1]
            if not np.isfinite(nu):
                return None
            if abs(change[-1]) < 1e-12 * nu and np.abs(change[:size]).max() < 1e-9 * scale:
                return float(nu), x.reshape(a.shape)
        return None


def load_rows(balance: Balance, load: Mapping[int, Array]) -> Array:
    """Fourier load Im sum P_k exp(i k theta), P_k of each coordinate, as rows of the balance."""
    out = np.zeros((2 * balance.highest + 1, balance.model.n))
    for k, p in load.items():
        p = np.asarray(p, complex)
        if k == 0:
            out[0] += p.imag
        else:
            out[2 * k - 1] += p.real
            out[2 * k] += p.imag
    return out


def magnus(matrices: Any, period: float, n: int) -> Array:
    """Monodromy matrix by a sixth-order Magnus expansion; ``matrices``(t) gives A(t) (m, N, N)."""
    h = period / n
    t = h * np.arange(n)
    nodes = 0.5 + np.array([-1, 0, 1]) * np.sqrt(15) / 10
    a_1, a_2, a_3 = (matrices(t + c * h) for c in nodes)
    b_1 = h * a_2
    b_2 = np.sqrt(15) / 3 * h * (a_3 - a_1)
    b_3 = 10 / 3 * h * (a_3 - 2 * a_2 + a_1)

    def bracket(x: Array, y: Array) -> Array:
        return x @ y - y @ x

    c_1 = bracket(b_1, b_2)
    c_2 = -bracket(b_1, 2 * b_3 + c_1) / 60
    omega = b_1 + b_3 / 12 + bracket(-20 * b_1 - b_3 + c_1, b_2 + c_2) / 240
    steps = exponential(omega)
    while len(steps) > 1:
        if len(steps) % 2:
            steps = np.concatenate([steps, np.eye(steps.shape[1])[None]])
        steps = steps[1::2] @ steps[::2]
    return steps[0]


def exponential(m: Array) -> Array:
    """Exponential of a stack of matrices: Taylor series after scaling."""
    size = float(np.abs(m).sum(-1).max())
    halvings = max(0, int(np.ceil(np.log2(max(size, 1e-300) / 0.25))))
    m = m / 2.0**halvings
    out = term = np.broadcast_to(np.eye(m.shape[-1]), m.shape)
    for k in range(1, 14):
        term = term @ m / k
        out = out + term
    for _ in range(halvings):
        out = out @ out
    return out


def multipliers(model: Model, coefficients: Array, nu: float, n: int = 256) -> tuple[Array, Array]:
    """Floquet multipliers of a motion X_k, k = 0, 1, ..., largest first, and their errors.

    Kernels must be sums of exponentials.
    """
    k = np.arange(coefficients.shape[1])

    def matrices(t: Array) -> Array:
        u = (np.exp(1j * nu * np.outer(t, k)) @ coefficients.T).imag
        return model.linearised(u)

    return multipliers_of(matrices, 2 * np.pi / nu, n)


def multipliers_of(matrices: Any, period: float, n: int) -> tuple[Array, Array]:
    """Floquet multipliers of x' = A(t) x, largest first, and the error of each magnitude.

    Errors are estimated separately: the error of a multiplier of 1e6 would hide the errors of
    multipliers near 1. Only the rounding error, of the largest multiplier, is common to all.
    """
    found = []
    for count in (n, 2 * n):
        values = np.linalg.eigvals(magnus(matrices, period, count))
        found.append(values[np.argsort(-np.abs(values))])
    sizes = np.abs(found[1])
    return found[1], np.abs(np.abs(found[0]) - sizes) + 1e-12 * max(1.0, float(sizes[0]))


def growing(got: Array, sizes: Array, off: Array, share: float, close: float) -> Claim | None:
    """Claim that all growing multipliers were found, and no others; None if none grows.

    ``got``: magnitudes found. ``sizes``, largest first, and their errors ``off``: the reference. The
    number found is at least the number that certainly grows, at most the number that may grow.
    """
    found = np.sort(got[got > 1 + close])[::-1]
    surely = sizes > 1 + close + 10 * off
    may = sizes > 1 - close - 10 * off
    n = found.size if surely.sum() <= found.size <= may.sum() else int(surely.sum())
    if not (n or found.size):
        return None
    true = sizes[:n]
    return Claim(
        "growing multipliers", found, true, share * true + 10 * off[:n], damage=100 * share
    )
