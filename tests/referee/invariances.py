"""The same system in other units, order, signs and phases: results must agree after transformation."""

from dataclasses import dataclass, replace

import numpy as np

from referee.case import Case, Claim, even, few, number, numbers

JUDGES = (
    "forced_response",
    "trace_response",
    "backbone",
    "simulate",
    "simulate_ensemble",
    "MultipleScales.response",
    "PolynomialSystem.characteristic_roots",
    "Structure.characteristic_roots",
    "Response.converged",
)
_KINDS = ("units", "order", "signs", "phase", "mixed units")


@dataclass(frozen=True)
class Drawn:
    """A system as numbers: u_i = units_i times its value in the first units."""

    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    #: (equation, powers, coefficient), and laws (coordinate, kind, factor, width).
    monomials: tuple
    laws: tuple
    kernel: tuple | None
    loads: dict
    structure: bool
    units: np.ndarray
    time: float = 1.0
    force: float = 1.0
    order: np.ndarray = None
    phase: float = 0.0

    @property
    def n(self):
        return len(self.mass)

    @property
    def names(self):
        return ["x"] if self.n == 1 and not self.structure else [f"x{i + 1}" for i in range(self.n)]

    def in_other(self, **numbers_):
        """Return the same system in other units, order or phase."""
        return replace(self, **numbers_)

    def place(self, i):
        """Position of coordinate i."""
        return int(np.flatnonzero(self.order == i)[0])

    def vector(self, values):
        """Forces on the coordinates."""
        return (np.asarray(values) * self.units * self.force)[self.order]

    def state(self, values):
        """A state of this system, values of shape (n, 2)."""
        scaled = np.asarray(values) / np.c_[self.units, self.units / self.time]
        return scaled[self.order].ravel()

    def back(self, values):
        """Displacements in the first units, coordinates last."""
        values = np.asarray(values)
        return values[..., np.argsort(self.order)] * self.units

    def states_back(self, states):
        """States (..., 2 n) as (..., n, 2) in the first units."""
        states = np.asarray(states).reshape(*np.shape(states)[:-1], self.n, 2)
        states = states[..., np.argsort(self.order), :]
        return states * np.c_[self.units, self.units / self.time]

    def load(self):
        """Source of the load."""
        turned = {
            k: self.vector(p) * (np.exp(1j * k * self.phase) if k else 1.0)
            for k, p in self.loads.items()
        }
        texts = [f"{k}: np.array({numbers_of(p)})" for k, p in turned.items()]
        return "{" + ", ".join(texts) + "}"

    def source(self):
        """Source of the system."""
        both = np.outer(self.units, self.units) * self.force
        pick = np.ix_(self.order, self.order)
        mass, damping = (
            (both * self.mass / self.time**2)[pick],
            (both * self.damping / self.time)[pick],
        )
        stiffness, kernel = (both * self.stiffness)[pick], self.memory()
        matrices = (
            f"mass={numbers(mass)}, stiffness={numbers(stiffness)}, damping={numbers(damping)}"
        )
        forces = self.forces()
        if not self.structure:
            texts = {name: " + ".join(parts) for name, parts in forces.items()}
            given = repr(texts["x"]) if "x" in texts else repr(texts)
            return f"vv.PolynomialSystem({matrices}, forces={given}, kernel={kernel})"
        springs = ", ".join(
            f"vv.Spring(on={name!r}, law={' + '.join(parts)!r}, kernel={kernel})"
            for name, parts in forces.items()
        )
        return f"vv.Structure({matrices}, elements=[{springs}])"

    def memory(self):
        """Source of the kernel."""
        if self.kernel is None:
            return "None"
        a, b = self.kernel[1] * self.time, self.kernel[2] * self.time
        if self.kernel[0] == "prony":
            return f"vv.PronyKernel(weights=[{number(a)}], rates=[{number(b)}])"
        alpha = self.kernel[3]
        a = number(self.kernel[1] * self.time**alpha)
        return f"vv.RzhanitsynKernel(amplitude={a}, alpha={alpha!r}, beta={number(b)})"

    def forces(self):
        """Texts of the forces by coordinate."""
        parts: dict[str, list[str]] = {}
        names = [self.names[self.place(i)] for i in range(self.n)]
        for row, powers, c in self.monomials:
            scaled = c * self.force * self.units[row] * np.prod(self.units**powers)
            factors = [
                f"{'d' if self.structure else name}^{p}"
                for name, p in zip(names, powers, strict=True) if p
            ]  # fmt: skip
            parts.setdefault(names[row], []).append("*".join([f"({number(scaled)})", *factors]))
        for i, kind, c, width in self.laws:
            u, name = self.units[i], names[i]
            x, v = ("d", "v") if self.structure else (name, f"{name}_dot")
            if kind == "tanh":
                w = number(width / abs(u) * self.time)
                text = f"({number(c * self.force * abs(u))})*tanh({v}/{w})"
            elif kind == "drag":
                c = number(c * self.force * abs(u) ** 3 / self.time**2)
                text = f"({c})*{v}*abs({v})"
            else:
                side = "max" if u > 0 else "min"
                c = number(c * self.force * u**2)
                text = f"({c})*{side}({x} - ({number(width / u)}), 0)"
            parts.setdefault(name, []).append(text)
        return parts


