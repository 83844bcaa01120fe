"""Motions in time with switches: SciPy from switch to switch, with the equations of each mode."""

import numpy as np

from referee.case import Case, Claim, even, few
from referee.integration import solve_ivp

JUDGES = ("Jenkins", "Iwan", "Dahl", "BoucWen", "Gap", "Stop", "Spring")
#: Tolerance of an event that has begun; velocity of a bounce that ends in contact.
_NEAR, _SLOW = 1e-10, 3e-7
#: Maximum number of switches.
_MOST = 2000


class Automaton:
    """Masses at the coordinates, each with dry friction and a rigid stop, and elements."""

    def __init__(self, mass, stiffness, damping, force, elements, friction, stops):
        self.m, self.k, self.c, self.force = mass, stiffness, damping, force
        self.elements, self.friction, self.stops = elements, friction, stops
        self.n = len(mass)

    def start(self, q, v):
        y = np.zeros(2 * self.n + sum(e.size for e in self.elements))
        y[: self.n], y[self.n : 2 * self.n] = q, v
        first = 2 * self.n
        for e in self.elements:
            e.at = slice(first, first + e.size)
            first += e.size
            y[e.at] = e.begin(*self.deflection(e, y))
        # For each mass: the sign of its velocity (0: sticking) and the side of the stop in contact.
        self.way = [int(np.sign(x)) or 1 for x in v]
        self.rests = [0] * self.n
        return y

    def deflection(self, e, y):
        return e.direction @ y[: self.n], e.direction @ y[self.n : 2 * self.n]

    def push(self, t, y):
        """All forces except dry friction and rigid stops."""
        q, v = y[: self.n], y[self.n : 2 * self.n]
        f = self.force(t) - self.k @ q - self.c @ v
        for e in self.elements:
            f = f - e.direction * e.pull(self.deflection(e, y)[0], y[e.at])
        return f

    def rates(self, t, y):
        p = self.push(t, y)
        out = np.zeros_like(y)
        for j in range(self.n):
            if (self.friction[j] is None and self.stops[j] is None) or self.way[j]:
                out[j] = y[self.n + j]
                drag = self.friction[j] or 0.0
                if isinstance(drag, Stribeck):
                    drag = drag.at(self.way[j] * y[self.n + j])
                out[self.n + j] = (p[j] - drag * self.way[j]) / self.m[j]
        for e in self.elements:
            out[e.at] = e.flow(*self.deflection(e, out_of(y, out, self.n)), y[e.at])
        return out

    def signals(self):
        """Functions that are positive until the mode ends, each with the following action."""
        found = []
        for e in self.elements:
            for g, then in e.signals():
                found.append((lambda t, y, g=g, e=e: g(*self.deflection(e, y), y[e.at]), then))
        for j in range(self.n):
            if self.friction[j] is None and self.stops[j] is None:
                continue
            limit = self.friction[j] or 0.0
            if not self.way[j]:
                if self.rests[j] <= 0:
                    found.append((lambda t, y, j=j: limit_of(self, j) - self.push(t, y)[j],
                                  lambda t, y, j=j: self.go(j, 1)))  # fmt: skip
                if self.rests[j] >= 0:
                    found.append((lambda t, y, j=j: limit_of(self, j) + self.push(t, y)[j],
                                  lambda t, y, j=j: self.go(j, -1)))  # fmt: skip
                continue
            if limit:
                found.append((lambda t, y, j=j: self.way[j] * y[self.n + j],
                              lambda t, y, j=j: self.turn(t, y, j)))  # fmt: skip
            if self.stops[j] is not None:
                gap = self.stops[j][0]
                found.append((lambda t, y, j=j, gap=gap: gap - y[j],
                              lambda t, y, j=j: self.hit(t, y, j)))  # fmt: skip
        return found

    def go(self, j, way):
        self.way[j], self.rests[j] = way, 0

    def turn(self, t, y, j):
        """At zero velocity the mass sticks or reverses."""
        y[self.n + j] = 0.0
        p = self.push(t, y)[j]
        self.way[j] = 0 if abs(p) <= self.friction[j] else int(np.sign(p))

    def hit(self, t, y, j):
        gap, e = self.stops[j]
        speed = y[self.n + j]
        if speed <= 0 and speed < -_SLOW:
            return
        y[self.n + j] = -e * max(speed, 0.0)
        p, limit = self.push(t, y)[j], self.friction[j] or 0.0
        if abs(y[self.n + j]) < _SLOW and p > -limit:
            y[j], y[self.n + j] = gap, 0.0
            # Pushed with less than the friction force it sticks by friction alone.
            self.way[j], self.rests[j] = 0, 1
        else:
            # In front of the stop by a rounding error, or it would be hit again immediately.
            y[j], self.way[j] = gap - 1e-14, -1

    def run(self, q, v, times):
        """States at the times, the first of which is 0; None: too many switches."""
        y, t = self.start(np.array(q, float), np.array(v, float)), 0.0
        out, left = [state_of(q, v)], list(times[1:])
        for _ in range(_MOST):
            if not left:
                return np.array(out)
            self.settle(t, y)
            signals = [g for g, _ in self.signals()]
            for g in signals:
                g.terminal, g.direction = True, -1
            for longest in (0.2, 0.01):
                run = solve_ivp(
                    self.rates, (t, left[0]), y, "DOP853", rtol=1e-13, atol=1e-15, events=signals,
                    max_step=longest, dense_output=True,
                )  # fmt: skip
                # Contacts that are shorter than a step have no sign change at its ends.
                inside = [x for i in range(1, 8) for x in run.t[:-1] + np.diff(run.t) * i / 8]
                if all(g(x, run.sol(x)) > -1e-12 for x in inside for g in signals):
                    break
            t, y = run.t[-1], run.y[:, -1]
            if run.status == 0:
                out.append(state_of(y[: self.n], y[self.n : 2 * self.n]))
                del left[0]
                continue
            fired = next(i for i, at in enumerate(run.t_events) if at.size)
            t, y = self.corrected(signals[fired], run)
            self.signals()[fired][1](t, y)
        return None

    def stretch(self, y, t, end):
        """State at the end of an interval with smooth forces."""
        while t < end:
            self.settle(t, y)
            signals = [g for g, _ in self.signals()]
            for g in signals:
                g.terminal, g.direction = True, -1
            run = solve_ivp(
                self.rates, (t, end), y, "DOP853", rtol=1e-13, atol=1e-15, events=signals,
                max_step=0.02,
            )  # fmt: skip
            t, y = run.t[-1], run.y[:, -1]
            if run.status == 0:
                break
            fired = next(i for i, at in enumerate(run.t_events) if at.size)
            t, y = self.corrected(signals[fired], run)
            self.signals()[fired][1](t, y)
        return y

    def corrected(self, signal, run):
        """Time and state of an event, by Newton's method with integrations from the previous step."""
        now, y = run.t[-1], run.y[:, -1]
        before, state = run.t[-2], run.y[:, -2]
        for _ in range(3):
            if now > before:
                step = solve_ivp(
                    self.rates, (before, now), state, "DOP853", rtol=1e-13, atol=1e-15
                )  # fmt: skip
                y = step.y[:, -1]
            a = signal(now, y)
            slope = (signal(now + 1e-6, y + 1e-6 * self.rates(now, y)) - a) / 1e-6
            if not abs(slope) > 1e-6 or abs(a) > 1e-6 * abs(slope) or abs(a) < 1e-16:
                break
            now = max(before, now - a / slope)
        return now, y

    def settle(self, t, y):
        """Apply modes that end immediately."""
        for _ in range(50):
            for g, then in self.signals():
                a = g(t, y)
                b = g(t + 1e-6, y + 1e-6 * self.rates(t, y))
                if a < -_NEAR or (a < _NEAR and b < a and b < 0):
                    then(t, y)
                    break
            else:
                return


