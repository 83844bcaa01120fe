"""Stiffness ratios, loads from 0 to overflow, small divisors, folds within one step."""

import warnings
from collections.abc import Iterator

import mpmath as mp
import numpy as np
import viscovib as vv
from scenes import DAMPING, EPS, MOUNT, PENDULUM, START, far, mount
from scipy.linalg import expm
from steps import Job
from tally import Row, Tally

START_SCALES = (0.02, 0.0, 0.01, 0.0)
#: Factor by which the estimate of multiple scales may be too small.
TOO_SMALL = 5.0


def jobs(quick: bool) -> Iterator[tuple[str, Job]]:
    """One job per row."""
    yield "stiffness, modes", stiff_modes
    yield "stiffness, response", stiff_response
    yield "stiffness, motion", lambda: stiff_motion(quick)
    for method in ("linear", "successive", "newton"):
        yield f"loads, {method}", lambda m=method: loads_of_response(m)
    yield "loads, motion of the mount", loads_of_motion
    yield "loads, motion of the pendulum", loads_of_pendulum
    for coupled in (False, True):
        yield "small divisors", lambda c=coupled: small_divisors(c, quick)
    yield "close folds", lambda: close_folds(quick)


def _ratios() -> np.ndarray:
    return 10.0 ** np.arange(-8, 9, 2)


def stiff_modes() -> Row:
    """Natural frequencies and roots against values with 40 digits."""
    tally = Tally(
        "stiffness", "natural frequencies and roots of the mount", "ratio 1e-8 ... 1e8", 20 * EPS,
        "relative error; of roots over the largest",
    )  # fmt: skip
    for ratio in _ratios():
        body = vv.Mount(**(MOUNT | {"stiffness_phi": 2 * ratio}), damping=DAMPING)
        with mp.workdps(60):
            c, cp, arm, i = mp.mpf(10), mp.mpf(float(2 * ratio)), mp.mpf(0.5), mp.mpf(0.1)
            k = mp.matrix([[c, -c * arm], [-c * arm, c * arm**2 + cp]])
            d = mp.matrix(DAMPING)
            a, b = 1 * i, c * i + (c * arm**2 + cp)
            root = mp.sqrt(b * b - 4 * a * c * cp)
            omega = [mp.sqrt((b - root) / (2 * a)), mp.sqrt((b + root) / (2 * a))]
            made = tally.trial(f"ratio {ratio:g}", body.natural_frequencies)
            assert made is not None
            for m, e in zip(made, omega, strict=True):
                tally.measure(f"ratio {ratio:g}", float(abs(m / e - 1)))
            # det(s^2 M + s C + K) as a polynomial in s.
            p = [i, d[1, 1] + d[0, 0] * i, k[1, 1] + d[0, 0] * d[1, 1] + k[0, 0] * i
                 - d[0, 1] * d[1, 0],
                 d[0, 0] * k[1, 1] + k[0, 0] * d[1, 1] - d[0, 1] * k[1, 0] - k[0, 1] * d[1, 0],
                 k[0, 0] * k[1, 1] - k[0, 1] * k[1, 0]]  # fmt: skip
            roots = mp.polyroots(p, maxsteps=500, extraprec=400)
            found = tally.trial(f"ratio {ratio:g}", body.characteristic_roots)
            assert found is not None
            for s in found.oscillatory:
                gap = min(abs(mp.mpc(complex(s)) - e) for e in roots)
                # Eigenvalues of a matrix have an error relative to the largest one.
                largest = max(abs(e) for e in roots)
                tally.measure(f"roots, ratio {ratio:g}", float(gap / largest))
            pairs = sum(mp.im(e) > 1e-12 * abs(e) for e in roots)
            tally.check(
                f"roots, ratio {ratio:g}", len(found.oscillatory) == pairs, f"not {pairs} pairs"
            )
    return tally.row()