def numbers_of(values):
    """Source of complex numbers."""
    return "[" + ", ".join(repr(complex(z)) for z in values) + "]"


def some_system(rng, memory, laws, structure):
    """Draw a system of one to three coordinates."""
    n = int(rng.integers(1, 4))
    a, b = rng.normal(size=(2, n, n))
    stiffness = np.diag(rng.uniform(0.5, 3, n)) + 0.3 * b @ b.T
    monomials = [(i, 3 * np.eye(n, dtype=int)[i], few(rng, 0.1, 1)) for i in range(n)]
    for _ in range(int(rng.integers(3))):
        row, degree = int(rng.integers(n)), int(rng.choice([2, 3, 5]))
        at = np.full(degree, row) if structure else rng.integers(0, n, degree)
        monomials.append((row, np.bincount(at, minlength=n), even(rng, -0.3, 0.3)))
    drawn_laws = ()
    if laws:
        kind = str(rng.choice(["tanh", "drag", "gap"]))
        drawn_laws = ((int(rng.integers(n)), kind, few(rng, 0.1, 0.4), few(rng, 0.1, 0.5)),)
    kernel = None
    if memory:
        kernel = ("prony", few(rng, 0.02, 0.2), few(rng, 0.3, 2))
        if rng.random() < 0.5:
            kernel = ("singular", few(rng, 0.01, 0.08), few(rng, 0.2, 1), even(rng, 0.2, 0.9))
    loads = {1: rng.normal(size=n) * 0.2}
    if rng.random() < 0.4:
        loads[2] = rng.normal(size=n) * 0.1 + 0.05j
    if rng.random() < 0.3:
        loads[0] = 0.05j * rng.normal(size=n)
    return Drawn(
        np.eye(n) + 0.2 * a @ a.T / n, rng.uniform(0.02, 0.1) * stiffness, stiffness,
        tuple(monomials), drawn_laws, kernel, loads, structure, np.ones(n), order=np.arange(n),
    )  # fmt: skip


def other(rng, system, kind):
    """Return the same system in other units, order, signs or phase."""
    n = system.n
    if kind == "units":
        return system.in_other(
            units=np.full(n, few(rng, 1e-4, 1e4)), time=few(rng, 1e-6, 1e6),
            force=few(rng, 1e-12, 1e12),
        )  # fmt: skip
    if kind == "order":
        return system.in_other(order=rng.permutation(n))
    if kind == "signs":
        return system.in_other(units=rng.choice([-1.0, 1.0], n))
    if kind == "phase":
        return system.in_other(phase=even(rng, 0.1, 6))
    return system.in_other(units=np.array([few(rng, 1e-3, 1e3) for _ in range(n)]))


def case(rng, index):
    """Draw a system, its transformation and a method."""
    makers = (_response, _motion, _branch, _free, _scales, _many)
    method = makers[index % len(makers)]
    polynomial = method in (_free, _scales, _branch)
    rich = not polynomial and rng.random() < 0.6
    often = 0.9 if method is _motion else 0.6
    memory = rich and method is not _many and rng.random() < often
    system = some_system(
        rng, memory, rich and not memory and method is not _many,
        method in (_response, _motion) and bool(rng.random() < 0.4),
    )  # fmt: skip
    if method in (_response, _branch) and memory and system.kernel[0] == "singular":
        system = system.in_other(loads={1: system.loads[1]})
    kinds = [k for k in _KINDS if k != "phase" or method is _response]
    kind = kinds[int(rng.integers(len(kinds)))]
    return method(rng, system, other(rng, system, kind))


