"""Harmonic balance with twice the harmonics in NumPy, starting from the result."""

import numpy as np

from referee.balance import Balance, load_rows
from referee.case import Case, Claim, even, few
from referee.models import chain, mount, rzhanitsyn, some_memory
from referee.varying_loads import formula

JUDGES = (
    "forced_response", "Response.corrections", "Response.methods", "Monomial", "PeriodicMotions",
    "PeriodicMotions.velocity", "PeriodicMotions.acceleration", "PeriodicMotions.rms",
    "PeriodicMotions.peak_to_peak",
)  # fmt: skip
#: Factor by which an estimate may be smaller than the error.
ESTIMATE = 10.0


def system_of(rng, index, *, damped=(0.01, 0.08), quadratic=True):
    """Draw a nonlinear system of one to three coordinates, with or without memory."""
    memory = some_memory(rng) if index % 3 == 2 else None
    if index % 4 == 3:
        kernel = rzhanitsyn(0.048, 0.1, 0.05) if memory else None
        return mount(
            rng,
            damped=few(rng, *damped, 2),
            memory=kernel,
            geometry=str(rng.choice(["cubic", "printed"])),
        )
    n = int(rng.integers(1, 4))
    return chain(
        rng, n, few(rng, *damped, 2), memory=memory, quadratic=quadratic and index % 5 == 0
    ).model()


def refined(model, coefficients, orders, nu, load, highest=None):
    """Motion with twice the harmonics near a result, X_k from k = 0; None if there is none."""
    top = int(max(orders.max(), max(load)))
    balance = Balance(model, highest or min(2 * top + 6, 60))
    start = balance.real(np.nan_to_num(coefficients), orders)
    a = balance.solve(start, nu, load_rows(balance, load))
    return None if a is None else balance.complex(a)


def difference(model, coefficients, orders, true):
    """Relative error in the norm of the tolerance: the largest harmonic, weighted by the mass.

    The norm is max over k and d of sqrt(M_dd) (|Re X| + |Im X|). Without the masses, an angle in
    radians would be compared with a displacement in metres.
    """
    whole = np.zeros_like(true)
    for j, k in enumerate(orders):
        if k < true.shape[1]:
            whole[:, k] = coefficients[:, j]
    weights = np.sqrt(np.diag(model.mass))[:, None]
    error, size = (
        (weights * (np.abs(x.real) + np.abs(x.imag))).max() for x in (whole - true, true)
    )
    return float(error / size)


def _of_the_waveform(names, nu):
    """Quantities derived from the harmonics, against samples of a period."""
    orders, own = names["orders"], names["coefficients"][-1]
    t = 2 * np.pi / nu * np.arange(4096) / 4096
    waves = np.exp(1j * nu * np.outer(t, orders))
    u, v, a = ((waves * (1j * orders * nu) ** m @ own).imag for m in range(3))
    k = names["k"]
    for name, values in (("velocity", v), ("acceleration", a)):
        # X = (2 i/N) sum_j u_j exp(-i k nu t_j) of u = Im X exp(i k nu t).
        true = 2j / t.size * (values @ np.exp(-1j * k * nu * t))
        yield Claim(name, names[name], true, 1e-12 * max(abs(true), np.abs(values).max()))
    yield Claim("rms", names["rms"], np.sqrt(np.mean(u**2)), 1e-12 * np.abs(u).max())
    wide = u.max() - u.min()
    # The maximum may lie between samples.
    room = np.abs(a).max() * (t[1] - t[0]) ** 2
    yield Claim("peak to peak", names["extent"], wide, room + 1e-12 * wide, damage=1e-3)


