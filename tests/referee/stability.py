"""Floquet multipliers of the ordinary equations with memory states by a Magnus expansion."""

from dataclasses import replace
from math import gamma

import numpy as np

from referee.balance import growing, multipliers
from referee.case import Case, Claim, even, few
from referee.hidden import hidden
from referee.models import chain, mount, prony, rzhanitsyn, some_prony, spread
from referee.responses import refined

JUDGES = ("forced_response", "StabilityWarning")
#: Multipliers with a magnitude this near to 1 are not decided.
CLOSE = 3e-9


def case(rng, index):
    """Draw a system, often lightly damped, near a resonance or anywhere."""
    light = index % 2 == 0
    damping = few(rng, 1e-5, 1e-2, 2) if light else few(rng, 5e-3, 0.05, 2)
    remembers = index % 4 >= 1
    memory = None
    if remembers:
        memory = some_prony(rng, 0.02 if light else 0.3)
    if index % 16 == 11:
        return _singular(rng)
    if index % 4 == 2:
        return _barely_damped(rng)
    if index % 16 in (3, 7):
        model = hidden(rng, few(rng, 1e-5, 0.05, 2), memory if index % 32 < 24 else None)
        remembers = any(g.memory is not None for g in model.groups)
    elif index % 6 == 5:
        model = mount(rng, damped=damping, memory=memory)
    else:
        n = int(rng.integers(1, 4))
        model = chain(
            rng, n, damping, memory=memory, quadratic=index % 5 == 0, softening=True
        ).model()
    omega = model.frequencies
    near = omega[int(rng.integers(model.n))]
    nu = float(
        f"{near * rng.choice([0.5, 0.9, 1.0, 1.02, 1.1, 2.0]) * rng.uniform(0.97, 1.03):.4g}"
    )
    # Nearly linear, or a load a hundred times as large.
    size = few(rng, 3e-4, 1e-3, 2) if rng.random() < 0.5 else few(rng, 0.01, 0.5, 2)
    return _asked(model, nu, size, remembers, ', harmonics="auto"')


def _singular(rng):
    """Points of branches with a singular kernel, against a sum of exponentials."""
    alpha, beta = even(rng, 0.15, 0.75, 3), few(rng, 0.05, 1, 3)
    amplitude = float(f"{rng.uniform(0.02, 0.4) * beta**alpha / gamma(alpha):.3g}")
    memory = rzhanitsyn(amplitude, alpha, beta)
    n = int(rng.integers(1, 3))
    model = chain(
        rng, n, few(rng, 1e-4, 0.02, 2), memory=memory, quadratic=rng.random() < 0.5, softening=True
    ).model()
    w = float(model.frequencies[0])
    load = [few(rng, 0.1, 1.5, 2), *[0.0] * (n - 1)]
    call = f"""system = {model.source}
branch = vv.trace_response(system, ({0.6 * w:.4g}, {1.8 * w:.4g}), load={load}, max_points=300)
"""

    def judge(names, reported):
        branch = names["branch"]
        if branch.growing is None:
            yield Claim(
                "unknown stability is reported", any("Stability" in t for t in reported), True
            )
            return
        kept = np.flatnonzero((branch.truncation < 1e-8) & (branch.growing >= 0))
        unstable = kept[branch.growing[kept] > 0]
        for i in {*kept[:: max(1, kept.size)], *unstable[:: max(1, unstable.size)]}:
            nu = branch.nu[i]
            own = spread(memory, amplitude, alpha, beta, max(nu, w))
            at = 1j * nu * np.array([0.1, 1.0, 3.0])
            off_by = np.abs((own.weights / (at[:, None] + own.rates)).sum(1) / own.laplace(at) - 1)
            groups = tuple(replace(g, memory=g.memory and own) for g in model.groups)
            x = np.zeros((n, int(branch.harmonics.max()) + 1), complex)
            x[:, branch.harmonics] = branch.coefficients[i]
            mu, off = multipliers(replace(model, groups=groups), x, nu, 32)
            size = abs(mu[0])
            near = 1e-4 + 10 * off[0] + 10 * off_by.max()
            if abs(size - 1) < near:
                continue
            yield Claim(
                "stable with a singular kernel", bool(branch.growing[i] == 0), bool(size < 1)
            )
            if branch.slowest[i]:
                got = np.nanmax(np.abs(branch.multipliers[i]))
                yield Claim(
                    "slowest with a singular kernel", got, size, near * max(1, size),
                    damage=max(1e-2, 5 * near),
                )  # fmt: skip

    return Case(call, judge, may_refuse=True)


def _barely_damped(rng):
    """Nearly linear chains near each resonance: as stable as the equilibrium."""
    memory = prony([few(rng, 1e-5, 1e-2, 2)], [few(rng, 0.05, 2, 2)])
    model = chain(rng, 3, few(rng, 5e-5, 5e-4, 2), memory=memory, cubic=(0.099, 0.101)).model()
    nu = float(f"{0.9 * model.frequencies[int(rng.integers(3))]:.4g}")
    return _asked(model, nu, 1e-3, True, "")


def _asked(model, nu, size, remembers, orders):
    call = f"""system = {model.source}
r = vv.forced_response(
    system, [{nu}], load={size}, method="newton"{orders}, stability=True
)
coefficients, orders, outcome = r.coefficients[0], r.harmonics, r.outcome[0]
stable, multipliers, exponents = r.stable[0], r.multipliers[0], r.exponents[0]
slowest = r.slowest[0]
"""

    def judge(names, reported):
        if names["outcome"] != "converged":
            yield Claim("what is not found is reported", bool(reported), True)
            return
        load = {1: np.array([size] + [0.0] * (model.n - 1))}
        true = refined(model, names["coefficients"], names["orders"], nu, load)
        if true is None:
            return
        own, off = multipliers(model, true, nu)
        own_sizes = np.abs(own)
        if abs(own_sizes[0] - 1) < 10 * off[0] + CLOSE:
            return
        if names["stable"] is None:
            yield Claim(
                "unknown stability is reported", any("Stability" in t for t in reported), True
            )
            return
        yield Claim("stable", bool(names["stable"]), bool(own_sizes[0] < 1))
        got = np.asarray(names["multipliers"])
        got = np.abs(got[np.isfinite(got)])
        if not remembers:
            size_of = 1e-8 * own_sizes[0] + 10 * off[0]
            yield Claim(
                "largest multiplier", got.max(initial=0.0), own_sizes[0], size_of, damage=1e-5
            )
        else:
            if got.size and names["slowest"]:
                yield Claim(
                    "slowest multiplier", got.max(), own_sizes[0],
                    1e-5 * own_sizes[0] + 10 * off[0], damage=1e-3,
                )  # fmt: skip
            grown = growing(got, own_sizes, off, 1e-6, CLOSE) if got.size else None
            if grown is not None:
                yield grown

    return Case(call, judge)