def _pair(first, second, body):
    """Source of the same call for both systems."""
    return f"a = {first.source()}\nb = {second.source()}\n" + body


def _close(what, got, true, part, axis=None):
    """Equal within a fraction of the largest value along an axis."""
    got, true = np.asarray(got), np.asarray(true)
    size = np.abs(true).max(axis=axis, keepdims=True) if true.size else 1.0
    return Claim(what, got, true, part * np.maximum(size, 1e-300) + 0 * np.abs(true))


def _response(rng, one, two):
    nu = np.array([even(rng, 0.3, 3) for _ in range(3)])
    orders = 13 if one.laws else "'auto'"
    lines = [
        f"{r} = vv.forced_response({s}, {numbers(nu * d.time)}, load={d.load()}, method='newton', "
        f"stability=True, harmonics={orders})\n{r}_roots = {s}.characteristic_roots().oscillatory\n"
        for r, s, d in (("p", "a", one), ("q", "b", two))
    ]

    def judge(names, reported):
        p, q = names["p"], names["q"]
        roots = names["p_roots"].imag, names["q_roots"].imag / two.time
        if not np.isnan([*names["p_roots"], *names["q_roots"]]).any():
            yield _close("roots", np.sort(roots[1]), np.sort(roots[0]), 1e-9)
        both = p.converged & q.converged
        yield Claim("converged", q.converged, p.converged)
        wide = np.zeros((2, nu.size, 200, one.n), complex)
        wide[0][:, p.harmonics] = np.swapaxes(p.coefficients, 1, 2)
        turned = two.back(np.swapaxes(q.coefficients, 1, 2))
        wide[1][:, q.harmonics] = turned * np.exp(-1j * q.harmonics * two.phase)[:, None]
        for i in np.flatnonzero(both):
            admitted = 1e-8 + 3 * max(p.truncation[i], q.truncation[i])
            yield _close("coefficients", wide[1][i], wide[0][i], admitted, axis=0)
            if p.stable[i] is not None and q.stable[i] is not None:
                yield Claim("stable", bool(q.stable[i]), bool(p.stable[i]))

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)


def _motion(rng, one, two):
    end, nu, place = even(rng, 4, 15), even(rng, 0.4, 2.5), int(rng.integers(one.n))
    start, level = rng.normal(size=(one.n, 2)) * 0.4, even(rng, -0.2, 0.2)
    times = np.r_[np.geomspace(1e-11, 1e-2, 7) * end, np.linspace(0, end, 12)[1:]]
    memory = ", memory='exponentials'" if one.kernel else ""
    lines, given = [], bool(rng.random() < 0.5)
    for r, s, d in (("p", "a", one), ("q", "b", two)):
        x = d.names[d.place(place)]
        events = [f"{x} - ({number(level / d.units[place])})", f"{x}_dot"]
        lines.append(
            f"{r} = vv.simulate({s}, {number(end / d.time)}, load={d.load()}, "
            f"nu={number(nu * d.time)}, initial={numbers(d.state(start))}, "
            f"{f'dt={number(0.02 / d.time)}' if given else 'rtol=1e-9'}, "
            f"times={numbers(times / d.time)}, events={events!r}{memory})\n"
        )

    def judge(names, reported):
        p, q = names["p"], names["q"]
        if p.outcome != "completed" or np.abs(p.state).max() > 20:
            return
        yield Claim("outcome", q.outcome, p.outcome)
        yield _close("states", two.states_back(q.state), one.states_back(p.state), 1e-7, axis=0)
        for e, f in zip(p.events, q.events, strict=True):
            yield Claim("events", f.t.size, e.t.size)
            if e.t.size:
                yield Claim("times", f.t * two.time, e.t, 1e-8 * end)

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)


