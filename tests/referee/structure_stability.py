"""Stability of condensed structures: multipliers of the full ordinary equations by Magnus expansion."""

import numpy as np

from referee.balance import growing, multipliers_of
from referee.case import Case, Claim, few, numbers
from referee.models import some_prony

JUDGES = ("forced_response", "Structure", "StabilityWarning")
#: Multipliers with a magnitude this near to 1 are not decided.
CLOSE = 3e-9
KINDS = ("light", "gyroscopic", "negative", "rigid", "layered", "near-equal")


class _Draft:
    """A structure with cubic elements, with or without memory, and its equations as matrices."""

    def __init__(self, rng, index):
        kind = self.kind = KINDS[index % len(KINDS)]
        n = self.n = int(rng.integers(2, 11))
        self.mass = np.array([few(rng, 0.5, 2, 3) for _ in range(n)])
        if kind == "near-equal":
            self.mass[:] = 1.0
        cuts = np.diff(np.eye(n), axis=0)
        tie = few(rng, 1e-6, 1e-3, 2) if kind == "near-equal" else few(rng, 0.3, 2, 2)
        self.k = tie * cuts.T @ cuts
        if kind == "near-equal":
            self.k += np.eye(n)
        elif kind != "rigid":
            self.k[0, 0] += few(rng, 0.3, 2, 2)
        if kind == "negative":
            self.k[-1, -1] -= few(rng, 0.3, 1.5, 2)
        self.k = np.round(self.k, 9)
        self.c, given = np.zeros((n, n)), ""
        if kind == "gyroscopic":
            turn = np.round(0.2 * rng.normal(size=(n, n)), 2)
            self.c = np.diag([few(rng, 0.001, 0.1, 2) for _ in range(n)]) + turn - turn.T
            given = f", damping={numbers(self.c)}"
        elements, self.elements, self.states = [], [], []
        self.memory = some_prony(rng, 0.4) if index // 6 % 2 or kind == "layered" else None
        for j in range(int(rng.integers(1, 3))):
            e = np.zeros(n)
            e[n - 1 - j] = 1.0
            if j and rng.random() < 0.5:
                e[0] -= 1.0
            if not e.any():
                continue
            # Steep springs stabilize the springs with negative stiffness.
            own, square, cube = few(rng, 0.05, 0.5, 2), few(rng, 0.01, 0.4, 2), few(rng, 0.3, 3, 2)
            kernel = ""
            remembers = self.memory is not None and kind != "layered"
            if remembers:
                kernel = f", kernel={self.memory.source}"
                self.states.append((e, j))
            self.elements.append((e, own, square, cube, remembers))
            elements.append(
                f"vv.Spring(on={numbers(e)}, stiffness={own}, "
                f"law='{square}*d^2 + {cube}*d^3'{kernel})"
            )
        self.layer = np.zeros((n, n))
        if kind == "layered":
            self.layer = np.round(few(rng, 0.1, 1, 2) * cuts.T @ cuts, 9)
            given += f", layers=[({numbers(self.layer)}, {self.memory.source})]"
        if not self.c.any():
            ratio = few(rng, 0.001, 0.02, 2)
            rest = self.k + self.layer + sum(o * np.outer(e, e) for e, o, *_ in self.elements)
            root = 1 / np.sqrt(self.mass)
            squares, shapes = np.linalg.eigh(root[:, None] * rest * root)
            pushed = np.sqrt(self.mass)[:, None] * shapes
            self.c = (pushed * (2 * ratio * np.sqrt(np.maximum(squares, 0)))) @ pushed.T
            given += f", modal_damping={ratio}"
        squares = np.linalg.eigvalsh(
            (self.k + self.layer + sum(o * np.outer(e, e) for e, o, *_ in self.elements))
            / np.sqrt(np.outer(self.mass, self.mass))
        )
        self.frequencies = np.sqrt(np.abs(squares))
        self.source = (
            f"vv.Structure(mass={numbers(self.mass)}, stiffness={numbers(self.k)}{given}, "
            f"elements=[{', '.join(elements)}])"
        )

    def matrices(self, u):
        """Linearized equations x' = A x at displacements u, shape (instants, n)."""
        n, count = self.n, u.shape[0]
        w = np.zeros(0) if self.memory is None else self.memory.weights
        r = np.zeros(0) if self.memory is None else self.memory.rates
        layered = self.kind == "layered"
        # Memory states: for each exponential of an element, or of all coordinates of a layer.
        held = len(self.states) if not layered else n
        total = 2 * n + w.size * held
        a = np.zeros((count, total, total))
        a[:, :n, n : 2 * n] = np.eye(n)
        a[:, n : 2 * n, :n] = -(self.k + self.layer)
        a[:, n : 2 * n, n : 2 * n] = -self.c
        at = 2 * n
        for e, own, square, cube, remembers in self.elements:
            d = u @ e
            slope = own + 2 * square * d + 3 * cube * d**2
            a[:, n : 2 * n, :n] -= slope[:, None, None] * np.outer(e, e)
            if remembers:
                for one, rate in zip(w, r, strict=True):
                    a[:, n : 2 * n, at] += e
                    a[:, at, :n] = one * slope[:, None] * e
                    a[:, at, at] = -rate
                    at += 1
        if layered:
            for one, rate in zip(w, r, strict=True):
                part = slice(at, at + n)
                a[:, n : 2 * n, part] += self.layer
                a[:, part, :n] = one * np.eye(n)
                a[:, part, part] = -rate * np.eye(n)
                at += n
        a[:, n : 2 * n] /= self.mass[:, None]
        return a


