"""Bodies in space: modes, sag, transmissibility and mount forces by vectors, mount by mount."""

import numpy as np
import scipy.linalg
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from referee.case import Case, Claim, even, few, number, numbers
from referee.integration import solve_ivp
from referee.models import prony

JUDGES = (
    "Body", "Body.modes", "Body.sag", "Body.torque_roll_axis", "Body.roll_share", "Body.centers",
    "Body.load", "Body.unbalance", "Body.motion_of", "Body.mount_forces",
    "Body.base_transmissibility", "Body.random_floor", "Body.engine_orders", "Body.force_transmissibility", "Body.scatter",
    "Body.energy", "Body.angular_momentum", "BodyModes", "Scene.body",
    "BodyModes.hz", "BodyModes.decoupling", "FluidTrack", "FluidTrack.dynamic_stiffness",
    "MountForces", "MountForces.lost_power", "MountForces.amplitude", "MountPoint",
    "MountPoint.dynamic_stiffness", "MountPoint.static_stiffness", "Sag",
)  # fmt: skip

_CHECKED = """modes = body.modes(stiffness="instantaneous")
hz, energy, decoupling = modes.hz, modes.energy, modes.decoupling
"""


class _Model:
    """Independent model of a body: forces of its mounts as vectors."""

    def __init__(self, rng):
        box = np.array([few(rng, 0.1, 2) for _ in range(3)])
        self.mass = few(rng, 0.5, 2000)
        turn = scipy.linalg.qr(rng.normal(size=(3, 3)))[0]
        moments = self.mass / 12 * (box @ box - box**2)
        self.inertia = turn @ np.diag(moments) @ turn.T
        self.inertia = (self.inertia + self.inertia.T) / 2
        self.center = (rng.normal(size=3) * 0.1).round(3)
        size = box.max()
        self.memory = None
        if rng.random() < 0.6:
            rates = [few(rng, 1, 500), few(rng, 1, 500)]
            self.memory = prony([float(f"{r * rng.uniform(0.01, 0.3):.3g}") for r in rates], rates)
        self.mounts = []
        for _ in range(int(rng.integers(3, 6))):
            self.mounts.append({
                "position": (rng.uniform(-1, 1, 3) * size).round(4),
                "stiffness": np.array([few(rng, 1e4, 1e6) for _ in range(3)]),
                "angles": rng.uniform(-3, 3, 3).round(3),
                "damping": np.array([few(rng, 1, 300) for _ in range(3)]),
                "cubic": few(rng, 1e7, 1e11),
            })  # fmt: skip
        texts = []
        for i, m in enumerate(self.mounts):
            kernel = "None" if self.memory is None else self.memory.source
            texts.append(
                f'vv.MountPoint(name="m{i}", position={numbers(m["position"])}, '
                f"stiffness={numbers(m['stiffness'])}, angles={numbers(m['angles'])}, "
                f"damping={numbers(m['damping'])}, kernel={kernel}, "
                f'law=(None, None, "{m["cubic"]!r}*d^3"))'
            )
        self.source = (
            f"vv.Body(mass={number(self.mass)}, inertia={numbers(self.inertia)}, "
            f"center={numbers(self.center)}, mounts=[{', '.join(texts)}]"
        )

    @staticmethod
    def axes(m):
        """Local axes as columns: rotations about x, then y, then z."""
        axes = np.eye(3)
        for k, angle in enumerate(m["angles"]):
            e = np.eye(3)[k]
            turned = [
                np.cos(angle) * v
                + np.sin(angle) * np.cross(e, v)
                + (1 - np.cos(angle)) * (e @ v) * e
                for v in axes.T
            ]
            axes = np.array(turned).T
        return axes

    def arm(self, m):
        return m["position"] - self.center

    def forces(self, u, stiffness=1.0, damping=0.0, cubic=0.0):
        """Force and moment about the centre that hold the body at u (linear parts with factors)."""
        total = np.zeros(6, dtype=np.result_type(u, stiffness, damping))
        for m in self.mounts:
            axes, arm = self.axes(m), self.arm(m)
            d = axes.T @ (u[:3] + np.cross(u[3:], arm))
            local = (stiffness * m["stiffness"] + damping * m["damping"]) * d
            local[2] = local[2] + cubic * m["cubic"] * d[2] ** 3
            force = axes @ local
            total[:3] += force
            total[3:] += np.cross(arm, force)
        return total

    def matrix(self, stiffness=1.0, damping=0.0):
        return np.array([self.forces(e, stiffness, damping) for e in np.eye(6)]).T

    @property
    def masses(self):
        return scipy.linalg.block_diag(self.mass * np.eye(3), self.inertia)

    def kept(self, nu):
        return 1.0 if self.memory is None else 1 - complex(self.memory.laplace(1j * nu))

    def dynamic(self, nu):
        return self.matrix(self.kept(nu), 1j * nu) - nu**2 * self.masses


