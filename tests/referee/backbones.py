"""Backbones: periodicity of free motions by SciPy over a period, energies, Floquet multipliers."""

import numpy as np

from referee.balance import magnus
from referee.case import Case, Claim, few
from referee.models import Model, Swinging, chain, integrate, mount, pendulum

JUDGES = (
    "backbone", "Backbone", "Backbone.amplitude", "Backbone.start", "BackbonePoint",
)  # fmt: skip


def _oscillator(rng, index):
    if index % 3 == 0:
        model = mount(rng, damped=0.01)
    else:
        model = chain(
            rng, int(rng.integers(1, 4)), 0.0, quadratic=index % 2 == 0, softening=index % 5 == 0
        ).model()
    model = Model(model.source, model.mass, 0 * model.damping, model.groups, model.names)
    mode = int(rng.integers(model.n))
    top = few(rng, 0.02, 0.6, 2)
    kept = rng.choice(["", ", harmonics=5"])
    call = f"""system = {model.source}
curve = vv.backbone(system, {mode}, ({top / 100}, {top}){kept})
finer = vv.backbone(system, {mode}, ({top / 100}, {top}), harmonics=2 * int(curve.harmonics[-1]) + 1,
    tolerance=1e-13)
fine, fine_orders, fine_nu, fine_outcome = finer.coefficients, finer.harmonics, finer.nu, finer.outcome
folds = curve.folds
nu, start, outcome, truncation = curve.nu, curve.start, curve.outcome, curve.truncation
fine_truncation = finer.truncation
amplitude = curve.amplitude({model.names[0]!r})
coefficients, orders = curve.coefficients, curve.harmonics
"""
    draw = np.random.default_rng(index)

    def judge(names, reported):
        # At an internal resonance a curve may turn back and end as a motion of a higher mode.
        ended = names["outcome"] if names["folds"].size else "completed"
        yield Claim(
            "completed", names["outcome"], "returned" if ended == "returned" else "completed"
        )
        yield from _of_both(names, model.mass)
        first = list(names["orders"]).index(1)
        own = np.abs(names["coefficients"][:, 0, first])
        yield Claim("amplitude", names["amplitude"], own, 1e-14 * own + 1e-300)
        own = names["coefficients"].imag.sum(axis=2)
        yield Claim("start", names["start"], own, 1e-14 * np.abs(own).max())
        n = len(names["nu"])
        i = n - 1 if ended == "returned" else int(draw.integers(n))
        # With a large stated truncation (far too few harmonics) the motion may be arbitrary.
        if names["truncation"][i] < 0.01:
            yield _periodic(model, names, i)
        if index % 4 == 0:
            linear = np.sqrt(np.linalg.eigvals(np.linalg.solve(model.mass, model.stiffness)).real)
            nearest = np.sort(linear)[mode]
            yield Claim(
                "begins at the mode",
                names["nu"][0],
                nearest,
                0.3 * top**2 * nearest * 0.01 + 1e-4 * nearest,
                limit=3.0,
                damage=0.05,
            )

    return Case(call, judge, may_refuse=True)


def _periodic(model, names, i):
    """Claim that the true motion returns after a period, or that the residual is small.

    Errors of the start and rounding errors grow by the largest multiplier. If this factor is too
    large for an integrator, the residual of the equations is checked instead.
    """
    nu, k, x = names["nu"][i], names["orders"], names["coefficients"][i]
    estimate, period = names["truncation"][i], 2 * np.pi / names["nu"][i]

    def motion(t):
        return (np.exp(1j * nu * np.outer(t, k)) @ x.T).imag

    grown = np.linalg.eigvals(magnus(lambda t: model.linearised(motion(t)), period, 400))
    admitted = (100 * estimate + 1e-8) * max(1.0, np.abs(grown).max())
    if admitted < 0.1 or np.abs(grown).max() < 1e3:
        u = names["start"][i]
        y = np.concatenate([u, 0 * u])
        back = integrate(model.equations(None), y, np.array([period]))[0]
        off, what = np.abs(back - y).max() / np.abs(u).max(), "periodic from rest"
    else:
        t = period * np.arange(8 * k.max()) / (8 * k.max())
        pull = ((np.exp(1j * nu * np.outer(t, k)) * (k * nu) ** 2) @ x.T).imag @ model.mass.T
        force = sum(g.force(motion(t)) for g in model.groups)
        off = np.abs(force - pull).max() / np.abs(pull).max()
        # Omitted harmonics contribute to the acceleration with the square of their order.
        admitted, what = (100 * estimate + 1e-12) * k.max() ** 2, "defect of an unstable motion"
    return Claim(what, 1 + off, 1.0, admitted, damage=max(1e-6, 100 * admitted))


