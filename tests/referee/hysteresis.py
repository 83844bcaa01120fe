"""Elements with hysteresis and gaps: their loops by the steps of SciPy, cycle after cycle."""

import numpy as np

from referee.case import Case, Claim, even, few
from referee.integration import solve_ivp

JUDGES = (
    "Iwan", "Iwan.loop", "Iwan.energy", "BoucWen", "BoucWen.loop", "BoucWen.energy", "Dahl",
    "Dahl.loop", "Dahl.energy", "Gap", "Gap.force", "Stop", "Stop.force",
    "Response.dissipation", "Branch.dissipation", "Response.sampling", "Branch.sampling",
)  # fmt: skip


def _draw(rng, index):
    """Draw the source of an element, dz/dd of its state, and its elastic and hysteretic part."""
    k = few(rng, 1, 30)
    if index % 3 == 0:
        k = [few(rng, 1, 30), few(rng, 1, 30)]
        limit = [few(rng, 0.1, 20), few(rng, 0.1, 20)]

        def slope(z, way):
            return np.where(way * z < limit, k, 0)

        return f"vv.Iwan(on='x1', stiffness={k}, limit={limit})", slope, 0.0, np.ones(2), limit
    if index % 3 == 1:
        limit, exponent = few(rng, 0.3, 5), [1, 2, 1.5, 3][int(rng.integers(4))]

        def slope(z, way):
            return k * np.maximum(1 - way * z / limit, 0) ** exponent

        source = f"vv.Dahl(on='x1', stiffness={k}, limit={limit}, exponent={exponent})"
        return source, slope, 0.0, np.ones(1), None
    beta, exponent = few(rng, 0.5, 5), [1, 2, 1.5, 3][int(rng.integers(4))]
    gamma, ratio = round(beta * even(rng, -0.5, 2.5, 2), 3), even(rng, 0, 0.5, 2)

    def slope(z, way):
        return 1 - (gamma + beta * np.sign(way * z)) * np.abs(z) ** exponent

    source = (
        f"vv.BoucWen(on='x1', stiffness={k}, ratio={ratio}, beta={beta}, gamma={gamma}, "
        f"exponent={exponent})"
    )
    return source, slope, ratio * k, np.array([(1 - ratio) * k]), None


def _loop(rng, index):
    source, slope, elastic, weight, limit = _draw(rng, index)
    n = int(rng.integers(2, 6))
    d = [round(x, 3) for x in rng.normal(size=n) * few(rng, 0.5, 3)]
    call = f"element = {source}\nloop = element.loop({d})\nlost = float(element.energy({d}))\n"

    def judge(names, reported):
        z, _ = _moved(slope, weight, limit, np.zeros(weight.size), d[0])
        before = np.full(n, np.inf)
        for _ in range(60):
            own, work = np.empty(n), 0.0
            for i in range(n):
                now = d[(i + 1) % n]
                z, more = _moved(slope, weight, limit, z, now - d[i])
                own[(i + 1) % n] = elastic * now + weight @ z
                work += more
            if np.abs(own - before).max() < 1e-11 * np.abs(own).max():
                size = np.abs(own).max()
                yield Claim("loop", names["loop"], own, 1e-8 * size)
                yield Claim("energy", names["lost"], work, 1e-8 * size * np.ptp(d))
                return
            before = own

    return Case(call, judge)


