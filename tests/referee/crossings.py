"""Floquet multipliers along branches; bifurcations against them and against neighbouring counts."""

import numpy as np

from referee.balance import Balance, load_rows, multipliers
from referee.case import Case, Claim, even, few
from referee.hidden import hidden
from referee.models import Draft, Term, chain, mount, some_prony

JUDGES = ("Crossing", "BranchPoint", "trace_response")
CLOSE = 1e-7


def _own(model, coefficients, orders, nu, load, highest=None):
    balance = Balance(model, highest or int(orders.max()))
    a = balance.solve(balance.real(coefficients, orders), nu, load_rows(balance, load))
    return None if a is None else balance.complex(a)


def reported_by_crossings(branch):
    """Bifurcations explain each change of the count, have a location, and include each fold."""
    g = branch.growing
    by = {i: [c for c in branch.crossings if c.before == i] for i in range(g.size - 1)}
    unexplained = 0
    for i, here in by.items():
        if g[i] < 0 or g[i + 1] < 0:
            continue
        sums = {0}
        for c in here:
            weight = 2 if c.kind == "Neimark-Sacker" else 1
            sums = {s + sign * weight for s in sums for sign in (-1, 1)}
        unexplained += int(g[i + 1] - g[i]) not in sums
    yield Claim("every change is explained", unexplained, 0)
    yield Claim("a crossing has a place", sum(c.parameter is None for c in branch.crossings), 0)
    if branch.truncation.max() < 1e-3 and (g >= 0).all():
        reported = sum(c.kind == "fold" for c in branch.crossings)
        yield Claim("every fold is a crossing", reported, len(branch.folds))


def places_of_more(branch, more):
    """The error of each location covers the difference to the same branch with more harmonics."""
    for found, true in (
        (branch.crossings, more.crossings),
        (branch.branch_points, more.branch_points),
    ):
        for one in found:
            kind = getattr(one, "kind", "branch leaves")
            if one.parameter is None or not one.error < 1e-3:
                continue
            nearby = [c for c in true if getattr(c, "kind", kind) == kind and c.parameter]
            m = one.coefficients.shape[1]
            nearby = [
                c
                for c in nearby
                if np.abs(c.coefficients[:, :m] - one.coefficients).max()
                < 0.05 * np.abs(one.coefficients).max()
            ]
            if not nearby:
                continue
            nearest = min(nearby, key=lambda c, p=one.parameter: abs(c.parameter - p))
            yield Claim(
                f"place of a {kind}",
                one.parameter,
                nearest.parameter,
                1.5 * (one.error + nearest.error),
                damage=1e-2,
            )


