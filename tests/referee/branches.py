"""Points and folds solved again with twice the harmonics; number of folds against turning points."""

import numpy as np

from referee.balance import Balance, load_rows
from referee.case import Case, Claim, even, few
from referee.models import Draft, Term, chain, mount, some_memory
from referee.responses import difference
from referee.varying_loads import formula

JUDGES = ("trace_response", "Branch", "Branch.amplitude")


def _solve(model, coefficients, orders, nu, load):
    top = int(orders.max())
    top = min(2 * top + 6, max(41, top + 8))
    balance = Balance(model, top)
    a = balance.solve(balance.real(coefficients, orders), nu, load_rows(balance, load))
    return None if a is None else balance.complex(a)


def _judge_points(model, names, load, tolerance, rng):
    """Random points, ends, folds; ``load``: by harmonics, or a function of the frequency."""
    branch, reported = names["branch"], names["reported"]
    orders = branch.harmonics
    at = load if callable(load) else lambda nu: load
    warned = any("Convergence" in text for text in reported)
    yield Claim("truncation is estimated", branch.truncation is not None, True)
    estimate = np.zeros(branch.nu.size) if branch.truncation is None else branch.truncation
    turns = np.sign(np.diff(branch.parameter))
    turns = turns[turns != 0]
    seen = int((np.diff(turns) != 0).sum())
    between = len(branch.folds) - seen
    if between > 0 and between % 2 == 0 and branch.varies == "nu":
        # Two folds within a step give no turning point: check that the equations are singular there.
        highest = Balance(model, int(orders.max()))
        for nu, x in zip(branch.folds, branch.fold_coefficients, strict=True):
            _r, jac = highest.residual(highest.real(x, orders), nu, load_rows(highest, at(nu)))
            sizes = np.linalg.svd(jac, compute_uv=False)
            yield Claim("a fold is singular", 1 + sizes[-1] / sizes[0], 1.0, 1e-6, damage=1e-4)
        seen += between
    yield Claim("folds are where the branch turns", len(branch.folds), seen)
    for i in rng.integers(0, branch.nu.size, 3):
        scaled = {k: p * branch.load_factor[i] for k, p in at(branch.nu[i]).items()}
        true = _solve(model, branch.coefficients[i], orders, branch.nu[i], scaled)
        if true is None:
            continue
        off = difference(model, branch.coefficients[i], orders, true)
        if off > 0.5:
            continue  # A different motion, beyond a fold of the larger balance.
        admitted = max(estimate[i], 0.1 * tolerance) + 10 * tolerance
        if warned and branch.truncation is None:
            continue
        yield Claim("points", 1 + off, 1.0, admitted, limit=30.0, damage=max(1e-6, 1e3 * admitted))
    if branch.varies != "nu" or not len(branch.folds) or model.n > 2:
        return
    i = int(rng.integers(len(branch.folds)))
    # A reference with as many harmonics or fewer would be less accurate.
    if orders.max() > 24:
        return
    balance = Balance(model, min(2 * int(orders.max()) + 4, 31))
    start = balance.real(branch.fold_coefficients[i], orders)
    found = balance.fold(start, float(branch.folds[i]), lambda nu: load_rows(balance, at(nu)))
    if found is not None and abs(found[0] / branch.folds[i] - 1) < 0.1:
        own, motion = found
        # Newton's method of the reference, by differences, finds the location to about 1e-11.
        admitted = 3 * branch.fold_errors[i] + 1e-10 * own
        yield Claim(
            "place of a fold", branch.folds[i], own, admitted, damage=max(1e-6, 10 * admitted / own)
        )
        off = difference(model, branch.fold_coefficients[i], orders, balance.complex(motion))
        admitted = 3 * branch.fold_coefficient_errors[i] + 1e-8
        yield Claim("motion at a fold", 1 + off, 1.0, admitted, damage=max(1e-6, 10 * admitted))


def _any(rng, index):
    memory = some_memory(rng) if index % 4 == 2 else None
    if index % 4 == 3:
        model = mount(rng, damped=few(rng, 0.01, 0.03, 2), memory=memory)
    else:
        model = chain(
            rng,
            int(rng.integers(1, 3)),
            few(rng, 0.01, 0.06, 2),
            memory=memory,
            softening=index % 2 == 0,
            quadratic=index % 5 == 0,
        ).model()
    w = model.frequencies[0]
    size = few(rng, 0.01, 0.5, 2)
    load = {1: np.array([size] + [0.0] * (model.n - 1))}
    kept = rng.choice(["", ', harmonics="auto"', ", harmonics=13"])
    tolerance = float(rng.choice([1e-10, 1e-10, 1e-8]))
    if index % 3 < 2:
        ends = [float(f"{w * rng.uniform(0.4, 0.7):.4g}"), float(f"{w * rng.uniform(1.3, 2):.4g}")]
        where = f"({ends[0]}, {ends[1]})" if rng.random() < 0.7 else f"({ends[1]}, {ends[0]})"
    else:
        where = f"nu={float(f'{w * rng.uniform(0.7, 1.4):.4g}')}, load_range=(0.1, {even(rng, 1, 3, 2)})"
    draw = np.random.default_rng(index)
    given = size
    if index % 3 < 2 and index % 7 in (1, 4):
        text, amplitude = formula(draw, size, w)
        given = f"{{1: {{{model.names[0]!r}: {text!r}}}}}"

        def load(nu):
            return {1: np.array([amplitude(nu)] + [0.0] * (model.n - 1))}

    call = f"""system = {model.source}
branch = vv.trace_response(system, {where}, load={given}{kept}, tolerance={tolerance}, stability=False)
outcome, first, last = branch.outcome, branch.parameter[0], branch.parameter[-1]
amplitude = branch.amplitude({model.names[0]!r})
"""

    def judge(names, reported):
        names["reported"] = reported
        branch = names["branch"]
        if names["outcome"] == "returned":
            # The resonance peak lies behind the start, so only one of two folds is passed.
            yield Claim("back at its beginning", names["last"], names["first"], 1e-12)
            yield Claim("an odd number of folds", branch.folds.size % 2, 1)
        else:
            yield Claim("completed", names["outcome"], "completed")
        own = np.abs(branch.coefficients[:, 0, list(branch.harmonics).index(1)])
        yield Claim("amplitude", names["amplitude"], own, 1e-14 * own)
        yield from _judge_points(model, names, load, tolerance, draw)

    return Case(call, judge)