def _modes(rng, index):
    model = _Model(rng)
    about = rng.normal(size=3).round(3)
    call = f"""body = {model.source})
{_CHECKED}axis, share = body.torque_roll_axis({numbers(about)}), body.roll_share({numbers(about)})
centers = np.array(body.centers())
same, shares = body.scatter(2, 0.0)
own = body.modes()
"""

    def judge(names, reported):
        k, m = model.matrix(), model.masses
        squares, shapes = scipy.linalg.eigh(k, m)
        hz = np.sqrt(squares) / 2 / np.pi
        yield Claim("hz", names["hz"], hz, 1e-11 * hz.max() ** 2 / hz)
        energy = names["energy"]
        yield Claim("energy", energy.sum(axis=0), np.full(6, 100.0), 1e-9)
        apart = np.diff(np.sqrt(squares), prepend=-1, append=1e9) / np.sqrt(squares.max())
        clear = (apart[1:] > 1e-3) & (apart[:-1] > 1e-3)
        true = 100 * shapes * (m @ shapes)
        yield Claim("energy of modes", energy[:, clear], true[:, clear], 1e-6, damage=1e-3)
        yield Claim("decoupling", names["decoupling"], energy.max(axis=0), 1e-10)
        own = names["own"]
        yield Claim("scatter", names["same"], np.array([own.hz] * 2), 1e-9 * hz.max())
        if model.memory is None:
            shares = np.array([true.max(0)[clear]] * 2)
            yield Claim("scatter", names["shares"][:, clear], shares, 1e-5, damage=1e-3)
        else:
            roots = np.linalg.eigvals(_with_memory(model))
            roots = roots[roots.imag > 1e-6 * np.abs(roots)]
            roots = roots[np.argsort(roots.imag)]
            size = np.abs(roots).max()
            yield Claim("damped hz", own.hz, roots.imag / 2 / np.pi, 1e-9 * size)
            yield Claim("damping ratio", own.damping_ratio, -roots.real / np.abs(roots), 1e-7)
        turned = scipy.linalg.solve(model.inertia, about, assume_a="pos")
        turned /= np.linalg.norm(turned)
        yield Claim("torque_roll_axis", names["axis"], turned, 1e-11)
        roll = np.concatenate([np.zeros(3), turned])
        if model.memory is None:
            parts = 100 * (shapes.T @ m @ roll) ** 2 / (roll @ m @ roll)
            yield Claim("roll_share", names["share"][clear], parts[clear], 1e-6, damage=1e-3)
            yield Claim("roll_share", names["share"].sum(), 100.0, 1e-8)
        for which, center in enumerate(names["centers"]):
            # Relative to this point the coupling block of the matrix, or its inverse, is symmetric.
            away = center - model.center
            view = np.eye(6)
            view[:3, 3:] = np.array([np.cross(e, -away) for e in np.eye(3)]).T
            seen = view.T @ k @ view
            block = (np.linalg.inv(seen) if which else seen)[:3, 3:]
            rest = np.abs(block - block.T).max() / np.abs(block).max()
            yield Claim("centers", 1 + rest, 1.0, 1e-8)

    return Case(call, judge)


