"""Motions of elements with internal states, by every method and start: SciPy from switch to switch."""

import numpy as np

from referee.case import Case, Claim, even, few
from referee.switched import Automaton, Contact, Sliders, Stribeck, Turning, state_of

JUDGES = ("Jenkins", "Iwan", "Dahl", "BoucWen", "FluidDamper", "StribeckFriction")
METHODS = ("auto", "gauss8", "gauss16", "gauss2", "gauss3", "rk4", "dop8", "verner8", "verner9")
#: Methods for more coordinates.
_OF_MANY = ("auto", "gauss8", "gauss2", "gauss3")
#: Exponents of the Dahl and Bouc-Wen laws, including non-integer values.
_DAHL, _BOUC_WEN = (0, 0.5, 1, 1.5, 2), (1, 1.5, 2, 2.3, 3)
#: Perturbation for the growth of errors, and the growth above which nothing is checked.
_MOVED, _MOST = 1e-8, 1e3


class Smooth:
    """A smooth law of the deflection and its rate."""

    size = 0

    def __init__(self, direction, law):
        self.direction, self.law = direction, law

    def begin(self, d, v):
        return np.zeros(0)

    def flow(self, d, v, z):
        return z

    def signals(self):
        return ()


class Power(Smooth):
    """c sign(v) |v|^a, with one smooth law on each side of v = 0."""

    def __init__(self, direction, c, a=2):
        super().__init__(direction, lambda d, v: c * np.maximum(v * self.way, 0) ** a * self.way)

    def begin(self, d, v):
        self.way = 1 if v >= 0 else -1
        return np.zeros(0)

    def signals(self):
        yield (lambda d, v, z: self.way * v), (lambda t, y: self.turn())

    def turn(self):
        self.way = -self.way


class Valve(Power):
    """c sign(v) |v|^a, and a line of slope s from the limit on."""

    def __init__(self, direction, c, a, limit, s):
        super().__init__(direction, c, a)
        self.law, self.rate = self.pull_of, (limit / c) ** (1 / a)
        self.c, self.a, self.limit, self.s = c, a, limit, s

    def begin(self, d, v):
        self.opens = abs(v) > self.rate
        return super().begin(d, v)

    def pull_of(self, d, v):
        v = self.way * v
        closed = self.c * np.maximum(v, 0) ** self.a
        return self.way * (self.limit + self.s * (v - self.rate) if self.opens else closed)

    def signals(self):
        yield from super().signals()
        far = 1 if self.opens else -1
        yield (lambda d, v, z: far * (self.way * v - self.rate)), (lambda t, y: self.switch())

    def switch(self):
        self.opens = not self.opens


class Driven(Automaton):
    """The automaton with smooth laws, under loads with corners and jumps."""

    def __init__(self, corners, *given):
        super().__init__(*given)
        self.corners = np.concatenate([[-np.inf], corners, [np.inf]])

    def settle(self, t, y):
        # At a jump of the load the value of the following piece applies until this piece ends.
        i = np.searchsorted(self.corners, t, side="right") - 1
        self.piece = self.corners[i] + 1e-12, self.corners[i + 1] - 1e-12
        super().settle(t, y)

    def push(self, t, y):
        f = self.force(min(max(t, self.piece[0]), self.piece[1]))
        f = f - self.k @ y[: self.n] - self.c @ y[self.n : 2 * self.n]
        for e in self.elements:
            d, v = self.deflection(e, y)
            pull = e.law(d, v) if isinstance(e, Smooth) else e.pull(d, y[e.at])
            f = f - e.direction * pull
        return f

    def run(self, q, v, times):
        whole = np.union1d(times, self.corners[(self.corners > 0) & (self.corners < times[-1])])
        found = super().run(q, v, whole)
        return None if found is None else found[np.isin(whole, times)]


def _direction(rng, n):
    """Attachment of an element: its source, and its vector."""
    if n == 1 or rng.random() < 0.5:
        weights = np.eye(n)[rng.integers(n)]
    elif rng.random() < 0.7:
        i, j = rng.choice(n, 2, replace=False)
        weights = np.eye(n)[i] - np.eye(n)[j]
    else:
        weights = np.array([even(rng, -1, 1, 2) for _ in range(n)])
    return {f"x{i + 1}": float(w) for i, w in enumerate(weights) if w}, weights


