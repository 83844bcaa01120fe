"""Steady motions of systems with quadratic and cubic terms by harmonic balance, for checks."""

import itertools

import numpy as np


def random_system(rng, frequencies, damping, *, quadratic=True, derivatives=False):
    """Matrices and terms of M q'' + C q' + K q + N2(x, x) + N3(x, x, x) for given frequencies.

    x is q, or (q, q', q'') with ``derivatives``; N3 is symmetric in its arguments.
    """
    n = len(frequencies)
    m = 3 * n if derivatives else n
    shapes = np.linalg.qr(rng.normal(size=(n, n)))[0]
    cubic = 0.3 * rng.normal(size=(n, m, m, m))
    orders = itertools.permutations((1, 2, 3))
    return {
        "mass": np.eye(n),
        "damping": damping * np.diag(1 + 0.3 * rng.uniform(size=n)),
        "stiffness": shapes @ np.diag(np.square(frequencies)) @ shapes.T,
        "quadratic": 0.5 * rng.normal(size=(n, m, m)) if quadratic else None,
        "cubic": sum(cubic.transpose(0, *order) for order in orders) / 6,
    }


class Balance:
    """Harmonics k.theta, sum |k| <= highest, of angles that rotate with the base frequencies."""

    def __init__(self, system, base, loads, highest):
        """``loads`` are pairs of an amplitude vector and its k."""
        self.system, m = system, len(base)
        ranges = itertools.product(range(-highest, highest + 1), repeat=m)
        zero = (0,) * m
        later = [k for k in ranges if k > zero and sum(map(abs, k)) <= highest]
        self.waves = [zero, *later]
        n_points = 8 * highest if m == 1 else 4 * highest + 2
        grid = np.stack(
            np.meshgrid(*[np.arange(n_points) * 2 * np.pi / n_points] * m, indexing="ij"), -1
        ).reshape(-1, m)
        phases = grid @ np.array(self.waves).T
        values = np.hstack([np.cos(phases), np.sin(phases[:, 1:])])
        self.n_waves, size = len(self.waves), values.shape[1]
        slope = np.zeros((size, size))
        for i, frequency in enumerate(np.array(self.waves) @ base):
            if i:
                slope[self.n_waves + i - 1, i] = -frequency
                slope[i, self.n_waves + i - 1] = frequency
        self.values = [values, values @ slope, values @ slope @ slope]
        self.project = np.linalg.pinv(values)
        mass, damping, stiffness = (system[k] for k in ("mass", "damping", "stiffness"))
        self.linear = (
            np.kron(slope @ slope, mass)
            + np.kron(slope, damping)
            + np.kron(np.eye(size), stiffness)
        )
        self.n = mass.shape[0]
        self.load = np.zeros((size, self.n))
        for amplitude, k in loads:
            self.load[self.waves.index(tuple(k))] += amplitude

    def pack(self, parts):
        """Real coefficients of a sum of Re(U exp(i k.theta)); parts are pairs of k and U."""
        x = np.zeros(self.load.shape)
        for k, u in parts:
            if tuple(k) not in self.waves:
                k, u = [-i for i in k], np.conj(u)
            i = self.waves.index(tuple(k))
            x[i] += np.real(u)
            if i:
                x[self.n_waves + i - 1] -= np.imag(u)
        return x

    def coefficient(self, x, k):
        """The coefficient U of Re(U exp(i k.theta))."""
        i = self.waves.index(tuple(k))
        return x[i] - 1j * x[self.n_waves + i - 1]

    def solve(self, x):
        """Newton's method from x; None if it does not converge."""
        quadratic, cubic = self.system["quadratic"], self.system["cubic"]
        m = cubic.shape[1]
        for _ in range(12):
            q = np.hstack([v @ x for v in self.values])[:, :m]
            force = np.einsum("ijkl,tj,tk,tl->ti", cubic, q, q, q, optimize=True)
            tangent = 3 * np.einsum("ijkl,tk,tl->tij", cubic, q, q, optimize=True)
            if quadratic is not None:
                force += np.einsum("ijk,tj,tk->ti", quadratic, q, q)
                tangent += np.einsum("ijk,tk->tij", quadratic + quadratic.transpose(0, 2, 1), q)
            matrix = self.linear.copy()
            for d in range(m // self.n):
                part = tangent[:, :, d * self.n : (d + 1) * self.n]
                columns = np.einsum("bt,tij,tc->bicj", self.project, part, self.values[d],
                                    optimize=True)  # fmt: skip
                matrix += columns.reshape(matrix.shape)
            rest = self.linear @ x.ravel() + (self.project @ force - self.load).ravel()
            change = np.linalg.solve(matrix, -rest).reshape(x.shape)
            x = x + change
            if not np.isfinite(x).all():
                return None
            if abs(change).max() < 1e-12 * abs(x).max():
                return x
        return None


def steady_motion(system, ms, response, point, loads, drives, highest):
    """The motion near a point of ``response("p1", ...)``: harmonic of p1, or None if none is found.

    Frequencies of the moving modes are combinations of the load frequencies, or, for a single
    load, of a fraction of its frequency.
    """
    drives = np.array([response.at[point], *drives[1:]])
    amplitudes, frame = response.amplitudes[point], response.frequencies[point]
    moving = np.flatnonzero(abs(amplitudes) > 1e-12 * abs(amplitudes).max())
    part = 1
    if drives.size == 1:
        whole = [q for q in (1, 2, 3, 4, 6)
                 if (abs(frame[moving] * q / drives[0] % 1 - 0.5) > 0.5 - 1e-6).all()]  # fmt: skip
        if not whole:
            return None
        part = whole[0]
    lines = part * np.eye(drives.size, dtype=int)
    balance = Balance(system, drives / part, list(zip(loads.T, lines, strict=True)), highest * part)
    waves = np.array(balance.waves)
    parts = []
    for j in moving:
        distance = abs(abs(waves @ drives / part) - frame[j])
        k = waves[distance.argmin()]
        if distance.min() > 1e-9:
            return None
        parts.append((k * np.sign(k @ drives), amplitudes[j] * ms.mode_shapes[:, j]))
    for k, p, load in zip(lines, drives, loads.T, strict=True):
        # Near a mode the harmonic is part of the amplitudes.
        if (abs(p - ms.frequencies) > ms.tolerance * np.maximum(p, ms.frequencies)).all():
            stiffness = system["stiffness"] - p**2 * system["mass"] + 1j * p * system["damping"]
            parts.append((k, np.linalg.solve(stiffness, load)))
    x = balance.solve(balance.pack(parts))
    return None if x is None else balance.coefficient(x, lines[0])