def _with_memory(model):
    """Matrix of the ordinary equations with a state for each exponential and coordinate."""
    k, c, m = model.matrix(), model.matrix(0.0, 1.0), model.masses
    weights, rates = (
        ((), ()) if model.memory is None else (model.memory.weights, model.memory.rates)
    )
    n = 12 + 6 * len(rates)
    states = np.zeros((n, n))
    states[:6, 6:12] = np.eye(6)
    states[6:12, :12] = -np.linalg.solve(m, np.hstack([k, c]))
    for j, (w, r) in enumerate(zip(weights, rates, strict=True)):
        own = slice(12 + 6 * j, 18 + 6 * j)
        states[6:12, own] = w * np.linalg.solve(m, k)
        states[own, :6], states[own, own] = np.eye(6), -r * np.eye(6)
    return states


def _power(model, along, hz):
    """Mean square response to a floor density that is linear between 1, 2, ... at hz.

    Gauss quadrature on intervals that shrink towards the roots of the equations with memory states.
    """
    k, c, m = model.matrix(), model.matrix(0.0, 1.0), model.masses
    roots = np.linalg.eigvals(_with_memory(model)) / 2 / np.pi
    apart = 10.0 ** np.arange(-1, 8)
    near = [s.imag + sign * abs(s.real) * apart for s in roots for sign in (-1, 1)]
    edges = np.unique(np.clip(np.concatenate([hz, roots.imag, *near]), hz[0], hz[-1]))
    nodes, share = np.polynomial.legendre.leggauss(30)
    half = np.diff(edges)[:, None] / 2
    at = ((edges[1:] + edges[:-1])[:, None] / 2 + half * nodes).ravel()
    x = 2 * np.pi * at[:, None, None]
    kept = 1.0 if model.memory is None else 1 - model.memory.laplace(1j * x[:, 0, 0])[:, None, None]
    b = np.concatenate([along, np.zeros(3)])
    push = x**2 * (m @ b)[:, None]
    u = np.linalg.solve(kept * k + 1j * x * c - x**2 * m, push)[:, :3, 0] + along
    density = np.interp(at, hz, np.arange(1, hz.size + 1))
    return (half * share).ravel() * density @ np.abs(u) ** 2


