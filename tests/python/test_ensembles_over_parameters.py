"""Ensembles over parameters of laws and elements: parallel runs equal single runs."""

import numpy as np
import pytest
import viscovib as vv
from viscovib.systems.many_numbers import scaled_parts, systems_of_parameters
from viscovib.systems.whole import whole_system, whole_with_parameters

TERMS = (
    "{p}*tanh({v}/{q})", "{p}*sin({q}*{x})", "{p}*{x}^3", "{p}*{x}^2*{y}", "{p}*{v}^3",
    "{p}*exp(-({x}/(1 + {q}^2))^2)*{v}", "{p}*{x}/(1 + {x}^2)", "{p}*{x}*sqrt(1 + {q}*{x}^2)",
    "{p}*{x}", "{x}^3*{p}^2", "{p}*{x}*(1 + {x}^2)^{q}", "{p}*cos({q})*{x}^5", "sinh({p}*{x})",
    "{p}*tanh({x} + {p})", "{p}*atan2({x}, 1 + {q}^2)",
)  # fmt: skip


def drawn(rng):
    """A system of one to three coordinates whose forces contain a, b and c."""
    d = int(rng.integers(1, 4))
    names = ("x",) if d == 1 else tuple(f"x{i + 1}" for i in range(d))
    forces = {}
    for name in names:
        terms = []
        for _ in range(rng.integers(1, 4)):
            p, q = rng.choice(["a", "b", "c", "0.3"], 2)
            x, y = rng.choice(names, 2)
            q = "b" if q == "c" else q
            terms.append(str(rng.choice(TERMS)).format(p=p, q=q, x=x, y=y, v=f"{x}_dot"))
        forces[name] = " + ".join(terms)
    forces[names[0]] += " + a*x^3*b".replace("x", names[0])
    return vv.PolynomialSystem(
        mass=rng.uniform(0.8, 1.5, d), stiffness=rng.uniform(0.5, 2, d),
        damping=rng.uniform(0.05, 0.3, d), forces=forces,
        parameters={"a": 0.5, "b": 0.4, "c": -0.2},
    )  # fmt: skip


def values(rng, n):
    """Values of a, b and c; some make a term vanish, or turn a power into a square."""
    of = {name: rng.uniform(0.2, 0.9, n) for name in "abc"}
    of["a"][rng.random(n) < 0.3] = 0.6
    of["c"][rng.random(n) < 0.3] = 0.0
    of["b"][rng.random(n) < 0.3] = 1.0
    return of


def with_values(system, of, i):
    for name, x in of.items():
        system = system._with_parameters({name: float(x[i])})
    return system


@pytest.mark.parametrize("seed", range(10))
def test_numbers_of_all_runs_at_once_are_those_of_each(seed):
    """The core uses the same numbers, bitwise, as for a system with these parameters."""
    rng = np.random.default_rng(seed)
    system, n = drawn(rng), 9
    of = values(rng, n)
    of = {name: x for name, x in of.items() if name in system._named_parameters}
    many = systems_of_parameters(system, of)
    for i in range(n):
        flat = many.flat[i, : many.lengths[i]]
        assert np.array_equal(flat, with_values(system, of, i)._flat)


ASKED = (
    {"statistics": True, "amplitudes_at": [1.0, 2.0], "t_end": 6.0, "discard": 1.0},
    {"sections": 1, "n_periods": 2, "lyapunov": True, "method": "dop8"},
    {"sections": 1, "n_periods": 2, "lyapunov": "all"},
    {"statistics": True, "t_end": 6.0, "method": "gauss8"},
    {"statistics": True, "t_end": 6.0, "method": "taylor20"},
)
GATHERED = ("state", "t_reached", "peak", "mean", "rms", "amplitudes", "sections", "lyapunov")