def _branch(rng, one, two):
    at = np.sort([even(rng, 0.4, 2.8) for _ in range(3)])
    lines = [
        f"{r} = vv.trace_response({s}, ({0.3 * d.time!r}, {3.0 * d.time!r}), load={d.load()}, "
        f"at={numbers(at * d.time)}, max_points=300)\n"
        for r, s, d in (("p", "a", one), ("q", "b", two))
    ]

    def judge(names, reported):
        p, q = names["p"], names["q"]
        if p.outcome != "completed" or p.truncation.max() > 1e-9:
            return
        yield Claim("outcome", q.outcome, p.outcome)
        yield Claim("folds", len(q.folds), len(p.folds))
        if len(p.folds):
            yield _close("at folds", np.array(q.folds) / two.time, np.array(p.folds), 1e-8)
        yield Claim("stops", len(q.stops), len(p.stops))
        sizes = [
            d.back(np.array([r.peak_to_peak(name)[r.stops] for name in r.dof_names]).T)
            for r, d in ((p, one), (q, two))
        ]
        yield _close("amplitudes", np.abs(sizes[1]), sizes[0], 1e-7, axis=0)
        kinds = [[c.kind for c in r.crossings] for r in (p, q)]
        yield Claim("crossings", " ".join(kinds[1]), " ".join(kinds[0]))

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)


def _free(rng, one, two):
    mode, place, size = int(rng.integers(one.n)), int(rng.integers(one.n)), few(rng, 0.1, 0.5)
    lines = []
    for r, s, d in (("p", "a", one), ("q", "b", two)):
        end = size / abs(d.units[place])
        lines.append(
            f"{r} = vv.backbone({s}, {mode}, ({0.02 * end!r}, {end!r}), "
            f"dof={d.names[d.place(place)]!r}, max_points=300)\n"
        )

    def judge(names, reported):
        p, q = names["p"], names["q"]
        if p.outcome != "completed":
            return
        yield Claim("outcome", q.outcome, p.outcome)
        yield Claim("folds", len(q.folds), len(p.folds))
        yield _close("frequency", q.nu[-1] / two.time, p.nu[-1], 1e-9)

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)


def _scales(rng, one, two):
    nu, load = np.linspace(0.3, 3, 6), rng.normal(size=one.n) * 0.03
    lines = [
        f"{r} = vv.MultipleScales({s}, load={numbers(d.vector(load))}, "
        f"nu={number(d.time)}).response('nu', {numbers(nu * d.time)})\n"
        for r, s, d in (("p", "a", one), ("q", "b", two))
    ]

    def judge(names, reported):
        p, q = names["p"], names["q"]
        # A motion at the limit of the range may be reported for one system only.
        if p.index.size != q.index.size or p.n_beats.any() or q.n_beats.any():
            return
        sizes = [np.abs(d.back(r.harmonics)) for r, d in ((p, one), (q, two))]
        # The same terms are resonant in all units.
        yield Claim("harmonics", sizes[1], sizes[0], 1e-6 * sizes[0].max(), damage=1e-3)
        for i in range(len(p.index)):
            pair = float(q.growth_error[i] / two.time), float(p.growth_error[i])
            # A difference of growth rates of two orders, each with a rounding error.
            yield Claim("growth_error", *pair, 1e-3 * pair[1] + 1e-11, damage=1.0)
        for i in np.flatnonzero(p.decided & q.decided & p.in_range & q.in_range):
            yield Claim("stable", bool(q.stable[i]), bool(p.stable[i]))

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)


def _many(rng, one, two):
    nu, starts = even(rng, 0.5, 2), rng.normal(size=(2, one.n, 2)) * 0.3
    lines = [
        f"{r} = vv.simulate_ensemble({s}, initial={numbers([d.state(x) for x in starts])}, "
        f"t_end={number(8.0 / d.time)}, load={d.load()}, nu={number(nu * d.time)}, "
        f"dt={number(0.05 / d.time)}, statistics=True)\n"
        for r, s, d in (("p", "a", one), ("q", "b", two))
    ]

    def judge(names, reported):
        p, q = names["p"], names["q"]
        if not p.complete or np.abs(p.peak).max() > 20:
            return
        yield Claim("outcomes", q.outcome, p.outcome)
        for what in ("state", "mean", "rms", "peak"):
            got, true = two.states_back(getattr(q, what)), one.states_back(getattr(p, what))
            if what in ("rms", "peak"):
                got = np.abs(got)
            yield _close(what, got, true, 1e-7)

    return Case(_pair(one, two, "".join(lines)), judge, may_refuse=True)