def _loads(rng, index):
    model = _Model(rng)
    at, point = (rng.normal(size=(2, 3)) * 0.3).round(3)
    force, torque = rng.normal(size=(2, 3)).round(3)
    nu = sorted(few(rng, 1, 1000) for _ in range(4))
    axis = "xyz"[index % 3]
    size = few(rng, 1e-4, 1)
    call = f"""body = {model.source}, base_direction={axis!r})
load = body.load({numbers(force)}, {numbers(torque)}, at={numbers(at)})
turning = body.unbalance({nu[0]}, {size}, at={numbers(at)}, axis={axis!r})
base = body.base_transmissibility({nu}, {axis!r}, {numbers(point)})
relative = body.base_transmissibility({nu}, {axis!r}, {numbers(point)}, relative=True)
floor = body.force_transmissibility({nu}, {axis!r}, {numbers(at)})
shaken, rms = body.random_floor({[x / 6.25 for x in nu]}, [1.0, 2.0, 3.0, 4.0], {axis!r})
turned = body.engine_orders({nu[:2]}, [0.5, 2.0], [load, 2 * load])
r = vv.forced_response(body, {nu}, load=load, base=1e-3, method="linear")
coefficients, moved = r.coefficients, body.motion_of(r, {numbers(point)})
forces = body.mount_forces(r, base=1e-3)
deflection, force, power = forces.deflection, forces.force, forces.lost_power
sizes = forces.amplitude("m1")
stiffness, static = body.mounts[0].dynamic_stiffness({nu}), body.mounts[0].static_stiffness
track = vv.FluidTrack(mass={size}, damping=3.0, stiffness=2e4).dynamic_stiffness({nu})
"""

    def judge(names, reported):
        arm, place = at - model.center, point - model.center
        load = np.concatenate([force, torque + np.cross(arm, force)])
        yield Claim("load", names["load"].real, load, 1e-13 * np.abs(load).max())
        # Two forces of equal size, a quarter period apart, normal to the axis, with their torques.
        push = names["turning"]
        along = np.eye(3)["xyz".index(axis)]
        strength = size * nu[0] ** 2
        first, second = push.imag, push.real
        yield Claim("unbalance", np.array([np.linalg.norm(first[:3]), np.linalg.norm(second[:3])]),
                    np.full(2, strength), 1e-12 * strength)  # fmt: skip
        yield Claim("unbalance", np.cross(first[:3], second[:3]), along * strength**2,
                    1e-12 * strength**2)  # fmt: skip
        for part in (first, second):
            yield Claim("unbalance", part[3:], np.cross(arm, part[:3]), 1e-11 * strength)
        for i, x in enumerate(nu[:2]):
            for j, order in enumerate((0.5, 2.0)):
                d = model.dynamic(order * x)
                u = np.linalg.solve(d, (1 + j) * load)
                far = np.abs(u).max() * np.linalg.cond(d) * 1e-13
                yield Claim("engine_orders", names["turned"][i, j], u, far)
        shaken = []
        for i, x in enumerate(nu):
            d, b = model.dynamic(x / 6.25 * 2 * np.pi), np.concatenate([along, np.zeros(3)])
            u = np.linalg.solve(d, (x / 6.25 * 2 * np.pi) ** 2 * model.masses @ b)[:3] + along
            shaken.append((i + 1) * np.abs(u) ** 2)
        shaken = np.array(shaken)
        yield Claim("random_floor", names["shaken"], shaken, 1e-8 * shaken.max())
        power = _power(model, along, np.array(nu) / 6.25)
        yield Claim("random_floor", names["rms"] ** 2, power, 1e-8 * power.max())
        for i, x in enumerate(nu):
            d, m = model.dynamic(x), model.masses
            b = np.concatenate([along, np.zeros(3)])
            c = np.linalg.cond(d) * 1e-14
            u = np.linalg.solve(d, x**2 * m @ b)
            seen = u[:3] + np.cross(u[3:], place)
            far = (np.abs(u[:3]).max() + np.abs(u[3:]).max() * np.linalg.norm(place) + 1) * (
                c + 1e-13
            )
            yield Claim("base_transmissibility", names["relative"][i], seen, far)
            yield Claim("base_transmissibility", names["base"][i], seen + along, far)
            u = np.linalg.solve(d, np.concatenate([along, np.cross(arm, along)]))
            total = model.forces(u, model.kept(x), 1j * x)[:3]
            size_of = np.abs(total).max() + x**2 * model.mass * np.abs(u).max() + 1
            yield Claim("force_transmissibility", names["floor"][i], total, size_of * (c + 1e-12))
            # Springs deflect by the motion relative to the floor.
            u = np.linalg.solve(d, load + x**2 * m @ b * 1e-3)
            scale = np.abs(u).max() + 1e-3
            yield Claim(
                "response", names["coefficients"][i, :, 0], u + 1e-3 * b, scale * (c + 1e-13)
            )
            point_moved = u[:3] + np.cross(u[3:], place) + 1e-3 * along
            yield Claim("motion_of", names["moved"][i, :, 0], point_moved, 3 * scale * (c + 1e-12))
            for j, mount in enumerate(model.mounts):
                own = model.axes(mount).T @ (u[:3] + np.cross(u[3:], model.arm(mount)))
                k = model.kept(x) * mount["stiffness"] + 1j * x * mount["damping"]
                reach = 3 * scale * (c + 1e-12) * (1 + np.linalg.norm(model.arm(mount)))
                yield Claim("deflection", names["deflection"][i, j, :, 0], own, reach)
                limit = reach * np.abs(k)
                yield Claim("force", names["force"][i, j, :, 0], k * own, limit)
                lost = 0.5 * x * k.imag * np.abs(own) ** 2
                yield Claim("lost_power", names["power"][i, j], lost,
                            x * limit * (np.abs(own) + reach) + 1e-12 * np.abs(lost))  # fmt: skip
            yield Claim("amplitude", names["sizes"][i], np.abs(names["force"][i, 1, :, 0]), 1e-9)
            mount = model.mounts[0]
            k = model.kept(x) * mount["stiffness"] + 1j * x * mount["damping"]
            yield Claim("dynamic_stiffness", names["stiffness"][i], k, 1e-12 * np.abs(k))
            z = -(x**2) * size + 3j * x
            series = 1 / (1 / 2e4 + 1 / z)
            yield Claim(
                "FluidTrack",
                names["track"][i],
                series,
                1e-11 * abs(series) * (1 + 2e4 / abs(2e4 + z)),
            )
        kept = 1 - (
            0 if model.memory is None else np.sum(model.memory.weights / model.memory.rates)
        )
        true = kept * model.mounts[0]["stiffness"]
        yield Claim("static_stiffness", names["static"], true, 1e-12 * true)

    return Case(call, judge)