def _light(rng, index):
    """One resonance, damping down to 1e-8: exactly two folds."""
    c = few(rng, 1e-8 if index % 4 == 0 else 1e-6, 1e-2, 2)
    k3 = even(rng, 0.2, 1, 2)
    amplitude = even(rng, 0.6, 1.2, 2)
    model = Draft([1.0], [[c]], [[1.0]], [Term(k3, (3,), 0)]).model()
    size = float(f"{c * amplitude:.3g}")
    call = f"""system = {model.source}
branch = vv.trace_response(system, (0.8, 1.8), load={size}, max_points=5000, stability=False)
outcome, folds, peak = branch.outcome, len(branch.folds), branch.amplitude("x").max()
"""

    def judge(names, reported):
        # At the peak the load balances the damping: c nu a = P, nu^2 = 1 + 3/4 k3 a^2 + ...
        a = amplitude
        for _ in range(50):
            a = amplitude / np.sqrt(1 + 0.75 * k3 * a * a)
        yield Claim("completed", names["outcome"], "completed")
        # The peak shifts by much more than its width: the response has exactly two folds.
        if 0.375 * k3 * a * a > 20 * c:
            yield Claim("two folds", names["folds"], 2)
        yield Claim("amplitude at the peak", names["peak"], a, 0.02 * a, damage=0.1)

    return Case(call, judge)


def _begin(rng, index):
    """Any starting point, with automatic harmonics: a result or a refusal, no crash."""
    model = chain(rng, int(rng.integers(1, 3)), few(rng, 0.01, 0.1, 2)).model()
    low = few(rng, 0.05, 0.5, 3)
    size = few(rng, 1, 40, 2)
    call = f"""system = {model.source}
branch = vv.trace_response(
    system, ({low}, {float(f"{low * 1.05:.4g}")}), load={size}, harmonics="auto", stability=False, max_points=50
)
"""
    load = {1: np.array([size] + [0.0] * (model.n - 1))}
    draw = np.random.default_rng(index)

    def judge(names, reported):
        names["reported"] = reported
        branch = names["branch"]
        warned = any("Convergence" in text for text in reported)
        yield Claim(
            "truncation above the tolerance is reported",
            bool((branch.truncation <= 1.001e-10).all() or warned),
            True,
        )
        if not warned:
            yield from _judge_points(model, names, load, 1e-10, draw)

    return Case(call, judge, may_refuse=True)


def _leave(rng, index):
    """Branches that bifurcate at symmetry-breaking points: their motions lack the symmetry."""
    c, k3, nu = even(rng, 0.05, 0.15, 2), even(rng, 0.5, 1.5, 2), even(rng, 0.9, 1.2, 3)
    model = Draft([1.0], [[c]], [[1.0]], [Term(k3, (3,), 0)]).model()
    call = f"""system = {model.source}
same = dict(load_range=(0.1, 20), nu={nu}, load=1, harmonics=13, symmetric=False, stability=False)
main = vv.trace_response(system, **same)
sides = [vv.trace_response(system, **same, leave=p, max_points=300) for p in main.branch_points]
mirrored = [vv.trace_response(system, **same, leave=p, opposite=True, max_points=60) for p in main.branch_points]
"""
    load = {1: np.array([1.0])}
    draw = np.random.default_rng(index)

    def judge(names, reported):
        even_of_main = np.abs(names["main"].coefficients[:, 0, 2]).max(initial=0)
        yield Claim("the main branch keeps the symmetry", 1 + even_of_main, 1.0, 1e-7, damage=1e-5)
        for side, other in zip(names["sides"], names["mirrored"], strict=True):
            sizes = np.abs(side.coefficients[1:, 0, 2::2]).max(axis=1, initial=0)
            yield Claim("the symmetry stays broken", int((sizes < 1e-8).sum()), 0)
            known = min(side.nu.size, other.nu.size)
            if known < 6:
                continue  # the side branch ends near its start
            i = int(draw.integers(5, known))
            yield Claim("symmetry is broken", bool(abs(side.coefficients[i, 0, 0]) > 1e-6), True)
            x = _solve(
                model, side.coefficients[i], side.harmonics, nu, {1: load[1] * side.load_factor[i]}
            )
            if x is not None:
                sizes = np.abs(side.coefficients[i])
                left_out = float(sizes[:, -3:].max() / sizes.max())
                off = difference(model, side.coefficients[i], side.harmonics, x)
                admitted = 1e-8 + 3 * left_out
                yield Claim(
                    "points of another branch",
                    1 + off,
                    1.0,
                    admitted,
                    limit=10.0,
                    damage=max(1e-5, 100 * admitted),
                )
            means = np.array([side.coefficients[i, 0, 0].imag, -other.coefficients[i, 0, 0].imag])
            yield Claim("the other way is the mirror", bool(means.prod() > 0), True)

    return Case(call, judge)


def case(rng, index):
    """Draw a system and a way to follow it."""
    return (_any, _light, _any, _begin, _leave)[index % 5](rng, index // 5)
