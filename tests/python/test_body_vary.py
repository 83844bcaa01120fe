"""Branches over numbers of a body, against separate bodies and an independent balance."""

import dataclasses

import numpy as np
import pytest
import viscovib as vv
from referee.integration import solve_ivp
from scipy.optimize import fsolve
from test_body import DATA, engine
from viscovib.units import hz

KERNEL = vv.PronyKernel(weights=[2.0], rates=[60.0])
NU = 11.5 * hz
TORQUE = 20.0


def body_with(name, p):
    """The engine of the table with one changed number, with public arguments only."""
    given = {"mass": DATA["mass"], "inertia": np.array(DATA["inertia"])}
    center = np.zeros(3)
    mounts = list(engine(KERNEL, "1e10*d^3").mounts)
    if name == "mass":
        given["mass"] = p
    elif name == "inertia_scale":
        given["inertia"] = p * given["inertia"]
    elif name == "center[z]":
        center[2] = p
    else:
        place, key, entry = int(name[8]) - 1, *name[11:].split("[")
        value = np.array(getattr(mounts[place], key), dtype=float)
        value["xyz".index(entry[0])] = p
        mounts[place] = dataclasses.replace(mounts[place], **{key: value})
    return vv.Body(**given, mounts=mounts, center=center)


RANGES = {
    "mass": (150, 180),
    "inertia_scale": (0.9, 1.2),
    "center[z]": (-0.04, 0.04),
    "mounts[m2].stiffness[z]": (3e5, 5e5),
    "mounts[m3].damping[x]": (0, 300),
    "mounts[m1].position[x]": (-0.1, 0.1),
}


