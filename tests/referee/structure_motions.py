"""Structures in time against DOP853 of SciPy at its finest tolerance, with memory states."""

import numpy as np

from referee.case import Case, Claim, even, few, numbers
from referee.models import integrate, interleaved, some_prony
from referee.motions import ESTIMATE, claims

JUDGES = (
    "simulate", "Structure", "Structure.deflections", "Spring", "LoadTable", "Past", "Trajectory",
)  # fmt: skip
METHODS = ("auto", "gauss8", "gauss6", "gauss4")


class _Draft:
    """A random structure of few coordinates: elements and memory as matrices."""

    def __init__(self, rng, index):
        n = self.n = int(rng.integers(2, 9))
        self.mass = np.array([few(rng, 0.3, 3, 2) for _ in range(n)])
        self.k = self._links(rng, n, 0.3)
        kind = index % 5
        self.c = np.zeros((n, n))
        options = []
        if kind == 1:
            self.c = np.round(0.05 * self._links(rng, n), 4)
        elif kind == 2:
            turn = np.round(0.3 * rng.normal(size=(n, n)), 2)
            self.c = np.round(0.05 * self._links(rng, n), 4) + turn - turn.T
        if self.c.any():
            options.append(f"damping={numbers(self.c)}")
        if kind == 3:
            a, b = few(rng, 1e-3, 0.1, 2), few(rng, 1e-3, 0.1, 2)
            options.append(f"rayleigh=({a}, {b})")
            self.rayleigh = a, b
        else:
            self.rayleigh = 0.0, 0.0
        self.base = np.ones(n)
        options.append(f"base_direction={numbers(self.base)}")
        self.memory = some_prony(rng, 0.4) if index % 2 else None
        self.elements, texts = [], []
        for _ in range(int(rng.integers(1, 4))):
            e = np.zeros(n)
            chosen = rng.choice(n, int(rng.integers(1, 3)), replace=False)
            e[chosen] = np.array([1.0, -1.0])[: chosen.size]
            own, square, cube = few(rng, 0.1, 1, 2), few(rng, 0.01, 0.2, 2), few(rng, 0.1, 2, 2)
            damper = few(rng, 0.01, 0.2, 2) if kind != 3 and rng.random() < 0.3 else 0.0
            remembers = self.memory is not None and rng.random() < 0.7
            self.elements.append((e, own, square, cube, damper, remembers))
            kernel = f", kernel={self.memory.source}" if remembers else ""
            texts.append(
                f"vv.Spring(on={numbers(e)}, stiffness={own}, damping={damper}, "
                f"law='{square}*d^2 + {cube}*d^3'{kernel})"
            )
        self.source = (
            f"vv.Structure(mass={numbers(self.mass)}, stiffness={numbers(self.k)}, "
            f"{', '.join(options)}, elements=[{', '.join(texts)}])"
        )
        full = self.k.copy()
        for e, own, _, _, damper, _ in self.elements:
            full += own * np.outer(e, e)
            self.c = self.c + damper * np.outer(e, e)
        a, b = self.rayleigh
        self.c = self.c + a * np.diag(self.mass) + b * full
        self.remembering = [e for e in self.elements if e[5]]

    @staticmethod
    def _links(rng, n, stiff=0.0):
        k = np.zeros((n, n))
        for i in range(n):
            e = np.zeros(n)
            e[i] = 1
            if i:
                e[i - 1] = -1
            k += few(rng, 0.3, 3, 2) * np.outer(e, e)
        if rng.random() < stiff:
            i = int(rng.integers(n))
            k[i, i] += few(rng, 10, 300, 2)
        return np.round(k, 3)

    def force(self, e, own, square, cube, u):
        d = e @ u
        return own * d + square * d**2 + cube * d**3

    def right(self, push):
        """Equations of (u, v, memory states of each element and exponential)."""
        n, terms = self.n, 0 if self.memory is None else self.memory.rates.size

        def right(t, y):
            u, v, past = y[:n], y[n : 2 * n], y[2 * n :].reshape(-1, max(terms, 1))
            total = push(t) - self.k @ u - self.c @ v
            gained, j = [], 0
            for e, own, square, cube, _, remembers in self.elements:
                full = self.force(e, own, square, cube, u)
                kept = full
                if remembers:
                    kept = full - past[j] @ self.memory.weights
                    gained.append(full - past[j] * self.memory.rates)
                    j += 1
                total = total - e * kept
            return np.concatenate([v, total / self.mass, *gained])

        return right

    def start(self, state, held=None):
        past = []
        for e, own, square, cube, _, _ in self.remembering:
            full = 0.0 if held is None else self.force(e, own, square, cube, held)
            past.append(full / self.memory.rates)
        return np.concatenate([state[::2], state[1::2], *past])