def stiff_response() -> Row:
    """Linear response relative to its condition."""
    tally = Tally(
        "stiffness", "linear response", "ratio 1e-8 ... 1e8, nu = 1e-3 ... 1e3", 10.0,
        "error / (condition x epsilon)",
    )  # fmt: skip
    nu = np.geomspace(1e-3, 1e3, 25)
    for ratio in _ratios():
        cp = float(2 * ratio)
        body = vv.Mount(**(MOUNT | {"stiffness_phi": cp}), damping=DAMPING)
        r = tally.trial(
            f"ratio {ratio:g}",
            lambda b=body: vv.forced_response(b, nu, load=1.0, method="linear", harmonics=1),
        )
        assert r is not None
        for j, n in enumerate(nu):
            with mp.workdps(40):
                k = mp.matrix([[10, -5], [-5, mp.mpf(2.5) + cp]])
                terms = [k, mp.mpc(0, float(n)) * mp.matrix(DAMPING),
                         -mp.diag([mp.mpf(1), mp.mpf(0.1)]) * mp.mpf(float(n)) ** 2]  # fmt: skip
                d = terms[0] + terms[1] + terms[2]
                x = mp.lu_solve(d, mp.matrix([1, 0]))
                inverse = mp.inverse(d)
                moved = max(
                    sum(abs(inverse[a, b]) * sum(abs(t[b, c]) for t in terms) * abs(x[c])
                        for b in range(2) for c in range(2))
                    for a in range(2)
                )  # fmt: skip
                top = max(abs(v) for v in x)
                error = max(abs(mp.mpc(complex(r.coefficients[j, a, 0])) - x[a]) for a in range(2))
                tally.measure(
                    f"ratio {ratio:g}, nu = {n:.3g}", float(error / max(moved, top)) / EPS
                )
    return tally.row()


def stiff_motion(quick: bool) -> Row:
    """Linear free motion against the matrix exponential, or a refusal."""
    tally = Tally(
        "stiffness", "free motion of the linear mount, dt = 0.125", "ratio 1e-8 ... 1e8", 3.0,
        "error / its estimate, where that is below 0.1",
    )  # fmt: skip
    counts: dict[str, int] = {}
    for ratio in _ratios()[:: 2 if quick else 1]:
        body = vv.Mount(**(MOUNT | {"stiffness_phi": 2 * ratio}), damping=DAMPING, cubic_scale=0.0)
        label = f"ratio {ratio:g}"
        run = tally.trial(
            label,
            lambda b=body: vv.simulate(
                b, 16, dt=0.125, initial=[0.01, 0, 1e-3, 0], keep="last", estimate_error=True
            ),
        )
        if run is None:
            continue
        counts[run.outcome] = counts.get(run.outcome, 0) + 1
        if run.outcome != "completed":
            continue
        inverse = np.diag([1, 10.0])
        k = np.array([[10, -5], [-5, 2.5 + 2 * ratio]])
        a = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ k, -inverse @ np.array(DAMPING)]])
        exact = expm(16 * a) @ np.array([0.01, 1e-3, 0, 0])
        error = float(np.abs(run.state[0, ::2] - exact[:2]).max())
        estimate = max(float(run.error or 0), 1e-13)
        tally.check(label, bool(np.isfinite(run.state).all()), "states are not finite")
        if estimate < 0.1 * 0.01:
            tally.measure(label, error / estimate)
    tally.notes.append(", ".join(f"{n} {name}" for name, n in counts.items()))
    return tally.row()