def _sag(rng, index):
    model = _Model(rng)
    gravity = [even(rng, -10, 10) for _ in range(3)]
    call = f"""body = {model.source}, gravity={gravity})
sag = body.sag()
u, deflections, forces = sag.displacement, sag.deflections, sag.forces
stiffness = body.dynamic_stiffness(1e3)
"""

    def judge(names, reported):
        kept = 1 - (
            0 if model.memory is None else np.sum(model.memory.weights / model.memory.rates)
        )
        weight = np.concatenate([model.mass * np.array(gravity), np.zeros(3)])
        scale = np.linalg.solve(model.matrix(kept), weight)
        units = np.where(np.arange(6) < 3, np.abs(scale[:3]).max(), np.abs(scale[3:]).max())

        def left(v):
            return (model.forces(v * units, kept, cubic=kept) - weight) / np.abs(weight).max()

        found = root(left, names["u"] / units, method="lm", options={"xtol": 1e-15, "ftol": 1e-15})
        yield Claim("sag", names["u"] / units, found.x, 1e-7, damage=1e-5)
        rest = np.abs(left(names["u"] / units)).max()
        yield Claim("sag", 1 + rest, 1.0, 1e-9)
        preload = np.zeros((6, 6))
        stiff = np.zeros((6, 6))
        for j, mount in enumerate(model.mounts):
            axes, arm = model.axes(mount), model.arm(mount)
            d = axes.T @ (names["u"][:3] + np.cross(names["u"][3:], arm))
            reach = 1e-12 * np.abs(names["u"]).max() * (1 + np.linalg.norm(arm))
            yield Claim("deflections", names["deflections"][j], d, reach)
            f = -kept * mount["stiffness"] * d
            f[2] -= kept * mount["cubic"] * d[2] ** 3
            slope = kept * (mount["stiffness"].max() + 3 * mount["cubic"] * d[2] ** 2)
            yield Claim("forces", names["forces"][j], f, reach * slope)
            # Work of a force at a point fixed to the body, to second order in the rotation.
            p, force = arm, axes @ f
            for a in range(3):
                for b in range(3):
                    e, g = np.eye(3)[a], np.eye(3)[b]
                    second = np.cross(e, np.cross(g, p)) + np.cross(g, np.cross(e, p))
                    preload[3 + a, 3 + b] -= 0.5 * force @ second
            tangent = mount["stiffness"].copy()
            tangent[2] += 3 * mount["cubic"] * d[2] ** 2
            for c in range(6):
                e = np.eye(6)[c]
                own = axes.T @ (e[:3] + np.cross(e[3:], arm))
                force = axes @ ((model.kept(1e3) * tangent + 1e3j * mount["damping"]) * own)
                stiff = stiff.astype(complex)
                stiff[:, c] += np.concatenate([force, np.cross(arm, force)])
        true = stiff + preload - 1e6 * model.masses
        yield Claim(
            "about the loaded position", names["stiffness"], true, 1e-9 * np.abs(true).max()
        )

    return Case(call, judge)