@pytest.mark.parametrize("name", RANGES)
def test_points_are_motions_of_bodies_with_that_number(name):
    """First, middle and last point satisfy the balance at 64 samples of a body with that number."""
    body = engine(KERNEL, "1e10*d^3")
    load = body.load(torque=(0, TORQUE, 0)).real
    branch = vv.trace_response(
        body, nu=NU, vary=name, vary_range=RANGES[name], load=load, harmonics=5, tolerance=1e-6,
    )  # fmt: skip
    assert branch.varies == name
    for i in (0, branch.parameter.size // 2, branch.parameter.size - 1):
        other = body_with(name, float(branch.parameter[i]))
        start = branch.coefficients[i]
        expected = balance(other, load, branch.harmonics, start)
        np.testing.assert_allclose(start, expected, atol=1e-8 * np.abs(expected).max())


def balance(body, load, orders, start):
    """Harmonics of M u'' + sum_j c_j (1 - R) (k_j d_j + 1e10 d_j^3) = F sin(nu t)."""
    springs = body._mount_springs
    mass = np.zeros((6, 6))
    mass[:3, :3], mass[3:, 3:] = body.body_mass * np.eye(3), body.inertia
    phase = np.exp(1j * np.outer(orders, np.arange(64) * 2 * np.pi / 64))
    kept = 1 - KERNEL.weights[0] / (KERNEL.rates[0] + 1j * orders * NU)

    def residual(numbers):
        u = (numbers[: start.size] + 1j * numbers[start.size :]).reshape(start.shape)
        d = (springs.rows @ u @ phase).imag
        force = springs.stiffness[:, None] * d
        force[2::3] += 1e10 * d[2::3] ** 3
        waves = 2j * (force @ phase.conj().T) / 64
        rate = springs.damping[:, None] * (springs.rows @ u) * (1j * orders * NU)
        left = -((orders * NU) ** 2) * (mass @ u) + springs.rows.T @ (kept * waves + rate)
        left[:, orders == 1] -= load[:, None]
        left = left.ravel() / TORQUE
        return np.concatenate([left.real, left.imag])

    size = 1e-4
    first = np.concatenate([start.real.ravel(), start.imag.ravel()])
    found = fsolve(lambda x: residual(size * x), first / size, xtol=1e-13) * size
    return (found[: start.size] + 1j * found[start.size :]).reshape(start.shape)


@pytest.mark.parametrize(
    ("key", "ends"),
    [("k3", (1e6, 2e7)), ("k", (1e4, 5e4)), ("F", (1, 5)), ("w", (0.01, 0.02))],
)
def test_parameters_of_laws(key, ends):
    """Points are motions of bodies with that number in the laws of one mount."""
    numbers = {"k3": 1e7, "k": 3e4, "F": 3.0, "w": 0.01}

    def body(**changed):
        laws = ("k3*d^3", None, "k*d + F*tanh(v/w)")
        mounts = [
            vv.MountPoint(
                name=name, position=p, stiffness=(1e4, 1.2e4, 2e4), damping=20.0, law=laws,
                parameters=numbers | (changed if name == "b" else {}),
            )
            for name, p in {"a": (0.3, 0, -0.1), "b": (-0.2, 0.2, -0.1), "c": (0, -0.3, 0)}.items()
        ]  # fmt: skip
        return vv.Body(mass=20, inertia=(0.5, 0.6, 0.7), mounts=mounts)

    one = body()
    load = one.load((3, 0, 8))
    branch = vv.trace_response(
        one, nu=50.0, vary=f"mounts[b].{key}", vary_range=ends, load=load, tolerance=1e-8
    )
    assert branch.outcome == "completed"
    for i in (0, -1):
        other = body(**{key: float(branch.parameter[i])})
        found = vv.forced_response(other, [50.0], load=load, method="newton", tolerance=1e-8)
        at, n = branch.coefficients[i], min(branch.harmonics.size, found.harmonics.size)
        near = 2e-8 * np.abs(at).max()
        np.testing.assert_allclose(found.coefficients[0, :, :n], at[:, :n], atol=near)


@pytest.mark.parametrize(
    ("name", "reported"),
    [
        ("mounts[m9].stiffness[z]", "m9"),
        ("mounts[m1].stiffnes[z]", "must be a number of a mount"),
        ("mounts[m1].stiffness[w]", "must be a number of a mount"),
        ("weight", "vary = 'weight'"),
    ],
)
def test_names_that_are_none(name, reported):
    """One line with the name and the allowed values."""
    body = engine(KERNEL, "1e10*d^3")
    with pytest.raises(vv.InputError, match=reported):
        vv.trace_response(body, nu=NU, vary=name, vary_range=(1, 2), load={"z": 10.0})


def test_values_and_results_that_are_refused():
    """Negative numbers, numbers without a power law, and forces of another body."""
    body = engine(KERNEL, "1e10*d^3")
    given = {"nu": NU, "load": body.load(torque=(0, TORQUE, 0)).real}
    with pytest.raises(vv.InputError, match="mass = -1"):
        vv.trace_response(body, vary="mass", vary_range=(-1, 100), **given)
    with pytest.raises(vv.InputError, match="must not be less than 0"):
        vv.trace_response(body, vary="mounts[m1].stiffness[x]", vary_range=(-1, 100), **given)
    heavy = engine(None, "1e10*d^3", gravity=9.81)
    with pytest.raises(vv.InputError, match="static deflection on progressive mounts"):
        vv.trace_response(heavy, vary="mass", vary_range=(100, 200), **given)
    branch = vv.trace_response(body, vary="mass", vary_range=(160, 165), tolerance=1e-4, **given)
    with pytest.raises(vv.InputError, match="mass varies along it"):
        body.mount_forces(branch)


def test_left_handed_axes_are_reported():
    with pytest.raises(vv.InputError, match="left-handed, reverse one"):
        vv.MountPoint(name="a", position=(0, 0, 0), stiffness=(1, 1, 1), axes=-np.eye(3))


@pytest.mark.parametrize("law", ["k3*d^3 + c3*v*d^2", "k3*d^3 + 2e4*max(d - gap, 0)"])
def test_ensembles_over_numbers_of_bodies(law):
    """Newton-Euler equations by SciPy; smooth laws in parallel."""
    rng = np.random.default_rng(7)
    places = np.array([[-0.3, -0.2, -0.1], [0.3, -0.2, -0.1], [0.05, 0.25, -0.1]])
    numbers = {"k3": 1e7, "c3": 1e5, "gap": 1e-3}
    used = {name: value for name, value in numbers.items() if name in law}
    mounts = [
        vv.MountPoint(
            name=name, position=place, stiffness=(1e4, 8e3, 2e4), damping=(50, 40, 80),
            law=(None, None, law) if name == "a" else None,
            parameters=used if name == "a" else None,
        )
        for name, place in zip("abc", places, strict=True)
    ]  # fmt: skip
    body = vv.Body(mass=20, inertia=[0.8, 1.0, 1.2], mounts=mounts)
    own = "c3" if "c3" in used else "gap"
    values = {
        "mass": [18.0, 25.0],
        "mounts[a].k3": [2e7, 4e7],
        f"mounts[a].{own}": [1.7 * used[own], 0.6 * used[own]],
        "mounts[b].stiffness[z]": [3e4, 1e4],
        "mounts[c].damping_scale": [2.0, 0.5],
    }
    starts = 1e-3 * rng.normal(size=(2, 12))
    many = vv.simulate_ensemble(
        body, initial=starts, t_end=0.15, load={"z": 200.0}, nu=60.0, parameters=values
    )
    assert ("8 side by side" in str(many.plan)) == ("max" not in law)
    for i in range(2):
        mine = {name: value[i] for name, value in values.items()}
        stiffness = np.tile([1e4, 8e3, 2e4], (3, 1))
        stiffness[1, 2] = mine["mounts[b].stiffness[z]"]
        damping = np.tile([50.0, 40.0, 80.0], (3, 1))
        damping[2] *= mine["mounts[c].damping_scale"]
        gap = mine.get("mounts[a].gap", np.inf)
        c3 = mine.get("mounts[a].c3", 0.0)

        def motion(t, y, mine=mine, stiffness=stiffness, damping=damping, gap=gap, c3=c3):
            u, w = y[0::2], y[1::2]
            d = u[:3] + np.cross(u[3:], places)
            v = w[:3] + np.cross(w[3:], places)
            force = -stiffness * d - damping * v
            z, rate = d[0, 2], v[0, 2]
            force[0, 2] -= mine["mounts[a].k3"] * z**3 + c3 * rate * z**2
            force[0, 2] -= 2e4 * max(z - gap, 0)
            push = force.sum(0) + [0, 0, 200 * np.sin(60 * t)]
            turn = np.cross(places, force).sum(0)
            rates = np.empty(12)
            rates[0::2] = w
            rates[1::2] = [*(push / mine["mass"]), *(turn / [0.8, 1.0, 1.2])]
            return rates

        run = solve_ivp(motion, (0, 0.15), starts[i], rtol=1e-10, atol=1e-13, max_step=2e-3)
        np.testing.assert_allclose(many.state[i], run.y[:, -1], atol=3e-8 + 10 * many.error)


def test_ensembles_of_bodies_name_what_varies():
    """The names of one mount are listed; meaningless numbers are refused by name."""
    body = vv.Body(
        mass=1,
        inertia=[1, 1, 1],
        mounts=[
            vv.MountPoint(name=name, position=place, stiffness=(1, 1, 1))
            for name, place in (("a", (0, 0, 0)), ("b", (1, 0, 0)), ("c", (0, 1, 0)))
        ],
    )
    for name, words in (
        ("k3", r"must be one of nu, load_scale, mass, .*mounts\[a\].position_scale$"),
        ("mounts[a].stiffness[z]", "must not be less than 0, got -1"),
    ):
        with pytest.raises(vv.InputError, match=words):
            vv.simulate_ensemble(body, initial=np.zeros(12), t_end=1, parameters={name: [-1.0]})
