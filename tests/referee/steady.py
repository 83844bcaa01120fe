"""Steady motions of the pendulum, periodic and quasi-periodic: integration by SciPy; Floquet theory."""

import numpy as np

from referee.balance import magnus
from referee.case import Case, Claim, even, few
from referee.crossings import reported_by_crossings
from referee.models import pendulum

JUDGES = (
    "DrivenResponse", "DrivenResponse.nu", "DrivenResponse.harmonics", "DrivenResponse.converged",
    "DrivenResponse.frequencies", "DrivenResponse.coefficient", "DrivenResponse.amplitude",
    "DrivenResponse.state", "DrivenResponse.waveform", "DrivenBranch", "DrivenBranch.nu",
    "DrivenBranch.harmonics", "DrivenBranch.truncation", "DrivenBranch.amplitude",
)  # fmt: skip
CLOSE = 1e-6


def _state(omega, coefficients):
    """The motion as a function of time, shape (n, 6)."""

    def state(t):
        waves = np.exp(1j * np.multiply.outer(t, omega))
        out = np.empty((np.size(t), 6))
        out[:, ::2] = (waves @ coefficients.T).imag
        out[:, 1::2] = (waves @ (1j * omega * coefficients).T).imag
        return out

    return state


def _multipliers(p, state, period, n):
    return np.linalg.eigvals(magnus(lambda t: p.jacobian(t, state(t)), period, n))


def _monodromy(p, state, period, n=300):
    return np.sort(np.abs(_multipliers(p, state, period, n)))[::-1]


def _on(p, state, span, admitted):
    """Integrate the motion from its start and compare; the stated error grows like perturbations."""
    t = np.linspace(0, span, 7)[1:]
    grown, growth = np.eye(6), 10.0
    for begin in t - t[0]:
        part = magnus(lambda s, at=begin: p.jacobian(s + at, state(s + at)), t[0], 50)
        grown = part @ grown
        growth = max(growth, 10.0 * np.linalg.norm(grown, 2))
    true = p.motion(state(np.zeros(1))[0], np.concatenate([[0.0], t]))[1:]
    got = state(t)
    size = np.abs(got).max()
    yield Claim(
        "motion goes on as reported",
        got,
        true,
        admitted * size * growth,
        damage=max(1e-5, 100 * admitted * growth),
    )


def _periodic(rng, index):
    loads = {"f0": few(rng, 0.002, 0.05, 2), "p1": even(rng, 0.3, 1.6, 3)}
    if rng.random() < 0.6:
        loads |= {
            "m01": few(rng, 0.001, 0.02, 2),
            "p2": loads["p1"] * float(rng.choice([0.5, 1, 2])),
        }
    p = pendulum(rng, (0.01, 0.1), **loads)
    call = f"""system = {p.source}
r = vv.forced_response(system, stability=True)
found, outcome, truncation, stable = r.converged[0], r.outcome[0], r.truncation[0], r.stable[0]
multipliers, nu, orders, coefficients = r.multipliers[0], r.nu[0], r.harmonics, r.coefficients[0]
amplitude, coefficient, frequencies = r.amplitude("z", 1), r.coefficient("z", 1), r.frequencies(0)
t, wave = r.waveform(0, 8)
left = r.error[0]
fine = vv.forced_response(system, stability=False, harmonics=int(r.highest[0] or 1),
    tolerance=1e-13)
same, fine_left = fine.coefficients[0], fine.error[0]
"""

    def judge(names, reported):
        if not names["found"]:
            yield Claim("what is not found is reported", bool(reported), True)
            return
        same, ours = names["same"], names["coefficients"]
        apart = np.inf
        if same.shape == ours.shape:
            apart = np.abs(same - ours).max() / np.abs(ours).max()
        # The same harmonics have other solutions where a branch has folds.
        if apart < 1e-3:
            reported_error = 1.5 * (names["left"] + names["fine_left"])
            yield Claim("what is left of it", 1 + apart, 1.0, reported_error + 4e-16, damage=1e-2)
        yield Claim("frequencies", names["frequencies"], names["nu"] * names["orders"], 1e-13)
        place = list(names["orders"]).index(1)
        own = names["coefficients"][0, place]
        if own:
            yield Claim("amplitude", names["amplitude"][0], abs(own), 1e-14 * abs(own))
            yield Claim("coefficient", names["coefficient"][0], own, 1e-14 * abs(own))

        state = _state(names["frequencies"], names["coefficients"])
        t = names["t"]
        yield Claim("state and waveform", names["r"].state(0, t)[:, ::2], names["wave"], 1e-14)
        yield Claim("waveform", names["wave"], state(t)[:, ::2], 1e-13)
        sizes = _monodromy(p, state, 2 * np.pi / names["nu"])
        admitted = 10 * names["truncation"] + 3e-9
        yield from _on(p, state, 2 * np.pi / names["nu"], admitted)
        if abs(sizes[0] - 1) > CLOSE:
            yield Claim("stable", bool(names["stable"]), bool(sizes[0] < 1))
            got = np.abs(names["multipliers"][0])
            yield Claim(
                "largest multiplier",
                got,
                sizes[0],
                (1e-7 + 30 * names["truncation"]) * sizes[0],
                damage=1e-3,
            )

    return Case(call, judge)