def case(rng, index):
    """Draw a branch and check its stability."""
    memory = some_prony(rng) if index % 3 == 2 else None
    symmetric = index % 2 == 0
    if index % 5 == 0:
        model = mount(rng, damped=few(rng, 0.01, 0.03, 2), memory=memory)
    elif index % 5 == 1:
        # Parametric resonance and period doubling: a load of harmonic 2 at half its frequency.
        model = Draft([1.0], [[few(rng, 0.02, 0.1, 2)]], [[1.0]], [Term(even(rng, 0.2, 1, 2), (2,), 0), Term(even(rng, 0.3, 1, 2), (3,), 0)], memory).model()  # fmt: skip
    elif index % 10 == 4:
        memory = some_prony(rng)
        model = hidden(rng, few(rng, 0.01, 0.06, 2), memory)
    else:
        model = chain(
            rng,
            int(rng.integers(1, 3)),
            few(rng, 0.01, 0.06, 2),
            memory=memory,
            quadratic=index % 5 == 3,
        ).model()
    w = model.frequencies[0]
    size = few(rng, 0.05, 1.0, 2)
    order = 2 if index % 5 == 1 else 1
    load = {order: np.array([size] + [0.0] * (model.n - 1))}
    ends = (float(f"{w * 0.5:.4g}"), float(f"{w * 1.7:.4g}"))
    if rng.random() < 0.4:
        where = f"nu={float(f'{w * rng.uniform(0.5, 1.5):.4g}')}, load_range=(0.2, 4)"
    else:
        where = f"{ends}"
    same = f"{where}, load={{{order}: {load[order].tolist()}}}, harmonics=13, symmetric={symmetric}"
    # Small steps with memory are slow.
    refined = f"vv.trace_response(system, {same}, max_points=4000, max_step=0.02)"
    more = f"vv.trace_response(system, {same.replace('harmonics=13', 'harmonics=33')})"
    call = f"""system = {model.source}
branch = vv.trace_response(system, {same}, max_points=600)
refined = {refined if memory is None or index % 12 == 2 else None}
more = {more if memory is None or index % 12 == 5 else None}
"""
    draw = np.random.default_rng(index)

    def judge(names, reported):
        branch = names["branch"]
        if branch.stable is None or branch.growing is None:
            return
        orders = branch.harmonics
        for i in draw.integers(0, branch.nu.size, 2):
            scaled = {k: p * branch.load_factor[i] for k, p in load.items()}
            # With the same harmonics, so that the solution of this balance is the motion checked.
            x = _own(model, branch.coefficients[i], orders, branch.nu[i], scaled)
            if x is None or branch.growing[i] < 0:
                continue
            kept = np.zeros_like(x)
            kept[:, orders] = branch.coefficients[i]
            if np.abs(kept - x).max() > 1e-6 * np.abs(x).max():
                continue
            mu, off = multipliers(model, kept, branch.nu[i], 192)
            sizes = np.abs(mu)
            if (np.abs(sizes - 1) < CLOSE + 10 * off).any():
                continue
            yield Claim("growing", int(branch.growing[i]), int((sizes > 1).sum()))
            if memory is None:
                got = np.sort(np.abs(branch.multipliers[i]))[::-1]
                yield Claim(
                    "multipliers", got[0], sizes[0], 1e-7 * sizes[0] + 10 * off[0], damage=1e-4
                )
        yield from reported_by_crossings(branch)
        if names["more"] is not None:
            yield from places_of_more(branch, names["more"])
        refined = names["refined"]
        # Small steps find the same; with few harmonics the locations of folds and multipliers differ.
        if refined is not None and refined.growing is not None:
            whole = branch.outcome == refined.outcome == "completed"
            if whole and max(branch.truncation.max(), refined.truncation.max()) < 1e-3:
                kinds = [[c.kind for c in b.crossings] for b in (branch, refined)]
                yield Claim("smaller steps tell the same", *map(" ".join, kinds))
                if kinds[0] == kinds[1]:
                    got, true = (
                        np.array(
                            [np.nan if c.parameter is None else c.parameter for c in b.crossings]
                        )
                        for b in (branch, refined)
                    )
                    yield Claim(
                        "places with smaller steps",
                        got,
                        true,
                        (1e-5 + 5 * branch.truncation.max()) * np.abs(true),
                        damage=1e-2,
                    )
        for c in list(branch.crossings)[:3]:
            if c.parameter is None or c.coefficients is None:
                continue
            nu = c.parameter if branch.varies == "nu" else branch.nu[0]
            whole = np.zeros((model.n, int(orders.max()) + 1), complex)
            whole[:, orders] = c.coefficients
            mu, _ = multipliers(model, whole, nu, 192)
            target = {"period doubling": -1.0}.get(c.kind, 1.0)
            if c.kind == "Neimark-Sacker":
                away = np.abs(np.abs(mu) - 1)[np.abs(mu.imag) > 1e-6]
                away = float(away.min(initial=9.0))
            else:
                away = float(np.abs(mu - target).min())
            # At a fold a multiplier leaves 1 like the square root of the distance. Omitted harmonics have
            # the same effect.
            sizes = np.abs(whole)
            left_out = float(sizes[:, -2:].max() / sizes.max())
            near = 3e-4 + 30 * np.sqrt(left_out)
            yield Claim(
                f"multiplier at a {c.kind}", 1 + away, 1.0, near, damage=max(1e-2, 3 * near)
            )
        for point in branch.branch_points[:1]:
            factor = 1.0 if branch.varies == "nu" else point.parameter
            nu = point.parameter if branch.varies == "nu" else branch.nu[0]
            balance = Balance(model, int(orders.max()))
            scaled = {k: p * factor for k, p in load.items()}
            a = balance.real(point.coefficients, orders)
            _r, jac = balance.residual(a, nu, load_rows(balance, scaled))
            values = np.linalg.svd(jac, compute_uv=False)
            yield Claim(
                "derivatives at a branch point", 1 + values[-1] / values[0], 1.0, 1e-7, damage=1e-5
            )

    return Case(call, judge)