def case(rng, index):
    """Draw a structure, its load and its start."""
    draft = _Draft(rng, index)
    n = draft.n
    nu = even(rng, 0.3, 2, 3)
    end = even(rng, 3, 12, 3)
    tolerance = float(rng.choice([1e-10, 1e-8]))
    method = METHODS[int(rng.integers(4))]
    state = rng.normal(size=2 * n).round(2) * 0.3 if rng.random() < 0.6 else np.zeros(2 * n)
    held = None
    if draft.memory and rng.random() < 0.3:
        held = rng.normal(size=n).round(2) * 0.2
        state = np.zeros(2 * n)
        state[::2] = held
    load = {1: rng.normal(size=n).round(2) * 0.3, int(rng.choice([0, 3, 20])): 0.2j * np.ones(n)}
    options = [f"method={method!r}", f"tolerance={tolerance}"]
    options.append(f"held={held.tolist()}" if held is not None else f"initial={state.tolist()}")
    kind = int(rng.integers(4))
    breaks, base = [], 0.0
    if kind < 2:
        text = ", ".join(f"{k}: {np.asarray(p).tolist()}" for k, p in load.items())
        options += [f"load={{{text}}}", f"nu={nu}"]
    times = np.cumsum(rng.uniform(0.2, 2, 4)).round(3)
    values = rng.normal(size=4).round(2) * 0.5
    place = int(rng.integers(n))
    if kind in (1, 2):
        breaks = times.tolist()
        options.append(
            f"force=vv.LoadTable(times={breaks}, values={values.tolist()}, on='x{place + 1}')"
        )
    if kind == 3:
        base = few(rng, 0.01, 0.3, 2)
        options += [f"base={base}", f"nu={nu}"]

    def push(t):
        total = np.zeros(n)
        if kind < 2:
            for k, p in load.items():
                total += np.imag(np.asarray(p, complex) * np.exp(1j * k * nu * t))
        if kind in (1, 2) and times[0] <= t <= times[-1]:
            total[place] += np.interp(t, times, values)
        return total + draft.mass * draft.base * base * nu**2 * np.sin(nu * t)

    goes_on = rng.random() < 0.3
    call = f"""system = {draft.source}
run = vv.simulate(system, {end}, {", ".join(options)})
t, state, outcome, error = run.t, run.state, run.outcome, run.error
deflections, named = run.deflections, system.deflections
"""
    if goes_on:
        call += f"""more = vv.simulate(system, {2 * end}, resume=run)
t_more, state_more = more.t, more.state
"""

    def judge(names, reported):
        at = names["t"]
        if goes_on:
            at = np.unique(np.concatenate([at, names["t_more"]]))
        begin = draft.start(state, held)
        # Relative to the base.
        begin[n : 2 * n] -= draft.base * base * nu
        true = integrate(draft.right(push), begin, at, breaks=breaks, rtol=2.3e-14)[:, : 2 * n]
        relative = true[:, :n]
        true = true[:, interleaved(n)].copy()
        true[:, ::2] += np.outer(base * np.sin(nu * at), draft.base)
        true[:, 1::2] += np.outer(base * nu * np.cos(nu * at), draft.base)
        first = np.isin(at, names["t"])
        if np.abs(true).max() > 50:
            # Larger motions: the steps do not resolve the cubic springs.
            return
        size = float(np.abs(true).max())
        yield from claims(names, true[first], tolerance, scale=size)
        yield Claim("tolerance met", bool(names["error"] <= tolerance), True)
        deflections = names["deflections"]
        for column, name in enumerate(names["named"]):
            if name.startswith("x"):
                wanted = relative[first, int(name[1:]) - 1]
                admitted = names["error"] + 0.02 * tolerance + 3e-12 * max(size, 1.0)
                yield Claim(
                    "deflection", deflections[:, column], wanted, admitted, limit=3 * ESTIMATE,
                    damage=max(1e-5, 1e3 * admitted / max(float(np.abs(wanted).max()), 1e-300)),
                )  # fmt: skip
        if goes_on:
            later = np.isin(at, names["t_more"])
            off = 100 * (names["error"] + tolerance)
            yield Claim(
                "state after going on", names["state_more"], true[later], off,
                damage=max(1e-4, 1e3 * off / max(size, 1e-300)),
            )  # fmt: skip

    return Case(call, judge)