def _hysteresis(rng, n):
    """An element with internal states: its source, and its automaton."""
    on, e = _direction(rng, n)
    k, limit, kind = few(rng, 0.5, 20), few(rng, 0.02, 0.8), int(rng.integers(4))
    if kind == 0:
        return f"vv.Jenkins(on={on}, stiffness={k}, limit={limit})", Sliders(e, [k], [limit])
    if kind == 1:
        m = int(rng.integers(2, 6))
        ks = [few(rng, 0.5, 8) for _ in range(m)]
        limits = [few(rng, 0.02, 0.8) for _ in range(m)]
        if rng.random() < 0.3:
            # All sliders yield at the same time.
            ks, limits = ks[:1] * m, limits[:1] * m
        return f"vv.Iwan(on={on}, stiffness={ks}, limit={limits})", Sliders(e, ks, limits)
    if kind == 2:
        p = _DAHL[rng.integers(len(_DAHL))]
        law = Turning(e, lambda z, way: k * np.maximum(1 - way * z / limit, 0) ** p, 0.0, 1.0)
        source = f"vv.Dahl(on={on}, stiffness={k}, limit={limit}, exponent={p})"
        return source, (law if p else Sliders(e, [k], [limit]))
    p = _BOUC_WEN[rng.integers(len(_BOUC_WEN))]
    beta, ratio = few(rng, 0.5, 30), even(rng, 0, 0.5, 2)
    gamma = round(beta * even(rng, -0.9, 2.5, 3), 4)

    def slope(z, way):
        return 1 - (gamma + beta * np.sign(way * z)) * np.abs(z) ** p

    source = (
        f"vv.BoucWen(on={on}, stiffness={k}, ratio={ratio}, beta={beta}, gamma={gamma}, "
        f"exponent={p})"
    )
    return source, Turning(e, slope, ratio * k, (1 - ratio) * k)


def _nearby(rng, n):
    """Additional elements: gaps, polynomials, dampers."""
    on, e = _direction(rng, n)
    k, gap, c = few(rng, 2, 100), few(rng, 0.05, 0.6), few(rng, 0.05, 1)
    a, limit, slope = even(rng, 0.7, 2, 2), few(rng, 0.02, 0.5), few(rng, 0.01, 0.5)
    p, valve = even(rng, 1, 3, 1), f"limit={limit}, relief={slope}"
    return [
        (f"vv.FluidDamper(on={on}, coefficient={c}, exponent={a})", Power(e, c, a)),
        (f"vv.Gap(on={on}, stiffness={k}, gap={gap})", Contact(e, k, gap, False)),
        (f"vv.Stop(on={on}, stiffness={k}, gap={gap})", Contact(e, k, gap, True)),
        (f"vv.Gap(on={on}, stiffness={k}, gap={gap}, exponent={p})", Contact(e, k, gap, False, p)),
        (f"vv.Stop(on={on}, stiffness={k}, gap={gap}, exponent={p})", Contact(e, k, gap, True, p)),
        (
            f"vv.FluidDamper(on={on}, coefficient={c}, exponent={a}, {valve})",
            Valve(e, c, a, limit, slope),
        ),
        (f"vv.Spring(on={on}, law='{k}*d^3')", Smooth(e, lambda d, v: k * d**3)),
        (f"vv.Spring(on={on}, law='{c}*v*abs(v)')", Power(e, c)),
        (f"vv.Spring(on={on}, law='{c}*tanh(v/0.3)')", Smooth(e, lambda d, v: c * np.tanh(v / 0.3))),
    ][rng.integers(9)]  # fmt: skip


def _load(rng, n, mass, end):
    """Load: its source, its function, and the times of its corners."""
    kind = int(rng.integers(4))
    if kind == 0:
        return "", lambda t: np.zeros(n), []
    if kind == 1:
        times = np.unique(np.round(rng.uniform(0, end, int(rng.integers(3, 9))), 2))
        values = np.round(rng.uniform(-1.5, 1.5, (times.size, n)), 3)

        def force(t):
            if not times[0] <= t <= times[-1]:
                return np.zeros(n)
            return np.array([np.interp(t, times, values[:, j]) for j in range(n)])

        source = f"vv.LoadTable(times={times.tolist()}, values={values.tolist()})"
        return f", force={source}", force, times
    nu, second = even(rng, 0.4, 2.5, 3), few(rng, 0.05, 0.5)
    first = np.array([few(rng, 0.1, 2) for _ in range(n)]) * (rng.random(n) < 0.7)
    mean = even(rng, -0.3, 0.5, 2) * (kind == 2)
    orders = (
        f"{{0: {(1j * mean * mass).tolist()}, 1: {first.tolist()}, 2: {(second * mass).tolist()}}}"
    )

    def waves(t):
        return first * np.sin(nu * t) + mass * (second * np.sin(2 * nu * t) + mean)

    return f", load={orders}, nu={nu}", waves, []