def _multipliers(draft, x, orders, nu):
    """Largest first, with the error of each magnitude."""
    period = 2 * np.pi / nu

    def matrices(t):
        return draft.matrices((np.exp(1j * nu * np.outer(t, orders)) @ x.T).imag)

    n = int(max(96, np.ceil(3 * draft.frequencies.max() * period)))
    return multipliers_of(matrices, period, n)


def case(rng, index):
    """Draw a structure and motions near its resonances."""
    draft = _Draft(rng, index)
    n, count = draft.n, 6
    near = draft.frequencies[rng.integers(n, size=count)]
    near = np.maximum(near, 0.05)
    nu = [float(f"{x:.4g}") for x in near * rng.choice([0.5, 0.9, 1, 1.05, 2], count)
          * rng.uniform(0.95, 1.1, count)]  # fmt: skip
    size = few(rng, 3e-3, 0.5, 2)
    call = f"""system = {draft.source}
r = vv.forced_response(system, {sorted(set(nu))}, load={{"x{int(rng.integers(n)) + 1}": {size}}},
                       method="newton", stability=True, coordinates=list(system.dof_names))
"""

    def judge(names, reported):
        r = names["r"]
        for i in np.flatnonzero(r.converged & (r.truncation < 1e-9)):
            own, off = _multipliers(draft, r.coefficients[i], r.harmonics, r.nu[i])
            sizes = np.abs(own)
            # Omitted harmonics would change each multiplier by about this fraction.
            off = off + 1e3 * r.truncation[i] * sizes
            if abs(sizes[0] - 1) < 10 * off[0] + CLOSE:
                continue
            if r.stable[i] is None:
                yield Claim(
                    "unknown stability is reported", any("Stability" in t for t in reported), True
                )
                continue
            yield Claim("stable", bool(r.stable[i]), bool(sizes[0] < 1))
            got = np.abs(r.multipliers[i])
            got = got[np.isfinite(got)]
            if got.size and r.slowest[i]:
                yield Claim(
                    "slowest multiplier", got.max(), sizes[0], 1e-5 * sizes[0] + 10 * off[0],
                    damage=1e-3,
                )  # fmt: skip
            grown = growing(got, sizes, off, 1e-5, CLOSE) if r.slowest[i] and got.size else None
            if grown is not None:
                yield grown

    return Case(call, judge)