class Stribeck(float):
    """A static friction force, and the force at a speed."""

    def __new__(cls, static, coulomb, velocity, exponent):
        found = super().__new__(cls, static)
        found.at = lambda speed: (
            coulomb + (static - coulomb) * np.exp(-((max(speed, 0.0) / velocity) ** exponent))
        )
        return found


def limit_of(automaton, j):
    return automaton.friction[j] or 0.0


def out_of(y, rates, n):
    """States with zero velocity for sticking masses."""
    moved = y.copy()
    moved[n : 2 * n] = rates[:n]
    return moved


def state_of(q, v):
    return np.stack([q, v], axis=-1).ravel()


class Sliders:
    """Jenkins elements in parallel; ``z`` are their forces."""

    def __init__(self, direction, stiffness, limit):
        self.direction, self.k, self.limit = direction, np.array(stiffness), np.array(limit)
        self.size = len(stiffness)

    def begin(self, d, v):
        # As after a monotonic path from 0, where all springs are undeflected.
        force = np.clip(self.k * d, -self.limit, self.limit)
        self.slips = [
            int(np.sign(f)) * (abs(f) == b) for f, b in zip(force, self.limit, strict=True)
        ]
        return force

    def pull(self, d, z):
        return z.sum()

    def flow(self, d, v, z):
        return np.where(np.array(self.slips) == 0, self.k * v, 0.0)

    def signals(self):
        for i, slips in enumerate(self.slips):
            if slips:
                yield (lambda d, v, z, s=slips: s * v), (lambda t, y, i=i: self.set(i, 0))
            else:
                for s in (1, -1):
                    yield (
                        (lambda d, v, z, i=i, s=s: self.limit[i] - s * z[i]),
                        (lambda t, y, i=i, s=s: self.set(i, s)),
                    )

    def set(self, i, to):
        self.slips[i] = to