def _of_both(names, mass):
    """Check the truncation against the curve with more harmonics, if both are the same curve.

    A curve with far too few harmonics may pass a resonance of high harmonics on the other side.
    """
    both = names["outcome"] == names["fine_outcome"] == "completed"
    right = max(names["truncation"].max(), names["fine_truncation"].max()) < 1e-3
    if both and right and not names["folds"].size:
        yield from _against_finer(names, mass)


def _against_finer(names, mass):
    """Check the truncation by the motion with twice the harmonics at the same amplitude."""
    fine = names["fine"][-1].imag
    own = np.zeros_like(fine)
    own[:, np.searchsorted(names["fine_orders"], names["orders"])] = names["coefficients"][-1].imag
    weights = np.sqrt(np.diag(mass))[:, np.newaxis]
    apart = np.linalg.norm((own - fine) * weights) / np.linalg.norm(fine * weights)
    apart = max(apart, abs(names["nu"][-1] / names["fine_nu"][-1] - 1))
    estimate = names["truncation"][-1]
    yield Claim(
        "truncation", 1 + apart, 1.0, 2 * estimate + 1e-10, damage=max(1e-6, 100 * estimate)
    )


def _pendulum(rng, index):
    p = pendulum(rng, None)
    free = Swinging(p.e, p.w2, p.w3, p.alpha)
    mode = int(rng.integers(3))
    energy = index % 2
    ends = "energy_range=(1e-6, 3e-3)" if energy else "(0.005, 0.15)"
    call = f"""system = {free.source}
curve = vv.backbone(system, {mode}, {ends}, max_points=300)
finer = vv.backbone(system, {mode}, {ends}, harmonics=2 * int(curve.harmonics[-1]) + 1, tolerance=1e-13, max_points=300)
fine, fine_orders, fine_nu, fine_outcome = finer.coefficients, finer.harmonics, finer.nu, finer.outcome
nu, start, outcome, energy, truncation = curve.nu, curve.start, curve.outcome, curve.energy, curve.truncation
fine_truncation, folds = finer.truncation, curve.folds
stable, multipliers, growing = curve.stable, curve.multipliers, curve.growing
coefficients, orders = curve.coefficients, curve.harmonics
"""
    draw = np.random.default_rng(index)

    def judge(names, reported):
        curve = names["curve"]
        for column in (curve.nu, curve.energy, curve.coefficients, curve.truncation):
            yield Claim("numbers", bool(np.isfinite(column).all()), True)
        yield from _of_both(names, np.eye(3))
        i = int(draw.integers(len(names["nu"])))
        u = names["start"][i]
        y = np.zeros(6)
        y[::2] = u
        yield Claim(
            "energy",
            names["energy"][i],
            float(free.energy(y)),
            (1e-11 + 10 * names["truncation"][i]) * names["energy"][i],
            damage=max(1e-6, 1e3 * names["truncation"][i]),
        )
        period = 2 * np.pi / names["nu"][i]
        back = free.motion(y, [period])[0]
        size = np.abs(u).max()
        k = names["orders"]

        def matrices(t):
            waves = np.exp(1j * names["nu"][i] * np.outer(t, k))
            states = np.zeros((t.size, 6))
            states[:, ::2] = (waves @ names["coefficients"][i].T).imag
            states[:, 1::2] = (waves * (1j * names["nu"][i] * k) @ names["coefficients"][i].T).imag
            return free.jacobian(0 * t, states)

        own = np.linalg.eigvals(magnus(matrices, period, 400))
        sizes = np.sort(np.abs(own))[::-1]
        # An error of the start grows by the largest multiplier.
        admitted = (100 * names["truncation"][i] + 1e-8) * max(1.0, sizes[0])
        yield Claim(
            "periodic from rest",
            1 + np.abs(back - y).max() / size,
            1.0,
            admitted,
            damage=max(1e-6, 100 * admitted),
        )
        if abs(sizes[0] - 1) > 1e-3:
            yield Claim("growing", bool(names["growing"][i] > 0), True)
            got = np.abs(names["multipliers"][i]).max()
            yield Claim(
                "largest multiplier",
                got,
                sizes[0],
                1e-5 * sizes[0] + 100 * names["truncation"][i],
                damage=1e-3,
            )

    return Case(call, judge, may_refuse=True)


def case(rng, index):
    """Draw a system and a mode."""
    return _pendulum(rng, index // 3) if index % 3 == 2 else _oscillator(rng, index)