def _call(rng, index, method, end, initial, load, times):
    """The call; its results are ``state``, ``error`` and ``outcome``."""
    given = f"initial={initial}, method={method!r}{load}"
    tolerance = 10.0 ** -int(rng.integers(5, 11))
    how = index % 5
    kept = f"times={times.tolist()}"
    run = f"run = vv.simulate(system, {end}, {given}, {kept}, "
    if how == 0:
        run += f"tolerance={tolerance})"
    elif how == 1:
        run += f"rtol={tolerance}, atol={1e-3 * tolerance})"
    elif how == 2:
        run += f"dt={float(rng.choice([0.02, 0.1, 0.3]))}, estimate_error=True)"
    elif how == 3 or "force" in load:
        # In two runs, the second resumed.
        half = times[len(times) // 2 :].tolist()
        run = f"""first = vv.simulate(system, {end / 2}, {given}, tolerance={tolerance})
run = vv.simulate(system, {end}, resume=first, times={half}, estimate_error=True)"""
    else:
        return f"""run = vv.simulate_ensemble(
    system, initial=[{initial}] * 2, t_end={end}, method={method!r}{load}, tolerance={tolerance}
)
state, error, outcome = run.state[-1:], run.error, str(run.outcome[-1])
"""
    return f"{run}\nstate, error, outcome = run.state, run.error, run.outcome\n"


def case(rng, index):
    """Masses with such elements, other elements, dry friction, rigid stops.

    One to three masses; in every sixth case more than explicit methods accept.
    """
    many = index % 6 == 5
    n = int(rng.integers(7, 13) if many else rng.integers(1, 4))
    mass, c = np.array([few(rng, 0.5, 3) for _ in range(n)]), few(rng, 0.005, 0.3)
    stiffness = np.diag([few(rng, 0.3, 3) for _ in range(n)])
    for i in range(n - 1):
        pair = np.eye(n)[i] - np.eye(n)[i + 1]
        stiffness = stiffness + few(rng, 0.2, 3) * np.outer(pair, pair)
    drawn = [_hysteresis(rng, n)]
    for _ in range(int(rng.integers(3))):
        drawn.append(_hysteresis(rng, n) if rng.random() < 0.4 else _nearby(rng, n))
    sources = [source for source, _ in drawn]
    friction: list = [few(rng, 0.03, 0.5) if rng.random() < 0.2 else None for _ in range(n)]
    stops: list = [None] * n
    for j in range(n):
        on = {f"x{j + 1}": 1}
        if friction[j] and rng.random() < 0.5:
            sources.append(f"vv.Spring(on={on}, law='{friction[j]}*sign(v)')")
        elif friction[j]:
            coulomb, v_s = round(friction[j] * even(rng, 0.3, 1, 2), 4), few(rng, 0.05, 0.5)
            d = [1, 1.5, 2][rng.integers(3)]
            sources.append(
                f"vv.StribeckFriction(on={on}, coulomb={coulomb}, static={friction[j]}, "
                f"velocity={v_s}, exponent={d})"
            )
            friction[j] = Stribeck(friction[j], coulomb, v_s, d)
        if rng.random() < 0.12:
            stops[j] = few(rng, 0.1, 0.6), even(rng, 0, 0.9, 1)
            sources.append(f"vv.Gap(on={on}, gap={stops[j][0]}, restitution={stops[j][1]})")
    end = even(rng, 4, 12, 2)
    load, force, corners = _load(rng, n, mass, end)
    resting = rng.random() < 0.25
    q, v = np.round(rng.uniform([[-0.5], [-1]], [[0.09], [1]], (2, n)) * (not resting), 3)
    times = end / 10 * np.arange(11)
    methods = _OF_MANY if many else METHODS
    method = methods[rng.integers(len(methods))] if rng.random() < 0.5 else "auto"
    call = f"""system = vv.Structure(
    mass={mass.tolist()}, stiffness={stiffness.tolist()}, damping={(c * mass).tolist()},
    elements=[{", ".join(sources)}]
)
{_call(rng, index, method, end, state_of(q, v).tolist(), load, times)}"""

    def judge(names, reported):
        yield Claim("outcome", names["outcome"], "completed")
        found = Driven(
            corners, mass, stiffness, np.diag(c * mass), force, [e for _, e in drawn], friction,
            stops,
        )  # fmt: skip
        true, moved = found.run(q, v, times), found.run(q + _MOVED, v - _MOVED, times)
        if true is None or moved is None:
            return
        grows = max(1.0, np.abs(moved - true).max() / _MOVED)
        if grows > _MOST:
            return
        admitted = 3 * names["error"] + 1e-11 * grows
        state = names["state"]
        yield Claim("state", state, true[-len(state) :], admitted, damage=1e-3)

    return Case(call, judge, may_refuse=True)
