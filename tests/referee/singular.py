"""Switches with weakly singular kernels in time: graded collocation from switch to switch.

Each kernel is an independent sum of exponentials: Gauss-Legendre panels over the logarithms of the
rates r of its spectrum from 1e-6 to 1e10. Slower rates are one term, faster rates act at once.
Memory is integrated exactly with a polynomial of degree 9 for the force, the other states by
collocation at the same points. Steps begin at 1e-9 after each switch and double.
"""

from math import gamma

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from referee.case import Case, Claim, even, few
from referee.switched import Automaton, Contact, Fading, Sliders, state_of

JUDGES = ("RabotnovKernel", "RzhanitsynKernel", "AbelKernel", "Jenkins", "Gap")

#: Collocation points as fractions of a step, and the polynomials through them.
_N = 10
_AT = (leggauss(_N)[0] + 1) / 2
_ENDS = np.append(_AT, 1.0)
_VALUES = np.linalg.inv(legvander(2 * _AT - 1, _N - 1))
#: Points at which switching functions are evaluated.
_SEEN = np.linspace(0, 1, 17)[1:]
_FIRST, _LONGEST = 1e-9, 0.04
#: Maximum number of switches.
_MOST = 300


def _basis(x):
    return legvander(2 * x - 1, _N - 1) @ _VALUES


_U, _W = leggauss(32)
_U, _W = (_U + 1) / 2, _W / 2
#: Integrals of the polynomials to each point and to the end.
_PLAIN = np.array([(c * _W) @ _basis(c * _U) for c in _ENDS])


def _fading_integrals(z):
    """Integrals of exp(-z (c - x)) times each polynomial from 0 to c, for each c and z."""
    found = np.empty((_ENDS.size, z.size, _N))
    for i, c in enumerate(_ENDS):
        length = np.minimum(c, 40 / np.maximum(z, 1e-300))[:, None]
        x = length * _U
        weights = length * _W * np.exp(-z[:, None] * x)
        found[i] = np.einsum("qu,quj->qj", weights, _basis(c - x))
    return found


def _panels(low, high, width, order=14):
    g, w = leggauss(order)
    edges = np.linspace(low, high, int(np.ceil((high - low) / width)) + 1)
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (1 + g)).ravel(), (half * w).ravel()


def spectrum(kind, amplitude, alpha, beta):
    """Weights and rates of a sum of exponentials, and the fraction of the force that relaxes at once."""
    shift, beyond = 0.0, 1 / (1 - alpha)
    if kind == "rabotnov":
        # Mittag-Leffler function of order alpha (Gorenflo & Mainardi, 1997).
        beyond = 1.0

        def density(x):
            part = beta * np.exp(-alpha * x)
            below = 1 + 2 * part * np.cos(np.pi * alpha) + part**2
            return amplitude / np.pi * np.sin(np.pi * alpha) * np.exp(x * (1 - alpha)) / below

    else:
        # t^(alpha - 1) = integral r^(-alpha) exp(-r t) dr/Gamma(1 - alpha).
        shift = beta

        def density(x):
            return amplitude / gamma(1 - alpha) * np.exp(x * (1 - alpha))

    low, high = np.log(1e-6), np.log(1e10)
    x, w = _panels(low, high, 0.4 if kind == "rabotnov" and alpha > 0.8 else 1.5)
    weights, rates = w * density(x), np.exp(x)
    x, w = _panels(low - 80 * beyond, low, 2.0)
    slow = w * density(x)
    mean = (slow * np.exp(x)).sum() / slow.sum()
    x, w = _panels(high, high + 40 / alpha, 1.0)
    at_once = (w * density(x) * np.exp(-x)).sum()
    return np.append(weights, slow.sum()), np.append(rates, mean) + shift, at_once


class Remembering(Fading):
    """A spring with such a sum as kernel."""

    def __init__(self, direction, force, law, gap):
        weights, rates, self.at_once = spectrum(*law)
        super().__init__(direction, force, weights, rates, gap)


