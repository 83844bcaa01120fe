"""Rotors, whose matrices depend on the speed: eigenvalues of state matrices, direct integration."""

import numpy as np

from referee.case import Case, Claim, even, few, numbers
from referee.integration import solve_ivp

JUDGES = (
    "PolynomialSystem.at_speed", "campbell", "Campbell", "Campbell.frequencies",
    "Campbell.damping_ratios",
)  # fmt: skip


class _Rotor:
    """Random matrices, some of them 0."""

    def __init__(self, rng, n):
        self.n = n
        a, b = rng.normal(size=(2, n, n))
        self.mass = (a @ a.T / n + np.eye(n)).round(4)
        self.stiffness = (b @ b.T / n + 2 * np.eye(n)).round(4)
        self.damping = (few(rng, 1e-3, 0.3, 2) * np.diag(rng.uniform(0.2, 1, n))).round(5)
        skew = rng.normal(size=(n, n)).round(3)
        some = rng.random(3) < 0.7
        some[int(rng.integers(3))] = True
        self.gyroscopic = some[0] * 0.4 * (skew - skew.T)
        self.circulatory = some[1] * 0.1 * rng.normal(size=(n, n)).round(3)
        self.centrifugal = some[2] * 0.05 * rng.normal(size=(n, n)).round(3)
        self.cubic = even(rng, 0, 0.4, 2)
        self.load = rng.normal(size=n).round(3)

    @property
    def source(self):
        names = ("mass", "stiffness", "damping", "gyroscopic", "circulatory", "centrifugal")
        matrices = ", ".join(f"{name}={numbers(getattr(self, name))}" for name in names)
        return f'vv.PolynomialSystem({matrices}, forces={{"x1": "{self.cubic}*x1^3"}})'

    def state(self, speed):
        """The state matrix at a speed, without the cubic force."""
        inverse, n = np.linalg.inv(self.mass), self.n
        stiffness = self.stiffness + speed * (self.circulatory + speed * self.centrifugal)
        damping = self.damping + speed * self.gyroscopic
        return np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])

    def run(self, nu, start, end):
        """State (u, u') at the end of a motion."""
        matrix, inverse, n = self.state(nu), np.linalg.inv(self.mass), self.n

        def rate(t, z):
            force = self.load * np.sin(nu * t)
            force[0] -= self.cubic * z[0] ** 3
            found = matrix @ z
            found[n:] += inverse @ force
            return found

        return solve_ivp(rate, (0, end), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def _roots(rng, index):
    rotor = _Rotor(rng, int(rng.integers(2, 6)))
    speed = even(rng, 0.1, 3, 2)
    call = f"""system = {rotor.source}.at_speed({speed})
roots = system.characteristic_roots()
swings, growth, unstable = roots.oscillatory, roots.growth_rate, roots.n_unstable
"""

    def judge(names, reported):
        values = np.linalg.eigvals(rotor.state(speed))
        up = values[values.imag > 1e-7]
        up = up[np.argsort(up.imag)]
        claimed = 1e-9 if len(up) == len(names["swings"]) else 1.0
        yield Claim("oscillatory roots", names["swings"], up, claimed * np.abs(up))
        yield Claim("growth rate", names["growth"], values.real.max(), 1e-9)
        if np.abs(values.real).min() > 1e-9:
            yield Claim("n_unstable", names["unstable"], int((values.real > 0).sum()))

    return Case(call, judge)


def _response(rng, index):
    rotor = _Rotor(rng, int(rng.integers(2, 5)))
    nu = [even(rng, 0.3, 2.5, 2)]
    call = f"""system = {rotor.source}
r = vv.forced_response(system, {nu}, load={numbers(rotor.load)}, method="newton", stability=True)
found, orders, growing = r.coefficients[0], r.harmonics, r.exponents[0]
at_nu, error = r.nu[0], r.error[0]
"""

    def judge(names, reported):
        found, nu = names["found"], names["at_nu"]
        if not np.isfinite(found).all():
            return
        start = np.concatenate(
            [found.imag.sum(axis=1), (1j * nu * names["orders"] * found).imag.sum(axis=1)]
        )
        step = 1e-6
        period = 2 * np.pi / nu
        after = rotor.run(nu, start, period)
        ends = np.array(
            [
                (rotor.run(nu, start + e, period) - rotor.run(nu, start - e, period)) / (2 * step)
                for e in step * np.eye(2 * rotor.n)
            ]
        ).T
        values = np.linalg.eigvals(ends)
        size = max(1, np.abs(values).max()) * max(1, np.abs(start).max())
        yield Claim("state after a period", after, start, 1e-8 * size)
        rate = np.log(np.abs(values).max()) / period
        got = np.nanmax(names["growing"].real)
        yield Claim("largest growth rate", got, rate, 1e-5, damage=1e-3)

    return Case(call, judge)


def _motion(rng, index):
    rotor = _Rotor(rng, int(rng.integers(2, 5)))
    nu, end = even(rng, 0.3, 2.5, 2), even(rng, 3, 12, 1)
    start = rng.normal(size=2 * rotor.n).round(3)
    call = f"""system = {rotor.source}
run = vv.simulate(system, {end}, load={numbers(rotor.load)}, nu={nu}, initial={numbers(start)})
last, error = run.state[-1], run.error
"""

    def judge(names, reported):
        begin = np.concatenate([start[::2], start[1::2]])
        last = rotor.run(nu, begin, end)
        size = max(1.0, np.abs(last).max())
        yield Claim("state", names["last"][::2], last[: rotor.n], (names["error"] + 1e-9) * size)
        yield Claim("speeds", names["last"][1::2], last[rotor.n :], (names["error"] + 1e-9) * size)

    return Case(call, judge)


def _campbell(rng, index):
    rotor = _Rotor(rng, int(rng.integers(2, 7)))
    order = few(rng, 0.5, 3, 2)
    speeds = np.linspace(0, few(rng, 1, 6, 2), int(rng.integers(5, 40)))
    call = f"""system = {rotor.source}
diagram = vv.campbell(system, {numbers(speeds)}, orders={order})
frequencies, ratios = diagram.frequencies, diagram.damping_ratios
growth, threshold, critical = diagram.growth, diagram.threshold, diagram.critical_speeds
"""

    def judge(names, reported):
        largest = []
        for i, speed in enumerate(speeds):
            values = np.linalg.eigvals(rotor.state(speed))
            largest.append(values.real.max())
            up = values[values.imag > 1e-6]
            up = up[np.argsort(up.imag)]
            kept = np.isfinite(names["frequencies"][i])
            own = np.argsort(names["frequencies"][i][kept])
            yield Claim("frequencies", names["frequencies"][i][kept][own], up.imag, 1e-9)
            yield Claim("damping ratios", names["ratios"][i][kept][own], -up.real / abs(up), 1e-8)
        yield Claim("growth", names["growth"], np.array(largest), 1e-9)
        for speed in names["critical"]:
            values = np.linalg.eigvals(rotor.state(speed)).imag
            nearest = values[np.abs(values - order * speed).argmin()]
            yield Claim("frequency at a critical speed", nearest, order * speed, 1e-8)
        threshold = names["threshold"]
        stable = np.array(largest) < 1e-9
        yield Claim("is stable at all speeds", bool(np.isnan(threshold)), bool(stable.all()))
        if np.isfinite(threshold) and stable[0]:
            at = np.linalg.eigvals(rotor.state(threshold)).real.max()
            yield Claim("growth at the threshold", at, 0.0, 1e-9)

    return Case(call, judge)


def case(rng, index):
    """Draw a rotor and a question: roots, response, motion or Campbell diagram."""
    return (_roots, _response, _motion, _campbell)[index % 4](rng, index // 4)