class Turning:
    """A law z' = slope(z, sign of v) v that reverses with v."""

    size = 1

    def __init__(self, direction, slope, elastic, weight):
        self.direction, self.slope, self.elastic, self.weight = direction, slope, elastic, weight

    def begin(self, d, v):
        self.way = 1 if v >= 0 else -1
        way = 1.0 if d >= 0 else -1.0
        run = solve_ivp(
            lambda x, z: self.slope(z, way), (0, d), [0.0], "DOP853", rtol=1e-13, atol=1e-15
        )  # fmt: skip
        self.side = 1 if run.y[0, -1] >= 0 else -1
        return run.y[:, -1]

    def pull(self, d, z):
        return self.elastic * d + self.weight * z[0]

    def flow(self, d, v, z):
        return self.slope(z, self.way) * v

    def signals(self):
        yield (lambda d, v, z: self.way * v), (lambda t, y: self.turn())
        # The slope has a corner where the force crosses 0: steps end there.
        yield (lambda d, v, z: self.side * z[0]), (lambda t, y: self.cross())

    def turn(self):
        self.way = -self.way

    def cross(self):
        self.side = -self.side


class Contact:
    """A spring behind a gap, one-sided or two-sided, with a power of the deflection beyond it."""

    size = 0

    def __init__(self, direction, stiffness, gap, both, power=1):
        self.direction, self.k, self.gap, self.both = direction, stiffness, gap, both
        self.power = power

    def begin(self, d, v):
        self.side = 1 if d > self.gap else -1 if self.both and d < -self.gap else 0
        return np.zeros(0)

    def pull(self, d, z):
        beyond = self.side * d - self.gap
        # Trial steps beyond the switch see an odd continuation.
        return self.side * self.k * np.sign(beyond) * np.abs(beyond) ** self.power

    def flow(self, d, v, z):
        return z

    def signals(self):
        if self.side:
            s = self.side
            yield (lambda d, v, z: s * d - self.gap), (lambda t, y: self.set(0))
            return
        yield (lambda d, v, z: self.gap - d), (lambda t, y: self.set(1))
        if self.both:
            yield (lambda d, v, z: self.gap + d), (lambda t, y: self.set(-1))

    def set(self, to):
        self.side = to