def _laws(rng, index):
    model = _Model(rng)
    load = rng.normal(size=6).round(3) * model.mass
    nu = few(rng, 20, 200)
    call = f"""body = {model.source})
r = vv.forced_response(body, [{nu}], load={numbers(load)}, method="newton")
found, orders, forces = r.coefficients, r.harmonics, body.mount_forces(r).force
"""

    def judge(names, reported):
        x, orders = names["found"][0], names["orders"]
        if not np.isfinite(x).all():
            return
        theta = 2 * np.pi * np.arange(4096) / 4096
        waves = np.exp(1j * np.outer(orders, theta))
        true = np.zeros((len(model.mounts), 3, len(orders)), complex)
        size = 0.0
        for j, mount in enumerate(model.mounts):
            axes, arm = model.axes(mount), model.arm(mount)
            d = np.array([axes.T @ (c[:3] + np.cross(c[3:], arm)) for c in x.T]).T
            g = mount["cubic"] * (d[2] @ waves).imag ** 3
            bent = np.array([
                (1j if k == 0 else 2j) * np.mean(g * np.exp(-1j * k * theta)) for k in orders
            ])  # fmt: skip
            for place, k in enumerate(orders):
                elastic = mount["stiffness"] * d[:, place]
                elastic[2] += bent[place]
                damped = 1j * k * nu * mount["damping"] * d[:, place]
                true[j, :, place] = model.kept(k * nu) * elastic + damped
            size += mount["stiffness"].max() * np.abs(d).max() + np.abs(bent).max()
        yield Claim("mount_forces", names["forces"][0], true, 1e-11 * size)
        # All mounts together move the body.
        for place, k in enumerate(orders):
            total = -((k * nu) ** 2) * (model.masses @ x[:, place]) - load * (k == 1)
            scale = np.abs(load).max() + (k * nu) ** 2 * np.abs(model.masses @ x).max()
            for j, mount in enumerate(model.mounts):
                force = model.axes(mount) @ names["forces"][0, j, :, place]
                total[:3] += force
                total[3:] += np.cross(model.arm(mount), force)
                scale += np.abs(force).max() * (1 + np.linalg.norm(model.arm(mount)))
            yield Claim("response", 1 + np.abs(total).max() / scale, 1.0, 1e-8)

    return Case(call, judge)


def _turning(rng, index):
    """Finite rotations without losses: Newton-Euler equations with a rotation matrix."""
    model = _Model(rng)
    model.memory = None
    stiff, heavy = model.mounts[0]["stiffness"].max(), model.mass
    speed = np.sqrt(stiff / heavy)
    end = number(0.5 / speed)
    start = np.zeros(12)
    start[1::2] = rng.normal(size=6) * speed * np.repeat([0.1, 0.5], 3)
    start = start.round(6)
    inside = (rng.normal(size=3) * speed * np.trace(model.inertia) * (index % 3)).round(9)
    mounts = ", ".join(
        f'vv.MountPoint(name="m{i}", position={numbers(m["position"])}, '
        f"stiffness={numbers(m['stiffness'])}, angles={numbers(m['angles'])}, "
        f'law=(None, None, "{m["cubic"]!r}*d^3"))'
        for i, m in enumerate(model.mounts)
    )
    call = f"""body = vv.Body(mass={number(model.mass)}, inertia={numbers(model.inertia)},
    center={numbers(model.center)}, mounts=[{mounts}], geometry="exact",
    spin={numbers(inside)})
r = vv.simulate(body, {end}, initial={numbers(start)}, dt="auto", tolerance=1e-10)
state, energy, momentum = r.state[-1], body.energy(r.state), body.angular_momentum(r.state[:1])
"""

    def judge(names, reported):
        def rates(t, y):
            place, v, turn, w = y[:3], y[3:6], y[6:15].reshape(3, 3), y[15:]
            force, moment = np.zeros(3), np.zeros(3)
            for m in model.mounts:
                arm, axes = turn @ model.arm(m), model.axes(m)
                d = axes.T @ (place + arm - model.arm(m))
                pull = m["stiffness"] * d
                pull[2] += m["cubic"] * d[2] ** 3
                force -= axes @ pull
                moment -= np.cross(arm, axes @ pull)
            # w in body axes, so that only the inertia of the body is inverted.
            own = turn.T @ moment - np.cross(w, model.inertia @ w + inside)
            spin = np.linalg.solve(model.inertia, own)
            return np.concatenate([v, force / model.mass, np.cross(turn, w).ravel(), spin])

        begin = np.concatenate([start[:6:2], start[1:6:2], np.eye(3).ravel(), start[7::2]])
        run = solve_ivp(rates, (0, float(end)), begin, method="DOP853", rtol=1e-12, atol=1e-13)
        y = run.y[:, -1]
        size = np.abs(run.y[:3]).max()
        found = names["state"]
        yield Claim("place", found[:6:2], y[:3], 1e-6 * size, damage=1e-3)
        turn = Rotation.from_rotvec(found[6::2]).as_matrix()
        yield Claim("rotation", turn, y[6:15].reshape(3, 3), 1e-6, damage=1e-3)
        energy = names["energy"]
        yield Claim("energy", energy, np.full(energy.size, energy[0]), 1e-7 * energy[0])
        w, v = start[7::2], start[1:6:2]
        kinetic = 0.5 * (model.mass * v @ v + w @ model.inertia @ w)
        yield Claim("energy", energy[0], kinetic, 1e-12 * kinetic)
        whole = model.inertia @ w + inside
        far = 1e-12 * np.abs(w).max() + 1e-15 * np.abs(inside).max()
        yield Claim("momentum", names["momentum"][0], whole, far)

    return Case(call, judge)