def _quasi(rng, index):
    p = pendulum(
        rng,
        (0.05, 0.2),
        f0=few(rng, 0.002, 0.02, 2),
        p1=even(rng, 0.7, 1.3, 4),
        m01=few(rng, 0.001, 0.01, 2),
        p2=even(rng, 0.25, 0.6, 4),
    )
    call = f"""system = {p.source}
r = vv.forced_response(system, tolerance=1e-7, stability=True, max_denominator=2, duration=300)
found, truncation, stable, growth = r.converged[0], r.truncation[0], r.stable[0], r.growth[0]
orders, base, coefficients = r.orders, r.base[0], r.coefficients[0]
axes = r.axes
"""

    def judge(names, reported):
        if not names["found"]:
            yield Claim("what is not found is reported", bool(reported), True)
            return
        if len(names["axes"]) < 2:
            return

        def state(t):
            return names["r"].state(0, t)

        admitted = 10 * names["truncation"] + 1e-8
        yield from _on(p, state, 30.0, admitted)
        # The sum of the rates is the mean divergence of the flow.
        t = np.linspace(0, 300, 4001)
        mean = np.trace(p.jacobian(t, state(t)), axis1=1, axis2=2).mean()
        yield Claim("sum of the rates", names["growth"].sum(), mean, 1e-2 * abs(mean), damage=5e-2)
        if names["stable"] is not None:
            yield Claim("stable", bool(names["stable"]), bool(names["growth"][0] < 0))

    return Case(call, judge)


def _branch(rng, index):
    p = pendulum(rng, (0.01, 0.08), m01=few(rng, 0.001, 0.01, 2), p2=0.3)
    low = even(rng, 0.2, 0.3, 2)
    kept = rng.choice(["", ', harmonics="auto"', ", harmonics=21"])
    call = f"""system = {p.source}
branch = vv.trace_response(system, p2=({low}, 0.6){kept}, max_points=400)
nu, orders, coefficients, parameter = branch.nu, branch.harmonics, branch.coefficients, branch.parameter
amplitude, truncation, growing, folds = branch.amplitude("phi"), branch.truncation, branch.growing, branch.folds
multipliers, outcome = branch.multipliers, branch.outcome
"""
    draw = np.random.default_rng(index)

    def judge(names, reported):
        yield Claim("parameter", names["parameter"], names["nu"], 1e-14)
        place = list(names["orders"]).index(1)
        own = np.abs(names["coefficients"][:, 1, place])
        yield Claim("amplitude", names["amplitude"], own, 1e-14 * own + 1e-300)
        branch = names["branch"]
        for column in (branch.nu, branch.coefficients, branch.truncation):
            yield Claim("numbers", bool(np.isfinite(column).all()), True)
        known = names["growing"] >= 0
        yield Claim("multipliers", bool(np.isfinite(names["multipliers"][known]).all()), True)
        yield from reported_by_crossings(branch)
        turns = np.sign(np.diff(names["parameter"]))
        seen = int((np.diff(turns[turns != 0]) != 0).sum())
        between = len(branch.folds) - seen
        if between > 0 and between % 2 == 0:
            # Two folds within a step give no turning point: check for a multiplier of 1.
            for nu, x in zip(branch.folds, branch.fold_coefficients, strict=True):
                q = p.__class__(**(vars(p) | {"p2": float(nu)}))
                n = max(300, 4 * int(names["orders"].max()))
                mu = _multipliers(q, _state(names["orders"] * nu, x), 2 * np.pi / nu, n)
                yield Claim("a fold has a multiplier 1", 1 + np.abs(mu - 1).min(), 1.0, 1e-3, damage=1e-2)  # fmt: skip
            seen += between
        yield Claim("folds are where the branch turns", len(branch.folds), seen)
        i = int(draw.integers(len(names["nu"])))
        state = _state(names["orders"] * names["nu"][i], names["coefficients"][i])
        q = p.__class__(**(vars(p) | {"p2": float(names["nu"][i])}))
        period = 2 * np.pi / names["nu"][i]
        sizes = _monodromy(q, state, period)
        admitted = 10 * names["truncation"][i] + 3e-9
        yield from _on(q, state, period, admitted)
        if (np.abs(sizes - 1) > CLOSE + 10 * names["truncation"][i]).all():
            yield Claim("growing", int(names["growing"][i]), int((sizes > 1).sum()))

    return Case(call, judge, may_refuse=True)


def case(rng, index):
    """Draw a pendulum and its loads."""
    return (_periodic, _periodic, _branch, _quasi)[index % 4](rng, index // 4)