def loads_of_response(method: str) -> Row:
    """Small loads: X/P is linear. Large loads: a solution that balances, or a message."""
    tally = Tally(
        "load", f"response, {method}", "1e-300 ... 1e308", 1e-12,
        "X/P against the linear one, loads to 1e-9",
    )  # fmt: skip
    nu = [0.7, 1.5, 3.0]
    body = mount(damping=DAMPING)
    unit = vv.forced_response(body, nu, load=1.0, method="linear", harmonics=1).coefficients
    outcomes: dict[str, int] = {}
    for e in [*range(-300, 309, 19), 308]:
        load = 10.0**e
        label = f"load 1e{e}"
        r = tally.trial(
            label,
            lambda p=load: vv.forced_response(body, nu, load=p, method=method, harmonics=5),
        )
        if r is None:
            continue
        for outcome, x in zip(r.outcome, r.coefficients, strict=True):
            name = str(outcome)
            outcomes[name] = outcomes.get(name, 0) + 1
            good = bool(np.isfinite(x).all()) == (name == "converged")
            tally.check(label, good, f"{name} with {x.ravel()[0]}")
        if e <= -9 or method == "linear":
            tally.measure(label, far(r.coefficients[:, :, 0] / load, unit[:, :, 0]))
    tally.notes.append(", ".join(f"{n} {name}" for name, n in outcomes.items()))
    return tally.row()


def loads_of_motion() -> Row:
    """Motions of the mount with memory under loads of any size."""
    tally = Tally(
        "load", "motion of the mount", "1e-300 ... 1e308", 1e-11,
        "u/P against that of P = 1e-9, loads to 1e-9",
    )  # fmt: skip
    body = mount(damping=DAMPING)

    def run(load: float) -> vv.Trajectory:
        return vv.simulate(body, 10, dt=0.25, load=load, nu=1.5)

    unit = run(1e-9).state / 1e-9
    outcomes: dict[str, int] = {}
    for e in [*range(-300, 309, 19), 308]:
        made = tally.trial(f"load 1e{e}", lambda e=e: run(10.0**e))
        if made is None:
            continue
        outcomes[made.outcome] = outcomes.get(made.outcome, 0) + 1
        tally.check(f"load 1e{e}", bool(np.isfinite(made.state).all()), "states are not finite")
        if e <= -9:
            tally.check(f"load 1e{e}", made.outcome == "completed", made.outcome)
            # Numbers below 2e-308 are 0.
            tally.measure(
                f"load 1e{e}", far(made.state / 10.0**e, unit), max(1e-11, 1e-307 / 10.0**e)
            )
    tally.notes.append(", ".join(f"{n} {name}" for name, n in outcomes.items()))
    return tally.row()


def loads_of_pendulum() -> Row:
    """Every method under every load: completed and finite, or a message."""
    tally = Tally(
        "load", "motion of the pendulum, each load, four methods", "1e-300 ... 1e308", 0.5,
        "runs with a number that is not finite",
    )  # fmt: skip
    outcomes: dict[str, int] = {}
    for method in ("gauss2", "gauss8", "rk4", "verner9"):
        for name in ("f0", "m01", "m02"):
            for e in [*range(-300, 309, 38), 308]:
                body = vv.Pendulum(**(PENDULUM | {name: 10.0**e}))
                made = tally.trial(
                    f"{name} = 1e{e}",
                    lambda b=body, m=method: vv.simulate(b, 10, dt=0.25, initial=START, method=m),
                )
                if made is not None:
                    outcomes[made.outcome] = outcomes.get(made.outcome, 0) + 1
                    finite = bool(np.isfinite(made.state).all())
                    tally.measure(f"{name} = 1e{e}, {method}", float(not finite))
    tally.notes.append(", ".join(f"{n} {name}" for name, n in outcomes.items()))
    return tally.row()