def _moved(slope, weight, limit, z, change):
    """States after a change of the deflection, and the work of their forces."""
    way = np.sign(change)
    if change == 0:
        return z, 0.0
    if limit is not None:
        rate = slope(0 * z, way)
        wanted = z + rate * change
        after = np.clip(wanted, -np.array(limit), limit)
        slid = (wanted - after) / rate
        return after, float(((after**2 - z**2) / (2 * rate) + after * slid).sum())
    path = solve_ivp(
        lambda _, y: way * np.array([*slope(y[:-1], way), weight @ y[:-1]]),
        (0, abs(change)), [*z, 0.0], "DOP853", rtol=1e-11, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    return path[:-1], float(path[-1])


def _contact(rng, index):
    k, gap = few(rng, 1, 100), few(rng, 0.1, 1)
    d = [round(x, 3) for x in rng.normal(size=20)]
    call = f"""gap = vv.Gap(on="x1", stiffness={k}, gap={gap}).force({d})
stop = vv.Stop(on="x1", stiffness={k}, gap={gap}).force({d})
"""

    def judge(names, reported):
        x = np.array(d)
        yield Claim("gap", names["gap"], np.where(x > gap, k * (x - gap), 0), 1e-12 * k)
        beyond = np.sign(x) * (np.abs(x) - gap)
        yield Claim("stop", names["stop"], np.where(np.abs(x) > gap, k * beyond, 0), 1e-12 * k)

    return Case(call, judge)


def _fed(rng, index):
    """The work of the load equals the energy loss of the elements and of the structural damping."""
    element = _draw(rng, int(rng.integers(3)))[0].replace("'x1'", "('x1', 'x2')")
    c, own = few(rng, 0.05, 0.5), even(rng, 0.02, 0.1, 3)
    load, nu = few(rng, 0.5, 20), few(rng, 0.3, 3)
    call = f"""elements = [{element}, vv.Spring(on='x2', law='c*v*abs(v) + d^3', parameters={{'c': {c}}})]
s = vv.Structure(mass=np.eye(2), stiffness=np.eye(2), damping={own} * np.eye(2), elements=elements)
r = vv.forced_response(s, [{nu}], load=[{load}, 0], method="newton", harmonics=21)
x, k, ok, lost = r.coefficients[0], r.harmonics, r.converged[0], r.dissipation()[0]
"""

    def judge(names, reported):
        if not names["ok"]:
            return
        x, k = names["x"], names["k"]
        fed = -np.pi * load * float(x[0, k == 1].imag[0])
        damped = np.pi * own * nu * float((k**2 * np.abs(x) ** 2).sum())
        size = np.pi * load * np.abs(x[0]).sum()
        yield Claim("dissipation", float(names["lost"].sum()) + damped, fed, 1e-5 * size, damage=1)
        yield Claim("losses", bool((names["lost"] >= -1e-9 * size).all()), True)

    return Case(call, judge)


def _parts(rng, index):
    """The work of load and base equals the loss of dampers, laws of rates and kernels of a system."""
    laws = {
        "x1": f"{few(rng, 0.05, 1)}*x1_dot*abs(x1_dot) + {few(rng, 0.1, 2)}*x1^3",
        "x2": f"{few(rng, 0.05, 0.5)}*tanh(x2_dot/{few(rng, 0.2, 2)}) + 0.2*sin(x2 - x1)",
    }
    load, base, nu = few(rng, 0.3, 5), few(rng, 0.01, 0.3), few(rng, 0.3, 3)
    weight, rate = even(rng, 0.05, 0.4, 2), few(rng, 0.3, 3)
    call = f"""springs = [vv.Springs(stiffness=[[1, -1], [-1, 1]], forces={{"x1": "0.3*(x1 - x2)^3", "x2": "0.3*(x2 - x1)^3"}},
                      kernel=vv.PronyKernel(weights=[{weight}], rates=[{rate}]))]
s = vv.PolynomialSystem(mass=[1, 2], stiffness=[1, 0.5], damping=[0.05, 0.02], forces={laws}, springs=springs,
                        base_direction=[1, 1])
given = dict(load=[{load}, 0], base={base}, harmonics=21)
r = vv.forced_response(s, [{nu}], method="newton", **given)
b = vv.trace_response(s, load_range=(0.5, 1), nu={nu}, stability=False, max_points=4, **given)
x, k, ok, lost = r.coefficients[0], r.harmonics, r.converged[0], r.dissipation()[0]
y, kept, factor, reported = b.coefficients[-1], b.harmonics, b.load_factor[-1], b.dissipation()[-1]
"""

    def judge(names, reported):
        motions = [("Branch", names["y"], names["kept"], names["factor"], names["reported"])]
        if names["ok"]:
            motions.append(("Response", names["x"], names["k"], 1.0, names["lost"]))
        for name, x, k, factor, lost in motions:
            moved = np.outer([1, 1], k == 1) * base * factor
            push = np.outer([load, 0], k == 1) * factor + np.array([[1], [2]]) * nu**2 * moved
            fed = float(np.pi * (k * (push * (x - moved).conj()).imag.sum(axis=0)).sum())
            size = float(np.pi * (np.abs(push).sum(axis=1) * np.abs(x - moved).sum(axis=1)).sum())
            yield Claim(f"{name}.dissipation", float(np.sum(lost)), fed, 1e-5 * size, damage=1)
            # Forces on a single coordinate and forces behind kernels need not dissipate energy.
            yield Claim(f"{name} losses", bool(lost[0] >= 0), True)

    return Case(call, judge)


def _sampled(rng, index):
    """Errors of sampling: the same harmonics with 2^15 samples by NumPy are not further away."""
    a, b, c = few(rng, 0.02, 0.3), few(rng, 0.05, 1), few(rng, 0.05, 0.5)
    power, load, nu = even(rng, 0.6, 1.4, 1), few(rng, 0.1, 1), few(rng, 0.4, 2)
    most = int(rng.integers(3, 14))
    call = f"""s = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1,
                        forces="{a}*tanh(x_dot/{b}) + {c}*pow(x^2, {power})*x")
r = vv.forced_response(s, [{nu}], load={load}, method="newton", harmonics={most}, tolerance=1e-12)
b = vv.trace_response(s, load_range=(0.5, 1), nu={nu}, load={load}, harmonics={most}, stability=False,
                      tolerance=1e-12, max_points=40)
x, k, ok, reported = r.coefficients[0, 0], r.harmonics, r.converged[0], r.sampling[0]
y, kept, factor, also = b.coefficients[-1, 0], b.harmonics, b.load_factor[-1], b.sampling[-1]
noise = b.error[-1]
"""

    def correction(x, k, factor):
        theta = 2 * np.pi * np.arange(2**15) / 2**15
        waves = np.exp(1j * np.outer(theta, k))
        u, v = (waves @ x).imag, (waves @ (1j * k * nu * x)).imag
        odd = np.sign(u) * np.abs(u) ** (2 * power + 1)
        by_u = c * (2 * power + 1) * np.abs(u) ** (2 * power)
        by_v = a / b / np.cosh(np.minimum(np.abs(v / b), 300)) ** 2
        stiff = 1 - (k * nu) ** 2 + 0.1j * k * nu
        parts = 2j / theta.size * (np.conj(waves).T @ (a * np.tanh(v / b) + c * odd))
        residual = stiff * x + parts - load * factor * (k == 1)
        columns = []
        for e in (*np.eye(k.size, dtype=complex), *(1j * np.eye(k.size))):
            moved = by_u * (waves @ e).imag + by_v * (waves @ (1j * k * nu * e)).imag
            column = stiff * e + 2j / theta.size * (np.conj(waves).T @ moved)
            columns.append(np.concatenate([column.real, column.imag]))
        step = np.linalg.solve(np.array(columns).T, np.concatenate([residual.real, residual.imag]))
        size = np.abs(x.real) + np.abs(x.imag)
        return float((np.abs(step[: k.size]) + np.abs(step[k.size :])).max() / size.max())

    def judge(names, reported):
        if names["ok"]:
            true = correction(names["x"], names["k"], 1.0)
            yield Claim("Response.sampling", bool(true <= names["reported"] + 1e-11), True)
        true = correction(names["y"], names["kept"], names["factor"])
        allowed = names["also"] + 1e-11 + 10 * names["noise"]
        yield Claim("Branch.sampling", bool(true <= allowed), True)

    return Case(call, judge)


def case(rng, index):
    """Draw an element and a cycle of deflections, or a structure that two elements damp."""
    if index % 7 == 3:
        return _sampled(rng, index)
    if index % 7 == 4:
        return _parts(rng, index)
    if index % 7 == 5:
        return _fed(rng, index)
    return _contact(rng, index) if index % 7 == 6 else _loop(rng, index)