def case(rng, index):
    """Draw a system, a load and a method."""
    method = ("newton", "newton", "successive")[index % 3]
    model = system_of(rng, index // 3)
    omega = model.frequencies
    nu = float(f"{rng.uniform(0.25, 1.6) * omega[0]:.4g}")
    orders = "auto" if rng.random() < 0.5 else int(rng.choice([3, 5, 9, 13]))
    size = few(rng, 0.01, 0.08 if method == "successive" else 1.0, 3)
    tolerance = float(rng.choice([1e-10, 1e-7, 1e-12, 1e-14]))
    load = {1: np.array([size] + [0.0] * (model.n - 1))}
    if rng.random() < 0.3:
        load[int(rng.integers(2, 4))] = np.array([even(rng, 0.1, 0.5, 2) * size] * model.n).round(6)
    if orders != "auto":
        orders = max(orders, max(load))
    text = ", ".join(f"{k}: {p.tolist()}" for k, p in load.items())
    if index % 5 == 2:
        # The same amplitude as a formula.
        written, value = formula(np.random.default_rng(index), size, omega[0])
        load[1] = np.array([value(nu)] + [0.0] * (model.n - 1))
        others = ", ".join(f"{k}: {p.tolist()}" for k, p in load.items() if k > 1)
        text = f"1: {{{model.names[0]!r}: {written!r}}}, {others}"
    relaxed = ', relaxation="auto"' if method == "successive" and index % 2 else ""
    call = f"""system = {model.source}
r = vv.forced_response(
    system, [{nu}], load={{{text}}}, method={method!r}, harmonics={orders!r}, tolerance={tolerance}{relaxed}
)
coefficients, orders, outcome, used = r.coefficients[0], r.harmonics, r.outcome[0], r.methods[0]
truncation, corrections = r.truncation[0], r.corrections[0]
k, dof = int(orders[orders > 0][0]), r.dof_names[-1]
velocity, acceleration = r.velocity(dof, k)[0], r.acceleration(dof, k)[0]
rms, extent = r.rms(dof)[0], r.peak_to_peak(dof)[0]
coarse = vv.forced_response(
    system, [{nu}], load={{{text}}}, method={method!r}, harmonics={orders!r}, tolerance=1e-9
).outcome[0]
"""

    def judge(names, reported):
        if names["outcome"] != "converged":
            # No result, and the outcome states it.
            yield Claim("what is not found is reported", bool(reported), True)
            if method == "newton":
                # Rounding errors do not justify a missing result.
                yield Claim("found with a coarser tolerance", names["coarse"] == "converged", False)
            return
        kept = names["orders"]
        yield Claim("method", names["used"], method)
        yield from _of_the_waveform(names, nu)
        same = refined(model, names["coefficients"], kept, nu, load, highest=int(kept.max()))
        true = refined(model, names["coefficients"], kept, nu, load)
        if true is None and names["truncation"] > 0.05 and reported:
            # With so few harmonics the result is another motion, and the truncation states it.
            return
        if true is None:
            yield Claim("a motion is near the answer", False, True)
            return
        off = difference(model, names["coefficients"], kept, true)
        admitted = names["truncation"] + 3 * tolerance
        warned = any("Convergence" in text for text in reported)
        yield Claim(
            "truncation", 1 + off, 1.0, ESTIMATE * admitted + 1e-11, damage=max(1e-6, 30 * admitted)
        )
        yield Claim(
            "truncation above the tolerance is reported",
            bool(names["truncation"] <= 1.0001 * tolerance or warned),
            True,
        )
        full = np.arange(int(kept.max()) + 1)
        if same is not None and set(full[1::2]) <= set(kept.tolist()):
            # With equal harmonics only the iteration has an error; even ones may be 0 by symmetry.
            own = difference(model, names["coefficients"], kept, same)
            yield Claim(
                "solution of the balance",
                1 + own,
                1.0,
                300 * tolerance + 1e-11,
                damage=max(1e-6, 1e3 * tolerance),
            )
        if method == "newton" and index % 4 == 0 and model.n < 3 and kept.max() < 20:
            balance = Balance(model, max(9, int(kept.max())))
            raised = balance.raised(nu, load_rows(balance, load))
            if raised is not None:
                off = difference(model, names["coefficients"], kept, balance.complex(raised))
                yield Claim(
                    "the load grows from nothing", 1 + off, 1.0, 10 * admitted + 1e-3, damage=0.1
                )
        if method == "successive" and np.size(names["corrections"]) > 1:
            c = names["corrections"][np.isfinite(names["corrections"])]
            yield Claim("last correction", bool(c[-1] <= tolerance), True)

    return Case(call, judge, may_refuse=False)