class Fading:
    """A spring with a kernel of exponentials: each memory state follows the force."""

    def __init__(self, direction, force, weights, rates, gap):
        self.direction, self.force, self.gap = direction, force, gap
        self.weights, self.rates = np.array(weights), np.array(rates)
        self.size = len(weights)

    def begin(self, d, v):
        self.over = d > self.gap
        return np.zeros(self.size)

    def pull(self, d, z):
        return self.force(d, self.over) - self.weights @ z

    def flow(self, d, v, z):
        return self.force(d, self.over) - self.rates * z

    def signals(self):
        if self.gap < np.inf:
            s = 1 if self.over else -1
            yield (lambda d, v, z: s * (d - self.gap)), (lambda t, y: self.cross())

    def cross(self):
        self.over = not self.over


def _fading(rng, n):
    """A spring with memory, with or without a kink in its law: its source and its model."""
    place = int(rng.integers(1, n + 1))
    rates = [few(rng, 0.1, 2), few(rng, 2, 60)]
    shares = [even(rng, 0.1, 0.4, 2), even(rng, 0.1, 0.4, 2)]
    weights = [round(share * rate, 4) for share, rate in zip(shares, rates, strict=True)]
    k, cubic, gap = few(rng, 0.5, 4), few(rng, 0.2, 3), np.inf
    law = f"{cubic}*d^3"
    if rng.random() < 0.5:
        gap = few(rng, 0.05, 0.3)
        law = f"{cubic}*max(d - {gap}, 0)"

    def force(d, over):
        more = cubic * d**3 if gap == np.inf else cubic * (d - gap) * over
        return k * d + more

    kernel = f"vv.PronyKernel(weights={weights}, rates={rates})"
    source = f"vv.Spring(on='x{place}', stiffness={k}, law={law!r}, kernel={kernel})"
    return source, Fading(np.eye(n)[place - 1], force, weights, rates, gap)


def _element(rng, n):
    """The source of an element, and its automaton."""
    place = int(rng.integers(1, n + 1))
    on, direction = {f"x{place}": 1}, np.eye(n)[place - 1]
    if n == 2 and rng.random() < 0.4:
        on, direction = {"x1": 1, "x2": -1}, np.array([1.0, -1.0])
    k, kind = few(rng, 0.5, 8), int(rng.integers(6))
    limit = few(rng, 0.05, 0.8)
    if kind == 0:
        return f"vv.Jenkins(on={on}, stiffness={k}, limit={limit})", Sliders(
            direction, [k], [limit]
        )
    if kind == 1:
        ks, limits = [k, few(rng, 0.5, 8)], [limit, few(rng, 0.05, 0.8)]
        return f"vv.Iwan(on={on}, stiffness={ks}, limit={limits})", Sliders(direction, ks, limits)
    if kind == 2:
        power = [1, 2][int(rng.integers(2))]

        def slope(z, way):
            return k * np.maximum(1 - way * z / limit, 0) ** power

        source = f"vv.Dahl(on={on}, stiffness={k}, limit={limit}, exponent={power})"
        return source, Turning(direction, slope, 0.0, 1.0)
    if kind == 3:
        beta, ratio = few(rng, 0.5, 3), even(rng, 0, 0.5, 2)
        gamma = round(0.5 * beta, 3)

        def slope(z, way):
            # |z|^2 has no kink.
            return 1 - gamma * z**2 - beta * way * z * np.abs(z)

        source = (
            f"vv.BoucWen(on={on}, stiffness={k}, ratio={ratio}, beta={beta}, gamma={gamma}, "
            "exponent=2)"
        )
        return source, Turning(direction, slope, ratio * k, (1 - ratio) * k)
    gap, both = few(rng, 0.1, 0.6), kind == 5
    name = "Stop" if both else "Gap"
    return f"vv.{name}(on={on}, stiffness={5 * k}, gap={gap})", Contact(direction, 5 * k, gap, both)