class Graded(Automaton):
    """The same modes with graded steps. Forces with memory have switches at their gaps only."""

    def __init__(self, mass, stiffness, damping, force, elements):
        none = [None] * len(mass)
        super().__init__(mass, stiffness, damping, force, elements, none, none)
        self.fading = [e for e in elements if isinstance(e, Remembering)]
        self.tables = {}

    def pulled(self, t, y, recalled):
        """All forces, for given memory states."""
        f = self.force(t) - self.k @ y[: self.n] - self.c @ y[self.n : 2 * self.n]
        left = iter(recalled)
        for e in self.elements:
            d = self.deflection(e, y)[0]
            if isinstance(e, Remembering):
                f = f - e.direction * (e.force(d, e.over) * (1 - e.at_once) - next(left))
            else:
                f = f - e.direction * e.pull(d, y[e.at])
        return f

    def flows(self, t, y, recalled):
        """Rates of all states except memory states."""
        out = np.zeros_like(y)
        out[: self.n] = y[self.n : 2 * self.n]
        out[self.n : 2 * self.n] = self.pulled(t, y, recalled) / self.m
        for e in self.elements:
            if not isinstance(e, Remembering):
                out[e.at] = e.flow(*self.deflection(e, y), y[e.at])
        return out

    def rates(self, t, y):
        out = self.flows(t, y, [e.weights @ y[e.at] for e in self.fading])
        for e in self.fading:
            out[e.at] = e.force(self.deflection(e, y)[0], e.over) - e.rates * y[e.at]
        return out

    def table(self, h, keep):
        """For each force with memory: the effect of its values in the step, and of the memory before."""
        if h in self.tables:
            return self.tables[h]
        made = []
        for e in self.fading:
            gained = h * _fading_integrals(e.rates * h)
            kept = np.exp(-e.rates * h * _ENDS[:, None])
            made.append(
                (np.einsum("q,iqj->ij", e.weights, gained), e.weights * kept, gained[-1], kept[-1])
            )
        if keep:
            self.tables[h] = made
        return made

    def step(self, t, y, h, keep=True):
        """States at the points and at the end; memory states at the end only."""
        table = self.table(h, keep)
        at = np.repeat(y[None], _N + 1, 0)
        from_before = [
            kept[:_N] @ y[e.at] for (_, kept, _, _), e in zip(table, self.fading, strict=True)
        ]
        slow = np.ones(y.size, bool)
        for e in self.fading:
            slow[e.at] = False
        rates = np.zeros((_N, y.size))
        for _ in range(60):
            forces = self.forces(at)
            recalled = [
                before + gained[:_N] @ force
                for before, (gained, _, _, _), force in zip(from_before, table, forces, strict=True)
            ]
            new = np.array([
                self.flows(t + c * h, at[i], [r[i] for r in recalled]) for i, c in enumerate(_AT)
            ])  # fmt: skip
            change = h * np.abs(new - rates).max()
            rates = new
            at[:, slow] = (y + h * (_PLAIN @ rates))[:, slow]
            if change < 2e-15:
                break
        forces = self.forces(at)
        for (_, _, gained, kept), e, force in zip(table, self.fading, forces, strict=True):
            at[_N, e.at] = kept * y[e.at] + gained @ force
        return at

    def forces(self, at):
        """Values of each force with memory at the points."""
        return [
            np.array([e.force(self.deflection(e, y)[0], e.over) for y in at[:_N]])
            for e in self.fading
        ]

    def run(self, q, v, times):
        """States at the times, the first of which is 0; None: too many switches."""
        y, t, h = self.start(np.array(q, float), np.array(v, float)), 0.0, _FIRST
        out, switches = [state_of(q, v)], 0
        for goal in times[1:]:
            while t < goal - 1e-14:
                self.settle(t, y)
                length = min(h, goal - t)
                at = self.step(t, y, length)
                met = self.first_signal(t, y, length, at)
                if met is None:
                    y, t = at[_N], goal if length == goal - t else t + length
                    h = h if length < h else min(2 * h, _LONGEST)
                    continue
                part, y, then = met
                t, h, switches = t + part, _FIRST, switches + 1
                then(t, y)
                if switches > _MOST:
                    return None
            out.append(state_of(y[: self.n], y[self.n : 2 * self.n]))
        return np.array(out)

    def first_signal(self, t, y, h, at):
        """Fraction of a step at which the mode ends, the state there, and the following action."""
        through = np.vstack([y[None], at])
        seen = _THROUGH @ through
        best = None
        for g, then in self.signals():
            values = np.array([g(t + x * h, one) for x, one in zip(_SEEN, seen, strict=True)])
            if not (values < -1e-13).any():
                continue
            k = int(np.argmax(values < -1e-13))
            a, b = (_SEEN[k - 1] * h if k else 0.0), _SEEN[k] * h
            part, state = self.located(t, y, a, b, g)
            if best is None or part < best[0]:
                best = part, state, then
        return best

    def located(self, t, y, a, b, g):
        """A change of sign between two fractions of a step, by bracketed secants."""
        state = self.step(t, y, b, keep=False)[_N]
        ga, gb = g(t + a, self.step(t, y, a, keep=False)[_N] if a else y), g(t + b, state)
        if ga <= 0:
            return a, self.step(t, y, a, keep=False)[_N] if a else y.copy()
        side = 0
        for _ in range(60):
            if gb > 0 or b - a < 1e-15 * max(1.0, t):
                break
            c = (a * gb - b * ga) / (gb - ga)
            c = c if a < c < b else (a + b) / 2
            one = self.step(t, y, c, keep=False)[_N]
            gc = g(t + c, one)
            if abs(gc) < 1e-15:
                return c, one
            if gc > 0:
                a, ga = c, gc
                gb, side = (gb / 2, 1) if side == 1 else (gb, 1)
            else:
                b, gb, state = c, gc, one
                ga, side = (ga / 2, -1) if side == -1 else (ga, -1)
        return b, state


