"""Sparse structures: direct solution of the full equations at the motions; eigenvalues of the ordinary equations."""

import numpy as np
import scipy.linalg

from referee.case import Case, Claim, even, few, numbers
from referee.models import some_prony

JUDGES = (
    "Structure.reduce", "Structure.reduction", "Structure.characteristic_roots",
    "Structure.natural_frequencies",
)  # fmt: skip


class _Chain:
    """A chain of n masses with additional springs to the ground or between masses, with its matrices."""

    def __init__(self, rng):
        n = self.n = int(rng.integers(40, 120))
        self.mass = np.array([few(rng, 0.5, 2, 3) for _ in range(n)])
        links = [(i, i + 1, few(rng, 0.5, 2, 3)) for i in range(n - 1)]
        links += [(0, -1, 1.0), (n - 1, -1, even(rng, 0.5, 2, 2))]
        for _ in range(n // 6):
            i, j = (int(x) for x in rng.choice(n, 2, replace=False))
            links.append((i, j, few(rng, 0.05, 0.5, 2)))
        self.k = np.zeros((n, n))
        for i, j, k in links:
            e = np.zeros(n)
            e[i] = 1
            if j >= 0:
                e[j] = -1
            self.k += k * np.outer(e, e)
        self.rayleigh = (few(rng, 1e-3, 1e-2, 2), few(rng, 1e-3, 1e-2, 2))
        self.dashpot = (int(rng.integers(n)), few(rng, 0.01, 0.2, 2)) if rng.integers(2) else None
        self.c = np.zeros((n, n))
        if self.dashpot:
            self.c[self.dashpot[0], self.dashpot[0]] = self.dashpot[1]
        # Coordinates without mass and damping.
        if rng.integers(3) == 0 and not self.dashpot:
            self.mass[rng.choice(n, 3, replace=False)] = 0.0
        self.ratio = 0.0

    def modal(self, stiffness, count):
        """Matrix of modal damping for ``count`` modes; proportional to K above them."""
        mass = np.diag(self.mass)
        squares, shapes = (part[..., :count] for part in scipy.linalg.eigh(stiffness, mass))
        slope = 2 * self.ratio / squares[-1] ** 0.5
        rates = 2 * self.ratio * squares**0.5 - slope * squares
        return slope * stiffness + mass @ shapes @ np.diag(rates) @ shapes.T @ mass

    def source(self, elements):
        entries = [
            (i, j, self.k[i, j]) for i, j in zip(*np.nonzero(self.k), strict=True)
        ]  # fmt: skip
        rows, columns, values = (numbers([entry[a] for entry in entries]) for a in range(3))
        damping = ""
        if self.dashpot:
            i, c = self.dashpot
            damping = f" damping=sp.csc_array(([{c}], ([{i}], [{i}])), shape=({self.n}, {self.n})),"
        if self.ratio:
            damping += f" modal_damping={self.ratio},"
        return f"""import scipy.sparse as sp
k = sp.csc_array(({values}, ({rows}, {columns})), shape=({self.n}, {self.n}))
s = vv.Structure(mass={numbers(self.mass)}, stiffness=k,{damping} rayleigh={self.rayleigh},
                 elements=[{elements}])
"""


def _motion(rng, index):
    chain = _Chain(rng)
    n = chain.n
    if chain.mass.all() and rng.integers(2):
        chain.ratio = few(rng, 0.002, 0.05, 2)
    on, across = (int(x) for x in rng.choice(n, 2, replace=False))
    cubic, own = few(rng, 0.1, 3, 2), few(rng, 0.05, 0.5, 2)
    memory = some_prony(rng) if rng.integers(2) else None
    kernel = f", kernel={memory.source}" if memory else ""
    e = np.zeros(n)
    e[on], e[across] = 1, -1
    pushed = int(rng.integers(n))
    size = few(rng, 0.002, 0.05, 2)
    nu, tolerance = even(rng, 0.05, 0.3, 3), float(rng.choice([1e-4, 1e-6, 1e-8]))
    method = ["modes", "craig-bampton"][int(rng.integers(2))]
    spring = f"vv.Spring(on={{'x{on + 1}': 1, 'x{across + 1}': -1}}, stiffness={own}, law='{cubic}*d^3'{kernel})"
    call = f"""{chain.source(spring)}small = s.reduce(frequency={5.1 * nu}, tolerance={tolerance}, loads=['x{pushed + 1}'], method={method!r})
r = vv.forced_response(small, [{nu}], load={{'x{pushed + 1}': {size}}}, method="newton", harmonics=5,
                       coordinates=list(s.dof_names))
u, orders, found = r.coefficients[0], r.harmonics, bool(r.converged[0])
error, reported = small.reduction.largest_error, float(r.reduction_error[0])
modes, checked = small.reduction.n_modes, float(r.check(points=1).max())
omega = s.natural_frequencies()
"""

    def judge(names, reported):
        heavy = chain.mass > 0
        k = chain.k + own * np.outer(e, e)
        carried = np.linalg.solve(k[~heavy][:, ~heavy], k[~heavy][:, heavy])
        bent = k[heavy][:, heavy] - k[heavy][:, ~heavy] @ carried
        true = np.sqrt(scipy.linalg.eigvalsh(bent, np.diag(chain.mass[heavy])))
        yield Claim("natural frequencies", names["omega"], true, 1e-9 * true)
        if not names["found"]:
            return
        u, orders = names["u"], names["orders"]
        yield Claim("largest error", float(names["error"]) <= tolerance, True)
        yield Claim("error of the motion", float(names["reported"]) <= tolerance, True)
        yield Claim("check", names["checked"] <= 30 * tolerance, True)
        k = chain.k + own * np.outer(e, e)
        count = 64
        t = 2 * np.pi * np.arange(count) / count
        d = np.imag(np.exp(1j * np.outer(t, orders)) @ (e @ u))
        force = np.fft.rfft(cubic * d**3)
        a, b = chain.rayleigh
        damping = chain.c
        if chain.ratio:
            damping = damping + chain.modal(k, names["modes"])
        exact = np.zeros_like(u)
        for column, order in enumerate(orders):
            s = 1j * order * nu
            c = 2j / count * force[order]
            if memory:
                forgotten = memory.laplace(np.array(s))
                c = c - forgotten * (c + own * (e @ u[:, column]))
            p = -c * e
            if order == 1:
                p = p + size * (np.arange(n) == pushed)
            full = k * (1 + b * s) + np.diag(chain.mass * (s**2 + a * s)) + s * damping
            exact[:, column] = np.linalg.solve(full, p)
        # Relative to the largest motion; the strain energy norm differs slightly from this norm.
        scale = np.abs(u).max()
        yield Claim("displacements", u, exact, 30 * tolerance * scale, damage=0.1)

    return Case(call, judge)


def _roots(rng, index):
    chain = _Chain(rng)
    chain.mass[chain.mass == 0] = 1.0
    n = chain.n
    memory = some_prony(rng)
    on, own = int(rng.integers(n)), few(rng, 0.2, 2, 2)
    count = int(rng.integers(1, 6))
    spring = f"vv.Spring(on={on}, stiffness={own}, kernel={memory.source})"
    call = f"""{chain.source(spring)}roots = s.characteristic_roots({count}).oscillatory
"""

    def judge(names, reported):
        found = names["roots"]
        yield Claim("how many", found.size, count)
        e = (np.arange(n) == on).astype(float)
        a, b = chain.rayleigh
        k = chain.k + own * np.outer(e, e)
        c = chain.c + a * np.diag(chain.mass) + b * k
        inverse = 1 / chain.mass
        q = memory.rates.size
        # z_j' = e.u - rate_j z_j; the force on e is own (e.u - sum weight_j z_j).
        matrix = np.zeros((2 * n + q, 2 * n + q))
        matrix[:n, n : 2 * n] = np.eye(n)
        matrix[n : 2 * n, :n] = -inverse[:, None] * k
        matrix[n : 2 * n, n : 2 * n] = -inverse[:, None] * c
        matrix[n : 2 * n, 2 * n :] = inverse[:, None] * own * np.outer(e, memory.weights)
        matrix[2 * n :, :n] = e
        matrix[2 * n :, 2 * n :] = -np.diag(memory.rates)
        values = np.linalg.eigvals(matrix)
        nearest = np.array([values[np.argmin(np.abs(values - s))] for s in found])
        yield Claim("roots", found, nearest, 1e-9 * np.abs(nearest).max())
        up = np.sort(values.imag[values.imag > 1e-6])[:count]
        # Sorted by the frequency of the modes; memory may exchange close roots.
        yield Claim("frequencies", np.sort(found.imag), up, 1e-6 * up, damage=1e-3)

    return Case(call, judge)


def case(rng, index):
    """Draw a sparse chain."""
    return _roots(rng, index) if index % 3 == 2 else _motion(rng, index)
