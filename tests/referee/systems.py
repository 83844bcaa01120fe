"""Equations of the pendulum and energies written independently; derivatives by complex step."""

import math

import numpy as np

from referee.case import Case, Claim, even, few
from referee.models import Swinging, chain, escape, pendulum

JUDGES = (
    "Pendulum", "Pendulum.from_physical", "Pendulum.r", "Pendulum.z_r",
    "Pendulum.natural_frequencies", "Pendulum.mode_shapes", "Pendulum.rhs", "Pendulum.jacobian",
    "Pendulum.energy", "Pendulum.power", "PolynomialSystem.energy", "Trajectory.energy_defect",
)  # fmt: skip


def _equations(rng, index):
    p = pendulum(
        rng,
        f0=even(rng, 0, 0.1),
        m01=even(rng, 0, 0.1),
        m02=even(rng, 0, 0.1),
        p1=even(rng, 0.2, 2),
        p2=even(rng, 0.2, 2),
        p3=even(rng, 0.2, 2),
    )
    states = (rng.normal(size=(4, 6)) * 0.5).round(3)
    states[:, 0] = np.clip(states[:, 0], -0.8, 1)
    t = rng.uniform(0, 50, 4).round(3)
    call = f"""system = {p.source}
states, t = np.array({states.tolist()}), {t.tolist()}
rhs, jacobian = system.rhs(t, states), system.jacobian(t, states)
energy, power = system.energy(states), system.power(t, states)
frequencies, shapes, r, z_r = system.natural_frequencies(), system.mode_shapes(), system.r, system.z_r
"""

    def judge(names, reported):
        right = np.array([p.right(a, y) for a, y in zip(t, states, strict=True)])
        scale = np.abs(right).max() / (1 - p.e * p.w3**2 / p.w2**2)
        yield Claim("rhs", names["rhs"], right, 1e-13 * scale)
        jacobian = np.concatenate([p.jacobian(a, y[None]) for a, y in zip(t, states, strict=True)])
        yield Claim("jacobian", names["jacobian"], jacobian, 1e-12 * np.abs(jacobian).max())
        energy = p.energy(states)
        yield Claim("energy", names["energy"], energy, 1e-13 * (1 + np.abs(energy)))
        # The power is the rate of the energy: by a complex step along the motion.
        h = 1e-150
        rate = np.array(
            [p.energy(y + 1j * h * x).imag / h for y, x in zip(states, right, strict=True)]
        )
        yield Claim("power", names["power"], rate, 1e-12 * (np.abs(rate) + scale))
        yield Claim("r", names["r"], p.w3**2 / p.w2**2, 1e-14 * names["r"])
        yield Claim("z_r", names["z_r"], p.z_r, 1e-12 * p.z_r)
        free = Swinging(p.e, p.w2, p.w3, p.alpha)
        a = free.jacobian(np.zeros(1), np.zeros((1, 6)))[0]
        squares = np.sort(np.linalg.eigvals(-a[1::2, ::2]).real)
        true = np.sqrt(squares)
        yield Claim("natural_frequencies", np.sort(names["frequencies"]), true, 1e-12 * true.max())
        rest = a[1::2, ::2] @ names["shapes"] + names["shapes"] * names["frequencies"] ** 2
        yield Claim("mode_shapes", 1 + np.abs(rest).max(), 1.0, 1e-12 * np.abs(a).max())

    return Case(call, judge)


def _physical(rng, index):
    m, length, k1 = few(rng, 0.2, 5, 3), even(rng, 0.2, 1.5, 3), few(rng, 50, 900, 3)
    arm = even(rng, 0.02, 0.2, 2)
    inertia = float(f"{m * arm**2 * rng.uniform(1.3, 4):.4g}")
    k2, loss, force, nu = (
        few(rng, 1, 2000, 2),
        even(rng, 0, 0.5, 2),
        even(rng, 0, 1, 2),
        even(rng, 1, 20, 3),
    )
    call = f"""system = vv.Pendulum.from_physical(
    m={m}, I_A={inertia}, E={arm}, L0={length}, k1={k1}, k2={k2}, C1={loss}, C2={loss}, C3={loss}, F1={force}, Omega1={nu}
)
numbers = [getattr(system, name) for name in ("e", "w2", "w3", "alpha", "c1", "c2", "c3", "f0", "p1")]
"""

    def judge(names, reported):
        roots = np.roots([k2, 0, k1, -m * 9.81])
        z = float(next(x.real for x in roots if abs(x.imag) < 1e-9))
        for _ in range(3):
            z -= (k2 * z**3 + k1 * z - m * 9.81) / (3 * k2 * z**2 + k1)
        whole, omega = length + z, math.sqrt(k1 / m)
        true = np.array([
            arm / whole, math.sqrt(9.81 / whole) / omega, math.sqrt(m * 9.81 * arm / inertia) / omega,
            k2 * whole**2 / k1, loss / (m * omega), loss / (m * whole**2 * omega),
            loss / (inertia * omega), force / (m * whole * omega**2), nu / omega,
        ])  # fmt: skip
        yield Claim(
            "dimensionless numbers", np.array(names["numbers"]), true, 1e-13 * true + 1e-300
        )

    return Case(call, judge, may_refuse=True)


def _polynomial_energy(rng, index):
    model = chain(rng, int(rng.integers(1, 4)), 0.0, quadratic=True).model()
    n = model.n
    state = (rng.normal(size=(3, 2 * n)) * 0.5).round(3)
    call = f"""system = {model.source}
energy = system.energy({state.tolist()})
run = vv.simulate(system, 12, dt=0.05, initial={(state[0] * 0.3).tolist()})
drift, defect = system.energy(run.state) - system.energy(run.state[0]), run.energy_defect()
outcome, reached = run.outcome, run.t_reached
"""

    def judge(names, reported):
        # Work of the forces along a straight line from rest, by Gauss quadrature.
        x, w = np.polynomial.legendre.leggauss(8)
        x, w = (x + 1) / 2, w / 2
        u, v = state[:, ::2], state[:, 1::2]
        work = [sum(w[i] * (model.groups[0].force(x[i] * a) @ a) for i in range(8)) for a in u]
        true = np.array(work) + 0.5 * np.einsum("ta,ab,tb->t", v, model.mass, v)
        yield Claim(
            "energy of a polynomial system", names["energy"], true, 1e-13 * (1 + np.abs(true))
        )
        if names["outcome"] == "diverged":
            # A spring of negative stiffness: energies of a divergent motion are differences of large numbers.
            gone = escape(model.equations(None), model.start(state[0] * 0.3), n, 12.0)
            yield Claim("it runs away", gone is not None, True)
            if gone is not None:
                yield Claim("when", names["reached"], gone, 0.01 * gone, damage=0.1)
            return
        size = np.abs(true).max()
        yield Claim("energy is kept", 1 + np.abs(names["drift"]).max(), 1.0, 1e-11 * (1 + size))
        yield Claim(
            "energy_defect", 1 + np.abs(names["defect"]).max(), 1.0, 1e-6 * (1 + size), damage=1e-4
        )

    return Case(call, judge, may_refuse=True)


def case(rng, index):
    """Draw a system and states."""
    return (_equations, _physical, _equations, _polynomial_energy)[index % 4](rng, index // 4)