def _scene(rng, index):
    """A body in a scene: the driver against the forces as vectors."""
    model = _Model(rng)
    load = (rng.normal(size=6) * model.mass).round(3)
    nu = few(rng, 20, 200)

    def row(values):
        return " ".join(map(repr, np.ravel(values).tolist()))

    kernel = ""
    if model.memory is not None:
        weights, rates = row(model.memory.weights), row(model.memory.rates)
        kernel = f"&kernel kind = 'prony', weights = {weights}, rates = {rates} /\n"
    text = (
        f"&body mass = {float(model.mass)!r}, inertia = {row(model.inertia)}, "
        f"center = {row(model.center)} /\n{kernel}"
    )
    for i, m in enumerate(model.mounts):
        text += (
            f"&mount_point name = 'm{i}', position = {row(m['position'])}\n"
            f"  stiffness = {row(m['stiffness'])}, angles = {row(m['angles'])}\n"
            f"  damping = {row(m['damping'])}, law_z = '{m['cubic']!r}*d^3' /\n"
        )
    for name, size in zip(("x", "y", "z", "rx", "ry", "rz"), load.tolist(), strict=True):
        text += f"&load on = '{name}', amplitude = {size!r} /\n"
    text += f"&response nu = {nu!r}, method = 'linear' /\n"
    call = f"""import pathlib, tempfile
text = {text!r}
path = pathlib.Path(tempfile.mkdtemp()) / "scene.nml"
path.write_text(text)
response = vv.run(path).response
found = np.array([response.coefficient(n, 1)[0] for n in "x y z rx ry rz".split()])
masses = [[m.stiffness, m.rotation @ np.ones(3)] for m in vv.Scene.read(path).body().mounts]
"""

    def judge(names, reported):
        d = model.dynamic(nu)
        true = np.linalg.solve(d, load)
        far = np.abs(true).max() * np.linalg.cond(d) * 1e-13
        yield Claim("scene", names["found"], true, far)
        for mount, (stiffness, turned) in zip(model.mounts, names["masses"], strict=True):
            yield Claim("Scene.body", stiffness, mount["stiffness"], 1e-9)
            yield Claim("Scene.body", turned, model.axes(mount) @ np.ones(3), 1e-13)

    return Case(call, judge)


def case(rng, index):
    """Draw a body and a question: modes, response to loads, sag, mount forces, motion, or scene."""
    return (_modes, _loads, _sag, _laws, _turning, _scene)[index % 6](rng, index // 6)
