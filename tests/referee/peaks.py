"""Peaks: the largest amplitude of the motion, by a balance solved at the peak and near it."""

import numpy as np
from scipy.optimize import minimize_scalar

from referee.balance import Balance, load_rows
from referee.case import Case, Claim, even, few
from referee.models import chain, mount
from referee.responses import refined

JUDGES = ("Peak", "Response.peak", "Branch.peak", "DrivenBranch.peak")
#: Relative tolerance of a peak with `enclosed`, which is refined by solving.
EXACT = 1e-6
#: Change of the phase per step, and maximum number of steps.
_TURN, _STEPS = 0.04, 120


def _turned(balance, a, nu, load, phase):
    """Motion near ``a`` with a given phase of harmonic 1 of the first coordinate; nu is unknown.

    Along a branch the phase is single-valued where nu is not: at folds and at the maximum.
    """
    size = a.size
    for _ in range(12):
        r, jac = balance.residual(a, nu, load)
        d = 1e-6 * nu
        by_nu = (
            balance.residual(a, nu + d, load, False)[0]
            - balance.residual(a, nu - d, load, False)[0]
        ).ravel() / (2 * d)
        m = np.zeros((size + 1, size + 1))
        m[:size, :size], m[:size, -1] = jac, by_nu
        # Im(X exp(-i phase)) of X = s_1 + i c_1, in rows 1 and 2 of the first coordinate.
        row = np.zeros(a.shape)
        row[1, 0], row[2, 0] = -np.sin(phase), np.cos(phase)
        m[-1, :size] = row.ravel()
        off = (row * a).sum()
        try:
            change = np.linalg.solve(m, np.append(r.ravel(), off))
        except np.linalg.LinAlgError:
            return None
        a, nu = a - change[:-1].reshape(a.shape), nu - change[-1]
        if not (np.isfinite(a).all() and np.isfinite(nu) and nu > 0):
            return None
        if np.abs(change[:-1]).max() <= 1e-11 * np.abs(a).max() and abs(change[-1]) < 1e-11 * nu:
            return a, nu
    return None


def _summit(model, coefficients, orders, nu, load, highest):
    """Return the next maximum of harmonic 1 of the first coordinate, uphill: nu, amplitude."""
    balance = Balance(model, highest)
    rows = load_rows(balance, load)
    a = balance.solve(balance.real(np.nan_to_num(coefficients), orders), nu, rows)
    if a is None:
        return None

    def size(motion):
        return np.hypot(*motion[0][1:3, 0])

    phase = np.arctan2(a[2, 0], a[1, 0])
    here = (a, nu)
    ways = [_turned(balance, a, nu, rows, phase + s * _TURN) for s in (-1, 1)]
    steps = [s * _TURN for s, m in zip((-1, 1), ways, strict=True) if m and size(m) > size(here)]
    if None in ways or len(steps) > 1:
        return None
    if steps:
        for _ in range(_STEPS):
            phase += steps[0]
            there = _turned(balance, *here, rows, phase)
            if there is None or abs(size(there) / size(here) - 1) > 0.3:
                return None
            if size(there) < size(here):
                break
            here = there
        else:
            return None
    found = {}

    def low(x):
        motion = _turned(balance, *here, rows, x)
        found[x] = motion
        return 0.0 if motion is None else -size(motion)

    best = minimize_scalar(
        low, bounds=(phase - 2.2 * _TURN, phase + 2.2 * _TURN), method="bounded",
        options={"xatol": 1e-8},
    )  # fmt: skip
    top = found.get(best.x)
    return None if top is None else (top[1], size(top))


def _of_summit(names, best, close):
    """Claims of a peak, by the maximum found."""
    if best is None:
        return
    yield Claim("peak is the summit", names["amplitude"], best[1], close * best[1], damage=1e-4)
    # A maximum is flat: the error of its location is the root of that of its height.
    yield Claim("place of the summit", names["at"], best[0], 1e-4 * best[0], damage=1e-2)


def _linear(rng, index):
    """Narrow resonances on coarse and fine grids."""
    model = chain(rng, int(rng.integers(1, 4)), few(rng, 1e-3, 0.05, 2)).model()
    w = model.frequencies[0]
    low, high = float(f"{w * rng.uniform(0.5, 0.9):.4g}"), float(f"{w * rng.uniform(1.1, 1.4):.4g}")
    n = int(rng.integers(6, 300))
    call = f"""system = {model.source}
r = vv.forced_response(system, np.linspace({low}, {high}, {n}), load=0.1, method="linear")
peak = r.peak({model.names[0]!r})
at, amplitude, enclosed = peak.nu, peak.amplitude, peak.enclosed
"""

    def judge(names, reported):
        def size(x):
            return abs(np.linalg.solve(model.dynamic_stiffness(x), np.eye(model.n)[0] * 0.1)[0])

        grid = np.linspace(low, high, 4000)
        i = int(np.argmax([size(x) for x in grid]))
        best = minimize_scalar(
            lambda x: -size(x), bounds=(grid[max(i - 1, 0)], grid[min(i + 1, 3999)]),
            method="bounded", options={"xatol": 1e-12},
        )  # fmt: skip
        if names["enclosed"]:
            yield Claim(
                "peak of a linear response",
                names["amplitude"],
                -best.fun,
                -best.fun * EXACT,
                damage=1e-5,
            )
        else:
            own = size(names["at"])
            yield Claim("largest sample", names["amplitude"], own, 1e-9 * own)

    return Case(call, judge)


