"""Linear motions of condensed systems where an element is at rest, against the full solution."""

import numpy as np
import pytest
import viscovib as vv

WEIGHTS, RATES = np.array([0.1, 0.3]), np.array([0.5, 3.0])
EPS = np.finfo(float).eps


def chain(seed):
    """A lightly damped chain, positions of cubic springs, frequencies with one of them at rest."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(9, 20))
    k = rng.uniform(0.5, 2) * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    places = np.sort(rng.choice(n, rng.integers(1, 4), replace=False))
    rest = np.delete(np.delete(k, places[0], 0), places[0], 1)
    still = np.sqrt(np.linalg.eigvalsh(rest))
    nu = np.concatenate([still, still * (1 + 1e-6), rng.uniform(0.1, 2.5, 8)])
    load = np.zeros(n)
    load[rng.integers(n)] = 1
    return k, 10 ** rng.uniform(-7, -1) * k, places, nu, load


def worst(found, stiffness, load):
    """Largest error of all motions, relative to rounding error times condition number."""
    errors = []
    for u, d in zip(found, stiffness, strict=True):
        true = np.linalg.solve(d, load)
        errors.append(np.abs(u - true).max() / np.abs(true).max() / np.linalg.cond(d) / EPS)
    return max(errors)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("kind", ["cubic", "remembers", "tanh"])
def test_linear_motions_keep_their_digits_where_an_element_is_at_rest(seed, kind):
    """Regression: up to 1e7 times the rounding error, 1e-7 of the motion for a damping of 1e-5."""
    k, c, places, nu, load = chain(seed)
    n = load.size
    law = "0.3*tanh(x{0})" if kind == "tanh" else "x{0}^3"
    laws = {f"x{a + 1}": law.format(a + 1) for a in places}
    held = np.zeros((n, n))
    springs = []
    remembers = kind == "remembers"
    if kind != "cubic":
        held[places, places] = 0.3
    if remembers:
        kernel = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
        springs = [vv.Springs(stiffness=held, forces=laws, kernel=kernel)]
    body = vv.PolynomialSystem(
        mass=np.ones(n), stiffness=k, damping=c, springs=springs,
        forces={} if remembers else laws,
    )  # fmt: skip
    motion = vv.forced_response(body, nu, load=load, method="linear")
    relaxed = [1 - remembers * (WEIGHTS / (RATES + 1j * w)).sum() for w in nu]
    stiffness = [
        k - w**2 * np.eye(n) + 1j * w * c + f * held for w, f in zip(nu, relaxed, strict=True)
    ]
    assert worst(motion.coefficients[:, :, 0], stiffness, load) < 300


def left_over(found, orders, nu, stiffness, load, force):
    """Residual of the full equations, relative to their terms; ``force`` from samples."""
    phase = 2 * np.pi * np.arange(1024) / 1024
    u = (found @ np.exp(1j * np.outer(orders, phase))).imag
    rate = ((1j * orders * nu * found) @ np.exp(1j * np.outer(orders, phase))).imag
    parts = 2j / 1024 * force(u, rate) @ np.exp(-1j * np.outer(phase, orders))
    left = size = 0.0
    for k, order in enumerate(orders):
        d = stiffness(order * nu)
        pushed = load if order == 1 else 0.0
        left = max(left, np.abs(d @ found[:, k] + parts[:, k] - pushed).max())
        size = max(size, np.abs(d @ np.diag(found[:, k])).max())
    return left / size


@pytest.mark.parametrize(
    ("kind", "method"),
    [
        ("cubic", "newton"), ("remembers", "successive"), ("tanh", "newton"),
        ("dampers", "newton"), ("structure", "newton"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::viscovib.ConvergenceWarning")
def test_nonlinear_motions_keep_their_digits_where_an_element_is_at_rest(kind, method):
    """Regression: forces by H^-1 from deflections had errors of up to 7e-9 of the motion."""
    worst = 0.0
    for seed in range(2):
        k, c, places, nu, load = chain(seed)
        n = load.size
        load = 0.01 * load
        if kind == "dampers":
            c = c + np.diag(np.diag(c)) * np.arange(n) / n
        laws = {f"x{a + 1}": f"x{a + 1}^3" for a in places}

        def force(u, rate, places=places, kind=kind):
            found = np.zeros_like(u)
            own = np.tanh(u) - u + 0.05 * rate**3 if kind == "tanh" else u**3
            found[places] = own[places]
            return found

        held = np.zeros((n, n))
        given = {"mass": np.ones(n), "stiffness": k, "damping": c}
        if kind == "remembers":
            held[places, places] = 0.3
            kernel = vv.PronyKernel(weights=WEIGHTS, rates=RATES)
            group = vv.Springs(stiffness=held, kernel=kernel)
            body = vv.PolynomialSystem(**given, springs=[group], forces=laws)
        elif kind == "structure":
            elements = [vv.Spring(on=f"x{a + 1}", law="d^3") for a in places]
            body = vv.Structure(**given, elements=elements)
        else:
            if kind == "tanh":
                laws = {name: f"tanh({name}) - {name} + 0.05*{name}_dot^3" for name in laws}
            body = vv.PolynomialSystem(**given, forces=laws)

        def stiffness(w, k=k, c=c, held=held, n=n):
            relaxed = 1 - (WEIGHTS / (RATES + 1j * w)).sum()
            return k - w**2 * np.eye(n) + 1j * w * c + relaxed * held

        motion = vv.forced_response(
            body, nu, load=load, method=method, harmonics=9, tolerance=1e-13, max_iterations=400
        )
        if kind == "structure":
            motion = motion.at([f"x{i + 1}" for i in range(n)])
        orders = np.asarray(motion.harmonics)
        for i in np.flatnonzero(motion.outcome == "converged"):
            found = motion.coefficients[i]
            if method == "newton" or np.abs(found).max() < 10:
                left = left_over(found, orders, nu[i], stiffness, load, force)
                worst = max(worst, left)
    assert worst < (1e-13 if method == "newton" else 1e-11), worst