#: Interpolation from the states at the start, the points and the end to the checked points.
_THROUGH = legvander(2 * _SEEN - 1, _N + 1) @ np.linalg.inv(
    legvander(2 * np.concatenate([[0.0], _AT, [1.0]]) - 1, _N + 1)
)


def _spring(rng, n):
    """A spring with memory, with or without a kink in its law: its source and its model."""
    place = int(rng.integers(n))
    alpha, beta, share = even(rng, 0.1, 0.85, 2), few(rng, 0.2, 4), even(rng, 0.1, 0.5, 2)
    kind = ["rabotnov", "rzhanitsyn", "abel"][int(rng.integers(3))]
    if kind == "rabotnov":
        amplitude = round(share * beta, 4)
        kernel = f"vv.RabotnovKernel(amplitude={amplitude}, alpha={alpha}, beta={beta})"
    elif kind == "rzhanitsyn":
        amplitude = round(share * beta**alpha / gamma(alpha), 4)
        kernel = f"vv.RzhanitsynKernel(amplitude={amplitude}, alpha={alpha}, beta={beta})"
    else:
        amplitude, beta = round(0.3 * share * alpha, 4), 0.0
        kernel = f"vv.AbelKernel(amplitude={amplitude}, alpha={alpha})"
    k, more, gap = few(rng, 0.5, 4), few(rng, 0.2, 3), np.inf
    law = f"{more}*d^3"
    if rng.random() < 0.5:
        gap = few(rng, 0.05, 0.3)
        law = f"{more}*max(d - {gap}, 0)"

    def force(d, over):
        return k * d + (more * d**3 if gap == np.inf else more * (d - gap) * over)

    source = f"vv.Spring(on='x{place + 1}', stiffness={k}, law={law!r}, kernel={kernel})"
    return source, Remembering(np.eye(n)[place], force, (kind, amplitude, alpha, beta), gap)


def _switch(rng, n):
    """A slider or a gap: its source and its automaton."""
    place = int(rng.integers(n))
    on, direction = f"x{place + 1}", np.eye(n)[place]
    if rng.random() < 0.5:
        k, limit = few(rng, 0.5, 8), few(rng, 0.05, 0.8)
        return f"vv.Jenkins(on={on!r}, stiffness={k}, limit={limit})", Sliders(
            direction, [k], [limit]
        )
    k, gap = few(rng, 3, 30), few(rng, 0.1, 0.6)
    return f"vv.Gap(on={on!r}, stiffness={k}, gap={gap})", Contact(direction, k, gap, False)


def case(rng, index):
    """One or two masses with a spring with memory, and a slider or a gap."""
    n = 1 + index % 2
    mass = np.array([few(rng, 0.5, 3) for _ in range(n)])
    stiffness, c = np.diag([few(rng, 0.5, 3) for _ in range(n)]), few(rng, 0.02, 0.3)
    if n == 2:
        stiffness = stiffness + few(rng, 0.2, 2) * np.array([[1, -1], [-1, 1]])
    drawn = [_switch(rng, n), _spring(rng, n)]
    nu, end = even(rng, 0.5, 1.8, 3), even(rng, 3, 6, 2)
    amplitude = np.array([few(rng, 0.2, 1.5) for _ in range(n)])
    q = np.array([even(rng, -0.3, 0.09, 3) for _ in range(n)])
    v = np.array([even(rng, -0.5, 0.5, 3) for _ in range(n)])
    times = np.linspace(0, end, 5)
    tolerance = [1e-5, 1e-7, 1e-9][index % 3]
    call = f"""system = vv.Structure(
    mass={mass.tolist()}, stiffness={stiffness.tolist()}, damping={(c * mass).tolist()}, elements=[{", ".join(source for source, _ in drawn)}]
)
run = vv.simulate(
    system, {end}, initial={state_of(q, v).tolist()}, load={amplitude.tolist()}, nu={nu}, times={times.tolist()}, tolerance={tolerance}
)
state, error, outcome = run.state, run.error, run.outcome
"""

    def judge(names, reported):
        yield Claim("outcome", names["outcome"], "completed")
        found = Graded(
            mass, stiffness, np.diag(c * mass), lambda t: amplitude * np.sin(nu * t),
            [e for _, e in drawn],
        )  # fmt: skip
        true = found.run(q, v, times)
        if true is not None:
            admitted = 3 * names["error"] + 3e-12
            yield Claim("state", names["state"], true, admitted, damage=1e-3)

    return Case(call, judge)