def case(rng, index):
    """One or two masses with elements, dry friction and rigid stops; every third case has memory.

    In every eighth case they are part of a structure of 70 coordinates.
    """
    n = 1 + index % 2
    twins = n == 2 and rng.random() < 0.25
    mass = np.array([few(rng, 0.5, 3) for _ in range(n)])
    k, c = np.array([few(rng, 0.5, 3) for _ in range(n)]), few(rng, 0.02, 0.3)
    between = few(rng, 0.2, 2) if n == 2 else 0.0
    drawn = [_element(rng, n) for _ in range(int(rng.integers(0, 3)))]
    remembers = index % 3 == 2
    if remembers:
        twins = False
        drawn += [_fading(rng, n) for _ in range(int(rng.integers(1, 3)))]
    friction: list = [None] * n
    stops: list = [None] * n
    sources = [source for source, _ in drawn]
    for j in range(n):
        if rng.random() < 0.45:
            friction[j] = few(rng, 0.05, 0.5)
        if remembers and any(
            np.array_equal(e.direction, np.eye(n)[j]) and isinstance(e, (Sliders, Turning))
            for _, e in drawn
        ):
            # Both on one deflection are refused with memory.
            friction[j] = None
        if rng.random() < 0.3:
            stops[j] = (few(rng, 0.1, 0.6), even(rng, 0, 0.9, 1))
    if twins:
        # Two masses with the same motion: all their switches coincide.
        mass[1], k[1], friction[1], stops[1], drawn = mass[0], k[0], friction[0], stops[0], []
        sources = []
    for j in range(n):
        on = {f"x{j + 1}": 1}
        if friction[j] is not None:
            law = f"{friction[j]}*sign(v)"
            sources.append(f"vv.Spring(on={on}, stiffness=0, law={law!r})")
        if stops[j] is not None:
            gap, e = stops[j]
            sources.append(f"vv.Gap(on={on}, gap={gap}, restitution={e})")
    nu, end = even(rng, 0.5, 1.8, 3), even(rng, 6, 14, 2)
    amplitude = np.array([few(rng, 0.2, 1.5) for _ in range(n)])
    if twins:
        amplitude[1] = amplitude[0]
    second, mean = few(rng, 0.05, 0.5), even(rng, -0.3, 0.5, 2)
    q = np.array([even(rng, -0.3, 0.09, 3) for _ in range(n)])
    v = np.array([even(rng, -0.5, 0.5, 3) for _ in range(n)])
    if twins:
        q[1], v[1] = q[0], v[0]
    stiffness = np.diag(k)
    if n == 2:
        stiffness = stiffness + between * np.array([[1, -1], [-1, 1]])
    times = np.linspace(0, end, 13)
    # A chain without connection to the masses does not change their motion.
    more = 68 if index % 8 == 7 else 0
    call = f"""k = np.zeros(({n + more}, {n + more}))
k[{n}:, {n}:] = 2 * np.eye({more}) - np.eye({more}, k=1) - np.eye({more}, k=-1)
k[:{n}, :{n}] = {stiffness.tolist()}
rest = {more} * [0.0]
system = vv.Structure(
    mass={mass.tolist()} + {more} * [1.0], stiffness=k, damping={(c * mass).tolist()} + rest, elements=[{", ".join(sources)}]
)
load = {{0: {(1j * mean * mass).tolist()} + rest, 1: {amplitude.tolist()} + rest, 2: {(second * mass * 1.0).tolist()} + rest}}
run = vv.simulate(
    system, {end}, initial={state_of(q, v).tolist()} + 2 * rest, load=load, nu={nu}, times={times.tolist()}, tolerance=1e-8,
    coordinates={[f"x{j + 1}" for j in range(n)]},
)
state, error, outcome = run.state, run.error, run.outcome
"""

    def force(t):
        own = amplitude * np.sin(nu * t) + second * mass * np.sin(2 * nu * t)
        return own + mean * mass

    def judge(names, reported):
        yield Claim("outcome", names["outcome"], "completed")
        found = Automaton(
            mass, stiffness, np.diag(c * mass), force, [e for _, e in drawn], friction, stops
        )
        true = found.run(q, v, times)
        moved = found.run(q + 1e-8, v - 1e-8, times)
        if true is None or moved is None:
            return
        # Growth of a small error until the end, and the uncertainty of the reference.
        grows = max(1.0, np.abs(moved - true).max() / 1e-8)
        if grows > 1e3:
            return
        admitted = 10 * names["error"] + 1e-10 * grows
        yield Claim("state", names["state"], true, admitted, damage=1e-3)

    return Case(call, judge, may_refuse=True)
