"""Floquet multipliers of the ordinary equations (memory as exponentials) by Magnus' expansion."""

import numpy as np

from referee.balance import multipliers
from referee.case import Case, Claim, few
from referee.models import chain, mount, prony, some_prony
from referee.responses import refined

JUDGES = ("forced_response", "StabilityWarning")
#: Multipliers this near to 1 in size are too close to call.
CLOSE = 3e-9


def case(rng, index):
    """Draw a system, often lightly damped, near a resonance or anywhere."""
    light = index % 2 == 0
    damping = few(rng, 1e-5, 1e-2, 2) if light else few(rng, 5e-3, 0.05, 2)
    remembers = index % 4 >= 1
    memory = None
    if remembers:
        memory = some_prony(rng, 0.02 if light else 0.3)
    if index % 4 == 2:
        return _barely_damped(rng)
    if index % 6 == 5:
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
    # Nearly linear, or a hundred times as much.
    size = few(rng, 3e-4, 1e-3, 2) if rng.random() < 0.5 else few(rng, 0.01, 0.5, 2)
    return _asked(model, nu, size, remembers, ', harmonics="auto"')


def _barely_damped(rng):
    """Chains beside each resonance, nearly linear: as stable as they are at rest."""
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

    def judge(names, told):
        if names["outcome"] != "converged":
            yield Claim("what is not found is told", bool(told), True)
            return
        load = {1: np.array([size] + [0.0] * (model.n - 1))}
        true = refined(model, names["coefficients"], names["orders"], nu, load)
        if true is None:
            return
        own, off = multipliers(model, true, nu)
        own_sizes = np.abs(own)
        if abs(own_sizes[0] - 1) < 10 * off + CLOSE:
            return
        if names["stable"] is None:
            yield Claim("unknown stability is told", any("Stability" in t for t in told), True)
            return
        yield Claim("stable", bool(names["stable"]), bool(own_sizes[0] < 1))
        got = np.asarray(names["multipliers"])
        got = np.abs(got[np.isfinite(got)])
        if not remembers:
            size_of = 1e-8 * own_sizes[0] + 10 * off
            yield Claim(
                "largest multiplier", got.max(initial=0.0), own_sizes[0], size_of, damage=1e-5
            )
        else:
            grown = own_sizes[own_sizes > 1 + CLOSE + 10 * off]
            found = np.sort(got[got > 1 + CLOSE])[::-1]
            if got.size and names["slowest"]:
                yield Claim(
                    "slowest multiplier", got.max(), own_sizes[0], 1e-5 * own_sizes[0] + 10 * off,
                    damage=1e-3,
                )  # fmt: skip
            if got.size and grown.size:
                yield Claim("growing multipliers", found, grown, 1e-6 * grown[0], damage=1e-4)

    return Case(call, judge)
