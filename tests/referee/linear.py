"""Modes, dynamic stiffness and responses of linear systems by dense linear algebra."""

import numpy as np
import scipy.linalg

from referee.case import Case, Claim, even, few, numbers
from referee.models import chain, mount, some_memory

JUDGES = (
    "Mount", "Mount.natural_frequencies", "Mount.mode_shapes", "Mount.dynamic_stiffness",
    "PolynomialSystem", "PolynomialSystem.natural_frequencies", "PolynomialSystem.mode_shapes",
    "PolynomialSystem.dynamic_stiffness", "Springs", "Response", "Response.converged",
    "PeriodicMotions.coefficient", "Response.amplitude", "PeriodicMotions.phase",
    "PeriodicMotions.waveform",
    "fourier_coefficients",
)  # fmt: skip


def _system(rng, index):
    memory = some_memory(rng) if index % 3 else None
    if index % 2:
        return mount(rng, damped=few(rng, 1e-4, 0.05, 2), memory=memory,
                     memory_phi=some_memory(rng) if index % 4 == 1 and memory else None)  # fmt: skip
    n = int(rng.integers(1, 6))
    draft = chain(rng, n, few(rng, 1e-4, 0.05, 2), memory=memory)
    draft.base = [1.0] * n
    if rng.random() < 0.4:
        draft.more = [(np.diag(rng.uniform(0.1, 1, n).round(3)), [], some_memory(rng))]
    return draft.model()


def _modes(rng, index):
    model = _system(rng, index)
    nu = [few(rng, 1e-3, 100) for _ in range(4)]
    call = f"""system = {model.source}
frequencies, shapes = system.natural_frequencies(), system.mode_shapes()
stiffness = system.dynamic_stiffness({nu})
"""

    def judge(names, reported):
        k, m = model.stiffness, model.mass
        squares = scipy.linalg.eigh(k, m, eigvals_only=True)
        true = np.sqrt(squares)
        yield Claim("natural_frequencies", names["frequencies"], true, 1e-12 * true.max())
        shapes, omega = names["shapes"], names["frequencies"]
        rest = np.abs(k @ shapes - m @ shapes * omega**2).max(axis=0)
        size = np.abs(k).max() * np.abs(shapes).max(axis=0)
        yield Claim("mode_shapes", 1 + rest / size, np.ones(model.n), 1e-11)
        own = np.array([model.dynamic_stiffness(x) for x in nu])
        scale = 1e-13 * np.abs(own).max(axis=(1, 2), keepdims=True)
        yield Claim("dynamic_stiffness", names["stiffness"], own, scale)

    return Case(call, judge)


def _response(rng, index):
    model = _system(rng, index)
    nu = sorted(few(rng, 0.1, 20) for _ in range(5))
    orders = sorted(set(rng.integers(1, 8, 3).tolist()))
    load = {k: (rng.normal(size=model.n) + 1j * rng.normal(size=model.n)).round(3) for k in orders}
    if rng.random() < 0.5:
        load[0] = 1j * rng.normal(size=model.n).round(3)
    based = rng.random() < 0.5
    base = complex(even(rng, -1, 1), even(rng, -1, 1)) if based else None
    # Forces that grow with the square of the frequency.
    growing = {k: rng.normal(size=model.n).round(3) for k in orders if rng.random() < 0.3}
    terms = {k: np.asarray(p).tolist() for k, p in load.items()}
    for k, masses in growing.items():
        terms[k] = [f"{p} + {m}*nu^2" for p, m in zip(terms[k], masses, strict=True)]
    text = ", ".join(f"{k}: {p}" for k, p in terms.items())
    call = f"""system = {model.source}
r = vv.forced_response(system, {nu}, load={{{text}}}, base={base}, method="linear")
coefficients, orders, outcome = r.coefficients, r.harmonics, r.outcome
first = r.coefficient({model.names[0]!r}, {orders[0]})
amplitude, phase = r.amplitude(0, {orders[0]}), r.phase(0, {orders[0]})
t, wave = r.waveform(2, 16)
converged = r.converged
"""

    def judge(names, reported):
        orders_kept = names["orders"]
        true = np.zeros((len(nu), model.n, len(orders_kept)), complex)
        for i, x in enumerate(nu):
            for j, k in enumerate(orders_kept):
                at = k * x
                d = model.dynamic_stiffness(at if k else 1e-200)
                p = np.asarray(load.get(int(k), np.zeros(model.n)), complex)
                p = p + x**2 * growing.get(int(k), 0.0)
                if based and k == 1:
                    direction = np.asarray(model.base)
                    # Springs and dampers act on the motion relative to the base.
                    p = p + model.dynamic_stiffness(at, inertia=False) @ direction * base
                true[i, :, j] = np.linalg.solve(d, p)
        size = np.abs(true).max(axis=(1, 2), keepdims=True)
        conditions = np.array([
            max(_condition(model, k * x if k else 1e-200) for k in orders_kept) for x in nu
        ])[:, None, None]  # fmt: skip
        # A load component that is 0 after rounding of its digits has no harmonic.
        acting = {k for k, p in load.items() if np.any(p)} | ({1} if based else set())
        yield Claim("orders", orders_kept, np.array(sorted(acting)))
        # With a base the core computes the relative motion.
        size = size + (abs(base) if based else 0.0)
        yield Claim("linear response", names["coefficients"], true, 1e-14 * conditions * size, 5)
        j = int(np.flatnonzero(orders_kept == orders[0])[0])
        x = names["coefficients"][:, 0, j]
        yield Claim("coefficient", names["first"], x, 1e-15 * np.abs(x))
        yield Claim("amplitude", names["amplitude"], np.abs(x), 1e-14 * np.abs(x))
        yield Claim("phase", np.exp(1j * names["phase"]) * np.abs(x), x, 1e-13 * np.abs(x))
        theta = 2 * np.pi * np.arange(16) / 16
        wave = np.imag(np.exp(1j * np.outer(theta, orders_kept)) @ names["coefficients"][2].T)
        yield Claim("waveform", names["wave"], wave, 1e-13 * np.abs(wave).max())
        yield Claim("converged", names["converged"], np.ones(len(nu), bool))

    return Case(call, judge)


