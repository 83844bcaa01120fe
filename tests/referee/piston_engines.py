"""Reciprocating engines: harmonics of the positions of their masses, and work of the gas."""

import numpy as np

from referee.case import Case, Claim, few, numbers

JUDGES = (
    "PistonEngine", "PistonEngine.orders", "PistonEngine.forces", "PistonEngine.moments",
    "PistonEngine.gas_moments", "PistonEngine.firing_angles", "PistonEngine.mean_torque",
    "PistonEngine.neglected", "PistonEngine.amplitudes", "PistonEngine.load",
)  # fmt: skip
#: Crank throws of four-stroke engines in line (degrees), and their firing orders.
IN_LINE = (
    ((0,), (1,)), ((0, 360), (2, 1)), ((0, 240, 120), (1, 3, 2)), ((0, 180, 180, 0), (1, 2, 4, 3)),
    ((0, 120, 240, 240, 120, 0), (1, 4, 2, 6, 3, 5)),
)  # fmt: skip
HIGHEST, SAMPLES = 8, 2**16


def _harmonics(values, k):
    """Coefficient of Im c exp(i k x) of samples of one period, in half orders."""
    x = np.arange(values.size) * (4 * np.pi / values.size)
    return 2j * (values * np.exp(-1j * k * x)).mean()


def case(rng, index):
    """Draw an engine: any cylinders of two strokes, or engines in line with four."""
    throws, order = IN_LINE[index // 2 % len(IN_LINE)]
    n, four = len(throws), index % 2 == 0
    throws, banks = np.radians(throws).round(12), np.zeros(n)
    if not four:
        throws, banks = rng.uniform(-3, 3, (2, n)).round(4)
    radius, mass, bore = few(rng, 0.01, 1), few(rng, 0.01, 10), few(rng, 0.01, 1)
    rod, places = float(f"{radius * rng.uniform(2, 6):.4g}"), rng.normal(size=n).round(3)
    pins, at = rng.normal(size=n).round(3), rng.normal(size=3).round(3)
    axis, nu = "xyz"[index % 3], few(rng, 1, 1000)
    cycle = (4 if four else 2) * np.pi
    table = (cycle / 40 * (np.arange(40) + rng.uniform(0.1, 0.8, 40))).round(6)
    pressure = (1e5 * rng.uniform(0, 40, 40)).round(1)
    call = f"""engine = vv.PistonEngine(
    crank_radius={radius}, rod_length={rod}, reciprocating_mass={mass},
    crank_angles={numbers(throws)}, positions={numbers(places)}, bank_angles={numbers(banks)},
    rotating_mass={numbers(pins)}, axis={axis!r}, up={"yzx"[index % 3]!r}, at={numbers(at)},
    strokes={4 if four else 2}, firing_order={order if four else None}, bore={bore},
    pressure=({numbers(table)}, {numbers(pressure)}), highest={HIGHEST},
)
foot = vv.MountPoint(name="a", position=(0, 0, 0), stiffness=(1, 1, 1))
body = vv.Body(mass=1, inertia=(1, 1, 1), mounts=[foot])
orders, fires, mean = engine.orders, engine.firing_angles, engine.mean_torque
forces, moments, gas = engine.forces, engine.moments, engine.gas_moments
neglected, amplitudes = engine.neglected, engine.amplitudes(body, [{nu}])[0]
formulas = engine.load(body, per="cycle")
load = np.zeros((orders.size, 6), dtype=complex)
for j, order in enumerate(orders):
    for name, text in formulas[int(2 * order)].items():
        value = eval(text.replace("^", "**"), {{"nu": {nu} / 2}}) if isinstance(text, str) else text
        load[j, body.dof_names.index(name)] = value
"""

    def judge(names, reported):
        along = np.eye(3)[index % 3]
        up, across = np.roll(along, 1), np.roll(along, 2)
        theta = np.arange(SAMPLES) * (4 * np.pi / SAMPLES)
        x = radius * np.cos(theta) + np.sqrt(rod**2 - (radius * np.sin(theta)) ** 2)
        # The rate of the position by its series.
        k = 0.5 * np.fft.fftfreq(SAMPLES, 1 / SAMPLES)
        rate = np.fft.ifft(1j * k * np.fft.fft(x)).real
        energy = 0.5 * mass * rate**2
        area = 0.25 * np.pi * bore**2
        work = -area * np.interp(theta, table, pressure, period=cycle) * rate
        fires, late = names["fires"], names["fires"] + throws - banks
        yield Claim("dead centres", late, 2 * np.pi * np.round(late / 2 / np.pi), 1e-9)
        if four:
            turn = (fires - fires[order[0] - 1])[np.array(order) - 1] % (4 * np.pi)
            yield Claim("firing order", turn, np.arange(n) * 4 * np.pi / n, 1e-9)
        yield Claim("mean", names["mean"], n * work.mean(), 1e-6 * np.abs(work).mean(),
                    damage=1e-3)  # fmt: skip
        above = [_harmonics(x, k) * k**2 for k in range(HIGHEST + 1, 40)]
        yield Claim("neglected", names["neglected"], np.abs(above).sum() / radius, 1e-9, damage=1.0)
        true = np.zeros((3, 2 * HIGHEST, 3), dtype=complex)
        for j in range(2 * HIGHEST):
            k = (j + 1) / 2
            for i in range(n):
                turned = np.exp(1j * k * (throws[i] - banks[i]))
                cylinder = np.cos(banks[i]) * up + np.sin(banks[i]) * across
                push = np.zeros(3, dtype=complex)
                if k % 1 == 0:
                    push = mass * k**2 * _harmonics(x, k) * turned * cylinder
                    true[1, j] += 1j * k * _harmonics(energy, k) * turned * along
                if k == 1:
                    push += pins[i] * radius * np.exp(1j * throws[i]) * (1j * up + across)
                true[0, j] += push
                true[1, j] += np.cross(places[i] * along, push)
                if four or k % 1 == 0:
                    true[2, j] -= _harmonics(work, k) * np.exp(-1j * k * fires[i]) * along
        sizes = n * (mass + 3) * radius, n * (mass + 3) * radius * (4 + radius)
        sizes = np.array([*sizes, 1e4 * np.abs(work).max()])[:, np.newaxis, np.newaxis] * 1e-10
        found = np.zeros_like(true)
        places_of = np.round(2 * names["orders"]).astype(int) - 1
        found[:, places_of] = names["forces"], names["moments"], names["gas"]
        yield Claim("loads", found, true, sizes + 0 * true.real, damage=1e-2)
        force, moment = nu**2 * true[0], nu**2 * true[1] + true[2] + np.cross(at, nu**2 * true[0])
        both = np.hstack([force, moment])[places_of]
        allowed = nu**2 * (sizes[0] + sizes[1]) * 10 + sizes[2]
        yield Claim("amplitudes", names["amplitudes"], both, allowed, damage=1e-2)
        yield Claim("formulas", names["load"], both, allowed, damage=1e-2)

    return Case(call, judge)