@pytest.mark.parametrize("asked", ASKED, ids=lambda asked: asked.get("method", "verner9"))
def test_each_lane_is_the_run_alone(asked):
    """All statistics, bitwise."""
    kinds = set()
    for seed in range(6):
        rng = np.random.default_rng([seed, 1])
        system, n = drawn(rng), int(rng.integers(2, 14))
        if asked.get("method") == "taylor20" and any(
            word in str(system.forces) for word in ("atan2", "^a", "^b", "^c", "^0.3")
        ):
            continue
        of = values(rng, n)
        of = {name: x for name, x in of.items() if name in system._named_parameters}
        start = rng.uniform(-0.6, 0.6, (n, 2 * len(system.dof_names)))
        nu = rng.uniform(0.8, 1.6, n)
        load = {system.dof_names[0]: 0.3}
        many = vv.simulate_ensemble(
            system, initial=start, parameters={**of, "nu": nu}, load=load, dt=0.1, **asked
        )
        assert "side by side" in str(many.plan)
        kinds.add(np.unique(systems_of_parameters(system, of).lengths).size > 1)
        for i in rng.permutation(n)[:4]:
            one = vv.simulate_ensemble(
                with_values(system, of, i), initial=start[i : i + 1], load=load,
                parameters={"nu": nu[i : i + 1]}, dt=float(many.step[i]), **asked,
            )  # fmt: skip
            for name in GATHERED:
                whole, its = getattr(many, name), getattr(one, name)
                if whole is not None:
                    assert np.array_equal(whole[i : i + 1], its, equal_nan=True), (seed, name)
    assert True in kinds


def test_layers_of_each_lane_are_seen():
    """A law that is thin in some runs only: these runs use divided steps and are accurate."""
    widths = np.array([0.3, 1e-4, 0.2, 1e-3])
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, forces="0.4*tanh(x_dot/w)", parameters={"w": 0.5}
    )
    many = vv.simulate_ensemble(system, initial=[3.0, 0], t_end=5.0, parameters={"w": widths})
    for w, state in zip(widths, many.state, strict=True):
        alone = with_values(system, {"w": [w]}, 0)
        one = vv.simulate(alone, initial=[3.0, 0], t_end=5.0, tolerance=1e-9)
        assert np.abs(one.state[-1] - state).max() < 2e-8


def test_numbers_of_elements_side_by_side():
    """Laws and stiffnesses of a structure, against single runs of separate structures."""

    def made(force=0.3, stiffness=0.5, cubic=0.1):
        return vv.Structure(
            mass=np.eye(2), stiffness=[[2, -1], [-1, 2]], damping=0.05 * np.eye(2),
            elements=[
                vv.Spring(on="x1", law="F*tanh(v/0.3)", parameters={"F": force}),
                vv.Spring(on=("x1", "x2"), stiffness=stiffness, law="k3*d^3",
                          parameters={"k3": cubic}),
            ],
        )  # fmt: skip

    of = {"force": [0.3, 0.0, 0.2, 0.5], "stiffness": [0.1, 0.5, 1, 2], "cubic": [1, 0, 0.2, 0]}
    names = ("elements[0].F", "elements[1].stiffness", "elements[1].k3")
    many = vv.simulate_ensemble(
        made(), initial=[1, 0, 0.5, 0], t_end=8.0,
        parameters=dict(zip(names, of.values(), strict=True)),
    )  # fmt: skip
    assert "side by side" in str(many.plan)
    for cubic in (0.0, 0.7):  # the matrices of the structure do not change
        flat, own = whole_with_parameters(made(), {"elements[1].k3": cubic})
        whole = whole_system(made(cubic=cubic))
        assert np.array_equal(flat, whole._flat)
        assert np.array_equal(own, scaled_parts(whole))
    for i, state in enumerate(many.state):
        alone = made(**{name: x[i] for name, x in of.items()})
        one = vv.simulate(alone, initial=[1, 0, 0.5, 0], t_end=8.0, tolerance=1e-11)
        assert np.abs(one.state[-1] - state).max() < 1e-8


def test_what_no_run_may_have_is_reported_of_the_run():
    system = vv.PolynomialSystem(
        mass=1, stiffness=1, forces="0.4*tanh(x_dot/w)", parameters={"w": 0.5}
    )
    with pytest.raises(vv.InputError, match="divides by 0"):
        vv.simulate_ensemble(system, initial=[1, 0], t_end=5.0, parameters={"w": [0.5, 0.0]})