def _condition(model, at):
    """Amplification of rounding errors: near a resonance stiffness and inertia cancel."""
    whole, springs = model.dynamic_stiffness(at), model.dynamic_stiffness(at, inertia=False)
    size = np.linalg.norm(springs, 2) + np.linalg.norm(whole - springs, 2)
    return size * np.linalg.norm(np.linalg.inv(whole), 2)


def _fourier(rng, index):
    n = int(rng.integers(3, 60))
    orders = int(rng.integers(0, (n - 1) // 2 + 1))
    samples = rng.normal(size=n).round(5)
    call = f"series = vv.fourier_coefficients({numbers(samples)}, {orders})\n"

    def judge(names, reported):
        theta = 2 * np.pi * np.arange(n) / n
        true = [1j * samples.mean()]
        true += [2j * np.mean(samples * np.exp(-1j * k * theta)) for k in range(1, orders + 1)]
        got = np.array([names["series"][k] for k in range(orders + 1)])
        yield Claim("fourier_coefficients", got, np.array(true), 1e-14 * n)

    return Case(call, judge)


def _held(rng, index):
    """Coordinates fixed by huge diagonal entries of K or M: the others by dense algebra."""
    n = int(rng.integers(3, 7))
    a, b = rng.normal(size=(2, n, n)).round(3)
    stiffness, mass = 100 * (a @ a.T + 0.3 * np.eye(n)), b @ b.T / n + np.eye(n)
    damping = 0.05 * mass + 1e-3 * stiffness
    fixed = rng.permutation(n)[: int(rng.integers(1, n - 1))]
    free = np.setdiff1d(np.arange(n), fixed)
    held, heavy = stiffness.copy(), mass.copy()
    (heavy if index % 2 else held)[fixed, fixed] = 10.0 ** int(rng.integers(26, 50))
    nu = [few(rng, 1, 30) for _ in range(3)]
    name = f"x{free[-1] + 1}"
    call = f"""system = vv.Structure(
    mass={numbers(heavy)}, stiffness={numbers(held)}, damping={numbers(damping)},
)
r = vv.forced_response(system, {nu}, load={{{name!r}: 1.0}}, method="linear")
amplitudes, supports = r.amplitude({name!r}), list(system.supports)
"""

    def judge(names, reported):
        inner = np.ix_(free, free)
        true, off = [], []
        for x in nu:
            whole = stiffness[inner] - x**2 * mass[inner] + 1j * x * damping[inner]
            true.append(abs(np.linalg.inv(whole)[-1, -1]))
            off.append(1e-14 * np.linalg.cond(whole) * true[-1])
        yield Claim("amplitude between supports", names["amplitudes"], np.array(true), off, 5)
        yield Claim("supports", np.array(sorted(names["supports"])),
                    np.array(sorted(f"x{j + 1}" for j in fixed)))  # fmt: skip

    return Case(call, judge)


def _supported(rng, index):
    """Response and reactions of full matrices whose supports move, by the full equations."""
    n = int(rng.integers(3, 8))
    held = rng.choice(n, int(rng.integers(1, n)), replace=False)
    free = np.setdiff1d(np.arange(n), held)

    def definite(size):
        a = rng.normal(size=(n, n))
        return (size * (a @ a.T / n + 0.2 * np.eye(n))).round(6)

    mass, damping, stiffness = definite(1), definite(0.2), definite(10)
    moved = rng.normal(size=held.size).round(3)
    nu = [few(rng, 0.2, 10) for _ in range(3)]
    load, base = rng.normal(size=free.size).round(3), few(rng, 0.01, 1)
    names = [f"x{i + 1}" for i in held]
    call = f"""system = vv.Structure(
    mass={numbers(mass)}, stiffness={numbers(stiffness)}, damping={numbers(damping)},
    supports={names}, base_direction={numbers(moved)},
)
r = vv.forced_response(system, {nu}, load={numbers(load)}, base={base}, method="linear")
coefficients, reactions = r.coefficients, r.support_reactions()
"""

    def judge(names, reported):
        true, pulled, off = [], [], []
        for x in nu:
            whole = stiffness - x**2 * mass + 1j * x * damping
            inner = whole[np.ix_(free, free)]
            u = np.zeros(n, complex)
            u[held] = base * moved
            u[free] = np.linalg.solve(inner, load - whole[np.ix_(free, held)] @ u[held])
            true.append(u[free])
            pulled.append((whole @ u)[held])
            off.append(1e-14 * np.linalg.cond(inner) * np.abs(u).max())
        off = np.array(off)[:, np.newaxis]
        size = np.abs(stiffness).max() + np.abs(mass).max() * max(nu) ** 2
        yield Claim("coefficients", names["coefficients"][:, :, 0], np.array(true), off, 5)
        yield Claim("reactions", names["reactions"][:, :, 0], np.array(pulled), n * size * off, 5)

    return Case(call, judge)


def case(rng, index):
    """Draw a system and a question: modes or response."""
    if index % 12 == 7:
        return _supported(rng, index // 12)
    if index % 12 == 11:
        return _held(rng, index // 12)
    return (_modes, _response, _response, _fourier)[index % 4](rng, index // 4)