def _nearby(nu, found, at):
    """Return the higher of the two neighbouring samples of a frequency."""
    left = np.where(np.isfinite(found) & (nu <= at), nu, -np.inf).argmax()
    right = np.where(np.isfinite(found) & (nu >= at), nu, np.inf).argmin()
    return int(max((left, right), key=lambda i: np.nan_to_num(found[i], nan=-1.0)))


def _nonlinear(rng, index):
    """Sweeps with possible jumps."""
    if index % 3 == 0:
        model = mount(rng, damped=few(rng, 0.01, 0.03, 2))
    else:
        model = chain(
            rng, int(rng.integers(1, 3)), few(rng, 0.01, 0.06, 2), softening=index % 3 == 1
        ).model()
    w = model.frequencies[0]
    size = few(rng, 0.01, 0.3, 2)
    low, high = float(f"{w * rng.uniform(0.6, 0.9):.4g}"), float(f"{w * rng.uniform(1.2, 1.8):.4g}")
    n = int(rng.integers(20, 200))
    order = "[::-1]" if rng.random() < 0.5 else ""
    dof = model.names[0]
    call = f"""system = {model.source}
r = vv.forced_response(system, np.linspace({low}, {high}, {n}){order}, load={size}, method="newton")
peak = r.peak({dof!r})
at, amplitude, enclosed = peak.nu, peak.amplitude, peak.enclosed
found, nu, orders, near = r.amplitude({dof!r}), r.nu, r.harmonics, r.coefficients
"""

    def judge(names, reported):
        found = names["found"]
        if np.isfinite(found).any():
            yield Claim(
                "not below the samples",
                bool(names["amplitude"] >= np.nanmax(found) * (1 - 1e-9)),
                True,
            )
        if not names["enclosed"]:
            return
        load = {1: np.array([size] + [0.0] * (model.n - 1))}
        top = max(11, int(names["orders"].max()))

        def summit(i):
            return _summit(model, names["near"][i], names["orders"], names["nu"][i], load, top)

        # Of several resonances the highest is not always that of the highest sample.
        highest, nearby = int(np.nanargmax(found)), _nearby(names["nu"], found, names["at"])
        yield from _of_summit(names, summit(nearby), 1e-5)
        if nearby == highest or not 0 < highest < found.size - 1:
            return
        other, around = summit(highest), names["nu"][[highest - 1, highest + 1]]
        if other is not None and around.min() < other[0] < around.max():
            yield Claim(
                "no lower than another summit",
                bool(names["amplitude"] >= other[1] * (1 - 1e-5)),
                True,
            )

    return Case(call, judge)


def _branch(rng, index):
    """Peaks of branches: neighbouring motions of the balance are lower."""
    model = chain(rng, 1, few(rng, 0.01, 0.06, 2), softening=bool(index % 2)).model()
    w, size = model.frequencies[0], few(rng, 0.005, 0.1, 2)
    low, high = float(f"{w * 0.5:.4g}"), float(f"{w * 1.8:.4g}")
    call = f"""system = {model.source}
branch = vv.trace_response(system, ({low}, {high}), load={size}, harmonics=11)
peak = branch.peak("x")
at, amplitude, enclosed = peak.nu, peak.amplitude, peak.enclosed
i = int(branch.amplitude("x").argmax())
near, orders, there, outcome = branch.coefficients[i], branch.harmonics, branch.nu[i], branch.outcome
"""

    def judge(names, reported):
        if not names["enclosed"]:
            return
        load = {1: np.array([size])}
        d = 2e-4 * names["at"]
        nearby = []
        for x in (names["at"] - d, names["at"], names["at"] + d):
            found = refined(model, names["near"], names["orders"], x, load, 11)
            nearby.append(np.nan if found is None else abs(found[0, 1]))
        best = _summit(model, names["near"], names["orders"], names["there"], load, 11)
        yield from _of_summit(names, best, EXACT)
        known = [b for b in nearby if np.isfinite(b)]
        if known:
            yield Claim(
                "no point next to it is higher",
                bool(names["amplitude"] >= max(known) * (1 - 1e-6)),
                True,
            )

    return Case(call, judge, may_refuse=False)


def _driven(rng, index):
    """A pendulum in z alone: one coordinate with a polynomial equation."""
    w2, alpha, c1 = even(rng, 0.3, 0.6, 3), even(rng, 0.2, 2, 3), few(rng, 0.02, 0.1, 2)
    f0 = few(rng, 0.002, 0.02, 2)
    call = f"""system = vv.Pendulum(e=0.1, w2={w2}, w3=0.7, alpha={alpha}, c1={c1}, c2=0.1, c3=0.1, f0={f0}, p1=1.0)
branch = vv.trace_response(system, p1=(0.7, 1.5), harmonics=12, symmetric=True, stability=False)
peak = branch.peak("z")
at, amplitude, enclosed = float(peak.nu), float(peak.amplitude), peak.enclosed
i = int(branch.amplitude("z").argmax())
near, orders, there = branch.coefficients[i], branch.harmonics, float(branch.nu[i])
"""

    def judge(names, reported):
        if not names["enclosed"]:
            return
        from referee.models import Draft, Swinging, Term

        zr = Swinging(0.1, w2, 0.7, alpha).z_r
        model = Draft(
            [1.0], [[c1]], [[1 + 3 * zr**2 * alpha]],
            [Term(alpha, (3,), 0), Term(3 * zr * alpha, (2,), 0)],
        ).model()  # fmt: skip
        load = {1: np.array([1j * f0])}
        best = _summit(model, names["near"][:1], names["orders"], names["there"], load, 14)
        yield from _of_summit(names, best, EXACT)

    return Case(call, judge)


def case(rng, index):
    """Draw a resonance, and a response or branch through it."""
    return (_linear, _nonlinear, _branch, _nonlinear, _driven)[index % 5](rng, index // 5)