def small_divisors(coupled: bool, quick: bool) -> Row:
    """Two modes near 1:2, with the resonance treated as small divisor; motions against simulate."""
    tally = Tally(
        "small divisors", "motion near w2 = 2 w1, " + ("resonant terms kept" if coupled else
        "divided by the difference"), "(w2 - 2 w1)/w2 = 1e-12 ... 0.3",
        TOO_SMALL,
        "error / its estimate, where in range",
    )  # fmt: skip
    t = np.linspace(0, 40, 81)
    refused = 0
    gaps = 10.0 ** np.arange(-12, 0, 3.0 if quick else 1.0)
    for gap in [*gaps, 0.3]:
        w2 = 2 / (1 - gap)
        cubic = vv.CubicSystem(
            mass=np.eye(2), stiffness=np.diag([1.0, w2**2]),
            quadratic=[[[0, 0.4], [0, 0]], [[0.2, 0], [0, 0]]],
        )  # fmt: skip
        same = vv.PolynomialSystem(
            mass=[1, 1], stiffness=[1, w2**2], forces={"x1": "0.4*x1*x2", "x2": "0.2*x1^2"}
        )
        label = f"gap {gap:.0e}"
        made = tally.trial(
            label,
            lambda c=cubic: vv.MultipleScales(c, tolerance=0.05 if coupled else 1e-15).motion(
                t, START_SCALES
            ),
        )
        if made is None:
            continue
        exact = vv.simulate(same, 40, dt=0.25, initial=START_SCALES, times=t[1:])
        error = np.abs(made.state[1:] - exact.state)[:, ::2].max(axis=1)
        inside = made.in_range[1:]
        refused += int(not inside.all())
        tally.check(label, bool(np.isfinite(made.state).all()), "states are not finite")
        if inside.any():
            tally.measure(label, (error / made.error_estimate[1:])[inside].max())
    tally.notes.append(f"{refused} of {len(gaps) + 1} leave the range, and a warning reports it")
    return tally.row()


def close_folds(quick: bool) -> Row:
    """Duffing oscillator just above the load at which two folds appear, one harmonic."""
    tally = Tally(
        "folds", "pair of folds of a Duffing oscillator, one harmonic", "load 1e-1 ... 1e-7 above",
        1e-9, "error of nu",
    )  # fmt: skip
    body = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
    for e in range(1, 8, 2 if quick else 1):
        load, exact = _folds(mp.mpf("0.1"), mp.mpf("0.75"), mp.mpf(10) ** -e)
        distance = abs(exact[0] - exact[1])
        label = f"load {10.0**-e:.0e} above, folds {distance:.1e} apart"
        branch = tally.trial(label, lambda p=load: _one_harmonic(body, p))
        if branch is None:
            continue
        if branch.folds.size == 0:
            tally.notes.append(f"both passed over: {label}")
            continue
        tally.check(label, branch.folds.size == 2, f"{branch.folds.size} folds")
        gap = np.abs(np.sort(branch.folds) - np.sort(exact)).max()
        tally.measure(label, float(gap))
    return tally.row()


def _one_harmonic(body: vv.PolynomialSystem, load: float) -> vv.Branch:
    """The balance with one harmonic is the exact problem here; its truncation is ignored."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "at .* harmonics up to 1 do not", vv.ConvergenceWarning)
        return vv.trace_response(
            body, (0.5, 2.5), load=load, harmonics=1, tolerance=1e-13, stability=False
        )


def _folds(c: mp.mpf, k: mp.mpf, above: mp.mpf) -> tuple[float, np.ndarray]:
    """Load slightly above the cusp, and its two folds.

    With y = a^2 and n = nu^2: y [(1 + k y - n)^2 + c^2 n] = P^2, k = 3/4 of the cubic coefficient;
    its derivative by y vanishes at 3 k y = 2 (n - 1) +- sqrt((n - 1)^2 - 3 c^2 n).
    """
    with mp.workdps(50):

        def square(n: mp.mpf, sign: int) -> mp.mpf:
            y = (2 * (n - 1) + sign * mp.sqrt(abs((n - 1) ** 2 - 3 * c**2 * n))) / (3 * k)
            return y * ((1 + k * y - n) ** 2 + c**2 * n)

        # (n - 1)^2 = 3 c^2 n
        half = 1 + 3 * c**2 / 2
        cusp = half + mp.sqrt(half**2 - 1)
        load = mp.mpf(float(mp.sqrt(square(cusp, 1)) * (1 + above)))
        found = []
        for sign in (-1, 1):
            low, high = cusp, cusp * 2
            for _ in range(160):
                middle = (low + high) / 2
                if square(middle, sign) < load**2:
                    low = middle
                else:
                    high = middle
            found.append(float(mp.sqrt(low)))
        return float(load), np.array(found)
